"""The steps of a frame that methods share: proposal, resampling, velocity and path, freshness of views, ends."""

from dataclasses import replace

import numpy as np
import pytest
from view_states import BLUE, PERIOD_NS, RED, H, W, changed, disc, frames_at, painted, state_of

from occlog.core.image import nearness
from occlog.track.methods.images.interface import GOOD, LEFT, NONE, TERMINATED
from occlog.track.methods.images.methods.config import BmctConfig, CmctConfig, IdmotConfig, MipfConfig
from occlog.track.methods.images.methods.state import LONGEST
from occlog.track.methods.images.methods.step import advance, advance_with, end_events
from occlog.track.methods.images.methods.weigh import arrival_of, local_weights, weigh

ONE, TWO = disc(40.0, 40.0), disc(80.0, 60.0)
BOTH = painted((ONE, RED), (TWO, BLUE))
FOUR = [(0, 1, ONE), (0, 2, TWO), (1, 1, ONE), (1, 2, TWO)]


def rng():
    return np.random.default_rng(7)


def heaviest(state, arrival, local, first, touching=False):
    """Samples with all weight on one particle of each tracker, which touch all others of their view or none."""
    t, (n, count) = state.trackers, local.particles.shape[:2]
    weights = np.zeros((n, count))
    weights[:, first] = 1.0
    same = (t.view[:, None] == t.view) & ~np.eye(n, dtype=bool)
    samples = weigh(state, arrival, local, rng())
    chosen = local.particles[:, first]
    return samples._replace(weights=weights, estimate=chosen, touching=same & touching)


# Freshness


@pytest.mark.parametrize(("age", "fresh"), [(1.0, True), (1.49, True), (1.5, False), (1.51, False), (2.9, False)])
def test_a_view_without_a_frame_is_fresh_until_one_and_a_half_frame_periods(age, fresh):
    state = state_of(BmctConfig(particles=4), FOUR, (BOTH, BOTH))
    arrival = arrival_of(state, frames_at(age, BOTH, None))
    assert arrival.here.tolist() == [True, True, False, False]
    assert arrival.fresh.tolist() == [True, True, fresh, fresh]


def test_a_frame_makes_a_view_fresh_however_long_it_had_none():
    state = state_of(BmctConfig(particles=4), FOUR, (BOTH, BOTH))
    assert arrival_of(state, frames_at(40, BOTH, BOTH)).fresh.all()


@pytest.mark.parametrize(("age", "helps"), [(1.49, True), (1.5, False)])
def test_a_stale_view_does_not_help(age, helps):
    """In view a both targets are close; in view b they are far apart, but its last frame is so old."""
    near, far = disc(40.0, 40.0), disc(58.0, 44.0)
    apart = [disc(30.0, 40.0), disc(90.0, 44.0)]
    first, second = painted((near, RED), (far, BLUE)), painted((apart[0], RED), (apart[1], BLUE))
    births = [(0, 1, near), (0, 2, far), (1, 1, apart[0]), (1, 2, apart[1])]
    state = state_of(BmctConfig(particles=20), births, (first, second))
    assert state.trackers.good.tolist() == [[False, True], [False, True], [True, False], [True, False]]
    _, outlines = advance(state, frames_at(age, first, None), rng())
    assert outlines.assisting_views.tolist() == [[False, helps], [False, helps]]


# Proposal


def moved_into(state, frames):
    """Particles after the proposal, with their local likelihoods."""
    return local_weights(state, frames, arrival_of(state, frames), rng())


def test_particles_of_a_view_without_a_frame_go_on_at_their_velocity_for_at_most_the_longest_gap():
    state = state_of(MipfConfig(particles=4), FOUR, (BOTH, BOTH))
    state = changed(state, velocity=np.tile([1.5, -0.5], (4, 1)))
    for age, counted in ((2.25, 2.25), (LONGEST, LONGEST), (LONGEST + 3.0, LONGEST)):
        local = moved_into(state, frames_at(age, BOTH, None))
        moved = local.particles[2:, :, :2] - state.trackers.particles[2:, :, :2]
        np.testing.assert_allclose(moved, np.broadcast_to([1.5 * counted, -0.5 * counted], moved.shape))
        np.testing.assert_array_equal(local.particles[2:, :, 2:], state.trackers.particles[2:, :, 2:])
        assert (local.similarities[2:] == 1.0).all()
        assert (local.log_local[2:] == 0.0).all()


def test_the_region_proposes_after_the_lines():
    """A share of the particles starts again at the tracker's own region, wherever the epipolar lines have put them."""
    config = CmctConfig(
        particles=10,
        epipolar_fraction=1.0,
        sigma_along_line_px=0.01,
        sigma_across_line=0.001,
        region_share=0.3,
        region_spread=0.001,
    )
    state = state_of(config, [(0, 1, ONE), (1, 1, disc(60.0, 47.0))], (BOTH, BOTH))
    region = disc(43.0, 40.0)
    frames = frames_at(1, BOTH, BOTH, regions=(region[None], None))
    particles = moved_into(state, frames).particles[0]
    np.testing.assert_allclose(particles[:3, :2], np.tile(region[:2], (3, 1)), atol=0.05)
    np.testing.assert_allclose(particles[3:, 1], 47.0, atol=0.1)


# Resampling, velocity and path


def test_the_estimate_moves_the_velocity():
    state = state_of(MipfConfig(particles=5, keep_velocity=0.75), FOUR, (BOTH, BOTH))
    state = changed(state, velocity=np.tile([2.0, 0.0], (4, 1)))
    frames = frames_at(2, BOTH, None)
    arrival, local = arrival_of(state, frames), moved_into(state, frames)
    after, outlines = advance_with(state, frames, arrival, heaviest(state, arrival, local, 3))
    t = after.trackers
    np.testing.assert_array_equal(t.estimate[:2], local.particles[:2, 3])
    # Two frame periods have passed: the displacement counts half
    step = (t.estimate[:2, :2] - state.trackers.estimate[:2, :2]) / 2.0
    np.testing.assert_allclose(t.velocity[:2], 0.75 * np.array([2.0, 0.0]) + 0.25 * step)
    np.testing.assert_allclose(t.path[:2, -1], step)
    # Trackers of the view without a frame stay as they were
    for old, new in zip(state.trackers, t, strict=True):
        np.testing.assert_array_equal(new[2:], old[2:])
    assert outlines.view.tolist() == [0, 0]


@pytest.mark.parametrize("touching", [False, True])
def test_a_displacement_counts_less_in_the_path_while_trackers_touch(touching):
    state = state_of(IdmotConfig(particles=5, memory=3, frozen=0.25), FOUR[:2], (BOTH, BOTH))
    path = np.arange(12.0).reshape(2, 3, 2)
    state = changed(state, path=path)
    frames = frames_at(1, BOTH, None)
    arrival = arrival_of(state, frames)
    after, _ = advance_with(state, frames, arrival, heaviest(state, arrival, moved_into(state, frames), 1, touching))
    step = after.trackers.estimate[:, :2] - state.trackers.estimate[:, :2]
    usual = path.mean(axis=1)
    np.testing.assert_array_equal(after.trackers.path[:, :2], path[:, 1:])
    np.testing.assert_allclose(after.trackers.path[:, 2], usual + 0.25 * (step - usual) if touching else step)


def test_half_axes_of_the_start_follow_those_of_the_own_region():
    state = state_of(MipfConfig(particles=5, region_axes=0.25), FOUR[:2], (BOTH, BOTH))
    larger = np.array([40.0, 40.0, 12.0, 16.0, 0.0])
    after, _ = advance(state, frames_at(1, BOTH, None, regions=(larger[None], None)), rng())
    np.testing.assert_allclose(after.trackers.axes, [[9.0, 10.0, 0.0], [8.0, 8.0, 0.0]])


def test_frames_are_weak_when_the_best_particle_is_less_alike_than_the_limit():
    state = changed(state_of(MipfConfig(particles=5), FOUR[:1], (BOTH, BOTH)), weak=np.array([4]))
    best = float(moved_into(state, frames_at(1, BOTH, None)).similarities.max())
    assert 0.5 < best < 1.0
    for limit, weak in ((best, 0), (np.nextafter(best, 2.0), 5)):
        strict = state._replace(config=replace(state.config, lost_similarity=limit))
        after, _ = advance(strict, frames_at(1, BOTH, None), rng())
        assert after.trackers.weak.tolist() == [weak]


# Parts that only some methods have


def test_counterparts_are_reported_only_by_methods_that_check_them():
    frames = frames_at(1, BOTH, BOTH)
    report = {}
    for method, config in (("idmot", IdmotConfig(particles=5)), ("bmct", BmctConfig(particles=5))):
        state = state_of(config, [*FOUR[:3]], (BOTH, BOTH))
        report[method] = advance(state, frames, rng())[1].counterpart.tolist()
    assert report == {"idmot": [0, 0, 0], "bmct": [GOOD, NONE, GOOD]}


# Ends

SIZE = np.array([[W, H]], dtype=float)


def one(x, y, r=8.0, weak=0, good=False):
    """Trackers after a frame: one with such an estimate."""
    state = state_of(MipfConfig(particles=2), [(0, 1, disc(40.0, 40.0))], (BOTH, BOTH))
    good = np.array([[False, good]])
    return changed(state, estimate=disc(x, y, r)[None], weak=np.array([weak]), good=good).trackers


@pytest.mark.parametrize(
    ("x", "y"), [(-0.5, 40.0), (W - 0.5, 40.0), (60.0, -0.5), (60.0, H - 0.5)], ids=["left", "right", "top", "bottom"]
)
def test_a_target_leaves_when_its_centre_passes_the_edge_of_the_image(x, y):
    config = MipfConfig()
    assert end_events(one(x, y), SIZE, config).tolist() == [0]
    out = np.sign([x - 60.0 if y == 40.0 else 0.0, y - 40.0 if x == 60.0 else 0.0]) * 1e-9
    assert end_events(one(x + out[0], y + out[1]), SIZE, config).tolist() == [LEFT]
    # Even if its counterparts are good
    assert end_events(one(x + out[0], y + out[1], good=True), SIZE, config).tolist() == [LEFT]


@pytest.mark.parametrize(("weak", "event"), [(0, 0), (24, 0), (25, TERMINATED), (26, TERMINATED)])
def test_a_target_is_lost_after_so_many_weak_frames(weak, event):
    assert end_events(one(60.0, 45.0, weak=weak), SIZE, MipfConfig(max_lost_frames=25)).tolist() == [event]
    assert end_events(one(60.0, 45.0, weak=weak), SIZE, MipfConfig(max_lost_frames=0)).tolist() == [0]


@pytest.mark.parametrize(
    ("x", "event"), [(7.5, TERMINATED), (7.5 - 1e-9, LEFT), (W - 8.5, TERMINATED), (W - 8.5 + 1e-9, LEFT)]
)
def test_a_target_lost_while_it_reaches_over_the_edge_has_left(x, event):
    assert end_events(one(x, 45.0, weak=25), SIZE, MipfConfig()).tolist() == [event]
    assert end_events(one(x, 45.0, weak=24), SIZE, MipfConfig()).tolist() == [0]


@pytest.mark.parametrize("x", [60.0, 4.0])
def test_a_tracker_with_a_good_counterpart_is_not_lost(x):
    assert end_events(one(x, 45.0, weak=25, good=True), SIZE, MipfConfig()).tolist() == [0]
    assert end_events(one(x, 45.0, weak=25, good=False), SIZE, MipfConfig()).tolist() != [0]


def test_a_tracker_on_nothing_ends_unless_its_counterpart_is_good():
    """Both targets vanish from view a; the tracker of the first has a good counterpart in view b."""
    gone = painted()
    state = state_of(MipfConfig(particles=5, max_lost_frames=3, sigma_px=0.1), FOUR[:3], (BOTH, BOTH))
    good = np.array([[False, True], [False, False], [True, False]])
    state = changed(state, good=good, checked=good, weak=np.array([2, 2, 0]))
    after, outlines = advance(state, frames_at(1, gone, BOTH), rng())
    assert outlines.lifecycle.tolist() == [0, TERMINATED, 0]
    assert after.trackers.target.tolist() == [1, 1]
    assert after.trackers.weak.tolist() == [3, 0]


def test_a_tracker_of_a_view_without_a_frame_does_not_end():
    state = state_of(MipfConfig(particles=5, max_lost_frames=3), FOUR[:2], (BOTH, BOTH))
    outside = state.trackers.estimate.copy()
    outside[0, 0] = -5.0
    state = changed(state, estimate=outside, weak=np.array([9, 9]))
    after, outlines = advance(state, frames_at(1, None, BOTH), rng())
    assert len(outlines.view) == 0
    assert len(after.trackers.view) == 2


def test_outlines_say_which_trackers_touch_and_how_many_particles_count():
    """A tracker of each view: those of different views do not touch."""
    state = state_of(IdmotConfig(particles=30), FOUR, (BOTH, BOTH))
    _, outlines = advance(state, frames_at(1, BOTH, BOTH), rng())
    assert outlines.touching.shape == (4, 4)
    assert not outlines.touching.any()
    assert (nearness(outlines.ellipse)[:2, 2:].min(axis=1) < 1.0).all()
    assert ((outlines.ess >= 1.0) & (outlines.ess <= 30.0)).all()
    assert outlines.covariance.shape == (4, 3)
    assert state.clock.t_ns.tolist() == [0, 0]
    assert _.clock.t_ns.tolist() == [PERIOD_NS, PERIOD_NS]
