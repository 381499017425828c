"""Points of the world that were marked in images: a text table with camera, u, v, x, y and perhaps z."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError
from occlog.io.files.names import match_sensor
from occlog.io.files.texts.formats import LENGTH, TEXT, FormatColumn, TextFormat, read_format

MARKED_POINTS = TextFormat(
    "a table of marked points",
    {
        "camera": FormatColumn(("camera", "sensor", "view", "cam"), TEXT),
        "u": FormatColumn(("u", "u_px"), unit="px"),
        "v": FormatColumn(("v", "v_px"), unit="px"),
        "x": FormatColumn(("x", "x_m"), LENGTH),
        "y": FormatColumn(("y", "y_m"), LENGTH),
        "z": FormatColumn(("z", "z_m"), LENGTH, default=0.0),
    },
)


def read_marked_points(path: Path, cameras: Sequence[str]) -> dict[str, tuple[Floats, Floats]]:
    """Read points that were marked in images: by camera their pixels (n, 2) and world positions (n, 3) [scene unit].

    z is 0 if the table has no such column.

    Raises:
        InputError: a column is missing, a cell is not a number, or a camera is none of `cameras` (names).
    """
    found: dict[str, list[Floats]] = {}
    for part in read_format(path, MARKED_POINTS):
        rows = np.column_stack([part[name] for name in "uvxyz"])
        for name in dict.fromkeys(part["camera"].tolist()):
            found.setdefault(match_sensor(name, cameras, str(path)), []).append(rows[part["camera"] == name])
    if not found:
        raise InputError(f"{path}: holds no points; give four or more for each camera", id="empty-input")
    every = {name: np.concatenate(parts) for name, parts in found.items()}
    return {name: (rows[:, :2], rows[:, 2:]) for name, rows in every.items()}
