"""Staged videos: what the scenes bring about, balls that a view does not see, and where trackers are stated to be."""

from __future__ import annotations

import math

import numpy as np
import pytest

from occlog.core.metrics.mot.frame_pairs import Objects
from occlog.errors import InputError
from occlog.papers.qu.staged import SCENES, Staging, staged_paths, staging_of, video_of
from occlog.papers.qu.tracker_runs import TrackerOutput
from occlog.papers.qu.trial import run_views_trial, views_spec, watched_figures, whereabouts
from occlog.papers.qu.world import births_of, truth_of
from occlog.simulate.balls.config import BallsConfig
from occlog.simulate.balls.motion import ball_cameras

RADIUS = 22.0
SMALL = {"frames": 4, "balls": 3, "radius": 9.0, "width": 80, "height": 64, "background_clutter": 0}


def seen(scene: str, seed: int, balls: int) -> np.ndarray:
    """Places in both views, (2, T, n, 2)."""
    config = BallsConfig(frames=120, balls=balls)
    centres = staged_paths(config, seed, scene).centres
    return np.stack([camera.project(centres.reshape(-1, 3)).reshape(120, balls, 2) for camera in ball_cameras(config)])


def gaps(positions: np.ndarray) -> np.ndarray:
    return np.linalg.norm(positions[..., 1, :] - positions[..., 0, :], axis=-1)


@pytest.mark.parametrize("scene", [name for name in SCENES if not name.startswith("decoys")])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_two_balls_start_and_end_apart_and_hide_one_another_in_one_view_alone(scene, seed) -> None:
    positions = seen(scene, seed, 2)
    near = gaps(positions)
    view = 0 if scene in ("together", "opposite") else 1
    assert near[:, [0, -1]].min() > 2.0 * RADIUS
    assert near[view].min() < 0.4 * RADIUS
    assert near[1 - view].min() > 4.0 * RADIUS
    assert ((positions > RADIUS - 1) & (positions < np.array([320, 240]) - RADIUS)).all()
    steps = np.diff(positions[view], axis=0)
    side = (steps[:, 0] * steps[:, 1]).sum(axis=-1)
    if scene == "opposite":
        assert (side < 0).all()
    elif scene != "right-angle":
        assert np.mean(side > 0) > 0.7
    if scene == "together":
        assert np.mean(near[0] < RADIUS) > 0.3  # for long


def test_balls_on_one_row_cannot_be_distinguished_by_the_lines() -> None:
    for scene in ("row-overtaking", "row-falling-back"):
        rows = seen(scene, 1, 2)[..., 1]
        assert np.abs(rows[..., 0] - rows[..., 1]).max() < 0.3 * RADIUS


@pytest.mark.parametrize("scene", ["decoys-on-line", "decoys-off-line"])
def test_decoys_never_touch_and_are_on_one_row_or_in_one_column(scene) -> None:
    positions = seen(scene, 4, 4)
    away = np.linalg.norm(positions[:, :, :, None] - positions[:, :, None], axis=-1)[..., *np.triu_indices(4, 1)]
    assert away.min() > 2.2 * RADIUS
    assert ((positions > RADIUS - 1) & (positions < np.array([320, 240]) - RADIUS)).all()
    axis = 1 if scene == "decoys-on-line" else 0
    np.testing.assert_allclose(np.ptp(positions[..., axis], axis=-1), 0.0, atol=0.1)


def test_unknown_scenes_and_wrong_numbers_of_balls_are_refused() -> None:
    with pytest.raises(InputError, match="scene is 'parade', must be one of together"):
        staging_of("parade", ())
    with pytest.raises(InputError, match="scene together has 2 balls, not 6"):
        staged_paths(BallsConfig(frames=5), 1, "together")


@pytest.mark.jit
def test_a_ball_that_the_first_view_does_not_see_is_there_for_the_others() -> None:
    config = BallsConfig(**SMALL)
    plain, hidden = (list(video_of(config, 2, Staging("", unseen))) for unseen in ((), (1,)))
    assert (plain[0].images[0] != hidden[0].images[0]).any()
    assert (plain[0].images[1] == hidden[0].images[1]).all()
    assert np.isnan(hidden[0].ellipses[0, 1]).all()
    np.testing.assert_array_equal(plain[0].ellipses[1], hidden[0].ellipses[1])
    assert hidden[0].share[0, 1] == 0.0
    assert [(b.view, b.target_id) for b in births_of(hidden[0], 2)] == [(0, 0), (0, 2), (1, 0), (1, 1), (1, 2)]
    truth, radius = truth_of(hidden)
    assert len(truth.frame) == len(radius) == 4 * 5
    found = run_views_trial(views_spec(2, {"b": {"method": "bmct"}}, SMALL, unseen=[1], watched={"w": [1, [1]]}))
    assert (found["b.w_helped"], found["b.w_off"], found["b.fr_p"]) == (0.0, 0.0, 0.0)


@pytest.mark.jit
def test_a_tracker_that_is_led_astray_is_off_its_target_from_then_on() -> None:
    diverted = {"view": 0, "target": 0, "frame": 2, "x": 400.0, "y": 32.0}
    methods = {"b": {"method": "mipf", "diverted": diverted}, "a": {"method": "mipf"}}
    found = run_views_trial(views_spec(2, methods, SMALL, watched={"w": [0, [0]]}))
    assert (found["a.w_off"], found["a.w_end_own"]) == (0.0, 1.0)
    assert (found["b.w_off"], found["b.w_end_none"]) == (0.5, 1.0)


def test_whereabouts_tell_own_other_and_none_apart_at_the_edge() -> None:
    n = 3
    box = np.array([[-10.0, -10.0, 20.0, 20.0], [40.0, -10.0, 20.0, 20.0]])
    truth = Objects(np.repeat(np.arange(n), 2), np.tile([0, 1], n), np.tile(box, (n, 1)), np.zeros(2 * n, dtype=int))
    # Of target 0: at the end of its reach, just beyond it, on the other; the tracker of target 1 ends after a frame
    x = np.array([10.0, 10.0 + 1e-9, 45.0, 50.0])
    frame, target = np.array([0, 1, 2, 0]), np.array([0, 0, 0, 1])
    zero = np.zeros(4, dtype=int)
    followed = TrackerOutput(
        frame=frame,
        view=zero,
        target=target,
        ellipse=np.column_stack([x, np.zeros((4, 4))]),
        mode=np.array([-1, 2, 0, -1]),
        counterpart=zero,
        event=zero,
        ess=np.zeros(4),
        seconds=np.zeros(3),
        parts=np.zeros((0, 3)),
    )
    where = whereabouts(truth, followed, np.full(2 * n, 10.0), 0, [0, 1])
    assert where.own.tolist() == [[True, True], [False, False], [False, False]]
    assert where.other.tolist() == [[False, False], [False, False], [True, False]]
    assert watched_figures(where) == {
        "helped": 0.5,
        "off": pytest.approx(4 / 6),
        "end_own": 0.0,
        "end_other": 0.5,
        "end_none": 0.5,
    }
    assert math.isnan(whereabouts(truth, followed, np.full(2 * n, 10.0), 0, [1]).helped)
