"""Frames of the tracker in several views against the same written in plain NumPy."""

import numpy as np
import pytest
import view_reference as ref
from view_films import begun, film, frame_set, geometry_of

from occlog.core.image import update_bins
from occlog.simulate.balls.config import BallsConfig
from occlog.track.methods.images.methods.step import advance

PAIR = BallsConfig(frames=25, width=100, height=80, balls=5, radius=9.0, ball_speed=4.0, background_clutter=2)
CROWDED = BallsConfig(
    frames=25, width=100, height=80, balls=5, radius=9.0, ball_speed=4.0, views=3, background_clutter=2
)


@pytest.mark.parametrize(
    ("config", "settings"),
    [
        (PAIR, {}),
        pytest.param(CROWDED, {}, marks=pytest.mark.jit),
        pytest.param(
            CROWDED, {"clear_distance": 0.0, "sweeps": 3, "iterations": 2, "pixel_step": 1}, marks=pytest.mark.jit
        ),
    ],
)
def test_frames_are_those_of_the_plain_form(config, settings):
    frames, helped = film(config, 3, 10), 0
    state, rng = begun("bmct", frames, config, particles=12, **settings)
    for frame in frames[1:]:
        twin = np.random.default_rng()
        twin.bit_generator.state = rng.bit_generator.state
        before = state.trackers
        normals = twin.standard_normal(before.particles.shape)
        order, u = twin.permutation(len(state.views)), twin.random(len(before.view))
        state, report = advance(state, frame_set(frame), rng)
        bins = [ref.bins_of(image).astype(int) for image in frame.images]
        want = ref.frame(before, state.config, geometry_of(config).fundamental, bins, normals, order, u)
        np.testing.assert_allclose(report.ellipse, want.estimate, rtol=1e-8, atol=1e-8)
        np.testing.assert_array_equal(report.assisting_views, want.helped)
        np.testing.assert_array_equal(report.touching, want.touching)
        np.testing.assert_allclose(report.ess, 1 / (want.weights**2).sum(axis=1), rtol=1e-6)
        np.testing.assert_allclose(state.trackers.velocity, want.velocity, rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(state.trackers.path, want.path, rtol=1e-7, atol=1e-8)
        np.testing.assert_allclose(state.trackers.particles, want.resampled, rtol=1e-9, atol=1e-9)
        helped += want.helped.sum()
    assert helped > 10


def test_bins_of_the_plain_form():
    image = np.random.default_rng(1).integers(0, 256, (30, 40, 3)).astype(np.uint8)
    bins = np.zeros(image.shape[:2], dtype=np.uint8)
    update_bins(bins, image, np.array([[0, 0, image.shape[1], image.shape[0]]]))
    np.testing.assert_array_equal(ref.bins_of(image), bins)
