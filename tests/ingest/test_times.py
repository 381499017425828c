"""What is checked of the times of a new recording, on good times and on each fault."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest

from occlog.array_types import NS
from occlog.ingest.times import EventTimes, Times, TimeSpanNs
from occlog.records.tables import Truth


def frames(times_s: Iterable[float]) -> EventTimes:
    own = EventTimes()
    for t in times_s:
        own.add(np.array([round(t * NS)]))
    return own


def found(times: Times) -> list[tuple[str, tuple[str, ...]]]:
    return [(check.id, check.sensors) for check in times.checks() if check.found]


@pytest.mark.parametrize("seed", range(5))
def test_nothing_is_found_in_good_times(seed: int) -> None:
    """Frames that are late or missing, cameras that begin one after the other, a pause, boxes of quiet hours."""
    rng = np.random.default_rng(seed)
    late = np.cumsum(0.04 + rng.exponential(0.01, 3000))
    times = Times(
        {"a": frames(late), "b": frames(20.0 + np.delete(late, slice(500, 700)))}, true=TimeSpanNs(NS, 30 * NS)
    )
    assert found(times) == []
    paused = np.concatenate([late, late + late[-1] + 100.0])
    assert found(Times({"a": frames(paused), "b": frames(paused)})) == []
    assert found(Times(rows={"a": EventTimes(0, 20 * NS), "b": EventTimes(1810 * NS, 1900 * NS)})) == []


def test_a_sensor_of_another_time_is_named() -> None:
    here = np.arange(0.0, 30.0, 0.1)
    assert found(Times({"a": frames(here), "b": frames(here), "c": frames(here + 600.0)})) == [
        ("sensor-times-disjoint", ("c",))
    ]
    day = 86_400 * NS
    rows = {"a": EventTimes(day, day + 20 * NS), "b": EventTimes(day, day + 15 * NS), "mic": EventTimes(0, 20 * NS)}
    assert found(Times(rows=rows)) == [("sensor-times-disjoint", ("mic",))]


@pytest.mark.parametrize(
    ("offset_s", "cause"),
    [
        (37.0, "TAI"),
        (-315_964_782.0, "GPS time"),
        (7200.0, "a time zone"),
        (-1.7e9, "times since a start"),
        (2_208_988_800.0, "times since 1900, as of NTP"),
    ],
)
def test_a_known_difference_of_clocks_is_named_with_its_size(offset_s: float, cause: str) -> None:
    here = EventTimes(1_700_000_000 * NS, 1_700_000_020 * NS)
    there = EventTimes(here.first + round(offset_s * NS), here.last + round(offset_s * NS))
    (check,) = (each for each in Times(rows={"a": here, "b": here, "c": there}).checks() if each.found)
    assert (check.id, check.sensors) == ("sensor-times-disjoint", ("c",))
    assert check.figures["offset_s"] == pytest.approx(offset_s, rel=1e-5)
    assert f"({cause})" in check.text


def test_times_of_another_unit_are_named_before_that_they_are_apart() -> None:
    """Also of directions that begin at the same time."""
    heard = np.arange(0.0, 30.0, 0.1)
    for start_s in (0.0, 1e5):
        rows = {name: frames(heard) for name in ("a", "b")} | {"c": frames(start_s + 1000.0 * heard)}
        assert found(Times(rows=rows)) == [("time-stamps-unit", ("c",))]


def test_a_sensor_without_frames_that_ends_as_much_later_as_it_was_silent_was_set() -> None:
    heard = np.arange(0.0, 30.0, 0.1)
    jumps = frames(np.where(heard < 12.0, heard, heard + 8.0))
    others = {"a": frames(heard), "b": frames(heard[::2])}
    (check,) = (each for each in Times(rows={**others, "c": jumps}).checks() if each.found)
    assert (check.id, check.sensors) == ("clock-jump", ("c",))
    assert check.figures["jump_s"] == pytest.approx(8.1)
    assert found(Times(rows={**others, "c": frames(heard[(heard < 12.0) | (heard > 20.0)])})) == []


def test_a_clock_that_is_set_is_named() -> None:
    steps = np.arange(0.0, 30.0, 0.1)
    assert found(Times({"a": frames(np.where(steps < 10.0, steps, steps + 1.7e9))})) == [("clock-jump", ("a",))]


def test_a_truth_of_another_time_is_reported() -> None:
    times = Times({"a": frames(np.arange(0.0, 30.0, 0.1))}, true=TimeSpanNs(100 * NS, 120 * NS))
    assert found(times) == [("truth-times-disjoint", ())]


@pytest.mark.parametrize(("step_s", "ids"), [(0.1, []), (0.001, []), (0.1 / 86400, ["truth-rate-implausible"])])
def test_true_times_in_days_are_named(step_s: float, ids: list[str]) -> None:
    times, t_ns = Times(), np.arange(40, dtype=np.int64) * round(step_s * NS)
    values = np.zeros(40)
    role = np.full(40, "target")
    times.table(Truth.of(t_ns=t_ns, target_id=np.zeros(40, np.int32), role=role, x=values, y=values, z=values))
    assert [id for id, _ in found(times)] == ids
