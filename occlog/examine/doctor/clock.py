"""Checks of sensor times: decreasing or repeated times, gaps, jumps, epochs, disjoint sensors.

Gaps are reported for regular sensors only, in which nearly all intervals are close to the median. Decreasing times in
file order of an external table indicate a clock that was set, or a restart.
"""

from __future__ import annotations

import heapq
from collections.abc import Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from occlog.array_types import NS, Ints
from occlog.consistency.clock_offsets import cause_of
from occlog.console.text import counted
from occlog.errors import InputError
from occlog.io.external.cells import TableCells
from occlog.io.external.table import ExternalTable
from occlog.io.files.timing.utc import time_words, utc
from occlog.records.messages import GAP_INTERVALS

from .findings import Findings

MIN_INTERVALS = 10
"""Fewer intervals determine no usual one."""
REGULAR_SHARE, REGULAR_FROM, REGULAR_TO = 0.9, 0.5, 1.5
"""A sensor is regular if at least this share of its intervals is between these multiples of their median."""
MAX_INTERVALS = 50_000
"""Different intervals that are kept separately; beyond, they are rounded to `DIGITS` digits."""
DIGITS = 3
KEPT_GAPS = 64
FIRST_NS, LAST_NS = 946_684_800 * NS, 4_102_444_800 * NS
"""Years 2000 to 2100, where times since 1970 are searched for."""
UNITS = (
    (10**3, "microseconds", "nanoseconds"),
    (10**6, "milliseconds", "nanoseconds"),
    (10**9, "seconds", "nanoseconds"),
)
"""Factors by which times that were taken for nanoseconds are too small."""
SHORTEST_NS = 100_000
"""A sensor that measures 10,000 times a second has such intervals."""
APART_NS = 60 * NS
"""Gap above which times of sensors count as disjoint, if also above the length of the recording."""
SAME_RATE = 0.01


@dataclass
class SensorTimes:
    """Statistics of the times of one sensor, in file order.

    Attributes:
        name: name of the sensor, for messages.
        unique: whether times must not repeat, since they are those of frames.
        dropped: whether readers skip messages with times that repeat or decrease.
        sorted: whether readers sort the rows by time, so that times may decrease.
        sporadic: whether the sensor reports detections only, so that gaps are no fault.
        count: number of times.
        low, high: first and last time [ns].
    """

    name: str
    unique: bool = False
    dropped: bool = False
    sorted: bool = False
    sporadic: bool = False
    count: int = 0
    low: int = 0
    high: int = 0
    _last: int | None = None
    _last_frame: int | None = None
    _step: int = 0  # smallest one of frame numbers; 0: they are not known
    _back: int = 0
    _repeats: int = 0
    _first_back: str = ""
    _first_repeat: str = ""
    _intervals: dict[int, int] = field(default_factory=dict)
    _longest: list[tuple[int, int, int]] = field(default_factory=list)  # interval, time before, step of frame numbers

    def add(self, t_ns: Ints, frame: Ints | None = None) -> None:
        """Add further times (n,) [ns] in file order, with frame numbers (n,) if there are any."""
        if not len(t_ns):
            return
        before = self.count
        whole = t_ns if self._last is None else np.concatenate([[self._last], t_ns])
        # As float64 a difference cannot overflow; it is exact for any interval below 104 days
        steps = np.diff(whole.astype(np.float64)) if _is_wide(whole) else np.diff(whole)
        added = len(whole) - len(t_ns)

        def where(index: int) -> str:
            row = index + 1 - added
            return f"row {before + row}" if frame is None else f"frame {frame[row]}"

        for index in np.flatnonzero(steps < 0).tolist():
            self._back += 1
            if self._back == 1:
                self._first_back = f"{where(index)}: {time_words(whole[index + 1])} after {time_words(whole[index])}"
        for index in np.flatnonzero(steps == 0)[:1].tolist():
            self._first_repeat = self._first_repeat or f"{where(index)}: {time_words(whole[index + 1])}"
        self._repeats += int((steps == 0).sum())
        self._note_intervals(whole, steps, frame)
        low, high = int(t_ns.min()), int(t_ns.max())
        self.low, self.high = (low, high) if not before else (min(self.low, low), max(self.high, high))
        self._last, self.count = int(t_ns[-1]), before + len(t_ns)
        self._last_frame = int(frame[-1]) if frame is not None else None

    def _note_intervals(self, whole: Ints, steps: np.ndarray, frame: Ints | None) -> None:
        forward = np.flatnonzero(steps > 0)
        if not len(forward):
            return
        lengths, counts = np.unique(steps[forward].astype(np.int64), return_counts=True)
        for length, count in zip(lengths.tolist(), counts.tolist(), strict=True):
            self._intervals[length] = self._intervals.get(length, 0) + count
        if len(self._intervals) > MAX_INTERVALS:
            rounded: dict[int, int] = {}
            for length, count in self._intervals.items():
                short = round(length, DIGITS - len(str(length)))
                rounded[short] = rounded.get(short, 0) + count
            self._intervals = rounded
        numbers = np.zeros(len(whole), dtype=np.int64)
        if frame is not None:
            known = [] if len(whole) == len(frame) else [self._last_frame if self._last_frame is not None else frame[0]]
            numbers = np.concatenate([np.array(known, dtype=np.int64), frame])
            risen = np.diff(numbers)
            self._step = min([self._step or 2**62, *risen[risen > 0].tolist()])
        for index in forward[np.argsort(steps[forward])[-KEPT_GAPS:]].tolist():
            one = (int(steps[index]), int(whole[index]), int(numbers[index + 1] - numbers[index]))
            if len(self._longest) < KEPT_GAPS:
                heapq.heappush(self._longest, one)
            else:
                heapq.heappushpop(self._longest, one)

    @property
    def times(self) -> int:
        """Number of distinct times, if times never go back."""
        return self.count - self._repeats

    @property
    def usual_ns(self) -> int | None:
        """Median interval [ns] of a regular sensor; None for an irregular one, few intervals, or times that go back."""
        total = sum(self._intervals.values())
        if total < MIN_INTERVALS or self._back:
            return None
        median = self._median()
        near = sum(n for d, n in self._intervals.items() if REGULAR_FROM * median <= d <= REGULAR_TO * median)
        return median if near >= REGULAR_SHARE * total else None

    def _median(self) -> int:
        """Return the median of all intervals between distinct successive times [ns]; 0 without intervals."""
        half, seen = sum(self._intervals.values()) / 2, 0
        for length in sorted(self._intervals):
            seen += self._intervals[length]
            if seen >= half:
                return length
        return 0

    def judge(self, findings: Findings) -> None:
        """Add findings about faults in the times of this sensor: order, repetition, epoch, gaps."""
        if self._back and not self.sorted:
            findings.add("skipped-stamp" if self.dropped else "order", self.name, self._first_back, count=self._back)
        if self.unique and self._repeats:
            findings.add(
                "skipped-stamp" if self.dropped else "duplicate-time",
                self.name,
                self._first_repeat,
                count=self._repeats,
            )
        if self.count:
            self._judge_epoch(findings)
            self._judge_gaps(findings)

    def _judge_epoch(self, findings: Findings) -> None:
        usual = self._median()
        for factor, unit, stated in UNITS:
            if not FIRST_NS <= self.low * factor <= self.high * factor <= LAST_NS:
                continue
            # Intervals distinguish seconds and milliseconds from short times after 0; those of microseconds determine
            # nothing
            if factor == UNITS[0][0] or 0 < usual < SHORTEST_NS:
                meant = utc(self.low * factor)
                value = f"from {utc(self.low)} if they are {stated}, and from {meant} if they are {unit}"
                findings.add("epoch-unit", self.name, value)
                return
        if self.low < 0 or self.high > LAST_NS:
            findings.add("epoch", self.name, f"from {utc(self.low)} to {utc(self.high)}")

    def _judge_gaps(self, findings: Findings) -> None:
        usual = self.usual_ns
        if usual is None:
            return
        long = sorted((one for one in self._longest if one[0] > GAP_INTERVALS * usual), key=lambda one: one[1])
        total = sum(n for d, n in self._intervals.items() if d > GAP_INTERVALS * usual)
        for length, before, step in long:
            kind = "jump" if 0 < step == self._step else "gap"
            if kind == "gap" and self.sporadic:
                continue
            numbered = "the frame numbers continue " if kind == "jump" else ""
            what = f"{numbered}for {length / NS:.6g} s, where {usual / NS:.6g} s are usual"
            missed = f", {counted(step // self._step - 1, 'frame')} by their numbers" if step > self._step > 0 else ""
            findings.add(
                kind,
                f"{self.name}: after {utc(before)}",
                what + missed,
                limit=f"{GAP_INTERVALS * usual / NS:.6g} s",
            )
        if total > len(long) and not self.sporadic:
            findings.add("gap", self.name, "further ones", count=total - len(long))


def _is_wide(t_ns: Ints) -> bool:
    return int(t_ns.max()) - int(t_ns.min()) >= 2**62


def check_clocks(clocks: Sequence[SensorTimes], findings: Findings) -> None:
    """Add findings about the times of each sensor: its own faults, no overlap with the others, a constant delay."""
    for clock in clocks:
        clock.judge(findings)
    # Whoever has times of another epoch is not late too
    counted = [clock for clock in clocks if clock.count]
    disjoint = list(_disjoint_sensors(counted))
    for clock in disjoint:
        others = [other for other in counted if other not in disjoint]
        low, high = min(other.low for other in others), max(other.high for other in others)
        value = f"{utc(clock.low)} to {utc(clock.high)}; the others {utc(low)} to {utc(high)}"
        value += cause_of((clock.low - low) / NS)
        findings.add("clock-disjoint", clock.name, value)
    for clock, late_ns in _late([clock for clock in counted if clock not in disjoint]):
        limit = f"{GAP_INTERVALS * (clock.usual_ns or 0) / NS:.6g} s"
        value = f"by {late_ns / NS:.6g} s, which an offset of {-late_ns / NS:.6g}s takes out"
        findings.add("clock-late", clock.name, value, limit=limit)


def check_truth_times(
    truth: Iterable[tuple[str, SensorTimes]], sensors: Iterable[SensorTimes], findings: Findings
) -> None:
    """Add a finding for each truth that has no time in common with the sensors.

    Args:
        truth: location for the message, and statistics of times.
        sensors: statistics of the times of each.
        findings: list that is extended in place.
    """
    counted = [sensor for sensor in sensors if sensor.count]
    low, high = min((s.low for s in counted), default=0), max((s.high for s in counted), default=0)
    for location, one in truth:
        if counted and one.count and (one.high < low or one.low > high):
            value = f"{utc(one.low)} to {utc(one.high)}; the sensors {utc(low)} to {utc(high)}"
            findings.add("truth-disjoint", location, value)


def _disjoint_sensors(clocks: Sequence[SensorTimes]) -> Iterator[SensorTimes]:
    """Generate sensors with times disjoint from those of the largest group (of equal groups, the first)."""
    groups: list[list[SensorTimes]] = []
    end = 0
    margin = max([APART_NS, *(clock.high - clock.low for clock in clocks)])
    for clock in sorted(clocks, key=lambda c: c.low):
        if groups and clock.low - end <= margin:
            groups[-1].append(clock)
            end = max(end, clock.high)
        else:
            groups.append([clock])
            end = clock.high
    best = max(groups, key=lambda group: (len(group), sum(c.count for c in group)), default=[])
    for group in groups:
        if group is not best:
            yield from group


def _late(clocks: Iterable[SensorTimes]) -> Iterator[tuple[SensorTimes, int]]:
    """Generate each regular sensor with times that are all shifted against others of its rate, and the shift [ns].

    Negative: early. Only sensors with numbers of times that differ by at most 1 are compared. Of two sensors the later
    one is reported.
    """
    regular = [(clock, usual) for clock in clocks if (usual := clock.usual_ns) is not None]
    for clock, usual in regular:
        like = [
            other
            for other, their in regular
            if abs(their - usual) <= SAME_RATE * usual and abs(other.times - clock.times) <= 1
        ]
        if len(like) < 2:
            continue
        others = sorted(like, key=lambda c: c.low)
        middle = others[(len(others) - 1) // 2]
        begins, ends = clock.low - middle.low, clock.high - middle.high
        if abs(begins) > GAP_INTERVALS * usual and abs(begins - ends) <= usual / 2:
            yield clock, begins


MAX_BACKWARD_SHARE = 1 / 3
"""Share of rows that go back in time above which a file counts as unordered, which is allowed and no clock fault."""


class Restarts:
    """Counts times that go back within a sensor or identity of an external table, in file order.

    They indicate a restart, or a clock that was set.
    """

    def __init__(self, table: ExternalTable) -> None:
        """Create a check of an external table for times that go back, before its first row."""
        self._table = table
        self._last: dict[Hashable, int] = {}
        self._rows = self._back = 0
        self._first = InputError("")

    def add(self, cells: TableCells) -> None:
        """Count those of further rows that are earlier than the previous row of their sensor.

        InputError for an invalid time.
        """
        t_ns = self._table.times_of(cells).tolist()
        for row, (t, owner) in enumerate(zip(t_ns, self._table.owners(cells), strict=True)):
            before = self._last.get(owner)
            if before is not None and t < before:
                self._first = (
                    self._first if self._back else cells.fail(row, f"{time_words(t)} after {time_words(before)}")
                )
                self._back += 1
            self._last[owner] = t
        self._rows += len(t_ns)

    def judge(self, findings: Findings) -> None:
        """Add a finding on how often times go back, unless they do so often that the file is unsorted."""
        if 0 < self._back <= MAX_BACKWARD_SHARE * self._rows:
            findings.refused("restart", self._first, count=self._back)
