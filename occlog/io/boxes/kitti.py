"""KITTI's text of tracked boxes in the images of one camera.

A line is frame (from 0), identity, type, truncated, occluded, alpha, left, top, right, bottom, height, width and length
of the object, its place and turn in the camera's frame, and perhaps a score.  What is not in the image is not used, nor
are regions of the type `DontCare`, of which nobody said what they hold.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from occlog.errors import InputError
from occlog.io.files.texts.csv_rows import Rows, text_lines

from .columns import BoxSource, Wanted, rows_of

ROWS_PER_CHUNK = 16_384
COLUMNS = 17
"""Without the score."""
NAMES = {0: "frame", 1: "id", 2: "class:label", 6: "left", 7: "top", 8: "right", 9: "bottom", 17: "confidence"}
TYPE = 2
DONT_CARE = "DontCare"


def is_kitti(head: Sequence[str]) -> bool:
    """Whether a first line is of this form: numbers, but for the type."""
    if len(head) not in (COLUMNS, COLUMNS + 1) or not head[TYPE].isalpha():
        return False
    try:
        [float(cell) for n, cell in enumerate(head) if n != TYPE]
    except ValueError:
        return False
    return True


def open_kitti(path: Path, wanted: Wanted) -> BoxSource:
    """Boxes of one camera.

    Raises:
        InputError: the camera is not named.
    """
    if wanted.camera is None:
        raise InputError(f"{path}: KITTI's text holds one camera and does not name it; give CAMERA={path.name}")
    return BoxSource(_kitti(path), "KITTI text", first_number=0)


def _kitti(path: Path) -> Iterator[Rows]:
    records: list[tuple[int, dict[str, str]]] = []
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        for number, line in text_lines(path, file):
            cells = line.split()
            if not cells or cells[TYPE : TYPE + 1] == [DONT_CARE]:
                continue
            if len(cells) not in (COLUMNS, COLUMNS + 1):
                raise InputError(
                    f"{path}: line {number}: {len(cells)} columns; KITTI's text of tracks has {COLUMNS}, and perhaps "
                    "a score"
                )
            records.append((number, {name: cells[n] for n, name in NAMES.items() if n < len(cells)}))
            if len(records) == ROWS_PER_CHUNK:
                yield rows_of(path, records, "line", ())
                records = []
    if records:
        yield rows_of(path, records, "line", ())
