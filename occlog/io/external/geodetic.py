"""Conversion of latitude, longitude and height columns of an external table to positions in the scene."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints, Strings
from occlog.errors import InputError
from occlog.io.files.geodetic import (
    HEIGHTS,
    LATITUDES,
    LONGITUDES,
    has_heights,
    note_unused_heights,
    positions_on_earth,
)

from .cells import TableCells
from .names import plain_name

METRES_PER_DEGREE = 111_320.0
X, Y, Z = POSITION = ("x_m", "y_m", "z_m")


class GeodeticColumns(NamedTuple):
    """Names of the columns of a table that hold geodetic positions (WGS 84).

    Attributes:
        latitude: name of the column of latitudes [deg].
        longitude: name of the column of longitudes [deg].
        height: name of the column of heights [m]; empty: there is none, or it is not used.
        unused: name of a column of heights that is not used, since the scene's origin states no height; empty: none.
    """

    latitude: str
    longitude: str
    height: str
    unused: str = ""

    @property
    def names(self) -> list[str]:
        """Names of the file's columns from which positions are computed."""
        return [name for name in self[:3] if name]

    def replaced(self, names: Sequence[str]) -> tuple[str, ...]:
        """Column names with those of longitude, latitude and height replaced by `x_m`, `y_m` and `z_m`."""
        ours = {self.longitude: X, self.latitude: Y, self.height: Z}
        return tuple(ours.get(name, name) if name else name for name in names)

    def read(self, names: Sequence[str]) -> list[str]:
        """Columns of the file that are needed for the columns `names`, of which `x_m`, `y_m` and `z_m` are computed."""
        own = [name for name in names if name not in POSITION]
        return [*own, *(name for name in self.names if name not in own)] if len(own) < len(names) else own


def geodetic_columns(names: Sequence[str]) -> GeodeticColumns | None:
    """Geodetic columns among the column names of a table; None without latitude or longitude, or if it has x or y.

    A column of heights is used only if the scene's origin, which the user states, has a height.
    """
    there = {plain_name(name): name for name in reversed(names)}
    latitude, longitude = (_first(there, known) for known in (LATITUDES, LONGITUDES))
    if not latitude or not longitude or any(name in ("x", "y") or name.startswith(("x_", "y_")) for name in there):
        return None
    height = _first(there, HEIGHTS)
    return GeodeticColumns(latitude, longitude, *((height, "") if has_heights() else ("", height)))


def _first(there: dict[str, str], known: Sequence[str]) -> str:
    return next((there[name] for name in known if name in there), "")


class GeodeticCells:
    """Cells of a table in which geodetic positions appear as columns `x_m`, `y_m` and `z_m` of scene positions.

    All other columns are those of the wrapped cells.
    """

    def __init__(self, path: Path, cells: TableCells, columns: GeodeticColumns) -> None:
        """Wrap the cells of the file `path`, which has latitudes and longitudes in `columns`."""
        self._path, self._cells, self._columns = path, cells, columns
        self._xyz: Floats | None = None

    def __len__(self) -> int:
        """Number of rows."""
        return len(self._cells)

    def floats(self, name: str, *, blank: bool) -> Floats:
        """(n,) numbers of a column; `x_m`, `y_m` and `z_m` are scene positions [m], computed from geodetic ones.

        Empty cells of other columns are NaN if `blank` is true, else an error; those of geodetic columns are always an
        error.
        """
        if name not in POSITION:
            return self._cells.floats(name, blank=blank)
        if self._xyz is None:
            columns = self._columns
            names = (columns.longitude, columns.latitude)
            degrees = np.column_stack([self._cells.floats(n, blank=False) for n in names])
            heights = self._cells.floats(columns.height, blank=False) if columns.height else None
            self._xyz = positions_on_earth(degrees, heights, str(self._path)) if len(degrees) else np.zeros((0, 3))
            if columns.unused:
                note_unused_heights(str(self._path))
        return self._xyz[:, POSITION.index(name)]

    def steps(self, name: str) -> Floats:
        """(n,) resolution of each number of a column, if coarse, else 0; that of degrees converted to metres."""
        if name not in POSITION:
            return self._cells.steps(name)
        if name == Z:
            return self._cells.steps(self._columns.height)
        return METRES_PER_DEGREE * self._cells.steps(self._columns.latitude if name == Y else self._columns.longitude)

    def ints(self, name: str, *, blank: int | None) -> Ints:
        """(n,) whole numbers of a column; `blank` replaces empty cells (None: empty cells are an error)."""
        return self._cells.ints(name, blank=blank)

    def texts(self, name: str, *, blank: bool) -> Strings:
        """(n,) texts of a column; empty cells are an error unless `blank` is true."""
        return self._cells.texts(name, blank=blank)

    def lists(self, name: str, width: int) -> Floats:
        """(n, width) numbers of a column of lists."""
        return self._cells.lists(name, width)

    def bools(self, name: str) -> Bools:
        """(n,) booleans of a column."""
        return self._cells.bools(name)

    def times(self, name: str, unit: str) -> Ints:
        """(n,) times of the column `name` [ns since the Unix epoch].

        An empty `unit` of numbers is inferred from their size.
        """
        return self._cells.times(name, unit)

    def raw(self, name: str) -> list[object]:
        """(n,) values of a column as in the file; of `x_m`, `y_m` and `z_m` the computed scene positions [m]."""
        return list(self.floats(name, blank=True).tolist()) if name in POSITION else self._cells.raw(name)

    def fail(self, row: int, message: str) -> InputError:
        """InputError, to be raised, with the file, the position of row `row` and a message."""
        return self._cells.fail(row, message)

    def part(self, start: int, stop: int) -> GeodeticCells:
        """The cells of the rows start <= row < stop."""
        return GeodeticCells(self._path, self._cells.part(start, stop), self._columns)
