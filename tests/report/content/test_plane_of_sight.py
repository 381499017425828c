from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_up import ring_scene, run

from occlog.core.geometry.camera import wrap_angle
from occlog.records.tables import Bearings
from occlog.report.content.model import ReportInput
from occlog.report.content.sight import edges_of, positions_at, visible_area

ROOM = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 6.0], [0.0, 6.0]])


def area(polygon: np.ndarray) -> float:
    x, y = polygon.T
    return 0.5 * abs(float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))))


def test_free_wedge_has_the_area_of_a_sector() -> None:
    seen = visible_area(np.zeros(2), 0.7, np.radians(60), 5.0, np.empty((0, 2, 2)))
    assert area(seen) == pytest.approx(0.5 * 25.0 * np.radians(60), rel=1e-3)
    np.testing.assert_array_equal(seen[0], [0, 0])


def test_all_around_in_a_room_is_the_room() -> None:
    seen = visible_area(np.array([4.0, 2.0]), 0.0, 2 * np.pi, 100.0, edges_of(ROOM))
    assert area(seen) == pytest.approx(60.0, rel=1e-3)


def test_camera_on_the_wall_sees_into_the_room() -> None:
    seen = visible_area(np.array([5.0, 0.0]), np.pi / 2, np.radians(178), 100.0, edges_of(ROOM))
    assert area(seen) > 50.0


def test_pillar_throws_a_shadow() -> None:
    pillar = np.array([[4.0, -1.0], [5.0, -1.0], [5.0, 1.0], [4.0, 1.0]])
    free = visible_area(np.zeros(2), 0.0, np.radians(90), 20.0, np.empty((0, 2, 2)))
    seen = visible_area(np.zeros(2), 0.0, np.radians(90), 20.0, edges_of(pillar))
    # The pillar hides a wedge of 2 atan(1/4) from its front, x = 4, on.
    hidden = 0.5 * 400.0 * 2 * np.arctan(0.25) - 0.5 * 4.0 * 2.0
    assert area(free) - area(seen) == pytest.approx(hidden, rel=1e-3)


def test_positions_between_estimates_and_outside_the_track() -> None:
    data = run(steps=50)
    t_ns = data.tracks.t_ns
    middle = positions_at(data.tracks, 0, (t_ns[:-1] + t_ns[1:]) // 2)
    np.testing.assert_allclose(middle[:, 0], (data.tracks.x[:-1] + data.tracks.x[1:]) / 2)
    assert np.isnan(positions_at(data.tracks, 0, t_ns[-1:] + 1)).all()
    assert np.isnan(positions_at(data.tracks, 7, t_ns)).all()


def truly(data: ReportInput) -> ReportInput:
    """The run with tracks that are the truth, of which no errors are known."""
    return replace(data, tracks=replace(data.tracks, x=data.truth.x, y=data.truth.y), errors=None)


def test_sight_lines_meet_at_the_truth_and_residuals_have_the_stated_noise() -> None:
    data = run(steps=600, cameras=6, targets=2)
    true = truly(data)
    for target in (0, 1):
        assert true.sight[target].rows > 300
        # Noise of 0.01 rad at about 50 m: half a metre across, more where lines cross at small angles.
        assert np.median(true.sight[target].distance) < 1.0
    found = true.residuals[0].drawn
    assert len(found.residual) > 1000
    # 1000 draws or more: the deviation is known to 5 % (two standard errors)
    assert np.std(found.residual / found.sigma) == pytest.approx(1.0, abs=0.06)


def test_distances_need_two_sensors() -> None:
    found = run(steps=100, cameras=1, errors=None).sight[0]
    assert found.rows == len(found.t_ns) == len(found.distance) == 0


def test_sensors_without_pose_are_left_out() -> None:
    data = run(steps=100, cameras=3)
    found = replace(data, scene=ring_scene(2)).residuals[0].drawn
    assert set(np.unique(found.sensor)) <= {0, 1}
    assert found.names == ("camera 1", "camera 2")


def moved(bearings: Bearings, **columns: np.ndarray) -> Bearings:
    values = {c.name: getattr(bearings, c.name) for c in Bearings.columns()} | columns
    return Bearings.of(**values).sorted()


def test_sensors_that_do_not_share_their_times_still_meet() -> None:
    data = run(steps=200, cameras=4)
    _, number = np.unique(data.bearings.sensor, return_inverse=True)
    apart = moved(data.bearings, t_ns=np.sort(data.bearings.t_ns + number * 1_000_000))
    together, found = truly(data).sight[0], truly(replace(data, bearings=apart)).sight[0]
    assert found.rows == pytest.approx(together.rows, abs=10)
    # The target moves by up to 1.2 m a frame.
    assert np.median(found.distance) < 1.5


def test_the_nearest_candidate_is_taken_where_none_is_labelled() -> None:
    data = run(steps=100, cameras=2, errors=None)
    own = moved(data.bearings, target_id=np.full(len(data.bearings), -1))
    away = np.where(own.seen, wrap_angle(own.bearing + 0.7), np.nan)
    both = Bearings.merge([own, moved(own, bearing=away)])
    empty = replace(data, bearings=both)
    want, found = data.residuals[0].drawn, empty.residuals[0].drawn
    np.testing.assert_array_equal(found.residual, want.residual)
    np.testing.assert_array_equal(found.t_ns, want.t_ns)
    assert empty.sight[0].rows == 0


@pytest.mark.parametrize(("fov", "sensor"), [(2 * np.pi, False), (7.0, False), (2 * np.pi - 1e-6, True)])
def test_the_sensor_is_a_corner_unless_it_sees_all_around(fov: float, sensor: bool) -> None:
    seen = visible_area(np.zeros(2), 0.0, fov, 5.0, np.empty((0, 2, 2)))
    assert bool((seen[0] == 0.0).all()) is sensor
