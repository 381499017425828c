"""Parsing of time stamps, and time stamp files with the time of every frame."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from datetime import UTC, datetime
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from occlog.array_types import NS, Floats, Ints
from occlog.console.notes import note_once
from occlog.errors import InputError, abridged, option
from occlog.io.files.timing.utc import time_words
from occlog.records.columns import MAX_NS

from ..names import check_meaning, match_sensor
from ..texts.csv_rows import MISSING, CsvRows, first_line, is_header, last_place, read_plain, read_rows

WHAT = "a table of time stamps"
HOUR_NS = 3600 * NS
UNITS = {"ns": 1, "us": 10**3, "ms": 10**6, "s": 10**9}
OUT_OF_RANGE = "time-out-of-range"
LATEST_S = 10**11
"""A larger number of seconds (year 5138) is in another unit."""
TICKS = {
    ".NET": (6.2e17, 6.8e17, "621355968000000000"),
    "Windows": (1.1e17, 1.7e17, "116444736000000000"),
}
"""Counts of 100 ns of programs in this century, which would be ns in 1973 to 1991, and that of 1970."""
COARSEST_NS = 10**6
"""Times that are held or written to less than this (1 ms) have been rounded by whoever wrote them."""

TIME_COLUMNS = {
    "ns": ("t_ns", "time_ns", "timestamp_ns", "frame_time_ns"),
    "us": ("t_us", "time_us", "timestamp_us", "frame_time_us"),
    "ms": ("t_ms", "time_ms", "timestamp_ms", "frame_time_ms"),
    "s": ("time", "t", "t_s", "time_s", "timestamp", "timestamp_s", "frame_time", "seconds", "unix_time"),
}
"""Accepted names of time columns; the ending states the unit, seconds without one."""

UNITLESS = ("time", "t", "timestamp", "frame_time")
"""Names of columns of seconds that do not state so."""
MAX_INTERVAL_S, MIN_INTERVALS = 2.0, 10
"""Time from frame to frame [s] above which the unit of such a column is asked for, and the number of intervals from
which it is."""
_FRAME = ("frame", "frame_index", "frame_number", "index")
_CAMERA = ("camera", "cam_id", "cam", "sensor", "port")
_COLUMNS = {**TIME_COLUMNS, "frame": _FRAME, "camera": _CAMERA}
_BESIDE = ("sync_index",)
_IMAGE = re.compile(r"\.(png|jpe?g|bmp|tiff?|pgm|webp)$", re.IGNORECASE)
NS_DIGITS = 18
"""Digits of a time since 1970 in ns, at least."""
_ISO = re.compile(r"^(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d(?::\d\d)?)(?:[.,](\d{1,9}))?\s*(Z|UTC|GMT|[+-]\d\d(?::?\d\d)?)?$")
_DATE = r"\d{1,4}[./-]\d{1,2}[./-]\d{1,4}"
_TIME_OF_DAY = r"\d{1,2}:\d\d(:\d\d([.,]\d+)?)?"
_FORM = "2024-05-01T12:00:00.25Z"
_OTHERWISE = (
    (r"[+-]?\d+,\d{1,2}|[+-]?\d+,\d{4,}", "has a decimal comma; write it with a point"),
    (r"[+-]?\d{1,3}(?:[, '\u00a0\u202f]\d{3})+(?:\.\d*)?", "has separators of thousands; write digits alone"),
    (_TIME_OF_DAY + r"\s*([AaPp][Mm])?", f"is a time of day without its date; write {_FORM}"),
    (r"\d{1,2}:\d\d:\d\d[:;]\d\d", "is a timecode; write seconds, or give frames and a frame rate"),
    (_DATE + r"[T ]+" + _TIME_OF_DAY + r"\s*([AaPp][Mm])", f"has hours of 12; write {_FORM}"),
    (
        r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d([.,]\d+)?)?\s*[A-Za-z][A-Za-z/_]+",
        "has a zone by name; write its offset, as +02:00",
    ),
    (_DATE + r"(?:[T ]+" + _TIME_OF_DAY + ")?", f"is a date that may be read in several orders; write {_FORM}"),
)
"""Texts that are meant as times and are not read, with the reason and the remedy."""


def parse_start_time(text: str) -> int:
    """Parse a start time: seconds or ISO 8601, as [ns since the Unix epoch].

    InputError names the option `start_time`.
    """
    try:
        return parse_time(text)
    except InputError as error:
        raise InputError(f"{option('start_time')}: {error}") from error


def parse_time(text: str, unit: str = "s") -> int:
    """Time [ns since the Unix epoch] of a number in `unit`, or of an ISO 8601 date and time (UTC unless it has a zone).

    Exact to the nanosecond.

    Raises:
        InputError: the text is neither, a number of seconds is beyond the year 5138 and so in another unit, or a number
            with an exponent is written so coarsely that its last digit is more than 1 ms.
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
        raise InputError(f"time {text!r}: {_fault(text.strip())}")
    if value.adjusted() > 30:  # before any arithmetic, which could overflow
        raise InputError(f"time {text!r}: out of range; times from 1824 to 2115 can be held", id="time-out-of-range")
    if unit == "s" and abs(value) > LATEST_S:
        raise InputError(
            f"time {text!r}: too large for seconds; write seconds, or name the column of a table t_ms, t_us or t_ns",
            id="time-out-of-range",
        )
    ns = int((value * UNITS[unit]).to_integral_value())
    if abs(ns) > MAX_NS:
        raise InputError(
            f"time {text!r}: out of range for {unit}; times from 1824 to 2115 can be held; check the unit",
            id=OUT_OF_RANGE,
        )
    step = last_place(text) * UNITS[unit]
    if step > COARSEST_NS:
        raise InputError(f"time {text!r}: {coarse(step)}; write all digits, or in a table t_ns in whole numbers")
    return ns


def _fault(text: str) -> str:
    """Why a text is not a valid time, and the remedy, for a message."""
    if text.lower() in MISSING:
        return "is missing; remove the row, or give its time"
    reason = next((reason for form, reason in _OTHERWISE if re.fullmatch(form, text)), "")
    return reason or f"neither a number nor a date and time such as {_FORM}; correct or remove this row"


def coarse(ns: float) -> str:
    """Text for messages: times are known to `ns` nanoseconds only, which is too coarse."""
    return f"known to {ns * 1e-9:g} s only, and 1 ms is the limit"


def _iso_ns(iso: re.Match[str], text: str) -> int:
    day, clock, fraction, zone = iso.groups()
    if clock.endswith(":60"):
        raise InputError(f"time {text!r}: a leap second, which these times do not have; write it as :59.999")
    try:
        instant = datetime.fromisoformat(f"{day}T{clock}" + (zone if zone and zone[0] in "+-" else "+00:00"))
    except ValueError as error:
        raise InputError(f"time {text!r}: {error}") from None
    seconds = (instant - datetime(1970, 1, 1, tzinfo=UTC)).total_seconds()
    ns = int(seconds) * 10**9 + int((fraction or "0").ljust(9, "0"))
    if abs(ns) > MAX_NS:
        raise InputError(f"time {text!r}: out of range; times from 1824 to 2115 can be held", id="time-out-of-range")
    return ns


def unit_by_size(largest: float) -> str:
    """Unit (s, ms, us or ns) of times since 1970, inferred from their largest absolute value.

    It is the first of them in which the year is at most 5138, so that times from 1973 on have one unit only.
    """
    for unit, scale in (("s", 1), ("ms", 10**3), ("us", 10**6)):
        if largest <= LATEST_S * scale:
            return unit
    return "ns"


def column_unit(values: Floats, unit: str, fail: Callable[[int, str], InputError]) -> str:
    """Unit of a time column: the stated one, else seconds, or by size if the values are too large for seconds.

    Args:
        values: (n,) times in the unknown unit.
        unit: stated unit; empty: none is stated.
        fail: makes an InputError of the index of a row and a message.

    Raises:
        InputError: times are too large for stated seconds, in several units by their size, or ticks of 100 ns.
    """
    sizes = np.abs(values)
    if unit not in ("", "s") or not len(sizes) or sizes.max() <= LATEST_S:
        return unit or "s"
    if unit:
        row = int(np.argmax(sizes))
        remedy = _interval(values, unit) or "; name the column t_ms, t_us or t_ns"
        raise fail(row, f"time {values[row]:.12g}: too large for seconds{remedy}")
    found = unit_by_size(float(sizes.max()))
    for program, (least_ticks, most_ticks, epoch) in TICKS.items():
        if not unit and least_ticks < sizes.min() and sizes.max() < most_ticks:
            raise fail(
                int(np.argmax(sizes)),
                f"times seem to be ticks of {program} (100 ns); write t_ns, (ticks - {epoch}) x 100",
            )
    least, most = (int(np.argmin(np.where(sizes > 0.0, sizes, np.inf))), int(np.argmax(sizes)))
    if unit_by_size(float(sizes[least])) != found:
        several = f"times {values[least]:.15g} and {values[most]:.15g} are in several units"
        raise fail(least, f"{several}; write all in one, in a column t_s, t_ms, t_us or t_ns")
    return found


def _number(text: str) -> float:
    """Number that a text represents; 0 for other texts, NaN and infinity."""
    try:
        value = float(text)
    except ValueError:
        return 0.0
    return value if math.isfinite(value) else 0.0


def parse_column(texts: Sequence[str], unit: str, fail: Callable[[int, str], InputError]) -> Ints:
    """Parse texts, numbers or ISO 8601 dates, to (n,) times [ns since the Unix epoch].

    Numbers without a stated unit are in seconds, or in the unit of their size if too large. Dates without a zone are in
    UTC.

    Args:
        texts: n cells.
        unit: unit of numbers; empty: it is not stated.
        fail: makes an InputError of the index of a row and a message.

    Raises:
        InputError: a text is no time, the unit is unclear, or only some dates have a zone.
    """
    out = np.empty(len(texts), dtype=np.int64)
    zoned: bool | None = None
    if unit in ("", "s"):
        unit = column_unit(np.array([_number(text) for text in texts]), unit, fail)
    for row, text in enumerate(texts):
        iso = _ISO.match(text.strip())
        if iso is not None:
            if zoned not in (None, iso[4] is not None):
                raise fail(row, f"time {text!r}: some times of the column have a time zone, some do not; give all one")
            zoned = iso[4] is not None
        try:
            out[row] = parse_time(text, unit)
        except InputError as error:
            values = np.array([_number(text) for text in texts]) if error.id == OUT_OF_RANGE else np.zeros(0)
            raise fail(row, f"{error}{_interval(values, unit)}") from None
    return out


def _interval(values: Floats, unit: str) -> str:
    """Addition to a message on times: their median interval, if it is above 2 s and suggests another unit; else empty.

    Args:
        values: (n,) times of a column.
        unit: in which they were read.
    """
    steps = np.diff(np.unique(values))
    usual_s = float(np.median(steps)) * UNITS[unit] / NS if len(steps) >= MIN_INTERVALS else 0.0
    return (
        f"; {usual_s:g} s from row to row: name the column after its unit (t_ms, t_us, t_ns)"
        if usual_s > MAX_INTERVAL_S
        else ""
    )


def parse_times(rows: CsvRows, name: str, unit: str) -> Ints:
    """(n,) times [ns since the Unix epoch] of the column `name`; InputError, with the line, for an invalid one.

    `unit` is that of numbers; empty: seconds, or by their size.
    """
    if unit == "ns":
        t_ns = rows.ints(name)
        far = np.flatnonzero((t_ns > MAX_NS) | (t_ns < -MAX_NS))
        if len(far):
            raise rows.fail(
                int(far[0]), f"time {time_words(t_ns[far[0]])}: out of range; times from 1824 to 2115 can be held"
            )
        return t_ns
    return parse_column(rows.cells[name].tolist(), unit, rows.fail)


def time_column(rows: CsvRows) -> str | None:
    """Unit of a text table's time column, which is also its name in `rows`; None without one, InputError for two."""
    found = [unit for unit in TIME_COLUMNS if rows.has(unit)]
    if len(found) > 1:
        raise InputError(
            f"{rows.path}: two columns of times (in {' and in '.join(found)}); keep one", id="conflicting-values"
        )
    return found[0] if found else None


def check_unit(rows: CsvRows, interval_s: Floats) -> None:
    """InputError for a time column that does not state its unit, if frames are so far apart that it is not seconds.

    Args:
        rows: some rows of the table.
        interval_s: (n,) time from each frame to the next [s], if the column is in seconds.
    """
    if len(interval_s) < MIN_INTERVALS or not (usual := float(np.median(interval_s))) > MAX_INTERVAL_S:
        return
    head = [cell.lower() for cell in first_line(rows.path, WHAT)]
    named = is_header_line(rows.path)
    if not rows.has("s") or _ISO.match(str(rows.cells["s"][0])) or (named and not set(head) & set(UNITLESS)):
        return
    column = next((f"column {name}" for name in UNITLESS if named and name in head), "times without a header")
    raise InputError(
        f"{rows.path}: {column}: {usual:g} s from frame to frame if these are seconds; name the column after its unit: "
        "t_ms, t_us or t_ns, or t_s for seconds",
        id="missing-unit",
    )


def read_sidecar(path: Path, cameras: Sequence[str]) -> dict[str, Ints]:
    """Read the times [ns] (n,) of frames 0, 1, ... of each camera, by name, from a time stamp file.

    The file has one time a line, or the columns frame and time, or a header line with a column of times and perhaps
    `frame` and `camera`. Without a column `camera` it holds for every name in `cameras`.

    Raises:
        InputError: times repeat or decrease, a frame is skipped, or the file is of none of `cameras`; with the line.
    """
    found = list(iter_times(path))
    if not found:
        raise InputError(f"{path}: holds a header and no row; {WHAT} was expected", id="empty-input")
    parts, unit = [rows for rows, _ in found], found[0][1]
    rows = CsvRows(
        path,
        np.concatenate([p.lines for p in parts]),
        {name: np.concatenate([p.cells[name] for p in parts]) for name in parts[0].cells},
    )
    return _by_camera(rows, unit, cameras)


def looks_like_times(path: Path) -> bool:
    """Whether a text file is a table of time stamps alone, by its first line; False if it cannot be read."""
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
    """Yield the rows of a time stamp table in parts, each with the unit of its time column.

    The rows have the column under the name of the unit (`s`, `ns`, ...). InputError without a column of times.
    """
    header = is_header_line(path)
    # The file is closed where a fault ends the reading, too
    with closing(read_rows(path, _COLUMNS, WHAT, ignored=_BESIDE) if header else read_plain(path, WHAT)) as parts:
        for part in parts:
            rows = part if header else _named(part)
            unit = time_column(rows)
            if unit is None:
                raise InputError(
                    f"{path}: no column of times; name one of them time (seconds) or t_ns", id="missing-column"
                )
            yield rows, unit


def is_header_line(path: Path) -> bool:
    """Whether the first line of a file has column names rather than numbers or dates."""
    cells = first_line(path, WHAT)
    return is_header(cells) and not any(cell[:1].isdigit() for cell in cells)


def _named(rows: CsvRows) -> CsvRows:
    cells = list(rows.cells.values())
    if len(cells) == 2 and all(_IMAGE.search(str(cell)) for cell in cells[1]):  # as in data sets of EuRoC and TUM
        unit = "ns" if all(len(str(cell)) >= NS_DIGITS and str(cell).isdecimal() for cell in cells[0]) else "s"
        return CsvRows(rows.path, rows.lines, {unit: cells[0]})
    columns = {1: ("s",), 2: ("frame", "s")}.get(len(rows.cells))
    if columns is None:
        raise InputError(
            f"{rows.path}: {len(rows.cells)} columns without a header; give one time a line, frame and time, "
            "or a header line",
            id="missing-column",
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
        raise InputError(
            f"{rows.path}: column camera has {str(given[0])!r}, which is none of the cameras "
            f"{abridged(cameras)}; write these names",
            id="missing-column",
        )
    return out


COUNTERS = (
    (2.0**32 * 1e-3, "a counter of 32 bits in ms"),
    (2.0**32 * 1e-6, "a counter of 32 bits in us"),
    (604_800.0, "a time of the week"),
    (86_400.0, "a time of the day"),
)
"""Spans after which times begin again [s]."""
MAX_STEP_S = 2.0
"""Time from the last row before that to the first one after, at most."""


def restart_of(fall_s: float) -> str:
    """Text on the counter that overflows where times decrease by `fall_s` [s], with the remedy.

    Empty: none is known.
    """
    for span, words in COUNTERS:
        if 0.0 <= span - fall_s <= MAX_STEP_S:
            return f"{words} began again; add {span:.15g} s to all rows from there on"
    return ""


MIN_ROWS_A_RUN = 8
"""Rows from one fall of the times to the next, at least, for a clock that was set; in mean."""


def note_clock_set(path: Path, location: str, lines: Ints, t_ns: Ints, owners: Sequence[np.ndarray]) -> None:
    """Warn once if times decrease from row to row of one owner: a clock was set, or two runs are in one file.

    No warning if they decrease so often that the rows are just in another order.

    Args:
        path: the file.
        location: word for the numbers of rows, as `line`.
        lines: (n,) numbers of rows, increasing.
        t_ns: (n,) their times [ns].
        owners: columns (n,) that together identify the owner of a row (sensor, target).
    """
    codes = [np.unique(owner, return_inverse=True)[1] for owner in owners]
    order = np.lexsort([np.arange(len(t_ns)), *codes])
    new = np.zeros(max(len(t_ns) - 1, 0), dtype=np.bool_)
    for code in codes:
        new |= code[order][1:] != code[order][:-1]
    sorted_ns = t_ns[order]
    back = np.flatnonzero((sorted_ns[1:] < sorted_ns[:-1]) & ~new)
    if not len(back) or len(t_ns) < MIN_ROWS_A_RUN * (len(back) + np.count_nonzero(new) + 1):
        return  # in order, or in another order than that of time
    first = back[np.argmin(lines[order][back + 1])]
    fall = float(sorted_ns[first] - sorted_ns[first + 1]) / NS
    cause = restart_of(fall) or "a clock that was set, or two runs in one file? Rows are sorted by time"
    note_once(f"warning: {path}: {location} {lines[order][first + 1]}: time goes back by {fall:.6g} s: {cause}")


def _in_order(rows: CsvRows, t_ns: Ints, picked: Ints) -> Ints:
    """Return `t_ns`, which has the times by frame number.

    Args:
        rows: of the file.
        t_ns: (n,) times of the picked rows [ns].
        picked: (n,) indices of these rows.

    Raises:
        InputError: times do not strictly increase, or frame numbers, if the file has them, are not 0, 1, ...
    """
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
        count = int(np.count_nonzero(np.diff(t_ns) == 0))
        verb = f"repeats, {count} times in all" if t_ns[row] == t_ns[row - 1] else "goes back"
        summer = abs(int(t_ns[row - 1] - t_ns[row]) - HOUR_NS) < HOUR_NS // 60
        remedy = restart_of(float(t_ns[row - 1] - t_ns[row]) / NS) or "correct the file"
        remedy += "; by an hour: local time at the end of summer time? Write UTC" * summer
        raise rows.fail(
            int(picked[row]),
            f"time stamp {verb} ({time_words(t_ns[row])} after {time_words(t_ns[row - 1])}); {remedy}",
        )
    check_unit(rows, np.diff(t_ns) / NS)
    return t_ns
