"""Classes of MOTChallenge truth: which true boxes are pedestrians that count, and which are of something else.

The truth of MOT16, MOT17 and MOT20 has two columns after the box and the mark: class and visible share.  That of MOT15
has none, but three of a position in the world.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Ints
from occlog.io.files.texts.csv_rows import Rows, read_plain

PEDESTRIAN = 1
CLASSES = 13
"""Classes are numbered from 1 to so many."""
DISTRACTORS = {"mot17": (2, 7, 8, 12), "mot20": (2, 6, 7, 8, 12)}
"""Person on a vehicle, static person, distractor, reflection, and in MOT20 vehicles without a motor: whoever tracks one
of these is neither right nor wrong.  MOT16 has the rule of MOT17."""
WITH_CLASSES = (8, 9)
"""Columns of a truth with classes, with and without the visible share."""
WHAT = "MOTChallenge truth"


class Marks(NamedTuple):
    """What the truth says of each of its n boxes beside the place."""

    frame: Ints  # (n,) from 0
    target_id: Ints  # (n,)
    counts: Bools  # (n,) its mark is not 0
    kind: Ints  # (n,) class, 1 to `CLASSES`


def has_classes(path: Path) -> bool:
    """Whether a truth has a column of classes; InputError for a file without a line of data."""
    return len(next(read_plain(path, WHAT)).cells) in WITH_CLASSES


def read_marks(path: Path) -> Marks:
    """Marks and classes of a truth that has classes; InputError with the line of a class that cannot be."""
    parts = [_marks(rows) for rows in read_plain(path, WHAT)]
    return Marks._make(np.concatenate(column) for column in zip(*parts, strict=True))


def _marks(rows: Rows) -> Marks:
    kind = rows.ints("7")
    bad = (kind < 1) | (kind > CLASSES)
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise rows.fail(
            row,
            f"class {kind[row]}; they are 1 to {CLASSES}; correct it, or say that the truth has no classes (benchmark "
            "mot15)",
        )
    return Marks(rows.ints("0") - 1, rows.ints("1"), rows.floats("6") != 0, kind)
