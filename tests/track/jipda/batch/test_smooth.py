"""Smoothed crowds: as the filter saw them, and better."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from crowds import crowd
from scipy.optimize import linear_sum_assignment

from occlog.settings import configure
from occlog.track.methods.jipda.batch.smooth import (
    SmoothingWindow,
    add,
    at_steps,
    finish,
    frames_between,
    independent_steps,
    smooth,
    track_extension,
)
from occlog.track.methods.jipda.batch.tracks import WindowSpan
from occlog.track.methods.jipda.config import JipdaConfig
from occlog.track.methods.jipda.filter import initial_state, step

pytestmark = pytest.mark.jit


@cache
def filtered(frames=60, hz=5.0):
    """A small crowd, and what the filter says of it: the state at the end, looks, states and times."""
    scene = crowd(5, cameras=4, frames=frames, hz=hz, seed=4)
    state = initial_state(scene.scene, scene.scene.cameras, configure(JipdaConfig.in_unit("m"), {}))
    states, moments = [], []
    for frames_of_step in scene.moments:
        state, snapshot = step(state, frames_of_step)
        states.append(state)
        moments.append(snapshot)
    return scene, states, moments


def emptied(observation):
    """The same point at no one."""
    return observation._replace(
        **{name: getattr(observation, name)[:0] for name in ("boxes", "score", "tracklet_id", "appearance", "row")}
    )


def errors(moments, truth):
    """Distances of people to those in truth, and how often somebody in truth is given another identity."""
    off, last, switches = [], {}, 0
    for snapshot, now in zip(moments, truth, strict=True):
        apart = np.hypot(*(now[:, None] - snapshot.mean[None, :, :2]).transpose(2, 0, 1))
        for a, b in zip(*linear_sum_assignment(np.minimum(apart, 1.0)), strict=True):
            if apart[a, b] < 1.0:
                off.append(apart[a, b])
                switches += last.get(a, snapshot.ids[b]) != snapshot.ids[b]
                last[a] = snapshot.ids[b]
    return np.array(off), switches


def test_smoothed_people_are_nearer_to_the_truth_than_the_filters():
    scene, states, snapshots = filtered()
    smoothed = smooth(states[-1], scene.moments, snapshots, np.random.default_rng(0))
    before, after = errors(snapshots, scene.truth), errors(smoothed, scene.truth)
    assert len(smoothed) == len(snapshots)
    assert len(after[0]) > 0.95 * len(before[0])
    assert np.sqrt(np.mean(after[0] ** 2)) < np.sqrt(np.mean(before[0] ** 2))
    assert after[1] <= before[1]


def test_one_seed_gives_one_result():
    scene, states, snapshots = filtered()
    one, other = (smooth(states[-1], scene.moments, snapshots, np.random.default_rng(7)) for _ in range(2))
    for a, b in zip(one, other, strict=True):
        assert a.ids.tolist() == b.ids.tolist()
        assert a.mean.tobytes() == b.mean.tobytes()
        assert a.covariance.tobytes() == b.covariance.tobytes()
        assert a.events == b.events


def span_of_looks(time, observations):
    looked = np.concatenate([np.zeros((1, observations.shape[1])), np.cumsum(observations, axis=0)])
    return WindowSpan(
        np.asarray(time),
        looked,
        area=10.0,
        people=1.0,
        false_people=0.0,
        stay=60.0,
        hiding_rate=np.zeros(observations.shape[1]),
        turning=0.05,
        bending=0.0,
        metre=1.0,
    )


def test_moments_are_linked_that_are_apart_for_some_camera():
    fast = span_of_looks(np.arange(50) / 25.0, np.ones((50, 2)))
    assert independent_steps(fast).tolist() == [0, 10, 20, 30, 40]
    apart = at_steps(fast, independent_steps(fast))
    assert apart.frame_counts[-1].tolist() == [5.0, 5.0]
    assert frames_between(fast, apart) == 10.0
    assert frames_between(fast, fast) == 1.0
    assert frames_between(fast, at_steps(fast, np.array([], dtype=np.int64))) == 1.0
    # Cameras that point in turn are each looked at as often
    in_turn = span_of_looks(np.arange(20) / 10.0, np.eye(4)[np.arange(20) % 4])
    assert independent_steps(in_turn).tolist() == list(range(20))
    slow = span_of_looks(np.arange(5) / 2.0, np.ones((5, 1)))
    assert independent_steps(slow).tolist() == list(range(5))


def test_a_person_whom_no_camera_sees_for_a_second_is_the_same_at_25_frames_a_second():
    scene = crowd(2, cameras=3, frames=100, hz=25.0, miss=0.0, false=0.0, seed=1)
    state = initial_state(scene.scene, scene.scene.cameras, configure(JipdaConfig.in_unit("m"), {}))
    all_looks, moments = [], []
    for t, observations in enumerate(scene.moments):
        if 40 <= t < 65:  # without the boxes of the first person
            seen_at = [
                scene.scene.cameras[frame_detections.camera].project(np.array([[*scene.truth[t, 0], 0.9]]))[0]
                for frame_detections in observations
            ]
            kept = [
                np.abs(0.5 * (frame_detections.boxes[:, 0] + frame_detections.boxes[:, 2]) - at[0]) > 25.0
                for frame_detections, at in zip(observations, seen_at, strict=True)
            ]
            observations = [
                frame_detections._replace(
                    **{
                        name: getattr(frame_detections, name)[k]
                        for name in ("boxes", "score", "tracklet_id", "appearance", "row")
                    }
                )
                for frame_detections, k in zip(observations, kept, strict=True)
            ]
        all_looks.append(observations)
        state, snapshot = step(state, observations)
        moments.append(snapshot)
    smoothed = smooth(state, all_looks, moments, np.random.default_rng(0))
    off, switches = errors(smoothed, scene.truth)
    assert switches == 0
    assert len(off) >= 2 * len(smoothed) - 2
    assert np.sqrt(np.mean(off**2)) < 0.1


def test_everybody_is_there_while_all_cameras_are_blind():
    scene, states, moments = filtered()
    state, observations, moments = states[29], list(scene.moments), moments[:30]
    for t in range(30, len(observations)):
        if t < 33:
            observations[t] = [emptied(frame_detections) for frame_detections in observations[t]]
        state, snapshot = step(state, observations[t])
        moments.append(snapshot)
    smoothed = smooth(state, observations, moments, np.random.default_rng(0))
    assert errors(smoothed, scene.truth)[1] == 0
    assert [m.ids.tolist() for m in smoothed[30:34]] == 4 * [smoothed[29].ids.tolist()]
    assert len(smoothed[29].ids) == scene.truth.shape[1]


def test_people_are_reported_whom_the_last_association_did_not_expect():
    scene = crowd(3, cameras=2, frames=30, hz=5.0, miss=0.6, false=0.5, seed=7)
    state = initial_state(scene.scene, scene.scene.cameras, configure(JipdaConfig.in_unit("m"), {}))
    moments = []
    for frames_of_step in scene.moments:
        state, snapshot = step(state, frames_of_step)
        moments.append(snapshot)
    for frames_of_step, snapshot in zip(
        scene.moments, smooth(state, scene.moments, moments, np.random.default_rng(0)), strict=True
    ):
        says = snapshot.support
        assert (says.person < len(snapshot.ids)).all()
        assert all(row < len(frames_of_step[c].boxes) for c, row in zip(says.camera, says.row, strict=True))


def test_births_and_deaths_are_those_of_the_identities():
    scene, states, snapshots = filtered()
    there, out = set(), smooth(states[-1], scene.moments, snapshots, np.random.default_rng(0))
    assert len(out) == len(snapshots)
    for snapshot in out:
        there |= {e.id for e in snapshot.events if e.kind == "initiated"}
        there -= {e.id for e in snapshot.events if e.kind == "terminated"}
        assert there == set(snapshot.ids.tolist())
        assert (np.diff(snapshot.ids) > 0).all()
        assert (snapshot.support.probability <= 1.0).all()
        assert np.linalg.eigvalsh(snapshot.covariance).min(initial=1.0) > 0.0


def through(lag_ns):
    scene, states, snapshots = filtered()
    window, out, most = SmoothingWindow(lag_ns, np.random.default_rng(0)), [], 0
    for state, frames_of_step, snapshot in zip(states, scene.moments, snapshots, strict=True):
        window, part = add(window, state, frames_of_step, snapshot)
        out += part
        most = max(most, len(window.snapshots))
    return out + finish(window, states[-1]), most


def test_a_window_gives_every_moment_once_and_holds_few():
    scene, _, snapshots = filtered()
    out, most = through(2_000_000_000)
    assert [m.t_ns for m in out] == [m.t_ns for m in snapshots]
    assert most < 45
    off, switches = errors(out, scene.truth)
    assert switches <= errors(snapshots, scene.truth)[1]
    assert np.sqrt(np.mean(off**2)) < 0.2


def test_without_a_lag_the_window_is_the_whole_recording():
    scene, states, snapshots = filtered()
    whole = smooth(states[-1], scene.moments, snapshots, np.random.default_rng(0))
    out, most = through(None)
    assert most == len(snapshots)
    for a, b in zip(out, whole, strict=True):
        assert a.mean.tobytes() == b.mean.tobytes()


@pytest.mark.parametrize(("similar", "keeps"), [(0.33, False), (0.34, True)], ids=["slow 1.99", "slow 2.03"])
def test_links_of_the_filter_are_kept_where_errors_of_boxes_go_on(similar, keeps):
    scene, states, snapshots = filtered(frames=40, hz=10.0)
    state = replace(states[-1], edges=replace(states[-1].edges, changes=np.array([1.0 + similar, 1.0])))
    drawn = np.random.default_rng(0)
    smoothed = smooth(state, scene.moments, snapshots, drawn)
    # Nothing is drawn where no chain runs
    assert (drawn.bit_generator.state == np.random.default_rng(0).bit_generator.state) == keeps
    assert errors(smoothed, scene.truth)[1] <= errors(snapshots, scene.truth)[1]


def test_nothing_at_all_is_smoothed_to_nothing():
    scene, states, _ = filtered()
    assert smooth(states[-1], [], [], np.random.default_rng(0)) == []
    empty = [[emptied(frame_detections) for frame_detections in frames_of_step] for frames_of_step in scene.moments[:3]]
    state = initial_state(scene.scene, scene.scene.cameras, states[0].config)
    out = []
    for frames_of_step in empty:
        state, snapshot = step(state, frames_of_step)
        out.append(snapshot)
    for snapshot in smooth(state, empty, out, np.random.default_rng(0)):
        assert len(snapshot.ids) == 0


@cache
def paused(pause, seed, apart):
    """The filter's people of a recording that pauses for so long [s] amid it; people walk on for some of that time."""
    scene = crowd(5, cameras=3, frames=86 + apart, hz=10.0, seed=seed)
    kept = [*range(43), *range(43 + apart, 86 + apart)]
    state = initial_state(scene.scene, scene.scene.cameras, configure(JipdaConfig.in_unit("m"), {}))
    steps = []
    for k, t in enumerate(kept):
        t_ns = round((0.1 * k + (pause if k >= 43 else 0.0)) * 1e9)
        frames_of_step = [frame_detections._replace(t_ns=t_ns) for frame_detections in scene.moments[t]]
        state, snapshot = step(state, frames_of_step)
        steps.append((state, frames_of_step, snapshot))
    return steps, scene.truth[kept]


@pytest.mark.parametrize(
    ("pause", "seed", "apart", "lag_ns"),
    [
        (8, 3, 79, None),
        (600, 4, 30, 2_000_000_000),
        *(
            pytest.param(*case, marks=pytest.mark.statistics)
            for case in ((60, 1, 30, 2_000_000_000), (600, 4, 30, None), (10800, 4, 30, 2_000_000_000))
        ),
    ],
)
def test_everybody_is_followed_up_to_a_pause_and_from_its_end_on(pause, seed, apart, lag_ns):
    steps, truth = paused(pause, seed, apart)
    window, out = SmoothingWindow(lag_ns, np.random.default_rng(0)), []
    for state, frames_of_step, snapshot in steps:
        window, part = add(window, state, frames_of_step, snapshot)
        out += part
    out += finish(window, state)
    for side in (slice(0, 43), slice(43, 86)):
        off, switches = errors(out[side], truth[side])
        assert (len(off), switches) == (5 * 43, 0)
        assert [len(m.ids) for m in out[side]] == 43 * [5]
    if pause >= 600:
        assert set(out[42].ids.tolist()).isdisjoint(out[43].ids.tolist())


def test_pauses_do_not_count_for_the_time_between_moments():
    time = np.concatenate([np.arange(50) / 10.0, 10800.0 + np.arange(50) / 10.0, 10900.0 + np.arange(50) / 10.0])
    with_pauses = span_of_looks(time, np.ones((150, 1)))
    assert with_pauses.step == pytest.approx(0.1)
    assert with_pauses.gaps.sum() == pytest.approx(14.7)
    assert track_extension(with_pauses) == pytest.approx(1.05)
    # Frames that are all so far apart are no pauses
    assert span_of_looks(np.arange(20) * 30.0, np.ones((20, 1))).step == 30.0
    assert span_of_looks(np.zeros(1), np.ones((1, 1))).step == 1.0
