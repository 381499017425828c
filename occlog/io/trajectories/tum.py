"""TUM text: lines `t x y z qx qy qz qw` of one target, in seconds; attitudes are not used."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from occlog.errors import InputError
from occlog.io.files.texts.csv_rows import Rows, read_plain

SUFFIX = ".tum"
NAMES = ("time", "x", "y", "z")
COLUMNS = 8
WHAT = "a trajectory in TUM text"
UNIT = 1e-3
"""How far the length of the quaternion of a first line may be from 1, so that the text is known as TUM's."""


def looks_like_tum(head: Sequence[str]) -> bool:
    """Whether a first line has eight numbers, of which the last four are a rotation."""
    if len(head) != COLUMNS:
        return False
    try:
        values = [float(cell) for cell in head]
    except ValueError:
        return False
    return abs(math.hypot(*values[4:]) - 1.0) <= UNIT


def read_tum(path: Path) -> Iterator[Rows]:
    """Rows with the columns `NAMES`; InputError for a text of another number of columns."""
    for rows in read_plain(path, WHAT):
        if len(rows.cells) != COLUMNS:
            raise InputError(f"{path}: {len(rows.cells)} columns; TUM text has {COLUMNS}: t x y z qx qy qz qw")
        yield replace(rows, cells=dict(zip(NAMES, rows.cells.values(), strict=False)))
