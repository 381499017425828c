"""Positions of direction-finding stations in a text table, as a minimal scene."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError
from occlog.io.files.geodetic import (
    HEIGHTS,
    LATITUDES,
    LONGITUDES,
    has_heights,
    note_unused_heights,
    positions_on_earth,
)
from occlog.io.files.input_units import STATED
from occlog.io.files.names import safe_name
from occlog.io.files.texts.csv_rows import CsvRows, first_line, is_header, read_rows
from occlog.records.names import first_double
from occlog.records.scene import MAX_COORDINATE, MAX_SIGMA_DEG, MIN_SIGMA_DEG, MicrophoneArray, Scene
from occlog.settings import METRES

WHAT = "a table of stations"
NAMES = ("name", "station", "sensor", "array", "tower", "camera", "node", "anchor", "reader", "gateway", "id")
COLUMNS: dict[str, Sequence[str]] = {
    "name": NAMES,
    **{axis + ending: (axis + ending,) for axis in "xyz" for ending in ("", *(f"_{unit}" for unit in METRES))},
    "sigma_deg": ("sigma_deg",),
    "yaw_deg": ("yaw_deg",),
    **{name: (name,) for name in (*LATITUDES, *LONGITUDES, *HEIGHTS)},
}
MAX_YAW_DEG = 360.0


def holds_stations(path: Path) -> bool:
    """Whether a text file has a header line with columns of names and of positions; False if it cannot be read."""
    try:
        header = {cell.lower() for cell in first_line(path, WHAT)}
    except InputError:
        return False
    columns = {name for name in header if name in COLUMNS and name[0] in "xy"}
    placed = len(columns) >= 2 or (bool(header & set(LATITUDES)) and bool(header & set(LONGITUDES)))
    return is_header(list(header)) and bool(header & set(NAMES)) and placed


def header_of_table(path: Path) -> list[str]:
    """Column names in the first line of a text table; empty for other texts, such as YAML."""
    try:
        header = first_line(path, WHAT)
    except InputError:
        return []
    return list(header) if len(header) > 1 and is_header(header) and all(cell.isidentifier() for cell in header) else []


def check_stations(path: Path) -> None:
    """InputError if a table of stations has a repeated column, or positions in several units."""
    header = [cell.lower() for cell in first_line(path, WHAT)]
    if (double := first_double(header)) is not None:
        raise InputError(
            f"{path}: line 1: two columns are called {double!r}; remove or rename one", id="duplicate-name"
        )
    units = {name.partition("_")[2] for name in header if name in COLUMNS and name[0] in "xyz"}
    if len(units) > 1:
        raise InputError(f"{path}: positions are in {_several(units)}; state all in one unit", id="unit-mismatch")


def occurs_twice(path: Path) -> bool:
    """Whether a name occurs in several rows of a table, as the identity of a track does, so that rows are not stations.

    Only the first chunk of rows is examined.
    """
    for rows in read_rows(path, COLUMNS, WHAT, ignore_extra=True):
        return len(set(rows.cells["name"].tolist())) < len(rows)
    return False


def _several(units: Iterable[str]) -> str:
    """Units joined by "and" for a message; an empty one is "no stated unit"."""
    return " and ".join(sorted(unit or "no stated unit" for unit in units))


def read_stations(path: Path) -> Scene:
    """Read a scene of direction-finding stations (as microphone arrays) from a text table: name, x, y, perhaps z.

    Names of position columns end in the unit (`x_m`, `y_m`), or are in metres. Without a column z, stations measure no
    elevation. Geodetic positions (`latitude`, `longitude`, perhaps `altitude`) require the origin that the user states.
    `sigma_deg` is the standard deviation of directions that come without one (default 3 degrees), `yaw_deg` the azimuth
    of a station's own x axis (default 0).

    Raises:
        InputError: a column is missing, units differ, or a name occurs twice.
    """
    found: dict[str, MicrophoneArray] = {}
    unit = "m"
    for rows in read_rows(path, COLUMNS, WHAT):
        rows = _in_the_scene(rows)
        spelled = {axis: _spelled(rows, axis) for axis in "xyz"}
        missing = [name for name in ("x", "y") if spelled[name] is None]
        if missing or not rows.has("name"):
            lacking = [*missing, *([] if rows.has("name") else ["name"])]
            raise InputError(
                f"{path}: has no column {' and '.join(lacking)}; {WHAT} has name, x, y, perhaps z, sigma_deg, yaw_deg",
                id="missing-column",
            )
        units = {_unit(name, path) for name in spelled.values() if name is not None}
        if len(units) > 1:
            raise InputError(f"{path}: positions are in {_several(units)}; state all in one unit", id="unit-mismatch")
        unit = units.pop()
        position = np.column_stack([_numbers(rows, spelled[axis]) for axis in "xyz"])
        sigma = rows.floats("sigma_deg") if rows.has("sigma_deg") else None
        yaw = rows.floats("yaw_deg") if rows.has("yaw_deg") else np.zeros(len(rows))
        for row, cell in enumerate(rows.cells["name"].tolist()):
            if not cell.strip():
                raise rows.fail(row, "the station has no name; give it one")
            name = safe_name(cell)
            if name in found:
                raise rows.fail(row, f"station {name} is there twice; give every station its own name")
            if sigma is not None and not MIN_SIGMA_DEG <= sigma[row] <= MAX_SIGMA_DEG:
                limits = f"above 0, from {MIN_SIGMA_DEG:g} to {MAX_SIGMA_DEG:g}"
                raise rows.fail(row, f"sigma_deg of station {name} is {sigma[row]:g}; it must be {limits}")
            if (far := float(np.abs(position[row]).max())) > MAX_COORDINATE:
                raise rows.fail(row, f"station {name} is {far:g} away; it must be within {MAX_COORDINATE:g}")
            if not abs(yaw[row]) <= MAX_YAW_DEG:
                raise rows.fail(row, f"yaw_deg of station {name} is {yaw[row]:g}; it must be within {MAX_YAW_DEG:g}")
            turn = math.radians(float(yaw[row]))
            station = MicrophoneArray(name, position[row], turn, planar=spelled["z"] is None)
            found[name] = station if sigma is None else replace(station, sigma=math.radians(float(sigma[row])))
    return Scene(arrays=tuple(found.values()), length_unit=unit)


def _in_the_scene(rows: CsvRows) -> CsvRows:
    """Copy of the rows with columns `x_m`, `y_m` (and `z_m`) computed from geodetic positions.

    Unchanged without these.
    """
    latitude, longitude, height = (
        next((name for name in names if rows.has(name)), None) for names in (LATITUDES, LONGITUDES, HEIGHTS)
    )
    if latitude is None or longitude is None or any(_spelled(rows, axis) is not None for axis in "xy"):
        return rows
    degrees = np.column_stack([rows.floats(longitude), rows.floats(latitude)])
    heights = rows.floats(height) if height is not None and has_heights() else None
    xyz = positions_on_earth(degrees, heights, str(rows.path))
    if height is not None:
        note_unused_heights(str(rows.path))
    axes = "xyz" if heights is not None else "xy"
    cells = {f"{axis}_m": np.array([repr(v) for v in xyz[:, n].tolist()]) for n, axis in enumerate(axes)}
    return replace(rows, cells={**rows.cells, **cells})


def _unit(name: str, path: Path) -> str:
    """Length unit of a position column: in its name, or as the user states; else m."""
    reported = name.partition("_")[2]
    STATED.get().note_use(name, "length", reported, path)
    return STATED.get().unit_of(name, "length", reported, path) or "m"


def _spelled(rows: CsvRows, axis: str) -> str | None:
    """Name of the column of an axis (`x`, `y`, `z`), with any unit suffix; None if missing, InputError for two."""
    found = [name for name in COLUMNS if name.partition("_")[0] == axis and rows.has(name)]
    if len(found) > 1:
        raise InputError(
            f"{rows.path}: columns {' and '.join(found)} both state {axis}; keep one", id="conflicting-values"
        )
    return found[0] if found else None


def _numbers(rows: CsvRows, name: str | None) -> Floats:
    return np.zeros(len(rows)) if name is None else rows.lengths(name)
