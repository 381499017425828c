"""Places of readers: a text table with the columns reader, x, y, and perhaps z, range and power."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError
from occlog.io.files.names.sensors import safe_name
from occlog.io.files.texts.csv_rows import Rows, read_rows
from occlog.records.scene import Reader

WHAT = "a table of readers"
COLUMNS: dict[str, Sequence[str]] = {
    "reader": ("reader", "name", "sensor", "anchor", "gateway"),
    "x": ("x", "x_m"),
    "y": ("y", "y_m"),
    "z": ("z", "z_m"),
    "range": ("range", "range_m", "radius"),
    "power": ("power", "power_dbm", "rssi_1m"),
}


def read_readers(path: Path) -> tuple[Reader, ...]:
    """Read the readers of a scene, in the order of the table.

    An empty cell of range or power stands for a reader of which it is not known.

    Raises:
        InputError: a column is missing, a name stands twice, a range is not above 0.
    """
    found: dict[str, Reader] = {}
    for rows in read_rows(path, COLUMNS, WHAT):
        missing = [name for name in ("reader", "x", "y") if not rows.has(name)]
        if missing:
            raise InputError(f"{path}: has no column {' and '.join(missing)}; {WHAT} has reader, x, y, z, range, power")
        place = np.column_stack([rows.lengths("x"), rows.lengths("y"), _numbers(rows, "z", 0.0)])
        far, power = _numbers(rows, "range", math.inf), _numbers(rows, "power", math.nan)
        for row, cell in enumerate(rows.cells["reader"].tolist()):
            if not cell.strip():
                raise rows.fail(row, "the reader has no name; give it one")
            name = safe_name(cell)
            if name in found:
                raise rows.fail(row, f"reader {name} is there twice; give every reader its own name")
            if not far[row] > 0.0:
                raise rows.fail(row, f"range of reader {name} is {far[row]:g}; it must be above 0, or empty")
            known = None if math.isnan(power[row]) else float(power[row])
            found[name] = Reader(name, place[row], range=float(far[row]), power=known)
    return tuple(found.values())


def _numbers(rows: Rows, name: str, absent: float) -> Floats:
    """(n,) numbers of a column that may be left out, as may its cells."""
    if not rows.has(name):
        return np.full(len(rows), absent)
    values = rows.floats(name, blank=True)
    return np.where(np.isnan(values), absent, values)
