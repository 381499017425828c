"""Text of the annotation tool VATIC, as of the CAMPUS data set: boxes of one view, with identities.

A line is identity, xmin, ymin, xmax, ymax, frame (from 0), lost, occluded, generated, and the label in quotes.  A box
that is lost is outside the view and left out; one that is occluded or interpolated is there.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from occlog.errors import InputError
from occlog.io.files.texts.csv_rows import Rows

from .columns import BoxSource, Wanted, rows_of

ROWS_PER_CHUNK = 16_384
NAMES = ("id", "left", "top", "right", "bottom", "frame")
_LINE = re.compile(r'^\s*((?:-?\d+(?:\.\d+)?\s+){6})([01])\s+([01])\s+([01])\s+"([^"]*)"(.*)$')


def is_vatic(head: Sequence[str]) -> bool:
    """Whether the first line of a text is of this form."""
    return _LINE.match(" ".join(head)) is not None


def open_vatic(path: Path, wanted: Wanted) -> BoxSource:
    """Boxes of one view.

    Raises:
        InputError: the camera is not named.
    """
    if wanted.camera is None:
        raise InputError(f"{path}: VATIC text holds one camera and does not name it; give CAMERA={path.name}")
    return BoxSource(_chunks(path), "VATIC text", first_number=0)


def _chunks(path: Path) -> Iterator[Rows]:
    records: list[tuple[int, dict[str, str]]] = []
    # Lines are by identity: they are brought into the order of frames
    for number, line in enumerate(path.read_text(encoding="utf-8-sig", errors="replace").splitlines(), start=1):
        if not line.strip():
            continue
        found = _LINE.match(line)
        if found is None:
            raise InputError(
                f'{path}: line {number}: want id xmin ymin xmax ymax frame lost occluded generated "label"'
            )
        if found[2] == "0":
            cells = dict(zip(NAMES, found[1].split(), strict=True))
            records.append((number, {**cells, "class:label": found[5]}))
    records.sort(key=lambda record: float(record[1]["frame"]))
    for start in range(0, len(records), ROWS_PER_CHUNK):
        yield rows_of(path, records[start : start + ROWS_PER_CHUNK], "line", ())
