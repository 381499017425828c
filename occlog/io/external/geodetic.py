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
    """Names of columns with geodetic positions.

    Attributes:
        latitude: of the column [deg].
        longitude: of the column [deg].
        height: of the column [m]; empty: there is none, or it is not used.
        unused: of a column of heights that is not used, since the origin states none.
    """

    latitude: str
    longitude: str
    height: str
    unused: str = ""

    @property
    def names(self) -> list[str]:
        """Names of the file's columns that positions are computed from."""
        return [name for name in self[:3] if name]

    def replaced(self, names: Sequence[str]) -> tuple[str, ...]:
        """Column names of a table, with geodetic ones replaced by those of positions in the scene."""
        ours = {self.longitude: X, self.latitude: Y, self.height: Z}
        return tuple(ours.get(name, name) if name else name for name in names)

    def read(self, names: Sequence[str]) -> list[str]:
        """Columns of the file that are needed for the table columns `names`."""
        own = [name for name in names if name not in POSITION]
        return [*own, *(name for name in self.names if name not in own)] if len(own) < len(names) else own


def geodetic_columns(names: Sequence[str]) -> GeodeticColumns | None:
    """Geodetic columns of a table with the columns `names`; None if missing, or if it has positions in the scene.

    Heights are used only if the origin states its own height.
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
    """Cells of a table with geodetic positions."""

    def __init__(self, path: Path, cells: TableCells, columns: GeodeticColumns) -> None:
        """Wrap the cells of a file with latitudes and longitudes in `columns`."""
        self._path, self._cells, self._columns = path, cells, columns
        self._xyz: Floats | None = None

    def __len__(self) -> int:
        """Number of rows."""
        return len(self._cells)

    def floats(self, name: str, *, blank: bool) -> Floats:
        """(n,) numbers of the column `name`; x, y and z are converted from geodetic positions to the scene [m].

        `blank`: empty cells are NaN rather than an error.
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
        """(n,) resolution of each number, where it may be coarse; of positions in metres."""
        if name not in POSITION:
            return self._cells.steps(name)
        if name == Z:
            return self._cells.steps(self._columns.height)
        return METRES_PER_DEGREE * self._cells.steps(self._columns.latitude if name == Y else self._columns.longitude)

    def ints(self, name: str, *, blank: int | None) -> Ints:
        """(n,) whole numbers; `blank` for cells that are empty; None: none may be."""
        return self._cells.ints(name, blank=blank)

    def texts(self, name: str, *, blank: bool) -> Strings:
        """(n,) texts; empty ones only if `blank` allows them."""
        return self._cells.texts(name, blank=blank)

    def lists(self, name: str, width: int) -> Floats:
        """Return (n, width) numbers of a list column."""
        return self._cells.lists(name, width)

    def bools(self, name: str) -> Bools:
        """Return the (n,) booleans of a column."""
        return self._cells.bools(name)

    def times(self, name: str, unit: str) -> Ints:
        """Return the (n,) times of the column `name` [ns since the Unix epoch]; `unit` is that of its numbers."""
        return self._cells.times(name, unit)

    def raw(self, name: str) -> list[object]:
        """(n,) values as in the file; positions in the scene."""
        return list(self.floats(name, blank=True).tolist()) if name in POSITION else self._cells.raw(name)

    def fail(self, row: int, message: str) -> InputError:
        """InputError with a message and the position of a row."""
        return self._cells.fail(row, message)

    def part(self, start: int, stop: int) -> GeodeticCells:
        """Return the cells of the rows start <= row < stop."""
        return GeodeticCells(self._path, self._cells.part(start, stop), self._columns)
