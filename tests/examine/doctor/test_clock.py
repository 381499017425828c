"""The doctor's clocks: gaps at their limit and below it, jumps, epochs of every unit, sensors apart or late."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.array_types import NS, Ints
from occlog.examine.doctor.clock import MAX_INTERVALS, SensorTimes, check_clocks
from occlog.examine.doctor.findings import Finding, Findings

START = 1_700_000_000 * NS
STEP = NS // 10


def regular(count: int, start: int = START, step: int = STEP) -> Ints:
    return start + np.arange(count, dtype=np.int64) * step


def judged(*clocks: SensorTimes) -> list[Finding]:
    findings = Findings("f")
    check_clocks(clocks, findings)
    return list(findings)


def clock(t_ns: Ints, name: str = "cam1", frame: Ints | None = None, **how: bool) -> SensorTimes:
    made = SensorTimes(name, **how)
    for part in np.array_split(np.arange(len(t_ns)), 3):  # as it comes from a file
        made.add(t_ns[part], None if frame is None else frame[part])
    return made


def test_a_regular_clock_has_no_finding() -> None:
    assert judged(clock(regular(100), unique=True)) == []


def with_interval(interval: int) -> Ints:
    t_ns = regular(40)
    t_ns[20:] += interval - STEP
    return t_ns


def test_a_gap_begins_above_two_and_a_half_intervals() -> None:
    limit = 5 * STEP // 2
    assert judged(clock(with_interval(limit))) == []
    (found,) = judged(clock(with_interval(limit + 1)))
    assert found.kind == "gap"
    assert found.location == "cam1: after 2023-11-14T22:13:21.900Z"
    assert found.value == "for 0.25 s, where 0.1 s are usual"
    assert found.limit == "0.25 s"


@pytest.mark.parametrize("where", [1, 13, 14, 26, 27, 39])
def test_a_gap_is_found_wherever_the_file_is_read_in_parts(where: int) -> None:
    t_ns = regular(40)
    t_ns[where:] += NS
    assert [f.kind for f in judged(clock(t_ns))] == ["gap"]


def test_frames_that_are_numbered_on_tell_a_jump_of_the_clock_from_a_gap() -> None:
    t_ns = with_interval(NS)
    (jump,) = judged(clock(t_ns, frame=np.arange(40)))
    assert jump.kind == "jump"
    frame = np.arange(40)
    frame[20:] += 9
    (gap,) = judged(clock(t_ns, frame=frame))
    assert gap.kind == "gap"
    assert "9 frames by their numbers" in gap.value
    (steps,) = judged(clock(t_ns, frame=5 * np.arange(40)))
    assert steps.kind == "jump"


def test_a_sensor_without_a_rhythm_has_no_gaps() -> None:
    draws = np.random.default_rng(1).exponential(0.1, 400)
    t_ns = START + np.cumsum(draws * NS).astype(np.int64)
    assert judged(clock(t_ns)) == []
    assert judged(clock(regular(5, step=NS))) == []
    # A reader without a tag says nothing
    assert judged(clock(with_interval(NS), sporadic=True)) == []


def test_times_that_go_back_and_repeat() -> None:
    t_ns = regular(30)
    t_ns[10] = t_ns[8]
    t_ns[20] = t_ns[19]
    kinds = {f.kind: f for f in judged(clock(t_ns, unique=True))}
    assert set(kinds) == {"order", "duplicate-time"}
    assert kinds["order"].value.startswith("row 10: ")
    assert kinds["duplicate-time"].value.startswith("row 20: ")
    assert [f.kind for f in judged(clock(t_ns, unique=True, dropped=True))] == ["skipped-stamp", "skipped-stamp"]
    assert judged(clock(t_ns, sorted=True)) == []


@pytest.mark.parametrize(
    ("unit", "word"), [(1, None), (10**3, "microseconds"), (10**6, "milliseconds"), (10**9, "seconds")]
)
def test_epochs_in_another_unit_are_found(unit: int, word: str | None) -> None:
    t_ns = regular(30, step=NS) // unit
    found = judged(clock(t_ns))
    if word is None:
        assert found == []
    else:
        assert [f.kind for f in found] == ["epoch-unit"]
        assert found[0].value.endswith(f"from 2023-11-14T22:13:20.000Z if they are {word}")


@pytest.mark.parametrize("seconds", [0, 1, 20 * 60, 86400])
def test_times_that_count_from_the_beginning_are_no_epoch(seconds: int) -> None:
    assert judged(clock(regular(50, start=seconds * NS))) == []


def test_times_before_1970_and_after_2100() -> None:
    assert [f.kind for f in judged(clock(regular(30, start=-NS)))] == ["epoch"]
    assert [f.kind for f in judged(clock(regular(30, start=2**62)))] == ["epoch"]


def test_a_sensor_of_another_day_is_apart() -> None:
    others = [clock(regular(100), name) for name in ("cam1", "cam2")]
    (found,) = judged(*others, clock(regular(100, start=START - 86400 * NS), "cam3"))
    assert (found.kind, found.location) == ("clock-disjoint", "cam3")
    (late,) = judged(*others, clock(regular(100, start=START + 30 * NS), "cam3"))
    assert late.kind == "clock-late"


def test_a_sensor_that_is_late_by_a_constant() -> None:
    others = [clock(regular(100, start=START + n * NS // 30), f"cam{n}") for n in range(3)]
    assert judged(*others) == []
    (late,) = judged(*others, clock(regular(100, start=START + 4 * STEP), "cam3"))
    assert (late.kind, late.location) == ("clock-late", "cam3")
    (early,) = judged(*others, clock(regular(100, start=START - 4 * STEP), "cam3"))
    assert early.value.startswith("by -0.4")
    # A camera that was switched on later has fewer frames, and its clock is right
    assert judged(*others, clock(regular(96, start=START + 4 * STEP), "cam3")) == []


def test_several_rows_of_one_time_count_once_as_of_a_sensor_that_is_late() -> None:
    t_ns = regular(100)
    boxes = np.repeat(t_ns, 1 + np.arange(100) % 3)  # one to three people in each frame
    (late,) = judged(clock(boxes, "left", sorted=True), clock(t_ns + 4 * STEP, "right", sorted=True))
    assert (late.kind, late.location, late.value) == (
        "clock-late",
        "right",
        "by 0.4 s, which an offset of -0.4s takes out",
    )


def test_memory_is_bounded_and_the_usual_interval_still_found() -> None:
    draws = np.random.default_rng(2).normal(STEP, STEP / 50, 3 * MAX_INTERVALS).astype(np.int64)
    draws[70_000] = NS
    made = clock(START + np.cumsum(draws))
    assert len(made._intervals) <= MAX_INTERVALS
    assert made.usual_ns == pytest.approx(STEP, rel=0.01)
    assert [f.kind for f in judged(made)] == ["gap"]
