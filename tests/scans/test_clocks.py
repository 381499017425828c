"""Clocks of a scene against those by which times were corrected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from walking_people import cameras

from occlog.io.files.timing.frame_times import to_world_time
from occlog.records.scene import Clock, Scene
from occlog.scans.clocks import ClockCorrection, clock_changes, clocks_of, stated_clocks, with_applied_clocks


def scene(*clocks: Clock | None) -> Scene:
    own = [replace(c, clock=None if k is None else k.name) for c, k in zip(cameras(), clocks, strict=True)]
    return Scene(tuple(own), clocks=tuple({k.name: k for k in clocks if k is not None}.values()))


@pytest.mark.parametrize("before", [Clock("a"), Clock("a", 3_000_000_000, 40.0)])
@pytest.mark.parametrize("after", [Clock("b", -250_000_000), Clock("b", 10**18, -25.0)])
def test_a_change_is_that_of_the_definition(before: Clock, after: Clock) -> None:
    """Sensor times by the first clock, and from them by the other one, are those of the change to 2 ns."""
    stamps = np.array([5 * 10**18, 5 * 10**18 + 7_000_000_000, 5 * 10**18 + 3600 * 10**9])
    recorded = to_world_time(stamps, before, int(stamps[0]))
    wanted = to_world_time(stamps, after, int(stamps[0]))
    change = ClockCorrection(before, after)
    found = [change.time(int(t), int(recorded[0])) for t in recorded]
    assert np.abs(np.array(found) - wanted).max() <= 2


def test_the_same_clock_changes_nothing() -> None:
    late = Clock("late", 400_000_000)
    one = scene(late, None, None)
    assert clock_changes(one.cameras, one, clocks_of(one)) == {}
    changes = clock_changes(one.cameras, one, {})
    assert {c: e.time(10**9, 0) for c, e in changes.items()} == {0: 600_000_000}


def test_a_camera_without_a_clock_keeps_the_one_that_was_applied() -> None:
    late, other = Clock("late", 400_000_000), Clock("late", 7)
    stated = scene(None, other, None)
    found = with_applied_clocks(stated, {"cam0": late})
    assert clocks_of(found)["cam0"].offset_ns == 400_000_000
    assert clocks_of(found)["cam1"].offset_ns == 7
    assert clock_changes(found.cameras, found, {"cam0": late, "cam1": other}) == {}
    assert with_applied_clocks(stated, {}) is stated


def test_clocks_that_are_right_are_not_stated() -> None:
    assert stated_clocks(scene(Clock("right"), None, None)) == {}
    assert stated_clocks(scene(Clock("late", 5), None, None)) == {
        "clocks": {"cam0": {"offset_ns": 5, "drift_ppm": 0.0}}
    }
