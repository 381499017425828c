"""Offsets of clocks: known differences from UTC, and steps and drifts of one clock against another."""

from __future__ import annotations

from typing import NamedTuple, TypedDict

import numpy as np

from occlog.array_types import NS, Floats
from occlog.records.verdicts import Check, finding

MAX_CLOCK_ERROR_S = 0.6
"""Largest distance of an offset from a known one [s]."""
CLOCKS = (
    ("TAI", 37.0, 37.0),
    ("leap seconds of GPS", 18.0, 18.0),
    ("GPS time", 315_964_782.0, 315_964_800.0),
    ("GPS weeks from 0 again", 619_315_200.0, 619_315_200.0),
    ("times since 2001, as of macOS", 978_307_200.0, 978_307_200.0),
    ("times since 1904, as of LabVIEW", 2_082_844_800.0, 2_082_844_800.0),
    ("times since 1900, as of NTP", 2_208_988_800.0, 2_208_988_800.0),
    ("times since 1601, as of Windows", 11_644_473_600.0, 11_644_473_600.0),
    ("times since year 1, as of .NET", 62_135_596_800.0, 62_135_596_800.0),
)
"""Clocks, and by how much they differ from UTC [s]; the leap seconds are those since 2017."""
ZONE_S, MAX_ZONES, MIN_EPOCH_S = 900.0, 56, 3e7
"""Step and number of time zones; a larger difference [s] than the last is that of an origin."""


def cause_of(offset_s: float, slack_s: float = MAX_CLOCK_ERROR_S) -> str:
    """Return what sets two clocks apart by an offset, as text in brackets after a space; empty: no known cause.

    Args:
        offset_s: offset of one clock against the other [s].
        slack_s: largest difference of the offset from a known one [s].
    """
    for cause, low, high in CLOCKS:
        if low - slack_s <= abs(offset_s) <= high + slack_s:
            return f" ({cause})"
    quarters = offset_s / ZONE_S
    if 1.0 <= abs(quarters) <= MAX_ZONES and abs(offset_s - round(quarters) * ZONE_S) <= slack_s:
        return " (a time zone)"
    return " (times since a start)" if abs(offset_s) > MIN_EPOCH_S else ""


class OffsetWords(TypedDict):
    """Texts that a message on an offset of time stamps is filled with; seconds are rounded to 0.1 ms.

    Attributes:
        offset: size of the offset [s].
        sense: `large` if time stamps are too large, `small` if they are too small.
        correction: what to add to the time stamps [s], as `--clock-offset` takes it.
    """

    offset: str
    sense: str
    correction: str


def offset_words(late_s: float) -> OffsetWords:
    """Return texts on time stamps that are `late_s` [s] too large; negative: too small."""
    late_s = round(late_s, 4)
    sense = "large" if late_s > 0.0 else "small"
    return {"offset": f"{abs(late_s):.10g}", "sense": sense, "correction": f"{-late_s:.10g}"}


MAX_BLOCKS = 256
"""Blocks of a comparison of two clocks; of more, pairs are joined."""
MIN_BLOCKS = 16
"""Fewer blocks determine no change of a clock."""
STALLED = 0.05
"""Share of the blocks in which a recorder may stall."""
MIN_STEP_S = 0.3
"""Smallest step of a clock that is stated [s]."""
MIN_DRIFT_S, MIN_DRIFT_SIGMAS = 0.015, 8.0
"""Smallest change by drift over a recording that is stated [s], also in standard deviations of the offsets."""
REWEIGHTED, LEAST_OFF_S = 20, 1e-5
"""Iterations of reweighted least squares, and difference [s] below which all have one weight."""
MAX_SPREAD, MAX_UNEVEN = 0.3, 0.5
"""Largest spread of offsets before or after a step, relative to it, and difference of the drifts of both halves."""


class ClockChange(NamedTuple):
    """How the offset of a clock from another one changes.

    Attributes:
        step_s: by how much it was set forward (negative: back) [s]; 0: it was not.
        at: index of the first offset after the step.
        drift: seconds that it gains per second of the other clock; 0: none that is significant.
    """

    step_s: float
    at: int
    drift: float


def change_of(t_s: Floats, offset_s: Floats) -> ClockChange:
    """Return the step and drift of a clock against another one, from n offsets.

    Without enough offsets, or significance, both are 0.

    Args:
        t_s: (n,) times by the other clock [s], increasing.
        offset_s: (n,) offsets of the clock from the other one at these times [s].
    """
    if len(t_s) < MIN_BLOCKS:
        return ClockChange(0.0, 0, 0.0)
    since_s, at = t_s - t_s[0], _split(offset_s)
    line, _ = _line(since_s, offset_s, at)
    before, after = offset_s[:at], offset_s[at:]
    off_s = max(
        max(float(np.subtract(*np.quantile(part, [0.9, 0.1]))) for part in (before, after)),
        abs(line[2] - float(offset_s[at] - offset_s[at - 1])),
        abs(line[2] - float(np.median(after) - np.median(before))),
    )
    if abs(line[2]) < MIN_STEP_S or off_s > MAX_SPREAD * abs(line[2]):
        return ClockChange(0.0, 0, _significant_drift(since_s, offset_s, 0))
    return ClockChange(float(line[2]), at, _significant_drift(since_s, offset_s, at))


def _split(offset_s: Floats) -> int:
    """Return the index of the first offset after the most probable step.

    It is the largest change next to the division into two parts of constant offset by least squares.
    """
    n, near = len(offset_s), MIN_BLOCKS // 4
    count = np.arange(1, n)
    sums = np.cumsum(offset_s - offset_s.mean())[:-1]
    gain = (sums**2 / (count * (n - count)))[near - 1 : n - near]
    k = int(np.argmax(gain)) + near
    window = np.abs(np.diff(offset_s))[k - near : k + near - 1]
    return k - near + 1 + int(np.argmax(window))


def _line(t_s: Floats, offset_s: Floats, at: int) -> tuple[Floats, float]:
    """Return (3,) slope, constant and step of offsets, fitted by least absolute differences, and their deviation.

    The deviation is a robust standard deviation of the offsets from the line [s].

    Args:
        t_s: (n,) times [s].
        offset_s: (n,) offsets [s].
        at: index of the first offset after the step; 0: no step.
    """
    design = np.column_stack([t_s, np.ones(len(t_s)), np.arange(len(t_s)) >= at])[:, : 3 if at else 2]
    line, off = np.zeros(3), np.ones(len(t_s))
    for _ in range(REWEIGHTED):
        root = 1.0 / np.sqrt(np.maximum(off, LEAST_OFF_S))
        line[: design.shape[1]] = np.linalg.lstsq(design * root[:, None], offset_s * root, rcond=None)[0]
        off = np.abs(offset_s - design @ line[: design.shape[1]])
    return line, 1.5 * float(np.median(off))


def _significant_drift(t_s: Floats, offset_s: Floats, at: int) -> float:
    """Return the slope of offsets with a step at the index `at` (0: none) [s/s]; 0 if insignificant or uneven.

    `t_s` and `offset_s` (n,) are times and offsets [s].
    """
    line, sigma = _line(t_s, offset_s, at)
    total = abs(line[0]) * t_s[-1]
    if total < max(MIN_DRIFT_S, MIN_DRIFT_SIGMAS * sigma):
        return 0.0
    rest = offset_s - line[2] * (np.arange(len(t_s)) >= at)
    first = t_s < 0.5 * t_s[-1]
    slopes = [_line(t_s[half], rest[half], 0)[0][0] for half in (first, ~first)]
    return float(line[0]) if max(abs(s - line[0]) for s in slopes) <= MAX_UNEVEN * abs(line[0]) else 0.0


class _Block(NamedTuple):
    """A run of successive times by a clock with their times of reception, summarised.

    Attributes:
        received_ns: first time of reception [ns].
        delay_ns: least delay of reception [ns].
        change_ns: the change of the delay from one time to the next that is largest in size [ns].
        before_ns, after_ns: times of reception before and after that change [ns].
    """

    received_ns: int
    delay_ns: int
    change_ns: int
    before_ns: int
    after_ns: int

    def joined(self, other: _Block) -> _Block:
        """Return this block and the next one, `other`, as one."""
        largest = max(self, other, key=lambda block: abs(block.change_ns))
        return largest._replace(received_ns=self.received_ns, delay_ns=min(self.delay_ns, other.delay_ns))


class ReceivedChange(NamedTuple):
    """How a clock changes against the times of reception.

    Attributes:
        step_s: by how much it was set forward (negative: back) [s]; 0: it was not.
        before_ns: time of reception before the step.
        drift: seconds that it gains per second; 0: none that is significant.
        by_recorder: the step is one of the times of reception, in the other direction.
    """

    step_s: float
    before_ns: int
    drift: float
    by_recorder: bool


class ReceivedTimes:
    """Times by a clock against those of reception, in bounded memory (at most `MAX_BLOCKS` blocks).

    A recorder that stalls delays what it receives for a while; the least delay of each block is not affected by it.
    """

    def __init__(self) -> None:
        """Start without times."""
        self._blocks: list[_Block] = []
        self._size, self._in_last = 1, 0
        self._last: tuple[int, int] | None = None  # time by the clock, and delay

    def add(self, t_ns: int, received_ns: int) -> None:
        """Add a time by the clock and that of its reception [ns]; a time that repeats the last one does not count."""
        if self._last is not None and t_ns == self._last[0]:
            return
        delay = received_ns - t_ns
        change = 0 if self._last is None else delay - self._last[1]
        before = received_ns if self._last is None else self._last[0] + self._last[1]
        self._last = t_ns, delay
        one = _Block(received_ns, delay, change, before, received_ns)
        if not self._blocks or self._in_last == self._size:
            self._blocks.append(one)
            self._in_last = 0
            if len(self._blocks) > MAX_BLOCKS:
                pairs = zip(self._blocks[0:-1:2], self._blocks[1:-1:2], strict=True)
                self._blocks = [*(a.joined(b) for a, b in pairs), one]
                self._size *= 2
        else:
            self._blocks[-1] = self._blocks[-1].joined(one)
        self._in_last += 1

    @property
    def range_s(self) -> tuple[float, float]:
        """Return the range of the least delays of blocks [s], without the `STALLED` share at each end.

        (0, 0) without times.
        """
        delays = np.array([block.delay_ns for block in self._blocks] or [0]) / NS
        low, high = np.quantile(delays, [STALLED, 1.0 - STALLED]).tolist()
        return low, high

    def change(self) -> ReceivedChange:
        """Return the step and drift of the clock against the times of reception; 0 where there is none."""
        if not self._blocks:
            return ReceivedChange(0.0, 0, 0.0, by_recorder=False)
        first = self._blocks[0]
        t_s = np.array([(block.received_ns - first.received_ns) / NS for block in self._blocks])
        offset_s = np.array([(first.delay_ns - block.delay_ns) / NS for block in self._blocks])
        step_s, at, drift = change_of(t_s, offset_s)
        if not step_s:
            return ReceivedChange(0.0, 0, drift, by_recorder=False)
        block = max(self._blocks[max(at - 1, 0) : at + 1], key=lambda each: abs(each.change_ns))
        later_ns = block.after_ns - block.before_ns
        # One of both clocks goes on as ever
        by_recorder = abs(later_ns) > abs(later_ns - block.change_ns)
        return ReceivedChange(step_s, block.before_ns, drift, by_recorder=by_recorder)


MAX_DRIFT = 0.05
"""Largest drift of a clock; beyond it the times have another unit."""
MIN_INVERSE = 1.5
"""Ratio from which rates are stated as 1 over it."""


def drift_finding(check: str, sensor: str, drift: float, other: str) -> Check:
    """Return the finding that the clock of a sensor runs fast or slow, by a drift or by a factor of units.

    Args:
        check: name of the check.
        sensor: name of the sensor.
        drift: gained time over the time of the others.
        other: what its times are compared with.
    """
    if abs(drift) <= MAX_DRIFT:
        return finding(check, "clock-drift", sensors=[sensor], ppm=1e6 * drift, other=other)
    rate = 1.0 + drift
    factor = f"1/{1.0 / rate:.4g}" if 0.0 < rate < 1.0 / MIN_INVERSE else f"{rate:.4g}"
    return finding(check, "clock-rate-differs", sensors=[sensor], ppm=1e6 * drift, factor=factor, other=other)
