"""A scan: rows of one time, of one sensor, of one target."""

from __future__ import annotations

import numpy as np
from tracker_scenes import room100, with_array

from occlog.records.tables import UNLABELLED, Bearings
from occlog.scans.grouping import COLUMNS, Scan, concat, empty_scan, sensor_names


def made(*rows):
    """Rows (sensor, target, seen), with bearings 0, 1, 2 .. rad."""
    sensor, target, seen = zip(*rows, strict=True)
    return Scan.of(7, sensor, target_id=target, seen=seen, bearing=np.arange(len(rows)))


def test_a_scan_has_the_columns_of_bearings_in_their_types() -> None:
    names = [c.name for c in Bearings.columns()]
    assert [n for n in names if n in COLUMNS] == list(COLUMNS)
    assert set(names) - set(COLUMNS) == {"t_ns", "cause"}
    scan = Scan.of(5, [0, 2])
    assert all(getattr(scan, c.name).dtype == c.dtype for c in Bearings.columns() if c.name in COLUMNS[1:])
    assert np.isnan(scan.bearing).all()
    assert (scan.seen.all(), scan.labelled.any(), scan.occluders) == (True, False, None)


def test_a_target_has_its_rows_and_candidates_of_sensors_that_have_none_for_it() -> None:
    scan = made((0, 3, True), (0, UNLABELLED, True), (1, UNLABELLED, True), (1, UNLABELLED, True), (2, 4, False))
    three, four = scan.of_target(3), scan.of_target(4)
    assert three is not None
    assert three.bearing.tolist() == [0.0, 2.0, 3.0]
    assert three.labelled.tolist() == [True, False, False]
    assert four is not None
    assert four.bearing.tolist() == [1.0, 2.0, 3.0, 4.0]
    alone = made((0, 3, True), (1, 3, False))
    assert alone.of_target(3) is alone
    assert alone.of_target(4) is None
    assert Scan.of(0, []).of_target(0) is None


def test_rows_by_sensor_are_those_that_are_seen() -> None:
    scan = made((0, 1, True), (0, 2, False), (3, UNLABELLED, False), (5, 1, True), (5, 2, True))
    found = {sensor: rows.bearing.tolist() for sensor, rows in scan.by_sensor()}
    assert found == {0: [0.0], 3: [], 5: [3.0, 4.0]}


def test_sensors_that_look_in_vain_have_a_row_that_is_not_seen() -> None:
    scan = concat([empty_scan(3, [1, 4]), made((2, 1, True))])
    assert scan.t_ns == 7  # that of the last
    assert scan.sensor.tolist() == [1, 4, 2]
    assert scan.seen.tolist() == [False, False, True]
    assert [(sensor, len(rows.sensor)) for sensor, rows in scan.by_sensor()] == [(1, 0), (2, 1), (4, 0)]


def test_sensors_count_cameras_first() -> None:
    assert sensor_names(with_array(room100(cameras=2), (1.0, 1.0))) == ("cam1", "cam2", "array")
