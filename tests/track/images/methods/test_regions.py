"""What the regions of a detector tell the trackers."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.measure.epipolar.views import TrackedView, ViewGeometry
from occlog.track.methods.images.interface import Birth, FrameSet
from occlog.track.methods.images.kernels.appearance import colours_in
from occlog.track.methods.images.methods.config import CONFIGS, MipfConfig
from occlog.track.methods.images.methods.state import (
    OUTSIDE,
    drawn_at_regions,
    initial_state,
    log_region_likelihood,
    mask_outside,
    own_regions,
)
from occlog.track.methods.images.methods.step import advance, initiate_trackers

SIZE = (120, 90)
ROW = np.array([[30.0, 40.0, 6.0, 15.0, 0.0]])


def frame_set(regions: tuple[np.ndarray | None, ...], image: np.ndarray | None = None) -> FrameSet:
    return FrameSet(0, np.zeros(1, dtype=np.int64), (image,), regions)


def at(*positions: tuple[float, float]) -> np.ndarray:
    """Ellipses of one size."""
    return np.array([[x, y, 6.0, 15.0, 0.0] for x, y in positions]).reshape(-1, 5)


def test_colours_count_inside_boxes_only() -> None:
    bins = np.full((90, 120), 7, dtype=np.uint8)
    mask_outside(bins, np.array([[0, 0, 120, 60]]), frame_set((at((30.0, 40.0), (116.0, 2.0)),)), 0)
    y, x = np.mgrid[:90, :120]
    first = (abs(x - 30.0) <= 6.0) & (abs(y - 40.0) <= 15.0)
    second = (abs(x - 116.0) <= 6.0) & (abs(y - 2.0) <= 15.0)
    np.testing.assert_array_equal(bins == 7, first | second | (y >= 60))
    assert set(np.unique(bins)) == {7, OUTSIDE}
    whole = colours_in(bins, ROW, np.zeros(len(ROW), dtype=bool), 1)
    assert whole[0, 7] == pytest.approx(1.0, abs=1e-9)  # the ellipse is inside its box
    assert colours_in(bins, at((60.0, 30.0)), np.zeros(1, dtype=bool), 1).sum() == 0.0


@pytest.mark.parametrize("regions", [(), (None,)])
def test_without_a_detector_nothing_is_masked(regions: tuple[None, ...]) -> None:
    bins = np.full((90, 120), 7, dtype=np.uint8)
    mask_outside(bins, np.array([[0, 0, 120, 90]]), frame_set(regions), 0)
    assert (bins == 7).all()


def test_without_regions_all_is_masked() -> None:
    bins = np.full((90, 120), 7, dtype=np.uint8)
    mask_outside(bins, np.array([[-5, -5, 500, 500]]), frame_set((at(),)), 0)
    assert (bins == OUTSIDE).all()


def test_a_region_is_held_where_no_other_tracker_or_region_is_near() -> None:
    expected = at((30.0, 40.0), (80.0, 40.0), (84.0, 40.0), (30.0, 200.0))
    regions = at((33.0, 42.0), (82.0, 40.0), (31.0, 201.0), (29.0, 198.0))
    found = own_regions(frame_set((regions,)), np.zeros(4, dtype=np.int64), expected, 0.6)
    # Two trackers share a region; two regions are at the last tracker.
    assert found.has.tolist() == [True, False, False, False]
    np.testing.assert_array_equal(found.region[0], regions[0])
    assert np.isnan(found.region[1:]).all()


@pytest.mark.parametrize(("away", "own"), [(6.0, True), (6.0 + 1e-9, False)])
def test_a_region_is_near_up_to_the_reach(away: float, own: bool) -> None:
    """Half a sum of radii of 6 px each."""
    expected = at((30.0, 40.0))
    found = own_regions(frame_set((at((30.0 + away, 40.0)),)), np.zeros(1, dtype=np.int64), expected, 0.5)
    assert found.has.tolist() == [own]


def test_regions_of_another_view_are_none_of_ones_own() -> None:
    both = FrameSet(0, np.zeros(2, dtype=np.int64), (None, None), (None, at((30.0, 40.0))))
    found = own_regions(both, np.array([0, 1]), at((30.0, 40.0), (30.0, 40.0)), 0.6)
    assert found.has.tolist() == [False, True]


def test_particles_are_drawn_to_the_region() -> None:
    rng = np.random.default_rng(3)
    particles = np.repeat(at((30.0, 40.0), (80.0, 40.0))[:, None], 50, axis=1)
    region = np.array([[36.0, 42.0, 8.0, 18.0, 0.0]])
    found = own_regions(frame_set((region,)), np.zeros(2, dtype=np.int64), particles[:, 0], 0.6)
    out = drawn_at_regions(particles, found, rng.standard_normal(particles.shape), 0.4, 0.1)
    np.testing.assert_array_equal(out[1], particles[1])
    np.testing.assert_array_equal(out[0, 20:], particles[0, 20:])
    assert np.abs(out[0, :20, :2] - region[0, :2]).max() < 4.0 * 0.1 * 12.0
    np.testing.assert_array_equal(out[0, :20, 2:], np.repeat(region[:, 2:], 20, axis=0))
    log_weights = log_region_likelihood(particles[:, 20], found, np.array([0, 1]), 0.25)
    np.testing.assert_allclose(log_weights, [-0.5 * (36.0 + 4.0) / (8.0 * 18.0) / 0.25**2, 0.0])


def test_tracker_follows_a_region_in_place_and_size_where_colours_tell_nothing() -> None:
    geometry = ViewGeometry(np.full((1, 1, 3, 3), np.nan), (None,))
    rng = np.random.default_rng(5)
    image = np.full((90, 120, 3), 90, dtype=np.uint8)
    state = initial_state((TrackedView("cam", *SIZE),), geometry, MipfConfig())
    state = initiate_trackers(state, frame_set((ROW,), image), [Birth(0, 4, ROW[0])])
    for k in range(1, 26):
        region = np.array([[30.0 + 2.0 * k, 40.0, 6.0 + 0.1 * k, 15.0 + 0.2 * k, 0.0]])
        now = FrameSet(40_000_000 * k, np.array([k]), (image,), (region,))
        state, outlines = advance(state, now, rng)
    assert outlines.target_id.tolist() == [4]
    np.testing.assert_allclose(outlines.ellipse[0, :2], region[0, :2], atol=2.5)
    np.testing.assert_allclose(outlines.ellipse[0, 2:4], region[0, 2:4], rtol=0.12)


@pytest.mark.parametrize("method", ["mipf", "idmot", "bmct", "cmct", "mcmc"])
def test_a_target_that_fills_half_of_its_ellipse_is_alike_and_not_lost(method: str) -> None:
    """The mask leaves half of the first ellipse; that is how the target looks, and it stands still."""
    geometry = ViewGeometry(np.full((1, 1, 3, 3), np.nan), (None,))
    rng = np.random.default_rng(5)
    image, mask = np.full((90, 120, 3), 90, dtype=np.uint8), np.zeros((90, 120), dtype=np.uint8)
    mask[30:50, 30:40] = 1
    config = CONFIGS[method](particles=30, max_lost_frames=10)
    state = initial_state((TrackedView("cam", *SIZE),), geometry, config)
    first = np.array([30.0, 40.0, 10.0, 10.0, 0.0])
    for k in range(25):
        now = FrameSet(40_000_000 * k, np.array([k]), (image,), (), (mask,))
        if not k:
            state = initiate_trackers(state, now, [Birth(0, 4, first)])
            continue
        state, outlines = advance(state, now, rng)
        assert outlines.target_id.tolist() == [4]
        assert outlines.lifecycle.tolist() == [0]
        assert outlines.similarity[0] > 0.9
