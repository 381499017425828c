from __future__ import annotations

import numpy as np
import pytest
from tracker_scenes import SECOND, camera, room100, with_array

from occlog.errors import InputError
from occlog.records.scene import Scene
from occlog.records.tables import Bearings
from occlog.scans.grouping import BearingRows, scans_of

SCENE = room100()
ALL = BearingRows(frozenset(c.name for c in SCENE.cameras))


def table(*rows):
    """Rows (time [s], camera number, target, u_px or None)."""
    t, place, target, u = zip(*rows, strict=True)
    seen = np.array([v is not None for v in u])
    value = np.array([0.0 if v is None else v for v in u])
    n = len(rows)
    return Bearings.of(
        t_ns=[round(v * SECOND) for v in t],
        sensor=[f"cam{i}" for i in place],
        target_id=np.array(target, dtype=np.int32),
        seen=seen,
        bearing=np.where(seen, 0.1, np.nan),
        sigma=np.where(seen, 0.01, np.nan),
        u_px=np.where(seen, value, np.nan),
        sigma_px=np.where(seen, 1.0, np.nan),
        score=np.full(n, np.nan),
    )


def shown(found):
    return [(g.t_ns / SECOND, list(zip((g.sensor + 1).tolist(), g.target_id.tolist(), strict=True))) for g in found]


def test_rows_of_equal_time_form_a_scan_by_sensor():
    rows = table((0, 1, 0, 5.0), (0, 1, 1, None), (0, 3, 0, 7.0), (0.5, 2, 0, 1.0))
    found = list(scans_of([rows], SCENE, ALL))
    assert shown(found) == [(0.0, [(1, 0), (1, 1), (3, 0)]), (0.5, [(2, 0)])]
    assert found[0].u_px.tolist()[0] == 5.0
    assert found[0].seen.tolist() == [True, False, True]


def test_sensors_come_in_the_order_of_the_scene_not_of_their_names():
    scene = Scene((camera("z", (0, 0), 0), camera("a", (1, 0), 0)), room=SCENE.room)
    rows = table((0, 1, 0, 1.0), (0, 2, 0, 2.0))
    renamed = Bearings(
        **{c.name: getattr(rows, c.name) for c in Bearings.columns() if c.name != "sensor"}, sensor=np.array(["a", "z"])
    )
    (scan,) = scans_of([renamed], scene, BearingRows(frozenset("az")))
    assert scan.u_px.tolist() == [2.0, 1.0]


@pytest.mark.parametrize("window_ns", [0, 30_000_000])
def test_where_chunks_are_cut_does_not_matter(window_ns):
    rng = np.random.default_rng(0)
    times = np.sort(rng.integers(0, 40, 120)) * 0.01
    rows = [(t, int(i), -1, float(k)) for k, (t, i) in enumerate(zip(times, rng.integers(1, 9, 120), strict=True))]
    whole = table(*rows)
    expected = list(scans_of([whole], SCENE, ALL, window_ns))
    for cuts in ([7, 8, 50], [60], list(range(1, 120))):
        parts = [whole.take(slice(a, b)) for a, b in zip([0, *cuts], [*cuts, 120], strict=True)]
        found = list(scans_of([*parts, Bearings.empty()], SCENE, ALL, window_ns))
        assert shown(found) == shown(expected)
        for a, b in zip(found, expected, strict=True):
            np.testing.assert_array_equal(a.u_px, b.u_px)
    assert sum(len(g.sensor) for g in expected) == 120


def test_a_window_joins_cameras_that_are_a_little_apart():
    rows = table((0, 1, 0, 1.0), (0.004, 2, 0, 2.0), (0.009, 3, 0, 3.0), (0.02, 1, 0, 4.0), (0.024, 2, 0, 5.0))
    found = shown(scans_of([rows], SCENE, ALL, 10_000_000))
    assert found == [(0.009, [(1, 0), (2, 0), (3, 0)]), (0.024, [(1, 0), (2, 0)])]
    assert len(list(scans_of([rows], SCENE, ALL))) == 5


def test_rows_exactly_a_window_apart_form_a_scan_and_rows_a_nanosecond_more_do_not():
    window_ns = 10_000_000
    for apart_ns, scans in ((window_ns, 1), (window_ns + 1, 2)):
        rows = table((0, 1, 0, 1.0), (0, 2, 0, 2.0))
        columns = {c.name: getattr(rows, c.name) for c in Bearings.columns()}
        later = Bearings(**columns | {"t_ns": np.array([0, apart_ns])})
        assert len(list(scans_of([later], SCENE, ALL, window_ns))) == scans


def test_a_camera_that_speaks_twice_in_a_window_starts_a_new_scan():
    rows = table((0, 1, 0, 1.0), (0.001, 2, 0, 2.0), (0.002, 1, 0, 3.0), (0.003, 2, 0, 3.0))
    found = shown(scans_of([rows], SCENE, ALL, 10_000_000))
    assert found == [(0.001, [(1, 0), (2, 0)]), (0.003, [(1, 0), (2, 0)])]


def test_rows_of_other_sensors_and_targets_are_left_out():
    rows = table((0, 1, 0, 1.0), (0, 1, 4, 1.0), (0, 2, 0, 1.0), (0, 2, -1, 1.0), (1, 3, 4, None))
    use = BearingRows(frozenset({"cam1", "cam2"}), targets=(4,))
    assert shown(scans_of([rows], SCENE, use)) == [(0.0, [(1, 4), (2, -1)])]
    assert shown(scans_of([rows], SCENE, use._replace(unlabelled=False))) == [(0.0, [(1, 4)])]


def test_a_target_gets_its_rows_and_candidates_of_sensors_that_have_none_for_it():
    rows = table((0, 1, 0, 1.0), (0, 1, -1, 2.0), (0, 2, -1, 3.0), (0, 2, -1, 4.0), (0, 3, 7, 5.0))
    (scan,) = scans_of([rows], SCENE, ALL)
    found = scan.of_target(0)
    assert found is not None
    assert found.u_px.tolist() == [1.0, 3.0, 4.0]
    assert found.labelled.tolist() == [True, False, False]
    seven = scan.of_target(7)
    assert seven is not None
    assert seven.sensor.tolist() == [0, 1, 1, 2]
    assert seven.labelled.tolist() == [False, False, False, True]


def test_a_scan_without_rows_for_a_target_is_none():
    (scan,) = scans_of([table((0, 1, 0, 1.0))], SCENE, ALL)
    assert scan.of_target(1) is None


def test_a_camera_that_reports_a_target_twice_at_one_time_is_refused():
    rows = table((0, 1, 0, 1.0), (1, 2, 0, 1.0), (1, 2, 0, 2.0))
    with pytest.raises(InputError, match=r"sensor 'cam2' has two rows of target 0 at 1 s; .*-1"):
        list(scans_of([rows], SCENE, ALL))
    with pytest.raises(InputError, match="cam2"):  # also when a chunk ends between them
        list(scans_of([rows.take(slice(0, 2)), rows.take(slice(2, 3))], SCENE, ALL))


def test_times_that_go_back_between_chunks_are_refused():
    chunks = [table((0, 1, 0, 1.0), (2, 2, 0, 1.0)), table((1, 2, 0, 1.0))]
    with pytest.raises(InputError, match="row 2: sensor 'cam2': time 1 s is earlier than the preceding 2 s; sort"):
        list(scans_of(chunks, SCENE, ALL))


def test_a_sensor_that_the_scene_does_not_have_is_named_with_the_nearest():
    with pytest.raises(InputError, match="row 1: no sensor 'cam9' in the scene; did you mean 'cam"):
        list(scans_of([table((0, 1, 0, 1.0), (0, 9, 0, 1.0))], SCENE, ALL))


def test_a_camera_without_pose_is_refused_unless_it_is_left_out():
    blind = Scene((camera("cam1", (0, 0), 0), camera("cam2", (9, 0), 0, placed=False)), room=SCENE.room)
    rows = table((0, 1, 0, 1.0), (0, 2, 0, 1.0))
    with pytest.raises(InputError, match=r"camera 'cam2' has no pose in the scene; .*leave cam2 out"):
        list(scans_of([rows], blind, BearingRows(frozenset({"cam1", "cam2"}))))
    assert len(list(scans_of([rows], blind, BearingRows(frozenset({"cam1"}))))) == 1


def test_arrays_count_after_the_cameras():
    scene = with_array(SCENE, (5.0, 5.0))
    rows = table((0, 1, 0, 1.0))
    heard = Bearings(
        **{c.name: getattr(rows, c.name) for c in Bearings.columns() if c.name != "sensor"}, sensor=np.array(["array"])
    )
    (scan,) = scans_of([heard], scene, BearingRows(frozenset({"array"})))
    assert scan.sensor.tolist() == [8]
