"""Places of readers: a text table with the columns reader, x, y, and perhaps z, range and power."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from occlog.io.files.names.sensors import safe_name
from occlog.io.files.texts.formats import LENGTH, TEXT, Column, Format, read_format
from occlog.records.scene import Reader

FORMAT = Format(
    "a table of readers",
    {
        "reader": Column(("reader", "name", "sensor", "anchor", "gateway"), TEXT),
        "x": Column(("x", "x_m"), LENGTH),
        "y": Column(("y", "y_m"), LENGTH),
        "z": Column(("z", "z_m"), default=0.0),
        "range": Column(("range", "range_m", "radius"), above=0.0, default=math.inf),
        "power": Column(("power", "power_dbm", "rssi_1m"), default=math.nan),
    },
)


def read_readers(path: Path) -> tuple[Reader, ...]:
    """Read the readers of a scene, in the order of the table.

    An empty cell of range or power stands for a reader of which it is not known.

    Raises:
        InputError: a column is missing, a name stands twice, a range is not above 0.
    """
    found: dict[str, Reader] = {}
    for part in read_format(path, FORMAT):
        place = np.column_stack([part[axis] for axis in "xyz"])
        for row, cell in enumerate(part["reader"].tolist()):
            name = safe_name(cell)
            if name in found:
                raise part.rows.fail(row, f"reader {name} is there twice; give every reader its own name")
            power = float(part["power"][row])
            reach, known = float(part["range"][row]), None if math.isnan(power) else power
            found[name] = Reader(name, place[row], range=reach, power=known)
    return tuple(found.values())
