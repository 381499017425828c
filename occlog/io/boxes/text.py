"""Boxes in text tables: CSV with a header line, and MOTChallenge text without one.

A MOTChallenge file holds one camera and has the columns frame (from 1), id, left, top, width, height, confidence; then
class and visible share (truth of MOT16 to MOT20), or a place in the world that is not used.  -1 stands for what is not
known.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from occlog.errors import InputError
from occlog.io.files.texts.csv_rows import Rows, read_plain, read_rows

from .columns import BOX, CLASS_KEYS, COLUMNS, EDGES, IGNORED, WHAT, BoxSource, Wanted, check_columns
from .mot_classes import WITH_CLASSES

MOT_COLUMNS = ("frame", "id", "left", "top", "width", "height", "confidence")
_EDGE = re.compile(r"['\"](x1|y1|x2|y2|x3)['\"]\s*:\s*([^,}\s]+)")


def open_csv(path: Path, wanted: Wanted) -> BoxSource:
    """Boxes of a table with a header line; the table names its cameras unless the camera is stated."""
    return BoxSource(_csv(path, wanted.camera, wanted.ignore_extra), "CSV")


def _csv(path: Path, camera: str | None, ignore_extra: bool) -> Iterator[Rows]:
    known = {**COLUMNS, **CLASS_KEYS, BOX: (BOX,)}
    for rows in read_rows(path, known, WHAT, ignored=IGNORED, ignore_extra=ignore_extra):
        yield check_columns(_split_box(rows), camera)


def _split_box(rows: Rows) -> Rows:
    """The rows with edges of their own, where one column has them all."""
    if not rows.has(BOX) or rows.has("left"):
        return rows
    cells: dict[str, list[str]] = {name: [] for name in EDGES.values()}
    for n, text in enumerate(rows.cells[BOX]):
        found = dict(_EDGE.findall(str(text)))
        if set(found) != set(EDGES):
            raise rows.fail(n, f"box is {str(text)[:60]!r}; want {{'x1': ..., 'y1': ..., 'x2': ..., 'y2': ...}}")
        for edge, name in EDGES.items():
            cells[name].append(found[edge])
    return replace(rows, cells={**rows.cells, **{name: np.array(column) for name, column in cells.items()}})


def open_mot(path: Path, wanted: Wanted) -> BoxSource:
    """Boxes of MOTChallenge text."""
    if wanted.camera is None:
        raise InputError(f"{path}: a MOTChallenge file holds one camera and does not name it; give CAMERA={path.name}")
    return BoxSource(_mot(path), "MOTChallenge text", first_number=1)


def _mot(path: Path) -> Iterator[Rows]:
    for rows in read_plain(path, WHAT):
        columns = list(rows.cells.values())
        if not 7 <= len(columns) <= 10:
            raise InputError(
                f"{path}: {len(columns)} columns; MOTChallenge has 7 to 10 "
                "(frame,id,left,top,width,height,confidence,x,y,z), other tables need a header line"
            )
        cells = dict(zip(MOT_COLUMNS, columns, strict=False))
        if len(columns) in WITH_CLASSES:
            cells["class:class"] = columns[7]
        yield replace(rows, cells=cells)
