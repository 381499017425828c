"""Times of the likelihoods of `bmct`."""

import numpy as np
from view_films import begun, film, frame_set

from occlog.papers.qu.timing import likelihood_seconds


def test_times_are_taken_without_changing_anything():
    frames = film(count=2)
    state, rng = begun("bmct", frames, particles=10)
    kept, bits = [np.array(field) for field in state.trackers], rng.bit_generator.state
    seconds = likelihood_seconds(state, state.config, frame_set(frames[1]), rng, 3)
    assert len(seconds) == 3
    assert seconds[0] > 0.0
    assert min(seconds) >= 0.0
    assert rng.bit_generator.state == bits
    assert all(np.array_equal(a, b) for a, b in zip(kept, state.trackers, strict=True))
