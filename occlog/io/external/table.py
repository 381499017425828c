"""Conversion of an external table to an occlog table."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from occlog.array_types import NS, Bools, Floats, Ints, Strings
from occlog.console.notes import note_once
from occlog.errors import InputError
from occlog.io.files.limits import FREE_BYTES
from occlog.io.files.texts.csv_rows import COARSEST
from occlog.io.files.timing.frame_times import MAX_SECONDS, frames_to_ns
from occlog.io.files.timing.times import note_clock_set
from occlog.io.files.timing.utc import time_words
from occlog.io.formats.boxes.columns import both_sizes, disagree
from occlog.records.columns import ColumnTable, first_row, key_of, largest, repeated_rows
from occlog.records.declared.sensors import MIN_SIGMA_PX, MIN_SIGMA_RAD, VALUES, WITH_A_RANGE, Measurements
from occlog.records.tables import TABLES, WIDER, Bearings, Boxes, Doa, Reads, Tracks, Truth, TruthBoxes, has_all_columns
from occlog.settings import METRES

from .cells import TableCells
from .names import (
    FILLED,
    MAY_BE_EMPTY,
    POWERS,
    SECONDS,
    TIME,
    Spelling,
    TableLayout,
    describe_missing,
    lay_out,
    misspelled,
    plain_name,
)
from .source import ColumnSource

T = TypeVar("T", bound=ColumnTable)
Values = dict[str, NDArray[np.generic]]
OWNERS = ("sensor", "target_id", "source_id", "occluder_id", "tag", "reference")
"""Columns that identify the owner of a row."""
OF_READS = {"reader", "anchor", "gateway", "tag", "beacon", "epc", "rssi", "rssi_dbm", "signal"}
"""Names that reads of tags alone have."""
HELD_PER_BYTE = 100
"""Memory of rows that are held together to be put in order, for each byte of the file; `FREE_BYTES` for any file."""
FARTHEST_RAD = 4 * np.pi
"""Larger angles are not in radians."""


@dataclass
class ExternalTable:
    """A file of another program with columns that fit an occlog table, and its conversion.

    Attributes:
        source: the file.
        layout: mapping of its columns to those of the table that fits best.
        wanted_unit: unit of length to which rows are converted; None: as the file has them.
    """

    source: ColumnSource
    layout: TableLayout
    wanted_unit: str | None = None

    @property
    def length_unit(self) -> str | None:
        """Length unit of converted rows; None: the file states none, and they are in that of the scene."""
        return self.wanted_unit if self.wanted_unit is not None else self.layout.length_unit

    @property
    def has_lengths(self) -> bool:
        """Whether a used column is a length, or derived from one (area, speed)."""
        return any(s.column.unit in POWERS for s in self.layout.columns)

    def fits(self, table: type[ColumnTable]) -> bool:
        """Whether the file has all required columns of `table`."""
        return not self.layout_of(table).missing

    def widest(self, table: type[T]) -> type[T]:
        """The variant of `table` with the most additional columns, all of which the file has.

        `table` itself if there is none.
        """
        found = table
        for wider in WIDER:
            if not issubclass(wider, table) or not fields_of(found) < fields_of(wider):
                continue
            there = {s.column.name for s in self.layout_of(wider).columns}
            if fields_of(wider) - fields_of(table) <= there:
                found = wider
        return found

    def layout_of(self, table: type[ColumnTable]) -> TableLayout:
        """Mapping of the file's columns to those of `table`; InputError, with the file, if they are ambiguous."""
        if self.layout.table is table:
            return self.layout
        return _lay_out(self.source, table)

    def convert_to(self, length_unit: str) -> None:
        """Set `length_unit` as the unit to which lengths are converted when rows are read, if the file states its own.

        InputError if one of the two units is not a known length (as `unit`).
        """
        own = self.layout.length_unit
        if own is None or own == length_unit:
            return
        if not {own, length_unit} <= METRES.keys():
            raise InputError(
                f"{self.source.path}: lengths are in {own}, which cannot be converted to {length_unit} of the scene; "
                "convert them",
                id="unit-mismatch",
            )
        self.wanted_unit = length_unit

    def rows(self, table: type[T]) -> Iterator[T]:
        """Yield the rows as `table`, sorted by its key, in parts; all rows of one time are in one part.

        A file that is not sorted by time is held in memory.

        Raises:
            InputError: columns are missing, a cell cannot be read, an identity is twice at one time, or a row is
                repeated.
        """
        layout = self.layout_of(table)
        check_fits(self.source, layout)
        frames = _FrameCount()
        odd = _OddPositions()
        for part in self._in_order(layout):
            made = _as_table(self.source, table, _filled(part, table, frames), part["_row"])
            if has_all_columns(table):
                _check_copies(self.source, made, part["_row"])
            if isinstance(made, Tracks | Truth):
                odd.add(np.hypot(made.x, made.y), part["_row"].astype(np.int64))
            yield made
        odd.warn(self.source.path)

    def _in_order(self, layout: TableLayout) -> Iterator[Values]:
        """Yield the column values (by table column) sorted by time, in parts that do not split a time.

        InputError if rows that must be held for this need more memory than a file of its size may.
        """
        if self._is_in_order(layout):
            parts = self._parts(layout)
        else:
            all_of_it: list[Values] = []
            for part in self._parts(layout):
                all_of_it.append(part)
                self._check_held(all_of_it)
            whole = _join(all_of_it)
            owners = [whole[name] for name in OWNERS if name in whole]
            note_clock_set(
                self.source.path, "row", whole["_row"].astype(np.int64), whole[TIME].astype(np.int64), owners
            )
            parts = iter([_pick(whole, np.argsort(whole[TIME], kind="stable"))])
        held: Values | None = None
        for part in parts:
            whole = part if held is None else _join([held, part])
            self._check_held([whole])
            cut = int(np.searchsorted(whole[TIME], whole[TIME][-1]))
            if cut:
                yield _pick(whole, slice(0, cut))
            held = _pick(whole, slice(cut, None))
        if held is not None:
            yield held

    def _check_held(self, parts: Iterable[Values]) -> None:
        """InputError if the column values `parts`, held for sorting, take more memory than a file of its size may."""
        size, held = self.source.size, sum(c.nbytes for part in parts for c in part.values())
        if held > max(FREE_BYTES, HELD_PER_BYTE * size):
            raise InputError(
                f"{self.source.path}: unsorted rows, or rows of one time, need {held} bytes, too many for a file of "
                f"{size}; sort the rows by time, or shorten the longest text",
                id="input-too-large",
            )

    def _is_in_order(self, layout: TableLayout) -> bool:
        """Whether the times in the file never decrease; reads the whole time column."""
        time = next(s for s in layout.columns if s.column.name == TIME)
        last = None
        for cells in self.source.cells([time.name]):
            t_ns = _times(cells, time)
            if len(t_ns) and ((last is not None and t_ns[0] < last) or (t_ns[1:] < t_ns[:-1]).any()):
                return False
            last = t_ns[-1] if len(t_ns) else last
        return True

    def _parts(self, layout: TableLayout) -> Iterator[Values]:
        """Yield the values (n,) of the table's columns by name, in parts, in file order.

        `_row` has the row number, from 0.
        """
        first = 0
        for cells in self.source.cells(layout.names):
            if not len(cells):
                continue
            values = self._part(cells, layout)
            values["_row"] = first + np.arange(len(cells))
            first += len(cells)
            yield values

    def _part(self, cells: TableCells, layout: TableLayout) -> Values:
        """Values of some rows in the table's units, by table column; right and lower box edges become sizes.

        InputError, with the position of the cell, for a value that is invalid or out of range.
        """
        values = {s.column.name: self._values(cells, s, layout) for s in layout.columns}
        for s in layout.columns:
            near = values.get({"width_px": "left_px", "height_px": "top_px"}.get(s.column.name, ""))
            if s.edge:  # the far edge of a box instead of its size
                values[s.column.name] = values[s.column.name] - near  # type: ignore[operator]
            elif s.far and near is not None:
                _check_far_edge(cells, s, values[s.column.name].astype(np.float64), near.astype(np.float64))
        _check(cells, values, layout)
        return values

    def table_of(self, cells: TableCells) -> ColumnTable:
        """Convert cells of the file to the best fitting table, sorted by its key.

        Raises:
            InputError: a cell cannot be read, or an identity is twice at one time.
        """
        values = self._part(cells, self.layout)
        values["_row"] = np.arange(len(cells))
        values = _pick(values, np.argsort(values[TIME], kind="stable"))
        table = self.layout.table
        return _as_table(self.source, table, _filled(values, table, _FrameCount()), values["_row"])

    def cells(self) -> Iterator[TableCells]:
        """Yield the cells of the file columns that the best fitting table uses, in parts, in file order."""
        yield from self.source.cells(self.layout.names)

    def times_of(self, cells: TableCells) -> Ints:
        """(n,) times [ns since the Unix epoch] of some rows, in file order."""
        time = next(s for s in self.layout.columns if s.column.name == TIME)
        return _times(cells, time)

    def owners(self, cells: TableCells) -> list[tuple[object, ...]]:
        """For each of n rows, in file order, the raw values that say of whom it is (sensor, identity, tag), as a tuple.

        Columns that the file lacks are omitted.
        """
        names = [s.name for s in self.layout.columns if s.column.name in OWNERS]
        columns = ([repr(v) if isinstance(v, list | dict) else v for v in cells.raw(name)] for name in names)
        return list(zip(*columns, strict=True)) if names else [()] * len(cells)

    def _values(self, cells: TableCells, s: Spelling, layout: TableLayout) -> NDArray[np.generic]:
        """Values of one column of a table, converted to the unit of the table's own column.

        Args:
            cells: rows of the file.
            s: the column, with its name and unit in the file.
            layout: of the table, which decides on what replaces empty cells.

        Returns:
            (n,), or (n, width) of a column of lists.

        Raises:
            InputError: a value is missing, out of range, or so large that it must be in another unit.
        """
        c = s.column
        if c.name == TIME:
            return _times(cells, s)
        if c.width:
            return cells.lists(s.name, c.width).astype(c.dtype)
        if c.kind == "U":
            empty = c.name not in layout.table.KEY or c.name in MAY_BE_EMPTY.get(layout.table.NAME, ())
            return cells.texts(s.name, blank=empty)
        if c.kind == "?":
            return cells.bools(s.name)
        if c.dtype.kind == "i":
            default = FILLED.get(layout.table.NAME, {}).get(c.name, -1 if c.optional else None)
            whole = cells.ints(s.name, blank=default if isinstance(default, int) and default < 0 else None)
            low, high = c.limits
            beyond = np.flatnonzero((whole < low) | (whole > high))
            if len(beyond):
                row = int(beyond[0])
                raise cells.fail(row, f"{s.name} is {whole[row]}; it must be {low} to {high}; renumber it")
            return whole
        values = cells.floats(s.name, blank=c.nan is not None or c.optional)
        if POWERS.get(c.unit) == (1, 0):
            _check_steps(cells, s)
        if s.unit == "deg":
            values = np.radians(values)
        elif c.unit == "rad":
            _refuse(
                cells,
                values,
                np.abs(values) > FARTHEST_RAD,
                f"{s.name} is",
                f" rad; if it is in degrees, name it {s.name}_deg",
            )
        if s.compass:
            return 0.5 * np.pi - values
        if c.unit == "s" and s.unit in SECONDS:
            return values * SECONDS[s.unit]
        if c.unit in POWERS and s.unit and self.wanted_unit is not None:
            values = values * (METRES[s.unit] / METRES[self.wanted_unit]) ** POWERS[c.unit][0]
        most = largest(c.unit)
        _refuse(cells, values, np.abs(values) > most, f"{s.name} is", f"; it must be within {most:g}")
        return values


def _times(cells: TableCells, s: Spelling) -> Ints:
    """(n,) times [ns since the Unix epoch] from a column of times, or from frame numbers (from 0) and a frame rate.

    `s` has the column's name, unit and frame rate.
    """
    if s.fps is None:
        return cells.times(s.name, s.time_unit)
    frames = cells.ints(s.name, blank=None)
    _refuse(cells, frames.astype(np.float64), frames < 0, f"{s.name} is", "; frames are numbered from 0")
    most = MAX_SECONDS * float(s.fps)
    _refuse(cells, frames.astype(np.float64), frames > most, f"{s.name} is", f"; it must be at most {most:.0f}")
    return frames_to_ns(frames, s.fps)


def fields_of(table: type[ColumnTable]) -> frozenset[str]:
    """Names of the columns of a table."""
    return frozenset(c.name for c in table.columns())


_OF_A_TARGET = re.compile(r"x_?\d+(?:_m|_mm|_cm)?")
"""Name of a column of the positions of one of several targets."""


def best_fit(source: ColumnSource, tables: Sequence[type[ColumnTable]] = ()) -> TableLayout:
    """Mapping of a file's columns to the table, among several, that uses most of them.

    Args:
        source: the file.
        tables: candidates; empty: all tables.

    Raises:
        InputError: it fits none; the message lists the columns that the most similar table lacks.
    """
    if sum(_OF_A_TARGET.fullmatch(name.lower()) is not None for name in source.names) > 2:
        raise InputError(
            f"{source.path}: has separate columns for each target ({', '.join(source.names)[:60]}); write one row for "
            "each target and time: time,id,x,y",
            id="unknown-format",
        )
    wanted = tuple(tables) or _every_table()
    declared = TABLES.get(source.table)
    if declared is not None and (not tables or declared in wanted):
        wanted = (declared,)
    layouts, faults = [], []
    for table in wanted:
        try:
            layouts.append(_lay_out(source, table))
        except InputError as error:
            faults.append(error)
    fitting = [layout for layout in layouts if not layout.missing]
    if not fitting:
        if faults:
            raise faults[0]
        nearest = max(layouts, key=lambda layout: (layout.similarities[0] - len(layout.missing), layout.similarities))
        check_fits(source, nearest)
    best = max(fitting, key=lambda layout: layout.similarities)
    if faults and not best.similarities[1]:
        # Names that any table may have make no table, where those of another are there, but do not go together
        raise faults[0]
    if best.table is Reads and not tables and _is_vague(best, source.names):
        # Times, sensors and identities alone make reads of tags only if nothing else is there
        check_fits(source, _lay_out(source, Bearings))
    for layout in layouts:
        # A table that a misspelled column alone keeps from fitting better is the one that is meant
        if len(layout.missing) == 1 and layout.similarities > best.similarities and misspelled(layout, source.names):
            check_fits(source, layout)
    return best


def _lay_out(source: ColumnSource, table: type[ColumnTable]) -> TableLayout:
    """Mapping of the columns of a file to those of `table`; InputError, with the file, if they are ambiguous."""
    try:
        return lay_out(source.names, table, source.fps, source.path)
    except InputError as error:
        raise InputError(f"{source.path}: {error}") from error


def _is_vague(layout: TableLayout, names: Sequence[str]) -> bool:
    """Whether a match with the table of tag reads is doubtful.

    It is if no used column has a name of readers or tags, and other columns are unused. `names` are those of all
    columns of the file.
    """
    used = {plain_name(s.name) for s in layout.columns}
    return len(names) > len(used) and not used & OF_READS


def check_fits(source: ColumnSource, layout: TableLayout) -> None:
    """InputError if a file lacks required columns of the layout's table, or has an unused one with a similar name."""
    if layout.missing and (nested := [n for n in source.nested if n not in layout.names]):
        raise InputError(
            f"{source.path}: column {nested[0]} has several values in a row, and {', '.join(layout.missing)} of "
            f"{layout.table.NAME} is missing; write one column for each value",
            id="missing-column",
        )
    if layout.missing:
        raise InputError(f"{source.path}: {describe_missing(layout, source.names)}", id="missing-column")
    wrong = misspelled(layout, source.names)
    if wrong is not None:
        raise InputError(f"{source.path}: {wrong}")


def _every_table() -> tuple[type[ColumnTable], ...]:
    """All table types; the first has priority if a file fits several equally well."""
    first = (Tracks, Truth, Bearings, Doa, Boxes)
    return (*first, *(table for table in TABLES.values() if table not in first))


MIN_ZEROS, MAX_ZERO_SHARE, ZERO_GAP = 3, 0.5, 0.05
"""Number of positions at exactly (0, 0) from which they are reported, and share up to which they are; least distance of
all others from there, over the largest one: a target that is there is also nearby."""


MIN_FAR_RATIO, MAX_FAR_SHARE = 20.0, 0.01
"""Positions that are this many times as far from (0, 0) as all others are reported, up to this share of them."""


@dataclass
class _OddPositions:
    """Positions at exactly (0, 0), as programs write it for missing ones, and those far from all others.

    Attributes:
        count: number of positions.
        zeros: number of those at (0, 0).
        first: row of the first of these.
        near, far: least and largest distance of the others from (0, 0).
        outliers: number of those far away.
        outlier: row of the first of these.
        ratio: distance of the nearest of these over that of the farthest other one.
    """

    count: int = 0
    zeros: int = 0
    first: int = -1
    near: float = math.inf
    far: float = 0.0
    outliers: int = 0
    outlier: int = -1
    ratio: float = math.inf

    def add(self, away: Floats, rows: Ints) -> None:
        """Add positions at the distances `away` (n,) from (0, 0), of the rows (n,) of the file."""
        zero = away == 0.0
        self.count += len(away)
        self.zeros += int(np.count_nonzero(zero))
        if self.first < 0 and zero.any():
            self.first = int(rows[zero].min())
        others = away[~zero & np.isfinite(away)]
        self.near = min(self.near, float(others.min(initial=math.inf)))
        self.far = max(self.far, float(others.max(initial=0.0)))
        ends = np.sort(others)[-1 - int(MAX_FAR_SHARE * len(others) + 1.0) :]
        gaps = ends[1:] / np.maximum(ends[:-1], 1e-3)
        if len(others) >= 1.0 / MAX_FAR_SHARE and gaps.max(initial=0.0) >= MIN_FAR_RATIO:
            least = ends[1:][int(np.argmax(gaps))]
            found = np.flatnonzero(away >= least)
            self.outlier = int(rows[found].min()) if self.outlier < 0 else self.outlier
            self.outliers, self.ratio = self.outliers + len(found), min(self.ratio, float(gaps.max()))

    def warn(self, path: Path) -> None:
        """Warn of positions in the file `path` that seem to be missing ones."""
        if MIN_ZEROS <= self.zeros <= MAX_ZERO_SHARE * self.count and self.near > ZERO_GAP * self.far:
            note_once(
                f"warning: {path}: {self.zeros} of {self.count} positions are exactly (0, 0), the first in row "
                f"{self.first} (from 0): if they are missing, remove these rows"
            )
        if self.outliers:
            note_once(
                f"warning: {path}: {self.outliers} of {self.count} positions are {self.ratio:.3g} times as far from "
                f"(0, 0) as all others, the first in row {self.outlier} (from 0): correct or remove them"
            )


class _FrameCount:
    """Counts the frames of each sensor, from 0, by the times of rows that are given in the order of time."""

    def __init__(self) -> None:
        """Start without frames: each sensor begins with frame 0."""
        self._known: dict[str, int] = {}

    def number(self, t_ns: Ints, sensor: Strings) -> Ints:
        """(n,) frame numbers of rows, counted from 0 for each sensor; rows of one time must be in one call.

        Args:
            t_ns: (n,) times [ns], not before those of the last call.
            sensor: (n,) names.
        """
        out = np.zeros(len(t_ns), dtype=np.int64)
        for name in np.unique(sensor).tolist():
            own = np.flatnonzero(sensor == name)
            _, index = np.unique(t_ns[own], return_inverse=True)
            out[own] = self._known.get(name, 0) + index
            self._known[name] = int(out[own].max()) + 1
        return out


def _filled(values: Values, table: type[ColumnTable], frames: _FrameCount) -> Values:
    """Add default values of columns missing in the file, wrap azimuths to [-pi, pi), and sort rows by the table's key.

    Args:
        values: (n,) by column, with `_row`, which is sorted in place.
        table: type of the table.
        frames: counts frames of boxes if the file has no frame numbers.

    Returns:
        Columns of the table, without `_row`.
    """
    rows = len(values[TIME])
    out = {name: column for name, column in values.items() if name != "_row"}
    for name, default in FILLED.get(table.NAME, {}).items():
        if name not in out and default is not None:
            out[name] = np.full(rows, default)
    if table.NAME == Bearings.NAME and "seen" not in out:
        out["seen"] = np.isfinite(out["bearing"].astype(np.float64))
    if issubclass(table, Boxes):
        if "frame" not in out:
            out["frame"] = frames.number(out[TIME], out["sensor"])  # type: ignore[arg-type]
        if "box" not in out:
            out["box"] = _number_boxes(out)
    for c in table.columns():
        if c.name not in out and not c.optional and c.nan is not None:
            shape = (rows, c.width) if c.width else (rows,)
            out[c.name] = np.full(shape, np.nan, dtype=c.dtype)
    for name in {"bearing", "azimuth"} & set(out):
        angle = out[name].astype(np.float64)
        turned = np.mod(angle + np.pi, 2 * np.pi) - np.pi
        out[name] = np.where((angle < -np.pi) | (angle >= np.pi), turned, angle)
    order = np.lexsort([out[name] for name in reversed(table.KEY)])
    values["_row"] = values["_row"][order]
    return _pick(out, order)


def _number_boxes(values: Values) -> Ints:
    """(n,) box numbers, from 0 in each frame of each sensor, in file order; -1 in rows without a box.

    `values` has the columns `sensor`, `t_ns` and `left_px` of the rows.
    """
    sensor, t_ns = values["sensor"], values[TIME]
    there = np.isfinite(values["left_px"].astype(np.float64))
    order = np.lexsort((sensor, t_ns))
    out = np.full(len(t_ns), -1, dtype=np.int64)
    own = order[there[order]]
    fresh = np.ones(len(own), dtype=np.bool_)
    fresh[1:] = (t_ns[own][1:] != t_ns[own][:-1]) | (sensor[own][1:] != sensor[own][:-1])
    starts = np.flatnonzero(fresh)
    out[own] = np.arange(len(own)) - np.repeat(starts, np.diff(np.append(starts, len(own))))
    return out


def _check(cells: TableCells, values: Mapping[str, NDArray[np.generic]], layout: TableLayout) -> None:
    """InputError, with the position of the cell, for a value that is out of range.

    Checked are standard deviations, confidences, elevations and box sizes, and that bearings have standard deviations.

    Args:
        cells: for the position.
        values: (n,) by table column.
        layout: the table, with names and units of the columns in the file.
    """
    spelled = {s.column.name: s for s in layout.columns}

    def refuse(name: str, wrong: Callable[[Floats], Bools], limit: str) -> None:
        if name in values:
            column, spelling = values[name].astype(np.float64), spelled[name]
            shown = np.degrees(column) if spelling.unit == "deg" else column
            what = f"{spelling.name} gives a {name.removesuffix('_px')} of" if spelling.edge else f"{spelling.name} is"
            with np.errstate(invalid="ignore"):
                _refuse(cells, shown, wrong(column), what, f"; it must be {limit}")

    sigmas = tuple(f"sigma_{name}" for name in (*VALUES, *WITH_A_RANGE)) if layout.table is Measurements else ()
    for name in ("sigma", "sigma_px", "sigma_azimuth", "sigma_elevation", *sigmas):
        refuse(name, lambda v: v <= 0, "above 0")
    for name in ("sigma", "sigma_azimuth", "sigma_elevation"):
        refuse(name, lambda v: v < MIN_SIGMA_RAD, f"at least {MIN_SIGMA_RAD:g} rad")
    refuse("sigma_px", lambda v: v < MIN_SIGMA_PX, f"at least {MIN_SIGMA_PX:g} px")
    for name in ("confidence", "score"):
        refuse(name, lambda v: (v < 0) | (v > 1), "0 to 1")
    refuse("elevation", lambda v: np.abs(v) > np.pi / 2, "within 90 degrees")
    if layout.table.NAME == Bearings.NAME:
        bearing, sigma = values["bearing"].astype(np.float64), values["sigma"].astype(np.float64)
        bare = np.isfinite(bearing) & np.isnan(sigma)
        if bare.any():
            row = int(np.flatnonzero(bare)[0])
            value, spread = spelled["bearing"].name, spelled["sigma"].name
            raise cells.fail(row, f"{value} has a value, and {spread} has none; give both or neither")
    if layout.table in (Boxes, TruthBoxes):
        for name in ("width_px", "height_px"):
            refuse(name, lambda v: v <= 0, "above 0")


def _check_far_edge(cells: TableCells, s: Spelling, sizes: Floats, near: Floats) -> None:
    far = cells.floats(s.far, blank=True)
    disagreement = disagree(sizes, near, far)
    if disagreement.any():
        row = int(np.flatnonzero(disagreement)[0])
        raise cells.fail(row, both_sizes(s.name, float(sizes[row]), s.far, f"{far[row]:g}", float(near[row])))


def _check_steps(cells: TableCells, s: Spelling) -> None:
    """InputError if lengths are in floats of insufficient precision, such as float32 for northings of 5,000,000 m.

    `s` has the column's name and unit in the file.
    """
    steps, unit = cells.steps(s.name), s.unit if s.unit in METRES else ""
    text = f" {unit} only, and {COARSEST / METRES[unit]:g} {unit}" if unit else f" only, and {COARSEST}"
    bad = steps * (METRES[unit] if unit else 1.0) > COARSEST
    _refuse(cells, steps, bad, f"{s.name} is known to", f"{text} is the limit; write all digits (float64)")


def _refuse(cells: TableCells, values: Floats, bad: Bools, before: str, after: str) -> None:
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        # All digits: 1.0000001 is above 1
        raise cells.fail(row, f"{before} {str(float(values[row])).removesuffix('.0')}{after}")


def _as_table(source: ColumnSource, table: type[T], values: Values, row: NDArray[np.generic]) -> T:
    """Create the table from its columns; InputError, with rows, for a repeated identity at one time or invalid values.

    Args:
        source: for messages.
        table: type of the table.
        values: (n,) by column, sorted by the table's key.
        row: (n,) number of each row in the file.
    """
    if table.ONCE:
        same = np.ones(max(len(row) - 1, 0), dtype=np.bool_)
        for name in table.KEY:
            same &= values[name][1:] == values[name][:-1]
        if same.any():
            k = int(np.flatnonzero(same)[0])
            key, whole = table.KEY[-1], bool((values[TIME].astype(np.int64) % NS == 0).all())
            remedy = "times are whole seconds: write their fractions" if whole else "remove one, or state identities"
            raise InputError(
                f"{source.path}: rows {min(row[k], row[k + 1])} and {max(row[k], row[k + 1])} (from 0): "
                f"{key} {values[key][k]} is twice at {time_words(values[TIME][k])}; {remedy}",
                id="duplicate-row",
            )
    try:
        return table.of(**values)
    except InputError as error:
        raise InputError(f"{source.path}: among rows {row.min()} to {row.max()}: {error}") from error


def _check_copies(source: ColumnSource, made: ColumnTable, row: NDArray[np.generic]) -> None:
    """InputError if the table has a duplicate row (box numbers are not compared).

    `row` (n,) are row numbers in the file.
    """
    # Boxes were numbered here, so that copies differ in their numbers
    copies, _ = repeated_rows(made, "box" if isinstance(made, Boxes) else "")
    if copies.any():
        k = first_row(copies)
        raise InputError(
            f"{source.path}: row {row[k]} (from 0) is a duplicate ({key_of(made, k)}); remove the copies",
            id="duplicate-row",
        )


def _join(parts: Sequence[Values]) -> Values:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _pick(values: Values, rows: Ints | slice) -> Values:
    return {name: column[rows] for name, column in values.items()}
