"""Methods that track in images: films of balls, the loop check, missing frames, and how trackers end."""

import numpy as np
import pytest
from view_films import PERIOD_NS, SMALL, begun, births_of, film, frame_set, geometry_of, off, tracked, views_of

from occlog.core.geometry.fundamental import scaled
from occlog.errors import InputError
from occlog.measure.epipolar.views import TrackedView, ViewGeometry
from occlog.settings import configure
from occlog.simulate.balls.config import BallsConfig
from occlog.simulate.balls.motion import BallPaths, ball_paths
from occlog.simulate.balls.video import render_balls
from occlog.track.methods.images.interface import BAD, GOOD, LEFT, MODES, NONE, TERMINATED, Birth, FrameSet
from occlog.track.methods.images.methods.config import BmctConfig, MipfConfig
from occlog.track.methods.images.methods.state import end_trackers, initial_state
from occlog.track.methods.images.methods.step import advance, initiate_trackers

METHODS = ("mipf", "idmot", "cmct", "bmct")
ALONE = BallsConfig(frames=30, width=100, height=80, balls=1, radius=9.0, ball_speed=2.5, background_clutter=2)
CROSSING = BallsConfig(frames=50, width=140, height=100, balls=2, radius=10.0, background_clutter=0)


def crossing(rise=4.0):
    """Two balls that pass each other in the first view, one a little higher; in the second they stay apart."""
    t = np.arange(CROSSING.frames)[:, None]
    y = np.hstack([-35.0 + 1.4 * t, 35.0 - 1.4 * t])
    across = np.broadcast_to([-25.0, 25.0], y.shape)
    z = np.hstack([45.0 + 0.0 * t, 45.0 + rise + 0.0 * t])
    turns = ball_paths(CROSSING, 1).turns
    return tuple(render_balls(CROSSING, 3, paths=BallPaths(np.stack([across, y, z], axis=-1), turns)))


@pytest.mark.jit
@pytest.mark.parametrize("method", METHODS)
def test_a_ball_alone_is_followed(method):
    frames = film(ALONE, 2)
    report, _ = tracked(method, frames, ALONE, particles=30)
    # The motion adds 3 px a frame; the colours of a ball of 9 px hold the estimate within a third of it.
    assert off(frames, report).max() < 4.5
    assert np.median(off(frames, report)) < 1.5
    assert all(one.lifecycle.tolist() == [0, 0] for one in report)
    assert all((one.similarity > 0.8).all() and (one.ess >= 1).all() for one in report)


@pytest.mark.jit
def test_balls_that_cross_keep_their_labels_with_two_views():
    frames = crossing()
    hidden = np.array([frame.share.min(axis=1) for frame in frames]).min(axis=0)
    assert hidden[0] < 0.3
    assert hidden[1] == 1.0
    misses = {
        m: [off(frames, tracked(m, frames, CROSSING, s)[0])[-8:].max() > 10.0 for s in range(6)]
        for m in ("bmct", "mipf")
    }
    assert sum(misses["bmct"]) == 0
    assert sum(misses["mipf"]) > 0


@pytest.mark.jit
def test_modes_say_what_was_done():
    frames = film(SMALL, 1)
    for method in ("mipf", "cmct"):
        report, _ = tracked(method, frames[:3], particles=5)
        assert all((one.likelihood_mode == MODES.index(method)).all() for one in report)
    report, _ = tracked("bmct", frames[:20], particles=10)
    touching = np.concatenate([one.touching.any(axis=1) for one in report])
    mode, helped = (
        np.concatenate([one.likelihood_mode for one in report]),
        np.concatenate([one.assisting_views.any(axis=1) for one in report]),
    )
    assert (mode[helped] == MODES.index("bmct")).all()
    assert (mode[touching & ~helped] == MODES.index("idmot")).all()
    assert (mode[~touching & ~helped] == MODES.index("mipf")).all()
    assert not np.concatenate([one.assisting_views[np.arange(len(one.view)), one.view] for one in report]).any()


def injected(state, moved):
    """The state with the tracker of ball 0 in view 1 held a radius and a half up or down from where it is."""
    t, row = state.trackers, 1
    assert (t.view[row], t.target[row]) == (1, 0)
    shift = np.array([0.0, moved, 0, 0, 0])
    particles, estimate = t.particles.copy(), t.estimate.copy()
    particles[row] += shift
    estimate[row] += shift
    return state._replace(trackers=t._replace(particles=particles, estimate=estimate))


@pytest.mark.jit
def test_a_counterpart_that_is_moved_away_becomes_bad_and_good_again():
    still = BallsConfig(frames=60, width=100, height=80, balls=1, radius=9.0, ball_speed=0.0, background_clutter=0)
    frames = film(still, 4)
    states = []
    state, rng = begun("bmct", frames, still, particles=20, restart=False, sigma_px=0.5)
    for t, frame in enumerate(frames[1:], 1):
        if 10 <= t < 30:  # held where nothing is: so far off that the ball has no hold on it
            state = injected(state, 24.0 - (state.trackers.estimate[1, 1] - frame.ellipses[1, 0, 1]))
        if t == 30:
            state = injected(state, -24.0)
        state, report = advance(state, frame_set(frame), rng)
        states.append(report.counterpart.tolist())
    words = [GOOD if s == [GOOD, GOOD] else BAD if s == [BAD, BAD] else None for s in states]
    # Bad after 15 checks that fail, from frame 10 on; good after 5 that hold.
    assert words[: 10 - 1 + 14] == [GOOD] * 23
    assert words[23] == BAD
    back = words.index(GOOD, 24)
    assert back >= 30 - 1 + 4
    assert words[back:] == [GOOD] * (len(words) - back)


def test_no_help_from_a_bad_counterpart():
    frames = film(SMALL, 1, 2)
    state, rng = begun("bmct", frames, particles=10, clear_distance=0.0)
    t = state.trackers
    assert t.good[t.counterpart >= 0].all()
    bad = state._replace(trackers=t._replace(good=np.zeros_like(t.good)))
    bad = advance(bad, frame_set(frames[1]), rng)[1]
    assert not bad.assisting_views.any()
    assert (bad.counterpart == BAD).all()


def test_a_wrong_matrix_is_noticed():
    frames, wrong = film(SMALL, 1, 2), geometry_of().fundamental.copy()
    wrong[0, 1] = scaled(np.array([[0, 0, 0.0], [0, 0, -1.0], [0, 1.0, 40.0]]))  # lines 40 px too high
    wrong[1, 0] = wrong[0, 1].T
    state = initial_state(views_of(), ViewGeometry(wrong, (None, None)), BmctConfig(particles=5))
    state = initiate_trackers(state, frame_set(frames[0]), births_of(frames[0]))
    _, report = advance(state, frame_set(frames[1]), np.random.default_rng(0))
    assert (report.counterpart == BAD).all()


def test_without_geometry_no_one_is_a_counterpart():
    frames, unknown = film(SMALL, 1, 2), np.full((2, 2, 3, 3), np.nan)
    state = initial_state(views_of(), ViewGeometry(unknown, (None, None)), BmctConfig(particles=5))
    state = initiate_trackers(state, frame_set(frames[0]), births_of(frames[0]))
    _, report = advance(state, frame_set(frames[1]), np.random.default_rng(0))
    assert (report.counterpart == NONE).all()
    assert not report.assisting_views.any()


@pytest.mark.jit
@pytest.mark.parametrize("method", METHODS)
def test_missing_frames_are_waited_out(method):
    frames = film(ALONE, 2)
    report, _ = tracked(method, frames, ALONE, particles=30, without=lambda t: [1] if t % 3 == 0 or 12 < t < 17 else [])
    assert [one.view.tolist() for one in report[:3]] == [[0, 1], [0, 1], [0]]
    far = off(frames, report)[..., 0]
    assert np.isinf(far[:, 1]).sum() == 12
    assert far[np.isfinite(far)].max() < 6.0


@pytest.mark.jit
def test_views_of_unequal_rate_do_not_gain_noise():
    """A view with every second frame moves by one of its own frames, not by two, once its rate is known."""
    frames = film(ALONE, 2)
    _, state = tracked("mipf", frames, ALONE, particles=10, without=lambda t: [1] if t % 2 else [])
    assert np.median(state.clock.interval_ns, axis=1).tolist() == [PERIOD_NS, 2 * PERIOD_NS]


@pytest.mark.parametrize("method", METHODS)
def test_the_seed_decides_all_and_arguments_are_left_alone(method):
    frames = film(SMALL, 1, 2)
    state, rng = begun(method, frames, particles=8)
    images = [image.copy() for image in frames[1].images]
    kept = [np.array(field) for field in state.trackers]
    twin = np.random.default_rng()
    twin.bit_generator.state = rng.bit_generator.state
    first = advance(state, frame_set(frames[1]), rng)[1]
    again = advance(state, frame_set(frames[1]), twin)[1]
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one, other)
    for one, other in zip(kept, state.trackers, strict=True):
        np.testing.assert_array_equal(one, other)
    assert all(np.array_equal(a, b) for a, b in zip(images, frames[1].images, strict=True))
    assert (np.diff(first.view * 10 + first.target_id) > 0).all()


def blank_after(frames, last, centre=None):
    """The film, from some frame on a plain wall."""
    wall = np.full_like(frames[0].images[0], 90)
    return [f if f.frame <= last else f._replace(images=tuple(wall for _ in f.images)) for f in frames]


@pytest.mark.jit
@pytest.mark.parametrize("method", METHODS)
def test_trackers_end_when_nothing_is_left_of_their_targets(method):
    frames = blank_after(film(ALONE, 2), 5)
    report, state = tracked(method, frames, ALONE, particles=10, max_lost_frames=8)
    events = [one.lifecycle.tolist() for one in report]
    ended = [t for t, event in enumerate(events, 1) if event and any(event)]
    assert min(ended) >= 5 + 8
    assert len(state.trackers.view) == 0
    assert {e for event in events for e in event} <= {0, TERMINATED, LEFT}


def test_a_tracker_whose_target_leaves_the_image_ends():
    rng, ground = np.random.default_rng(1), np.full((60, 80, 3), (90, 120, 60), dtype=np.uint8)
    y, x = np.mgrid[:60, :80]
    nowhere = ViewGeometry(np.full((1, 1, 3, 3), np.nan), (None,))
    state = initial_state([TrackedView("a", 80, 60)], nowhere, MipfConfig(particles=40))
    event = 0
    for t in range(40):
        image = ground.copy()
        image[(x - 40 - 2 * t) ** 2 + (y - 30) ** 2 < 64] = (20, 30, 200)
        now = FrameSet(t * PERIOD_NS, np.array([t]), (image,))
        if t == 0:
            state = initiate_trackers(state, now, [Birth(0, 7, np.array([40.0, 30.0, 8.0, 8.0, 0.0]))])
            continue
        state, report = advance(state, now, rng)
        if report.lifecycle.any():
            event = int(report.lifecycle[0])
            break
    assert event == LEFT
    assert 18 <= t < 40
    assert len(state.trackers.view) == 0


@pytest.mark.jit
def test_grey_video_is_followed():
    frames = [f._replace(images=tuple(i.mean(axis=2).astype(np.uint8) for i in f.images)) for f in film(ALONE, 2)]
    report, _ = tracked("bmct", frames[:15], ALONE, particles=30)
    assert off(frames[:15], report).max() < 6.0


@pytest.mark.jit
def test_pixels_with_distortion_are_taken_to_those_without():
    """Images turned by a right angle about their corner, and the map back: the same bands help."""
    frames, config = film(SMALL, 1), SMALL
    turned = [
        f._replace(images=tuple(np.ascontiguousarray(i[::-1]) for i in f.images), ellipses=upside(f.ellipses, config))
        for f in frames
    ]

    def ideal(points):
        return np.column_stack([points[:, 0], config.height - 1.0 - points[:, 1]])

    geometry = geometry_of()._replace(ideal=(ideal, ideal))
    state = initial_state(views_of(), geometry, BmctConfig(particles=20))
    state = initiate_trackers(state, frame_set(turned[0]), births_of(turned[0]))
    helped = 0
    for frame in turned[1:20]:
        state, report = advance(state, frame_set(frame), np.random.default_rng(frame.frame))
        assert (report.counterpart == GOOD).all()
        helped += report.assisting_views.sum()
    assert helped > 0


def upside(ellipses, config):
    out = ellipses.copy()
    out[..., 1] = config.height - 1.0 - out[..., 1]
    return out


def test_ended_trackers_are_forgotten_by_their_counterparts():
    state, _ = begun("bmct", film(SMALL, 1, 2), particles=5)
    after = end_trackers(state, [(0, 1)])
    t = after.trackers
    assert sorted(zip(t.view.tolist(), t.target.tolist(), strict=True)) == [(0, 0), (0, 2), (1, 0), (1, 1), (1, 2)]
    lonely = (t.view == 1) & (t.target == 1)
    assert (t.counterpart[lonely] == -1).all()
    assert not t.good[lonely].any()


@pytest.mark.jit
def test_a_hijacked_tracker_starts_again_on_the_line():
    """Two balls apart in both views; the tracker of one is put onto the other in one view."""
    frames = crossing(25.0)[:1] * 40
    frames = [f._replace(frame=t) for t, f in enumerate(frames)]
    state, rng = begun("bmct", frames, CROSSING, particles=30)
    t = state.trackers
    particles, estimate = t.particles.copy(), t.estimate.copy()
    particles[0], estimate[0] = particles[1], estimate[1]
    state = state._replace(trackers=t._replace(particles=particles, estimate=estimate))
    gone = []
    for frame in frames[1:]:
        state, _ = advance(state, frame_set(frame), rng)
        gone.append(np.linalg.norm(state.trackers.estimate[0, :2] - frame.ellipses[0, 0, :2]))
    assert gone[0] > 20.0
    assert gone[-1] < 4.0


@pytest.mark.parametrize(
    ("name", "value", "reported"),
    [
        ("particles", "0", "at least 1"),
        ("alpha", "0.9", "at least 1"),
        ("anchor", "top", "centre, bottom"),
        ("epipolar_band", "0", "above 0"),
        ("axes_limit", "1", "below 1"),
        ("collaboration_distance", "0.5", "at least touch"),
    ],
)
def test_settings_that_cannot_be_are_refused(name, value, reported):
    with pytest.raises(InputError, match=reported):
        configure(BmctConfig(), {name: value})
