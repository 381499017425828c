from __future__ import annotations

import numpy as np
import pytest
from heard_scenes import NS, ROOM, room, table

from occlog.scans.grouping import BearingRows, scans_of
from occlog.track.methods.imm.filter import ArrayScans

SCENE = room(ROOM.replace(", rate_hz: 5}\n- {name: a2", "}\n- {name: a2"))
"""a1 has no stated rate; a2 has 5 Hz."""


def scans(times, scene=SCENE, forget_s=10.0):
    """What is heard [s -> sensors] as (time [s], arrays with bearings, arrays without)."""
    bearings = table([(round(t * NS), name, -1, 0.5, 0.1) for t, names in times for name in names])
    listener, out = ArrayScans(scene, forget_s), []
    for scan in scans_of([bearings], scene, BearingRows(frozenset({"a1", "a2", "c1"}))):
        for sounds in listener.scans(scan):
            arrays = [(sensor - len(scene.cameras), len(rows.bearing)) for sensor, rows in sounds.by_sensor()]
            out.append((sounds.t_ns / NS, [a for a, n in arrays if n], [a for a, n in arrays if not n]))
    return out


def test_a_gap_of_an_array_with_a_rate_is_filled_with_scans_in_vain():
    found = scans([(0.0, ["a2"]), (0.2, ["a2"]), (1.0, ["a2"])])
    assert found == [
        (0.0, [1], []),
        (0.2, [1], []),
        *((pytest.approx(t), [], [1]) for t in (0.4, 0.6, 0.8)),
        (1.0, [1], []),
    ]


@pytest.mark.parametrize(("late", "gaps"), [(0.299, 0), (0.301, 1)])
def test_a_row_that_is_late_by_up_to_half_a_period_is_no_gap(late, gaps):
    assert [len(f[2]) for f in scans([(5.0, ["a2"]), (5.0 + late, ["a2"])])] == [0] + gaps * [1] + [0]


def test_an_array_without_a_rate_is_timed_by_its_rows():
    times = [(5.0 + 0.1 * n, ["a1"]) for n in range(5)] + [(5.7, ["a1"])]
    assert scans(times)[-3:] == [(pytest.approx(5.5), [], [0]), (pytest.approx(5.6), [], [0]), (5.7, [0], [])]
    assert all(not f[2] for f in scans([(0.0, ["a1"]), (0.1, ["a1"]), (0.7, ["a1"])]))  # too few to tell


def test_an_array_that_has_had_no_row_does_not_listen():
    assert all(1 not in f[2] for f in scans([(0.2 * n, ["a1"]) for n in range(6)]))


def test_another_arrays_scan_shows_silence_at_its_time():
    times = [(0.2 * n, ["a1", "a2"]) for n in range(5)] + [(1.0, ["a1"]), (1.2, ["a1", "a2"])]
    assert scans(times)[-2:] == [(1.0, [0], [1]), (1.2, [0, 1], [])]


@pytest.mark.parametrize("offset", [0.0, 0.03, 0.1, 0.17])
def test_arrays_out_of_step_are_not_silent_before_their_time(offset):
    times = sorted([(0.2 * n, ["a1"]) for n in range(20)] + [(0.2 * n + offset, ["a2"]) for n in range(20)])
    assert not any(silent for _, _, silent in scans(times))


def test_rows_of_cameras_are_no_scans():
    found = scans([(0.0, ["a2"]), (0.2, ["a2"]), (0.25, ["c1"]), (0.75, ["c1"])])
    assert [f[0] for f in found] == [0.0, 0.2, pytest.approx(0.4), pytest.approx(0.6)]


def test_of_a_long_silence_only_so_much_is_gone_through():
    found = scans([(0.0, ["a2"]), (1000.0, ["a2"])], forget_s=2.0)
    assert len(found) == 2 + 10
    assert found[-1] == (1000.0, [1], [])


def test_rows_that_are_not_seen_are_silence():
    bearings = table([(0, "a2", 0, 0.5, 0.1)])
    empty = np.array([np.nan])
    unseen = type(bearings)(
        **{c.name: getattr(bearings, c.name) for c in type(bearings).columns()}
        | {"seen": np.array([False]), "bearing": empty, "sigma": empty}
    )
    (scan,) = scans_of([unseen], SCENE, BearingRows(frozenset({"a2"})))
    (sounds,) = ArrayScans(SCENE, 10.0).scans(scan)
    ((sensor, rows),) = sounds.by_sensor()
    assert (sensor, len(rows.bearing)) == (len(SCENE.cameras) + 1, 0)
