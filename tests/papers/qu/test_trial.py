"""Trials on rendered balls: what trackers are stated, how they are scored, and what the loop check is judged by."""

from __future__ import annotations

import math

import numpy as np
import pytest

from occlog.core.geometry.fundamental import epipolar_distances, line_distances
from occlog.core.metrics.mot.frame_pairs import Objects
from occlog.errors import InputError, UsageError
from occlog.papers.qu import tracker_runs as follow
from occlog.papers.qu import world as views_world
from occlog.papers.qu.tracker_runs import TrackerOutput
from occlog.papers.qu.trial import alarms, on_own, run_views_trial, runner_of, scores, timeline, views_spec
from occlog.papers.qu.world import births_of, boxes_of, geometry_of, truth_of
from occlog.simulate.balls.config import BallsConfig
from occlog.simulate.balls.video import BallsFrame, render_balls
from occlog.track.methods.images.interface import BAD, GOOD
from occlog.track.methods.images.methods.state import initial_state
from occlog.track.methods.images.methods.step import initiate_trackers

SMALL = {"frames": 6, "balls": 3, "radius": 9.0, "width": 80, "height": 64, "background_clutter": 0}


def made_up(frames: int = 4, views: int = 2, targets: int = 2) -> tuple[Objects, np.ndarray, TrackerOutput]:
    """Targets 50 px apart that do not move, and trackers that sit on them."""
    ellipses = np.zeros((views, targets, 5))
    ellipses[..., 0] = 50.0 * np.arange(targets)
    ellipses[..., 2:4] = 10.0
    shots = [BallsFrame(t, (), ellipses, np.ones((views, targets))) for t in range(frames)]
    truth, radius = truth_of(shots)
    rows = np.tile(ellipses.reshape(-1, 5), (frames, 1))
    n = len(rows)
    later = np.where(truth.frame > 0, 2, -1)
    checked = np.where(truth.frame > 0, GOOD, 0)
    zero = np.zeros(n, dtype=np.int64)
    return (
        truth,
        radius,
        TrackerOutput(
            truth.frame,
            truth.view,
            truth.label,
            rows,
            later,
            checked,
            zero,
            np.full(n, 30.0),
            np.full(frames - 1, 0.002),
            np.zeros((0, 3)),
        ),
    )


def moved(f: TrackerOutput, rows: np.ndarray, x: float) -> TrackerOutput:
    ellipse = f.ellipse.copy()
    ellipse[rows, 0] = x
    return f._replace(ellipse=ellipse)


def test_truth_is_every_target_in_every_frame_and_view_with_its_radius() -> None:
    truth, radius, _ = made_up(frames=3, views=2, targets=2)
    assert len(truth.frame) == 12
    np.testing.assert_allclose(radius, 10.0)
    np.testing.assert_allclose(truth.position[:2], [[-10, -10, 20, 20], [40, -10, 20, 20]])


def test_boxes_hold_their_ellipses() -> None:
    ellipse = np.array([[3.0, -2.0, 7.0, 4.0, 0.6]])
    t = np.linspace(0, 2 * np.pi, 5000)
    x = 3.0 + 7 * np.cos(t) * np.cos(0.6) - 4 * np.sin(t) * np.sin(0.6)
    y = -2.0 + 7 * np.cos(t) * np.sin(0.6) + 4 * np.sin(t) * np.cos(0.6)
    np.testing.assert_allclose(boxes_of(ellipse)[0], [x.min(), y.min(), np.ptp(x), np.ptp(y)], atol=1e-4)


def test_trackers_on_their_targets_have_no_failures() -> None:
    truth, radius, followed = made_up()
    found = scores(truth, followed, radius)
    assert (found["fr_p"], found["fr_l"], found["idf1"], found["mota"]) == (0.0, 0.0, 1.0, 1.0)
    assert found["hota"] == pytest.approx(1.0)
    assert found["frame_ms"] == pytest.approx(2.0)
    assert found["mode_bmct"] == 1.0


def test_a_tracker_on_another_target_fails_in_place_and_label() -> None:
    truth, radius, followed = made_up()  # 16 true rows
    wrong = (followed.frame >= 2) & (followed.view == 1) & (followed.target == 0)
    found = scores(truth, moved(followed, wrong, 50.0), radius)
    assert found["fr_p"] == found["fr_l"] == 2 / 16


def test_rows_of_own_targets_and_parts_of_the_video() -> None:
    truth, radius, followed = made_up()
    wrong = (followed.frame == 3) & (followed.target == 0)
    f = moved(followed, wrong, 10.1)
    np.testing.assert_array_equal(on_own(truth, f, radius), ~wrong)
    parts = timeline(truth, f, radius, 2)
    assert parts == {"off_0": 0.0, "off_1": 0.25, "off_end": 0.5}
    gone = f._replace(**{n: getattr(f, n)[f.frame < 3] for n in TrackerOutput._fields[:7]})
    assert timeline(truth, gone, radius, 2)["off_end"] == 1.0


def test_alarms_are_false_for_sound_targets_only() -> None:
    truth, radius, followed = made_up()
    off = (followed.frame == 2) & (followed.target == 0) & (followed.view == 0)
    counterpart = followed.counterpart.copy()
    counterpart[(followed.frame >= 2) & (followed.target == 0)] = BAD  # right in frame 2, false in frame 3
    found = alarms(truth, moved(followed, off, 90.0)._replace(counterpart=counterpart), radius)
    assert found["checked"] == 1.0
    assert found["bad"] == 4 / 12
    assert found["false_alarm"] == 2 / 10
    assert found["missed"] == 0.0


def test_a_wrong_tracker_is_noticed_and_comes_back() -> None:
    truth, radius, followed = made_up(frames=6)
    own = (followed.target == 0) & (followed.view == 1)
    f = moved(followed, own & np.isin(followed.frame, (0, 1, 2, 4)), 50.0)
    counterpart = f.counterpart.copy()
    counterpart[own & (f.frame == 3)] = BAD
    found = alarms(truth, f._replace(counterpart=counterpart), radius, (1, 0, 1))
    assert (found["noticed"], found["recovered"], found["returned"]) == (3.0, 3.0, 5.0)
    never = alarms(truth, moved(followed, own, 50.0), radius, (1, 0, 1))
    assert all(math.isinf(never[k]) for k in ("noticed", "recovered", "returned"))


def test_lines_are_right_or_as_wrong_as_asked_for() -> None:
    config = BallsConfig(**SMALL)
    a, b = next(render_balls(config, 1)).ellipses[..., :2]
    distance = {
        kind: epipolar_distances(geometry_of(config, 2, kind, amount).fundamental[0, 1], a, b)[:, 1]
        for kind, amount in (("true", 0.0), ("shift", 12.0), ("turn", 10.0))
    }
    np.testing.assert_allclose(distance["true"], 0.0, atol=0.05)
    np.testing.assert_allclose(distance["shift"], 12.0, atol=0.05)
    # The lines are level, and turn about the middle of the image
    up = b[:, 1] - 31.5
    c, s = math.cos(math.radians(10)), math.sin(math.radians(10))
    expected = np.abs(line_distances(np.stack([np.full(3, -s), np.full(3, c), -up], axis=1), b - [39.5, 31.5]))
    np.testing.assert_allclose(distance["turn"], expected, atol=0.1)
    assert np.isnan(geometry_of(config, 2, "none").fundamental).all()
    with pytest.raises(InputError, match="fundamental is 'wild'"):
        geometry_of(config, 2, "wild")


def test_trackers_start_on_the_truth_but_for_the_one_that_is_wrong() -> None:
    frame = next(render_balls(BallsConfig(**SMALL), 1))
    births = births_of(frame, 2, (1, 0, 2))
    assert [(b.view, b.target_id) for b in births] == [(v, k) for v in range(2) for k in range(3)]
    np.testing.assert_array_equal(births[3].ellipse, frame.ellipses[1, 2])
    np.testing.assert_array_equal(births[4].ellipse, frame.ellipses[1, 1])


@pytest.mark.jit
def test_a_trial_of_several_methods_is_that_of_each() -> None:
    methods = {
        "a": {"method": "mipf"},
        "b": {"method": "bmct", "set": {"particles": 30}},
        "c": {"method": "bmct", "use": 1},
    }
    together = run_views_trial(views_spec(5, methods, SMALL, parts=2))
    alone = run_views_trial({"kind": "qu-views", "seed": 5, "balls": SMALL, "method": "bmct", "set": {"particles": 30}})
    for name in ("fr_p", "fr_l", "idf1", "hota", "mota", "mode_bmct", "bad"):
        np.testing.assert_equal(together[f"b.{name}"], alone[name])
    assert (alone["particles"], together["a.particles"]) == (30.0, 60.0)
    assert together["c.mode_bmct"] == 0.0  # one view
    assert 0.0 <= together["a.off_1"] <= 1.0


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"balls": {"views": 9}}, "views is 9, must be at least 1 and at most 6"),
        ({"method": "magic"}, "no method 'magic'"),
        ({"colour": 3}, "unknown key 'colour'"),
        ({"use": 3}, "use is 3, must be 1 to 2"),
        ({"use": 0}, "use is 0, must be 1 to 2"),
    ],
)
def test_what_cannot_be_is_refused(change: dict[str, object], expected: str) -> None:
    spec = {"kind": "qu-views", "seed": 1, "balls": SMALL, "method": "mipf", **change}
    with pytest.raises(InputError, match=expected):
        run_views_trial(spec)


def test_settings_that_a_method_does_not_have_are_refused() -> None:
    with pytest.raises(UsageError, match="mipf has no setting 'alpha'"):
        run_views_trial({"seed": 1, "balls": SMALL, "method": "mipf", "set": {"alpha": 2.0}})


def test_the_first_views_of_the_truth() -> None:
    truth, radius, _ = made_up(frames=2, views=3)
    kept, reach = views_world.of_views(truth, radius, 2)
    assert len(kept.frame) == len(reach) == 8
    assert set(kept.view.tolist()) == {0, 1}


def test_exchanged_trackers_are_in_each_others_place() -> None:
    config = BallsConfig(**SMALL)
    runner = runner_of(config, {"seed": 5}, {"method": "bmct", "wrong": [1, 0, 2, 3]})
    frame = next(render_balls(config, 5))
    state = initial_state(views_world.views_of(config), runner.geometry, runner.config)
    state = initiate_trackers(state, views_world.frame_set_of(frame, 2), runner.births)
    assert runner.exchange == (1, 0, 2, 3)
    t, after = state.trackers, follow.exchanged(state, 1, 0, 2).trackers
    np.testing.assert_array_equal(after.target, t.target)
    np.testing.assert_array_equal(after.colours, t.colours)
    place = dict(zip(zip(t.view, t.target, strict=True), t.estimate, strict=True))
    for view, target, estimate, cloud in zip(t.view, t.target, after.estimate, after.particles, strict=True):
        source = {(1, 0): (1, 2), (1, 2): (1, 0)}.get((view, target), (view, target))
        np.testing.assert_array_equal(estimate, place[source])
        np.testing.assert_allclose(cloud.mean(axis=0), place[source])
    with pytest.raises(InputError, match="has no trackers of targets 0 and 9"):
        follow.exchanged(state, 1, 0, 9)
