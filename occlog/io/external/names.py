"""Column names in external tables, and units in names.

A name may end in the unit: `bearing_deg`, `x_cm`, `cov_xx_cm2`, `vx_cm_s`, `t_ms`. Without an ending lengths are in the
unit of the scene. An angle without one is in radians if the table has occlog's own time column `t_ns`; in any other
table it could be in degrees, and is refused. So is a time difference (`tdoa_s`, `tdoa_us`). An angle `compass_deg` is
clockwise from north (+y); all others are from +x towards +y.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import NamedTuple

from occlog.errors import InputError, option
from occlog.io.files.input_units import STATED
from occlog.io.files.timing.times import TIME_COLUMNS, UNITS
from occlog.io.formats.boxes.columns import COLUMNS as BOXES
from occlog.io.formats.sound.csv_log import ANGLES
from occlog.io.formats.sound.csv_log import FORMAT as DIRECTIONS
from occlog.io.formats.tags import TAG_READS as READS
from occlog.io.formats.truth import POSITIONS
from occlog.records.columns import Column, ColumnTable
from occlog.records.declared.sensors import VALUES, Measurements
from occlog.records.tables import Bearings, Boxes, Doa, Failures, Hulls, Occluders, Reads, Tracks, Truth, TruthBoxes
from occlog.settings import METRES

TIME = "t_ns"
LONGEST_NAME = 40
"""Characters of a name of a column in a message."""
_IDENTITY = tuple(dict.fromkeys((*POSITIONS.names["id"], *BOXES["id"])))
_SENSOR = tuple(dict.fromkeys((*DIRECTIONS.names["sensor"], *BOXES["camera"], *READS.names["reader"])))
COMPASS = "compass"
"""Names of bearings clockwise from north (+y), without the ending of the unit."""
SIGMAS = (
    *("sigma_bearing", *ANGLES["sigma_azimuth"], "bearing_sigma", "azimuth_sigma", "std", "sd", "stddev"),
    *(f"{angle}_{word}" for angle in ANGLES["azimuth"] for word in ("std", "sd")),
    *(f"{word}_{angle}" for angle in ANGLES["azimuth"] for word in ("std", "sd")),
)
"""Names of the standard deviation of a bearing, without the ending of the unit."""
ALIASES: Mapping[str, Sequence[str]] = {
    "sensor": _SENSOR,
    "target_id": _IDENTITY,
    "occluder_id": _IDENTITY,
    "source_id": tuple(DIRECTIONS.names["id"]),
    "bearing": (*ANGLES["azimuth"], COMPASS),
    "azimuth": (*ANGLES["azimuth"], COMPASS),
    "elevation": ANGLES["elevation"],
    "sigma": SIGMAS,
    "sigma_azimuth": SIGMAS,
    "sigma_elevation": (*ANGLES["sigma_elevation"], "elevation_sigma", "elevation_std", "std_elevation"),
    "confidence": tuple(dict.fromkeys((*BOXES["confidence"], *DIRECTIONS.names["confidence"]))),
    "score": tuple(BOXES["confidence"]),
    "frame": tuple(BOXES["frame"]),
    "left_px": tuple(BOXES["left"]),
    "top_px": tuple(BOXES["top"]),
    "width_px": tuple(BOXES["width"]),
    "height_px": tuple(BOXES["height"]),
    "tag": tuple(READS.names["tag"]),
    "rssi": tuple(READS.names["rssi"]),
    "sigma_rssi": ("rssi_sigma", "rssi_std", "sigma_rssi_db", "rssi_sigma_db", "rssi_std_db"),
    "range": ("distance", "dist"),
    "sigma_range": ("range_sigma", "range_std", "sigma_distance", "distance_sigma", "distance_std"),
    "reference": ("ref", "reference_station", "reference_sensor", "sensor_ref", "other"),
    "tdoa": ("time_difference", "delay"),
    "sigma_tdoa": ("tdoa_sigma", "tdoa_std"),
    "range_difference": ("distance_difference", "path_difference"),
    "sigma_range_difference": ("range_difference_sigma", "range_difference_std"),
    "x": ("pos_x", "p_rs_r_x"),
    "y": ("pos_y", "p_rs_r_y"),
    "z": ("pos_z", "p_rs_r_z"),
}
"""Names of columns in external tables, without endings of units; a column's own name is accepted, too."""
OWN_ALIASES: Mapping[str, Mapping[str, Sequence[str]]] = {
    Measurements.NAME: {"target_id": ("tag", "tag_id", "beacon"), "sigma_bearing": SIGMAS},
    Reads.NAME: {"target_id": READS.names["tag"]},
}
"""Further names in one table."""
SECONDS = {unit: ns * 1e-9 for unit, ns in UNITS.items()}
"""Seconds in the units of time differences."""
LENGTHS_OF_TIMES = {"range_difference": "tdoa", "sigma_range_difference": "sigma_tdoa"}
"""Lengths that may be called as a time is, with the ending of a length: `tdoa_m`."""
EDGES: Mapping[str, tuple[str, Sequence[str]]] = {
    "width_px": ("right_px", tuple(BOXES["right"])),
    "height_px": ("bottom_px", tuple(BOXES["bottom"])),
}
"""Edges of boxes that represent a width or a height."""
FILLED: Mapping[str, Mapping[str, object]] = {
    Bearings.NAME: {"target_id": -1, "seen": None},
    Doa.NAME: {"source_id": -1},
    Boxes.NAME: {"target_id": -1, "frame": None, "box": None},
    TruthBoxes.NAME: {"target_id": -1, "frame": None, "box": None},
    Truth.NAME: {"target_id": 0, "role": "target"},
    Tracks.NAME: {"target_id": 0},
    Measurements.NAME: {"target_id": 0},
}
"""Columns that may be skipped, and what they hold then; None: it follows from other columns."""
WANTED: Mapping[str, Sequence[str]] = {
    Bearings.NAME: ("bearing", "sigma"),
    Boxes.NAME: ("left_px", "top_px", "width_px", "height_px"),
    TruthBoxes.NAME: ("left_px", "top_px", "width_px", "height_px"),
    Occluders.NAME: ("x", "y", "cov_xx", "cov_xy", "cov_yy"),
    Hulls.NAME: ("x", "y"),
}
"""Columns that must be there although single cells may be empty."""
MAY_BE_EMPTY: Mapping[str, Sequence[str]] = {Failures.NAME: ("sensor",)}
"""Texts of keys that mean something where they are empty."""
ONE_OF: Mapping[str, Sequence[str]] = {Measurements.NAME: VALUES}
"""Columns of which at least one must be there."""
UNIT = "unit"
"""The unit of lengths of scenes that state none, as `occlog export` names it."""
IN_SECONDS = ("seconds", "unix_time")
"""Names of columns of times that state seconds without the ending of a unit."""
POWERS = {"m": (1, 0), "m^2": (2, 0), "m/s": (1, 1), "m^2/s": (2, 1), "m^2/s^2": (2, 2)}
"""Powers of length and of 1/s in the units that go with the scene's unit of length."""
COMPARED = 200
"""Names that no table has, of a file, that are compared with those that tables have, at most: each takes its time."""


def plain_name(name: str) -> str:
    """Normalise a column name: lower case, with a unit in brackets converted to an ending.

    `#timestamp [ns]` is `timestamp_ns`, `pos x [m]` is `pos_x_m`, and `vx (m/s)` is `vx_m_s`.
    """
    low = name.strip().removeprefix("#").strip().lower()
    opening = {"]": "[", ")": "("}.get(low[-1:], "")
    start = low.rfind(opening) if opening else -1
    if start < 0:
        return low
    unit = low[start + 1 : -1].strip().replace("/", "_").replace("^", "")
    base = low[:start].rstrip().replace(" ", "_")
    return f"{base}_{unit}" if unit else base


class Spelling(NamedTuple):
    """A column of an occlog table, with the name and unit under which a file has it."""

    column: Column
    name: str  # of the file's column
    unit: str  # that the name ends in: `ns`, `deg`, `cm`, ...; empty: the table's own
    edge: bool = False  # the column has the far edge of a box instead of its size
    far: str = ""  # name of a column with the far edge, in addition to that of the size
    stated: bool = False  # the unit is stated, by the name or by the user
    fps: Fraction | None = None  # the column has numbers of frames in place of times, so many a second

    @property
    def time_unit(self) -> str:
        """Unit of times, if the name or the user states it; empty: it is inferred from the size of the numbers."""
        return self.unit if self.stated else ""

    @property
    def compass(self) -> bool:
        """Whether it is an angle clockwise from north (column `compass`), and not from +x towards +y."""
        return self.column.unit == "rad" and plain_name(self.name).startswith(COMPASS)


class TableLayout(NamedTuple):
    """Mapping of a file's columns to those of an occlog table.

    Attributes:
        table: the occlog table.
        columns: columns of the table that the file has, each with its name and unit in the file.
        missing: names of columns that the table requires and the file lacks.
    """

    table: type[ColumnTable]
    columns: tuple[Spelling, ...]
    missing: tuple[str, ...]

    @property
    def names(self) -> list[str]:
        """Names of the file columns that are read."""
        return list(dict.fromkeys(name for s in self.columns for name in (s.name, s.far) if name))

    @property
    def similarities(self) -> tuple[int, int]:
        """How well the file matches the table: number of file columns used, and how many have the table's own names."""
        own = sum(s.name in (s.column.name, f"{s.column.name}_{s.unit}") for s in self.columns)
        return len({s.name for s in self.columns}), own

    @property
    def length_unit(self) -> str | None:
        """Unit that the names of length columns state (`x_cm`); None if they state none."""
        units = {s.unit for s in self.columns if s.column.unit in POWERS and s.unit}
        return next(iter(units), None)


def frame_column(names: Sequence[str]) -> str | None:
    """Name of the column of frame numbers among the columns `names` of a file.

    None if there is none, or if the file has times.
    """
    there = {plain_name(name): name for name in reversed(names)}
    if any(name in there for known in TIME_COLUMNS.values() for name in known):
        return None
    return next((there[name] for name in BOXES["frame"] if name in there), None)


def is_in_time(names: Sequence[str]) -> bool:
    """Whether one of the column names of a file is that of times or frame numbers."""
    there = {plain_name(name) for name in names}
    return not there.isdisjoint({*BOXES["frame"], *(name for known in TIME_COLUMNS.values() for name in known)})


def lay_out(
    names: Sequence[str], table: type[ColumnTable], fps: Fraction | None = None, path: Path | None = None
) -> TableLayout:
    """Match the column names of a file with the columns of a table, by known names and endings of units.

    Args:
        names: of the file's columns, in any case of letters.
        table: the table.
        fps: frames per second, which makes a column of frame numbers one of times; None: it is not used for times.
        path: the file, for which the user may have stated units; None: unknown.

    Raises:
        InputError: two columns have one meaning, an angle does not state its unit, lengths are in several units, or a
            stated unit contradicts the name of its column.
    """
    there = {plain_name(name): name for name in reversed(names)}
    found, missing = [], []
    # Most columns are in most files under no name
    columns = _columns_by_name(table)  # type: ignore[arg-type]  # a type is hashable
    named = {number for name in there for number in columns.get(name, ())}
    for number, (column, known, wanted) in enumerate(_sought(table)):  # type: ignore[arg-type]
        spelled = _find(column, there, known) if number in named else None
        if spelled is not None:
            reported = unit_in_name(table, column, spelled.name)
            stated = STATED.get().unit_of(spelled.name, kind_of(column), reported, path)
            found.append(spelled._replace(unit=stated or spelled.unit, stated=bool(stated)))
        elif column.name == TIME and fps is not None and (counted := frame_column(names)) is not None:
            found.append(Spelling(column, counted, "", fps=fps))
        elif wanted:
            missing.append(column.name)
    one_of = ONE_OF.get(table.NAME, ())
    if one_of and not any(s.column.name in one_of for s in found):
        missing += one_of
    layout = TableLayout(table, tuple(found), tuple(missing))
    if len(there) < len(names):
        _check_case(layout, names)
    _check_angles(layout, there)
    _check_lengths(layout)
    return layout


def kind_of(column: Column) -> str:
    """Kind of quantity in a column, if a file can state its unit; otherwise empty.

    The kinds are `time`, `interval` (time difference), `angle` and `length`.
    """
    if column.name == TIME:
        return "time"
    if _is_time_difference(column):
        return "interval"
    return "angle" if column.unit == "rad" else "length" if column.unit in POWERS else ""


def unit_in_name(table: type[ColumnTable], column: Column, name: str) -> str:
    """Unit that the column name in a file states (`x_cm`: `cm`).

    Empty if none, also for times that are in s by default.

    Args:
        table: the table.
        column: its column that the name means.
        name: as in the file.
    """
    low = plain_name(name)
    unit = spellings(column, table).get(low, "")
    return "" if column.name == TIME and not (low.endswith(f"_{unit}") or low in IN_SECONDS) else unit


def spellings(column: Column, table: type[ColumnTable] | None = None) -> Mapping[str, str]:
    """Names that a file may have for a table column, in lower case, each with the unit it states (empty: none).

    The column's own name comes first. `table` adds names that are accepted in this table only; None: no such names.
    """
    return _spellings(column, "" if table is None else table.NAME)


@cache
def _spellings(column: Column, table: str) -> Mapping[str, str]:
    if column.name == TIME:
        return {name: unit for unit, names in TIME_COLUMNS.items() for name in names}
    own = OWN_ALIASES.get(table, {})
    bases = tuple(dict.fromkeys((column.name, *ALIASES.get(column.name, ()), *own.get(column.name, ()))))
    out = dict.fromkeys(bases, "")
    if column.unit == "rad":
        out |= {f"{base}_{unit}": unit for unit in ("deg", "rad") for base in bases}
    elif column.unit in POWERS:
        out |= {base + ending(column, unit): unit for unit in (*METRES, UNIT) for base in bases}
        if column.name in LENGTHS_OF_TIMES:
            times = LENGTHS_OF_TIMES[column.name]
            out |= {f"{base}_{unit}": unit for unit in METRES for base in (times, *ALIASES[times])}
    elif _is_time_difference(column):
        out |= {f"{base}_{unit}": unit for unit in SECONDS for base in bases}
    return out


def _is_time_difference(column: Column) -> bool:
    """Return whether a column is a duration [s] with a name that does not end in `_s`: inputs must add its unit."""
    return column.unit == "s" and not column.name.endswith("_s")


def ending(column: Column, unit: str) -> str:
    """Ending of the name of a length, area or speed column for a unit of length.

    For cm it is `_cm`, `_cm2`, `_cm_s`, `_cm2_s` or `_cm2_s2`, by the unit of the column (m, m^2, m/s, ...).
    """
    length, per_second = POWERS[column.unit]
    return f"_{unit}" + ("2" if length == 2 else "") + ("", "_s", "_s2")[per_second]


def describe_missing(layout: TableLayout, names: Sequence[str]) -> str:
    """Text on the required columns that a file lacks for a table, with similar names of unused columns.

    Args:
        layout: the table, and the columns found.
        names: of all columns of the file.
    """
    used = {s.name for s in layout.columns}
    left = [name for name in names if name not in used][:COMPARED]
    one_of = [name for name in ONE_OF.get(layout.table.NAME, ()) if name in layout.missing]
    words = [f"one of {', '.join(one_of)}"] if one_of else []
    for column in layout.table.columns():
        if column.name in layout.missing and column.name not in one_of:
            known = list(spellings(column, layout.table))
            near = next((n for n in left if get_close_matches(plain_name(n), known, n=1, cutoff=0.6)), None)
            units = [f"{column.name}_deg", f"{column.name}_rad"] if column.unit == "rad" else []
            also = f" (or {', '.join(units)})" if units else ""
            words.append(f"{column.name}{also}" + (f", is it {near!r}?" if near is not None else ""))
    if layout.missing == (TIME,) and (counted := frame_column(names)) is not None:
        return (
            f"column {counted} counts frames, and {layout.table.NAME} requires times: add a column of times (time_s), "
            "or ingest a truth with its frame rate (occlog ingest --truth FILE --fps RATE)"
        )
    present = ", ".join(name[:LONGEST_NAME] for name in names)
    return f"{layout.table.NAME} requires {'; '.join(words)}; the file has {present}"


def misspelled(layout: TableLayout, names: Sequence[str]) -> str | None:
    """Message about an unused file column with a name similar to that of an absent table column; None if there is none.

    `names` are those of all columns of the file.
    """
    there = {s.column.name for s in layout.columns}
    absent = [c for c in layout.table.columns() if c.name not in there]
    known = {name: c.name for c in absent for name in spellings(c, layout.table) if len(name) > 3}
    used = {s.name for s in layout.columns}
    for name in [name for name in names if name not in used][:COMPARED]:
        if plain_name(name) not in known:
            near = get_close_matches(plain_name(name), list(known), n=1, cutoff=0.85)
            if near:
                return f"unknown column {name!r}; did you mean {near[0]!r}? Rename it, or leave it out"
    return None


@cache
def _sought(table: type[ColumnTable]) -> tuple[tuple[Column, Mapping[str, str], bool], ...]:
    """Columns of a table, each with its accepted names (and their units), and whether it is required."""
    return tuple((c, _spellings(c, table.NAME), _is_wanted(c, table.NAME)) for c in table.columns())


@cache
def _columns_by_name(table: type[ColumnTable]) -> Mapping[str, tuple[int, ...]]:
    """For each name that a file column can have, the indices of the table's columns that it can mean.

    Names of right and lower edges of boxes stand for width and height.
    """
    out: dict[str, tuple[int, ...]] = {}
    for number, (column, known, _) in enumerate(_sought(table)):  # type: ignore[arg-type]
        edge, others = EDGES.get(column.name, ("", ()))
        for name in {*known, edge, *others}:
            out[name] = (*out.get(name, ()), number)
    return out


def _find(column: Column, there: Mapping[str, str], known: Mapping[str, str]) -> Spelling | None:
    found = [Spelling(column, there[name], unit) for name, unit in known.items() if name in there]
    if len(found) > 1:
        # The table's own name states it, whatever else could
        own = [s for s in found if plain_name(s.name) == column.name]
        if not own:
            raise InputError(
                f"columns {' and '.join(s.name for s in found)} both state {column.name}; keep one",
                id="conflicting-values",
            )
        found = own
    if column.name in EDGES:
        name, others = EDGES[column.name]
        edges = [Spelling(column, there[n], "", edge=True) for n in dict.fromkeys((name, *others)) if n in there]
        if found and edges:
            return found[0]._replace(far=edges[0].name)
        found = found or edges
    return found[0] if found else None


def _is_wanted(column: Column, table: str) -> bool:
    """Whether a file must have a column of the table named `table`.

    It need not if the column is optional, may be NaN, or has a default (`FILLED`), except for columns in `WANTED`.
    """
    if column.name in WANTED.get(table, ()):
        return True
    may_lack = column.optional or column.nan is not None or column.name in FILLED.get(table, {})
    return not may_lack


def _check_case(layout: TableLayout, names: Sequence[str]) -> None:
    """InputError if the file has two columns of one name, up to case, brackets of units and so on, and it is used."""
    used = {plain_name(name) for name in layout.names}
    first: dict[str, str] = {}
    for name in names:
        low = plain_name(name)
        if low in used and low in first:
            raise InputError(
                f"columns {first[low]!r} and {name!r} are read as the same name; keep one", id="duplicate-name"
            )
        first.setdefault(low, name)


def _check_angles(layout: TableLayout, there: Mapping[str, str]) -> None:
    # A table of ours that went through another program states no unit at all
    stated = TIME not in there or any(s.column.unit == "rad" and s.unit for s in layout.columns)
    for s in layout.columns:
        if s.column.unit == "rad" and not s.unit and stated:
            raise InputError(
                f"column {s.name} does not state its unit; name it {s.name}_deg or {s.name}_rad, "
                f"or give {option('input_units')} {s.name}=deg",
                id="missing-unit",
            )
        if _is_time_difference(s.column) and not s.unit and TIME not in there:
            raise InputError(
                f"column {s.name} does not state its unit; name it {s.name}_s, {s.name}_us or {s.name}_m, "
                f"or give {option('input_units')} {s.name}=us",
                id="missing-unit",
            )


def _check_lengths(layout: TableLayout) -> None:
    lengths = [s for s in layout.columns if s.column.unit in POWERS]
    for s in lengths:
        if s.unit != lengths[0].unit:
            first = lengths[0]
            bare = next((each for each in (first, s) if not each.unit), None)
            if bare is None:
                similar = [each.column.name + ending(each.column, "m") for each in (first, s)]
            else:
                # A name without a unit next to one with it: the same unit is meant, or it must be stated
                unit = first.unit or s.unit
                similar = [e.name + ending(e.column, unit) if e is bare else e.name for e in (first, s)]
            raise InputError(
                (f"column {bare.name} does not state its unit: " if bare is not None else "")
                + f"columns {first.name} and {s.name} have different units; use one unit for all lengths "
                f"({', '.join(similar)})",
                id="conflicting-values",
            )
