"""Times of a camera's frames, from a table of times or a frame rate."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from occlog.array_types import NS, Ints
from occlog.errors import InputError, UsageError, option

if TYPE_CHECKING:
    from occlog.records.scene import Clock

MAX_SECONDS = 9e9
"""64 bits of nanoseconds end after 292 years."""
MAX_RATE_DENOMINATOR = 1001
"""29.97 fps is 30000/1001; no frame rate that a file rounds has a larger denominator."""
MAX_RATE_NUMERATOR = 10**9
"""Maximum numerator of a frame rate: frame numbers within `MAX_SECONDS` times the denominator fit into 64 bits."""


UNIT_FACTORS, UNIT_TOLERANCE = (1e3, 1e6, 1e9), 1.5
"""Ratios of units of time, and how much a ratio of durations may differ from one that states a wrong unit."""


def is_unit_factor(ratio: float) -> bool:
    """Whether a ratio of two durations is about that of two time units: 1e3, 1e6 or 1e9, or the inverse of these."""
    larger = max(ratio, 1.0 / max(ratio, 1e-300))
    return any(abs(math.log(larger / factor)) < math.log(UNIT_TOLERANCE) for factor in UNIT_FACTORS)


def no_frame_times(where: Path | str) -> UsageError:
    """UsageError, to be raised, for a file (`where`) of frame numbers, the times of which are not known."""
    return UsageError(
        f"{where}: counts frames, and no file states their times; give the frame rate ({option('fps')})",
        id="missing-times",
    )


@dataclass(frozen=True, eq=False)
class FrameTimes:
    """Times of the frames of one camera, from a table or a frame rate, with correction of its clock.

    Attributes:
        source: where the times come from, for provenance and messages.
        start_ns: time of the origin of `table_ns`, or of frame 0 [ns since the Unix epoch].
        table_ns: (n,) times of frames 0..n-1 after the origin [ns], strictly increasing; None: the rate is used.
        rate: frames per second; None: unknown.
        clock: clock model of the camera, by which its times are corrected; None: they are world times.
    """

    source: str
    start_ns: int = 0
    table_ns: Ints | None = None
    rate: Fraction | None = None
    clock: Clock | None = None

    @property
    def count(self) -> int | None:
        """Number of frames with a time; None if times follow from the rate, without limit."""
        return None if self.table_ns is None else len(self.table_ns)

    def at(self, frames: Ints) -> Ints:
        """(n,) world times [ns since the Unix epoch] of frame numbers (n,).

        InputError for a frame without a time, or if neither a table nor a rate is known.
        """
        frames = np.asarray(frames, dtype=np.int64)
        if self.table_ns is not None:
            bad = (frames < 0) | (frames >= len(self.table_ns))
            if bad.any():
                raise InputError(
                    f"frame {int(frames[bad][0])} has no time: {self.source} gives times for frames "
                    f"0 to {len(self.table_ns) - 1}; add its time",
                    id="missing-times",
                )
            return self.world(self.start_ns + self.table_ns[frames])
        if self.rate is None:
            raise InputError(
                f"no times of frames are known ({self.source}); give the frame rate ({option('fps')})",
                id="missing-times",
            )
        return self.world(self.start_ns + frames_to_ns(frames, self.rate))

    def elapsed_ns(self, frame: int) -> float:
        """Time [ns] from frame 0 to a frame by the camera's clock; beyond the table that of its last frame."""
        if self.table_ns is None:
            return frame * NS / float(self.rate or math.nan)
        return float(self.table_ns[min(frame, len(self.table_ns) - 1)] - self.table_ns[0])

    def until(self, elapsed_ns: float) -> int:
        """Number of the last frame that is at most `elapsed_ns` after frame 0, by the camera's clock.

        -1 if there is none.
        """
        if self.table_ns is None:
            return max(math.floor(elapsed_ns / NS * float(self.rate or math.nan)), -1)
        return int(np.searchsorted(self.table_ns - self.table_ns[0], elapsed_ns, side="right")) - 1

    def world(self, t_ns: Ints) -> Ints:
        """(n,) world times [ns] of times (n,) by the camera's clock: offset and drift are removed."""
        first = 0 if self.table_ns is None or not len(self.table_ns) else int(self.table_ns[0])
        return t_ns if self.clock is None else to_world_time(t_ns, self.clock, self.start_ns + first)

    def by(self, clock: Clock | None) -> FrameTimes:
        """Copy with a clock model, by which `at` corrects the times; unchanged if `clock` is None."""
        if clock is None:
            return self
        text = f"{self.source}; clock {clock.name} taken out ({clock.offset_ns} ns, {clock.drift_ppm:g} ppm)"
        return replace(self, source=text, clock=clock)

    def same_as(self, other: FrameTimes) -> bool:
        """Whether every frame has the same world time in `other`."""
        if self.count != other.count or (self.table_ns is None and self.rate != other.rate):
            return False
        if self.table_ns is not None:
            frames = np.arange(len(self.table_ns))
        elif self.rate is not None:
            # The drift of a clock follows from two frames that are far apart
            frames = np.array([0, min(10**6, int(MAX_SECONDS * float(self.rate)))])
        else:
            return self.start_ns == other.start_ns
        return np.array_equal(self.at(frames), other.at(frames))

    def interval_ns(self) -> float:
        """Median interval between frames [ns], or that of the frame rate; infinite if unknown."""
        if self.table_ns is not None:
            return float(np.median(np.diff(self.table_ns))) if len(self.table_ns) > 1 else math.inf
        return NS / float(self.rate) if self.rate else math.inf


def to_world_time(t_ns: Ints, clock: Clock, start_ns: int) -> Ints:
    """(n,) world times [ns] of sensor times t (n,) [ns]: t - offset - drift (t - start).

    `clock` has offset and drift; `start_ns` is the sensor's first time, at which the drift is 0.
    """
    drift = np.round((t_ns - start_ns) * (clock.drift_ppm * 1e-6)).astype(np.int64)
    return np.asarray(t_ns - clock.offset_ns - drift, dtype=np.int64)


def frames_to_ns(frames: Ints, rate: Fraction) -> Ints:
    """(n,) times [ns] of frame numbers (n,) after frame 0 at an exact frame rate [Hz], rounded to 1 ns.

    InputError for a frame that would lie more than 285 years away.
    """
    frames = np.asarray(frames, dtype=np.int64)
    if len(frames) and float(np.abs(frames).max()) > MAX_SECONDS * float(rate):
        raise InputError(
            f"frame {int(frames[np.abs(frames).argmax()])}: its time at {float(rate):g} fps is out of range "
            "(285 years); correct its number",
            id="time-out-of-range",
        )
    # Whole seconds and the rest apart: the product of frame number and 1e9 may leave 64 bits.
    whole, rest = np.divmod(frames * rate.denominator, rate.numerator)
    return np.asarray(whole * NS + (rest * NS + rate.numerator // 2) // rate.numerator, dtype=np.int64)


def as_rate(fps: float | str) -> Fraction:
    """Frame rate [Hz] as an exact fraction: 29.97 is taken for 30000/1001, 1/300 for itself.

    Others are kept to 9 digits. InputError unless 1e-6 < fps <= 1e6.
    """
    try:
        # A number as it is written: 0.1 is a tenth
        exact = Fraction(fps if isinstance(fps, str) else repr(float(fps)))
        value = float(exact)
    except (ValueError, ZeroDivisionError, OverflowError):
        exact, value = Fraction(0), math.nan
    if not 1e-6 < value <= 1e6:
        limits = "must be above 0.000001 and at most 1000000 (frames per second)"
        raise InputError(f"frame rate {fps!r}: {limits}; state it by {option('fps')}")
    near = Fraction(round(value * 1001), 1001)
    # Rates of television: N * 1000/1001, usually written with two or three decimals.
    if near.denominator == 1001 and near.numerator % 1000 == 0 and _is_written(float(near), value):
        return near
    return exact.limit_denominator(max(MAX_RATE_NUMERATOR // math.ceil(value), 1))


def _is_written(rate: float, value: float) -> bool:
    """Whether a stated value means a frame rate: it is the rate rounded to two or three decimals, or within 1e-6 of it.

    Args:
        rate: the frame rate, such as 30000 / 1001.
        value: as it is stated.
    """
    return value in (round(rate, 2), round(rate, 3)) or abs(value - rate) <= 1e-6 * rate
