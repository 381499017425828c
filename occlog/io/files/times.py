"""Times: of frames, in texts, for people.

When the frames of a camera were taken: a table of times, or a frame rate.

Time stamps as people write them, and sidecar files that give the time of every frame.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from decimal import Decimal, InvalidOperation
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from occlog.array_types import NS, Ints, Strings
from occlog.errors import InputError
from occlog.records.columns import MAX_NS

from .names import check_meaning, match_sensor
from .texts.csv_rows import CsvRows, first_line, is_header, last_place, read_plain, read_rows

if TYPE_CHECKING:
    from occlog.records.scene import Clock


MAX_SECONDS = 9e9
"""64 bits of nanoseconds end after 292 years."""
MAX_RATE_DENOMINATOR = 1001
"""29.97 fps is 30000/1001; no frame rate that a file rounds has a larger denominator."""
MAX_RATE_NUMERATOR = 10**9
"""With it the product of a frame number within `MAX_SECONDS` and the denominator is one of 64 bits."""


@dataclass(frozen=True, eq=False)
class FrameTimes:
    """Times of the frames of one camera.

    Attributes:
        source: what the times come from, for provenance and messages.
        start_ns: time of the origin of `table_ns`, or of frame 0.
        table_ns: (n,) times of frames 0..n-1 after the origin, strictly rising; None: the rate is used.
        rate: frames per second.
        clock: clock of the camera, with an error that is taken out of the times; None: they are world times.
    """

    source: str
    start_ns: int = 0
    table_ns: Ints | None = None
    rate: Fraction | None = None
    clock: Clock | None = None

    @property
    def count(self) -> int | None:
        """Number of frames that have a time; None: any number."""
        return None if self.table_ns is None else len(self.table_ns)

    def at(self, frames: Ints) -> Ints:
        """(n,) times [ns] of frame numbers; InputError for a frame that has none."""
        frames = np.asarray(frames, dtype=np.int64)
        if self.table_ns is not None:
            bad = (frames < 0) | (frames >= len(self.table_ns))
            if bad.any():
                raise InputError(
                    f"frame {int(frames[bad][0])} has no time: {self.source} gives times for frames "
                    f"0 to {len(self.table_ns) - 1}"
                )
            return self.world(self.start_ns + self.table_ns[frames])
        if self.rate is None:
            raise InputError(f"no times of frames are known ({self.source}); give the frame rate")
        return self.world(self.start_ns + frames_to_ns(frames, self.rate))

    def world(self, t_ns: Ints) -> Ints:
        """World times [ns] of times of the camera's clock."""
        first = 0 if self.table_ns is None or not len(self.table_ns) else int(self.table_ns[0])
        return t_ns if self.clock is None else to_world_time(t_ns, self.clock, self.start_ns + first)

    def by(self, clock: Clock | None) -> FrameTimes:
        """These times, read from a clock of the scene."""
        if clock is None:
            return self
        told = f"{self.source}; clock {clock.name} taken out ({clock.offset_ns} ns, {clock.drift_ppm:g} ppm)"
        return replace(self, source=told, clock=clock)

    def same_as(self, other: FrameTimes) -> bool:
        """Return whether every frame has the same time in the world."""
        if self.count != other.count or (self.table_ns is None and self.rate != other.rate):
            return False
        if self.table_ns is not None:
            frames = np.arange(len(self.table_ns))
        elif self.rate is not None:
            # The drift of a clock is determined by two frames that are far apart
            frames = np.array([0, min(10**6, int(MAX_SECONDS * float(self.rate)))])
        else:
            return self.start_ns == other.start_ns
        return np.array_equal(self.at(frames), other.at(frames))

    def interval_ns(self) -> float:
        """Typical time between two frames [ns]; infinity where that cannot be known."""
        if self.table_ns is not None:
            return float(np.median(np.diff(self.table_ns))) if len(self.table_ns) > 1 else math.inf
        return NS / float(self.rate) if self.rate else math.inf


def to_world_time(t_ns: Ints, clock: Clock, start_ns: int) -> Ints:
    """World time = sensor time - offset - drift (sensor time - start); `start_ns` is the sensor's first time."""
    drift = np.round((t_ns - start_ns) * (clock.drift_ppm * 1e-6)).astype(np.int64)
    return np.asarray(t_ns - clock.offset_ns - drift, dtype=np.int64)


def frames_to_ns(frames: Ints, rate: Fraction) -> Ints:
    """(n,) times [ns] after frame 0, rounded, without the error of a float frame rate.

    InputError for a frame that would be more than 285 years away.
    """
    frames = np.asarray(frames, dtype=np.int64)
    if len(frames) and float(np.abs(frames).max()) > MAX_SECONDS * float(rate):
        raise InputError(
            f"frame {int(frames[np.abs(frames).argmax()])}: its time at {float(rate):g} fps is out of range"
        )
    # Whole seconds and the rest separately: the product of frame number and 1e9 may leave 64 bits.
    whole, rest = np.divmod(frames * rate.denominator, rate.numerator)
    return np.asarray(whole * NS + (rest * NS + rate.numerator // 2) // rate.numerator, dtype=np.int64)


def as_rate(fps: float | str) -> Fraction:
    """A frame rate as an exact fraction: 29.97 is taken for 30000/1001, 1/300 for itself; others are kept to 9 digits.

    InputError unless 1e-6 < fps <= 1e6.
    """
    try:
        # A number as it is written: 0.1 is a tenth
        exact = Fraction(fps if isinstance(fps, str) else repr(float(fps)))
        value = float(exact)
    except (ValueError, ZeroDivisionError, OverflowError):
        exact, value = Fraction(0), math.nan
    if not 1e-6 < value <= 1e6:
        raise InputError(f"frame rate {fps!r}: must be above 0.000001 and at most 1000000 (frames per second)")
    near = Fraction(round(value * 1001), 1001)
    # Rates of television: N * 1000/1001, usually written with two or three decimals.
    if near.denominator == 1001 and near.numerator % 1000 == 0 and _is_written(float(near), value):
        return near
    return exact.limit_denominator(max(MAX_RATE_NUMERATOR // math.ceil(value), 1))


def _is_written(rate: float, value: float) -> bool:
    """Return whether a value is a rate with two decimals, three or many."""
    return value in (round(rate, 2), round(rate, 3)) or abs(value - rate) <= 1e-6 * rate


WHAT = "a table of time stamps"
UNITS = {"ns": 1, "us": 10**3, "ms": 10**6, "s": 10**9}
LATEST_S = 10**11
"""A larger number of seconds (year 5138) is taken for another unit."""
COARSEST_NS = 10**6
"""Times that are held or written to less than this (1 ms) have been rounded by whoever wrote them."""

TIME_COLUMNS = {
    "ns": ("t_ns", "time_ns", "timestamp_ns", "frame_time_ns"),
    "us": ("t_us", "time_us", "timestamp_us", "frame_time_us"),
    "ms": ("t_ms", "time_ms", "timestamp_ms", "frame_time_ms"),
    "s": ("time", "t", "t_s", "time_s", "timestamp", "timestamp_s", "frame_time", "seconds", "unix_time"),
}
"""Accepted names of time columns; the ending states the unit, seconds without one."""

_FRAME = ("frame", "frame_index", "frame_number", "index")
_CAMERA = ("camera", "cam_id", "cam", "sensor", "port")
_COLUMNS = {**TIME_COLUMNS, "frame": _FRAME, "camera": _CAMERA}
_BESIDE = ("sync_index",)
_ISO = re.compile(r"^(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d(?::\d\d)?)(?:[.,](\d{1,9}))?\s*(Z|[+-]\d\d:?\d\d)?$")


def parse_time(text: str, unit: str = "s") -> int:
    """Time [ns since the Unix epoch] of a number in `unit` or of an ISO 8601 date and time (UTC unless it states).

    Exact to the nanosecond.  Raises InputError for anything else, for a number of
    seconds beyond the year 5138, which must have been meant in another unit, and for a
    number with an exponent and a last digit that represents more than `COARSEST_NS`: float32 and
    six digits of 1.71456e+09 are a minute or more away from the time that was meant.
    """
    iso = _ISO.match(text.strip())
    if iso:
        return _iso_ns(iso, text)
    try:
        # Python alone takes 1_0 for a number
        value = Decimal("NaN" if "_" in text else text.strip())
    except InvalidOperation:
        value = Decimal("NaN")
    if not value.is_finite():
        raise InputError(f"time {text!r}: neither a number nor a date and time such as 2024-05-01T12:00:00.25Z")
    if value.adjusted() > 30:  # before any arithmetic, which could overflow
        raise InputError(f"time {text!r}: out of range")
    if unit == "s" and abs(value) > LATEST_S:
        raise InputError(f"time {text!r}: too large for seconds; name the column t_ms, t_us or t_ns")
    ns = int((value * UNITS[unit]).to_integral_value())
    if abs(ns) > MAX_NS:
        raise InputError(f"time {text!r}: out of range for {unit}")
    step = last_place(text) * UNITS[unit]
    if step > COARSEST_NS:
        raise InputError(f"time {text!r}: {coarse(step)}; write all digits, or t_ns in whole numbers")
    return ns


def coarse(ns: float) -> str:
    """Faults of times that are held to some nanoseconds only."""
    return f"known to {ns * 1e-9:g} s only, and 1 ms is the limit"


def _iso_ns(iso: re.Match[str], text: str) -> int:
    day, clock, fraction, zone = iso.groups()
    try:
        moment = datetime.fromisoformat(f"{day}T{clock}" + (zone or "+00:00").replace("Z", "+00:00"))
    except ValueError as error:
        raise InputError(f"time {text!r}: {error}") from None
    seconds = (moment - datetime(1970, 1, 1, tzinfo=UTC)).total_seconds()
    ns = int(seconds) * 10**9 + int((fraction or "0").ljust(9, "0"))
    if abs(ns) > MAX_NS:
        raise InputError(f"time {text!r}: out of range; times from 1824 to 2115 can be held")
    return ns


def parse_times(rows: CsvRows, name: str, unit: str) -> Ints:
    """(n,) times [ns] of a column; InputError names the line."""
    cells: Strings = rows.cells[name]
    if unit == "ns":
        t_ns = rows.ints(name)
        far = np.flatnonzero((t_ns > MAX_NS) | (t_ns < -MAX_NS))
        if len(far):
            raise rows.fail(int(far[0]), f"time {t_ns[far[0]]} ns: out of range; times from 1824 to 2115 can be held")
        return t_ns
    out = np.empty(len(cells), dtype=np.int64)
    for row, cell in enumerate(cells.tolist()):
        try:
            out[row] = parse_time(cell, unit)
        except InputError as error:
            raise rows.fail(row, str(error)) from None
    return out


def time_column(rows: CsvRows) -> str | None:
    """Unit of the column of times that a table has, None if it has none; InputError for two."""
    found = [unit for unit in TIME_COLUMNS if rows.has(unit)]
    if len(found) > 1:
        raise InputError(f"{rows.path}: two columns of times ({' and '.join(found)}); keep one")
    return found[0] if found else None


def read_sidecar(path: Path, cameras: Sequence[str]) -> dict[str, Ints]:
    """Times [ns] of frames 0, 1, ... of each camera in the file.

    The file has one time a line, or the columns frame and time, or a header line with a
    column of times and perhaps `frame` and `camera`.  Without a column `camera` it holds
    for every name in `cameras`.  InputError with the line where times repeat or go back,
    or where a frame is skipped.
    """
    found = list(iter_times(path))
    if not found:
        raise InputError(f"{path}: holds a header and no row; {WHAT} was expected")
    parts, unit = [rows for rows, _ in found], found[0][1]
    rows = CsvRows(
        path,
        np.concatenate([p.lines for p in parts]),
        {name: np.concatenate([p.cells[name] for p in parts]) for name in parts[0].cells},
    )
    return _by_camera(rows, unit, cameras)


def looks_like_times(path: Path) -> bool:
    """Return whether a text is a table of time stamps and nothing else, by its first line."""
    try:
        cells = first_line(path, WHAT)
        named = is_header_line(path)
    except InputError:
        return False
    if not named:
        return 0 < len(cells) <= 2
    names = {name for spelled in _COLUMNS.values() for name in spelled} | set(_BESIDE)
    times = {name for spelled in TIME_COLUMNS.values() for name in spelled}
    low = {cell.lower() for cell in cells}
    return low <= names and bool(low & times)


def iter_times(path: Path) -> Iterator[tuple[CsvRows, str]]:
    """Iterate over the rows of a table of time stamps, with the unit of its column of times; as for `read_sidecar`."""
    header = is_header_line(path)
    # The file is closed where a fault ends the reading, too
    with closing(read_rows(path, _COLUMNS, WHAT, ignored=_BESIDE) if header else read_plain(path, WHAT)) as parts:
        for part in parts:
            rows = part if header else _named(part)
            unit = time_column(rows)
            if unit is None:
                raise InputError(f"{path}: no column of times; name one of them time (seconds) or t_ns")
            yield rows, unit


def is_header_line(path: Path) -> bool:
    """Return whether the file begins with names of columns; a date and time is not a name."""
    cells = first_line(path, WHAT)
    return is_header(cells) and not any(_ISO.match(cell) for cell in cells)


def _named(rows: CsvRows) -> CsvRows:
    columns = {1: ("s",), 2: ("frame", "s")}.get(len(rows.cells))
    if columns is None:
        raise InputError(
            f"{rows.path}: {len(rows.cells)} columns without a header; give one time a line, frame and time, "
            "or a header line"
        )
    return CsvRows(rows.path, rows.lines, dict(zip(columns, rows.cells.values(), strict=True)))


def _by_camera(rows: CsvRows, unit: str, cameras: Sequence[str]) -> dict[str, Ints]:
    t_ns = parse_times(rows, unit, unit)
    if not rows.has("camera"):
        times = _in_order(rows, t_ns, np.arange(len(rows)))
        return dict.fromkeys(cameras, times)
    given = rows.cells["camera"]
    out: dict[str, Ints] = {}
    meant: dict[str, str] = {}
    for label in dict.fromkeys(given.tolist()):
        picked = np.flatnonzero(given == label)
        try:
            name = match_sensor(label, cameras, str(rows.path))
        except InputError:
            continue  # the file may contain more cameras than are ingested
        check_meaning(meant, label, name, str(rows.path))
        out[name] = _in_order(rows, t_ns[picked], picked)
    if not out:
        raise InputError(f"{rows.path}: contains {str(given[0])!r}, but none of {', '.join(cameras)}")
    return out


def _in_order(rows: CsvRows, t_ns: Ints, picked: Ints) -> Ints:
    """Times by frame number, strictly rising."""
    if rows.has("frame"):
        frames = rows.ints("frame")[picked]
        wrong = np.flatnonzero(frames != np.arange(len(frames)))
        if len(wrong):
            raise rows.fail(
                int(picked[wrong[0]]),
                f"frame {frames[wrong[0]]} where frame {wrong[0]} was expected; list every frame once, from 0",
            )
    back = np.flatnonzero(np.diff(t_ns) <= 0)
    if len(back):
        row = int(back[0]) + 1
        verb = "repeats" if t_ns[row] == t_ns[row - 1] else "goes back"
        raise rows.fail(
            int(picked[row]), f"time stamp {verb} ({t_ns[row]} ns after {t_ns[row - 1]} ns); correct the file"
        )
    return t_ns
