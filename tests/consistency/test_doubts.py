"""Reasons not to believe an estimate."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.consistency.estimates import QualityFlags, near_edge, outside_view, without_distance
from occlog.consistency.verdict import QUALITY_FLAGS
from occlog.records.scene import Camera, Scene, camera_rotation
from occlog.records.tables import Diagnostics, Tracks

SECOND = 1_000_000_000
SQUARE = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])


def camera(name: str, x: float, y: float, yaw_deg: float, **more) -> Camera:
    rotation = camera_rotation(np.radians(yaw_deg), 0.0, 0.0)
    return Camera(name, np.array([x, y, 0.0]), rotation, np.full(2, 500.0), np.full(2, 250.0), (501, 501), **more)


OPEN = Scene(cameras=(camera("a", 0.0, 0.0, 0.0, range=30.0), camera("b", 10.0, -10.0, 90.0, range=30.0)))
ROOM = Scene(cameras=OPEN.cameras, room=SQUARE - [0.0, 5.0])


def rows(*seen_by: str, xy=(10.0, 0.0), sd=0.1, step_s=1.0, fallback="", t0=0) -> tuple[Tracks, Diagnostics]:
    """Rows of one target every `step_s`, with the sensors that saw it in each."""
    n = len(seen_by)
    t_ns = np.round((t0 + step_s * np.arange(n)) * SECOND).astype(np.int64)
    spread = {"cov_xx": np.full(n, sd**2), "cov_xy": np.zeros(n), "cov_yy": np.full(n, sd**2)}
    place = {"x": np.full(n, xy[0]), "y": np.full(n, xy[1]), "vx": np.zeros(n), "vy": np.zeros(n)}
    tracks = Tracks.of(t_ns=t_ns, target_id=np.zeros(n, np.int32), **place, **spread)
    flags = [fallback] + [""] * (n - 1)
    counts = np.array([len(s.split(",")) if s else 0 for s in seen_by], dtype=np.int32)
    diagnostics = Diagnostics(
        t_ns=t_ns,
        target_id=np.zeros(n, np.int32),
        ess=np.full(n, 100.0),
        log_likelihood=np.zeros(n),
        n_observing=np.full(n, 2, np.int32),
        n_detected=counts,
        fallback=np.array(flags),
        cameras=np.full(n, "a,b"),
        n_available=np.full(n, 2, np.int32),
        selected=np.full(n, "", "U1"),
        predicted_mse=np.full(n, np.nan),
        seen_by=np.array(seen_by),
    )
    return tracks, diagnostics


def doubts(scene: Scene, *parts, online=True, started=False) -> list[str]:
    judge = QualityFlags(scene, online=online, started=started)
    return [d for part in parts for d in judge.judged(*part)[1].quality_flags.tolist()]


def test_an_estimate_is_at_the_edge_within_two_standard_deviations():
    cov = np.broadcast_to(np.diag([1.0, 0.01]), (4, 2, 2))
    xy = np.array([[2.01, 5.0], [1.99, 5.0], [5.0, 0.21], [11.0, 5.0]])
    assert near_edge(xy, cov, SQUARE).tolist() == [False, True, False, True]


def test_an_estimate_is_out_of_view_beyond_three_standard_deviations():
    origin, cov = np.zeros(2), np.broadcast_to(0.01 * np.eye(2), (4, 2, 2))
    border = np.pi / 4 + np.array([0.029, 0.031])
    xy = np.concatenate([10.0 * np.column_stack([np.cos(border), np.sin(border)]), [[20.29, 0.0], [20.31, 0.0]]])
    found = outside_view(xy, cov, origin, 0.0, np.pi / 2, np.inf)
    assert found.tolist() == [False, True, False, False]
    assert outside_view(xy, cov, origin, 0.0, np.pi / 2, 20.0).tolist() == [False, True, False, True]
    behind = np.array([[-5.0, 0.0], [-0.1, 0.0]])
    assert outside_view(behind, cov[:2], origin, 0.0, np.pi / 2, np.inf).tolist() == [True, False]
    assert not outside_view(behind, cov[:2], origin, 0.0, 2.0 * np.pi, np.inf).any()


def test_an_unknown_distance_has_the_second_moment_of_the_prior_along_the_line_alone():
    cov = without_distance(np.array([0.0, 30.0]), np.diag([0.04, 1.0]), np.zeros(2), 40.0)
    np.testing.assert_allclose(cov, np.diag([0.04, 40.0**2 / 12.0 + 10.0**2]))
    wide = np.diag([0.04, 1e4])
    np.testing.assert_array_equal(without_distance(np.array([0.0, 30.0]), wide, np.zeros(2), 40.0), wide)
    assert np.isfinite(without_distance(np.zeros(2), np.eye(2), np.zeros(2), 40.0)).all()


def test_two_sensors_leave_no_doubt():
    assert doubts(OPEN, rows("a,b", "a,b", "a", "b")) == [""] * 4


def test_one_sensor_alone_is_doubted_after_a_second_and_its_covariance_holds_all_distances():
    judge = QualityFlags(OPEN, online=True, started=False)
    tracks, diagnostics = judge.judged(*rows("a", "a", "a"))
    assert diagnostics.quality_flags.tolist() == ["", "", "single_sensor"]
    np.testing.assert_allclose(tracks.cov_xx, [0.01, 0.01, 30.0**2 / 12.0 + 5.0**2])
    np.testing.assert_allclose(tracks.cov_yy, 0.01)


def test_one_sensor_alone_is_doubted_five_seconds_after_two_and_keeps_the_filters_covariance():
    judge = QualityFlags(OPEN, online=True, started=False)
    tracks, diagnostics = judge.judged(*rows("a,b", *["a"] * 6, "a,b"))
    assert diagnostics.quality_flags.tolist() == [""] * 6 + ["single_sensor", ""]
    np.testing.assert_allclose(tracks.cov_xx, 0.01)


def test_what_was_seen_is_remembered_over_chunks_and_forgotten_at_a_restart():
    assert doubts(OPEN, rows("a,b"), rows("a", t0=4), rows("a", "a", t0=6)) == [
        "",
        "",
        "single_sensor",
        "single_sensor",
    ]
    again = rows("a", "a", "a", t0=1, fallback="restart")
    assert doubts(OPEN, rows("a,b"), again) == ["", "", "", "single_sensor"]


def test_sensors_that_look_in_turn_see_together_within_a_second():
    assert doubts(OPEN, rows(*["a", "b"] * 8, step_s=0.9)) == [""] * 16


def test_a_given_start_tells_the_distance_for_five_seconds():
    assert doubts(OPEN, rows(*["a"] * 7), started=True) == [""] * 6 + ["single_sensor"]


def test_in_a_room_one_sensor_is_doubted_but_the_covariance_stays():
    judge = QualityFlags(ROOM, online=True, started=False)
    tracks, diagnostics = judge.judged(*rows("a", "a", "a", xy=(9.99, 0.0)))
    assert diagnostics.quality_flags.tolist() == ["", "", "single_sensor"]
    np.testing.assert_allclose(tracks.cov_xx, 0.01)


def test_the_edge_of_a_guessed_region_is_doubted_and_that_of_a_room_is_not():
    middle = OPEN.region.mean(axis=0)
    assert doubts(OPEN, rows("", xy=OPEN.region[0])) == ["region_edge"]
    assert doubts(OPEN, rows("", xy=middle)) == [""]
    assert doubts(ROOM, rows("a,b", xy=(9.99, 0.0))) == [""]


def test_a_track_outside_the_view_of_a_camera_that_sees_it_is_doubted():
    assert doubts(ROOM, rows("a", "b", xy=(25.0, 0.0))) == ["", "out_of_view"]
    assert doubts(OPEN, rows("a,b", "a", xy=(5.0, 6.0)), online=False) == ["out_of_view", "out_of_view"]


def test_a_false_bearing_of_one_sensor_among_three_is_no_doubt_of_the_track():
    behind = camera("c", 20.0, 0.0, 0.0, range=30.0)
    scene = Scene(cameras=(*OPEN.cameras, behind), room=ROOM.room)
    assert doubts(scene, rows("a,b,c", "a,b", "a,c", "c", xy=(10.0, 0.0))) == ["", "", "out_of_view", "out_of_view"]


@pytest.mark.parametrize("scene", [OPEN, ROOM])
def test_a_smoothed_track_is_not_doubted_for_one_sensor_or_the_edge(scene):
    assert doubts(scene, rows(*["a"] * 9, xy=(29.99, 0.0)), online=False) == [""] * 9


def test_every_doubt_has_its_words_and_no_rows_no_doubts():
    row = {"region_edge", "single_sensor", "out_of_view", "undetected_in_view"}
    assert set(QUALITY_FLAGS) == {*row, "inconsistent_sensor"}
    assert doubts(OPEN, (Tracks.empty(), Diagnostics.empty())) == []
