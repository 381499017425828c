"""Particles that are drawn on epipolar lines, all of them after a loss, and colours that adapt."""

from dataclasses import replace

import numpy as np
import pytest
from view_states import BLIND, BLUE, RED, ROWS, changed, disc, frames_at, painted, state_of

from occlog.track.methods.images.interface import MODES
from occlog.track.methods.images.methods.config import CmctConfig
from occlog.track.methods.images.methods.restart import SAME_TARGET_RADII, adapt_colours, propose_on_lines
from occlog.track.methods.images.methods.step import advance
from occlog.track.methods.images.methods.weigh import arrival_of, local_weights, weigh

ONE, TWO = disc(40.0, 40.0), disc(80.0, 60.0)
BOTH = painted((ONE, RED), (TWO, BLUE))
COUNT = 10
CONFIG = CmctConfig(particles=COUNT, epipolar_fraction=0.3)


def rng():
    return np.random.default_rng(11)


def pair(config=CONFIG, distance=40.0, geometry=ROWS):
    """Two targets so far apart in view a, and far apart in view b."""
    births = [(0, 1, ONE), (0, 2, disc(40.0 + distance, 40.0)), (1, 1, disc(30.0, 40.0)), (1, 2, disc(90.0, 40.0))]
    return (
        state_of(config, births, (BOTH, BOTH)) if geometry is None else state_of(config, births, (BOTH, BOTH), geometry)
    )


def drawn(state, gap=None):
    """How many particles of each tracker are drawn on lines."""
    particles = state.trackers.particles + 100.0
    out = propose_on_lines(state, state.config, particles, np.ones(len(particles)) if gap is None else gap, rng())
    np.testing.assert_array_equal(out[..., 2:], particles[..., 2:])
    return (out != particles).any(axis=2).sum(axis=1).tolist()


def test_a_share_of_the_particles_is_drawn_on_the_line():
    assert drawn(pair()) == [3] * 4
    assert drawn(pair(replace(CONFIG, epipolar_fraction=0.0))) == [0] * 4
    assert drawn(pair(replace(CONFIG, epipolar_fraction=1.0))) == [COUNT] * 4


@pytest.mark.parametrize(("similarities", "count"), [(0.7, 3), (np.nextafter(0.7, 0.0), COUNT)])
def test_all_particles_are_drawn_on_the_line_when_the_estimate_was_not_like_the_target(similarities, count):
    state = pair(replace(CONFIG, max_similarity_to_search=0.7))
    assert drawn(changed(state, similarities=np.array([similarities, 1.0, 1.0, 1.0]))) == [count, 3, 3, 3]


@pytest.mark.parametrize(("radii", "count"), [(SAME_TARGET_RADII, 3), (SAME_TARGET_RADII - 1e-9, COUNT), (0.0, COUNT)])
def test_all_are_drawn_when_a_counterpart_is_bad_and_another_tracker_is_at_the_same_place(radii, count):
    state = pair(distance=16.0 * radii)
    assert drawn(state) == [3] * 4
    bad = state.trackers.good.copy()
    bad[0, 1] = False
    assert drawn(changed(state, good=bad)) == [count, 3, 3, 3]


def test_a_pair_that_was_not_checked_is_no_sign_of_a_loss():
    state = pair(distance=0.0)
    nothing = np.zeros_like(state.trackers.good)
    assert drawn(changed(state, good=nothing, checked=nothing)) == [3] * 4


@pytest.mark.parametrize(("gap", "count"), [(1.0, 3), (2.0, 0)])
def test_a_counterpart_whose_view_missed_a_frame_gives_no_line(gap, count):
    assert drawn(pair(), np.array([1.0, 1.0, gap, gap])) == [count, count, 3, 3]


def test_without_a_matrix_or_a_counterpart_particles_stay():
    assert drawn(pair(geometry=BLIND)) == [0] * 4
    state = pair()
    assert drawn(changed(state, counterpart=np.full_like(state.trackers.counterpart, -1))) == [0] * 4


def test_particles_are_spread_along_and_across_the_line_about_the_expected_place():
    """The line of the first target is row 40; its tracker is expected 3 px below it and 2 px to the right."""
    config = replace(CONFIG, particles=4000, epipolar_fraction=1.0, sigma_along_line_px=6.0, sigma_across_line=0.25)
    state = pair(config)
    state = changed(state, velocity=np.tile([1.0, 1.5], (4, 1)))
    gap = np.array([2.0, 1.0, 1.0, 1.0])
    counterpart = state.trackers.counterpart.copy()
    counterpart[1:] = -1
    velocity = np.tile([1.0, 1.5], (4, 1))
    velocity[2] = 0.0
    state = changed(state, counterpart=counterpart, velocity=velocity)
    out = propose_on_lines(state, config, state.trackers.particles, gap, rng())[0]
    # 4 standard errors of the means and of the standard deviations
    assert out[:, 0].mean() == pytest.approx(42.0, abs=4 * 6.0 / np.sqrt(4000))
    assert out[:, 1].mean() == pytest.approx(40.0, abs=4 * 2.0 / np.sqrt(4000))
    assert out[:, 0].std() == pytest.approx(6.0, rel=4 / np.sqrt(8000))
    assert out[:, 1].std() == pytest.approx(0.25 * 8.0, rel=4 / np.sqrt(8000))


def test_weights_are_those_of_the_colours():
    state = pair()
    arrival = arrival_of(state, frames_at(1, BOTH, BOTH))
    local = local_weights(state, frames_at(1, BOTH, BOTH), arrival, rng())
    weighed = weigh(state, arrival, local, rng())
    want = np.exp(local.log_local - local.log_local.max(axis=1, keepdims=True))
    np.testing.assert_allclose(weighed.weights, want / want.sum(axis=1, keepdims=True), rtol=1e-12)
    assert (weighed.mode == MODES.index("cmct")).all()


def adapted(state, similarities, here=None, estimate=None):
    """The colours after estimates on the other target."""
    t = state.trackers
    state = changed(state, similarities=similarities, estimate=t.estimate if estimate is None else estimate)
    return adapt_colours(state, state.config, np.ones(len(t.view), dtype=bool) if here is None else here).colours


def swapped():
    """Trackers of two targets of other colours in view a, and the estimates of each at the other."""
    state = state_of(
        replace(CONFIG, appearance_learning_rate=0.25, min_similarity_to_adapt=0.9),
        [(0, 1, ONE), (0, 2, TWO)],
        (BOTH, BOTH),
    )
    return state, state.trackers.estimate[::-1].copy()


@pytest.mark.parametrize(("similarities", "share"), [(0.9, 0.25), (1.0, 0.25), (np.nextafter(0.9, 0.0), 0.0)])
def test_colours_follow_those_of_estimates_that_are_alike_enough(similarities, share):
    state, estimate = swapped()
    old = state.trackers.colours
    got = adapted(state, np.array([similarities, 0.0]), estimate=estimate)
    np.testing.assert_allclose(got, [(1 - share) * old[0] + share * old[1], old[1]], atol=1e-12)
    np.testing.assert_array_equal(old, state.trackers.colours)


def test_colours_stay_where_the_view_has_no_frame():
    state, estimate = swapped()
    got = adapted(state, np.ones(2), np.zeros(2, dtype=bool), estimate)
    np.testing.assert_array_equal(got, state.trackers.colours)


def test_colours_keep_their_sum_at_the_edge_of_the_image():
    state, estimate = swapped()
    estimate[0] = disc(-0.5, 60.0)
    got = adapted(state, np.ones(2), estimate=estimate)
    np.testing.assert_allclose(got.sum(axis=1), state.trackers.colours.sum(axis=1))


def test_the_step_of_cmct_does_all_of_that():
    state = pair(distance=40.0)
    after, outlines = advance(state, frames_at(1, BOTH, BOTH), rng())
    assert (outlines.likelihood_mode == MODES.index("cmct")).all()
    assert not outlines.touching.any()
    assert outlines.counterpart.all()
    assert after.trackers.colours.shape == state.trackers.colours.shape
