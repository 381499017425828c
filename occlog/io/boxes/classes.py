"""Classes of boxes: those that are wanted, and what there is."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np

from occlog.array_types import Bools
from occlog.errors import InputError
from occlog.io.files.texts.csv_rows import Rows

from .columns import CLASS_KEYS


def class_labels(rows: Rows) -> list[tuple[str, ...]]:
    """All that a row says of its class, in small letters, numbers without fraction: `("0", "person")`."""
    columns = []
    for key in CLASS_KEYS:
        if rows.has(key):
            names, inverse = np.unique(rows.cells[key], return_inverse=True)
            columns.append(np.array([_plain(str(name)) for name in names])[inverse].tolist())
    return [tuple(sorted(set(cells) - {""})) for cells in zip(*columns, strict=True)] if columns else []


def _plain(cell: str) -> str:
    text = cell.strip().lower()
    try:
        value = float(text)
    except ValueError:
        return text
    return str(int(value)) if math.isfinite(value) and value == int(value) else text


def wanted_rows(rows: Rows, classes: Sequence[str]) -> Bools:
    """(n,) rows of one of the classes; InputError where the file does not say of what class its boxes are."""
    labels = class_labels(rows)
    if not labels and len(rows):
        raise InputError(
            f"{rows.path}: does not say of what class its boxes are; choose no class, or add a column class"
        )
    wanted = {_plain(name) for name in classes}
    return np.array([bool(wanted & set(label)) for label in labels], dtype=np.bool_)


def in_words(classes: Counter[tuple[str, ...]]) -> str:
    """Classes and how many boxes they have: `0 person (12), 2 car (3)`."""
    return ", ".join(f"{' '.join(label) or 'none'} ({count})" for label, count in sorted(classes.items()))


def check_classes(
    where: str, wanted: Sequence[str], kept: Counter[tuple[str, ...]], all_: Counter[tuple[str, ...]]
) -> None:
    """Raise InputError where boxes of several classes would be taken for people, or none is of a wanted class."""
    if wanted and all_ and not kept:
        numbered = all(name.isdigit() for label in all_ for name in label)
        hint = "; here classes have numbers only: give the number" if numbered else ""
        raise InputError(f"{where}: no box is of class {', '.join(wanted)}; there are {in_words(all_)}{hint}")
    if not wanted and len(all_) > 1:
        raise InputError(f"{where}: boxes of {len(all_)} classes: {in_words(all_)}; choose the class of people")
