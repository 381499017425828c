"""Ground truth: positions on the ground, and boxes in the views.

Formats (`FORMATS`), found out from the content:

    csv        a header line with x, y and perhaps z, id, role, and a column of times or
               frame; or with left, top, ... as for detector boxes
    mot        MOTChallenge text: boxes, and positions where the last three columns are not -1
    xml        frames with objects and their boxes (xc, yc, w, h), as for the PETS data sets
    caliscope  triangulated board corners (xyz_*.csv): the mean of the corners seen throughout
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from occlog.errors import InputError, UsageError
from occlog.io.boxes.reader import COLUMNS as BOX_COLUMNS
from occlog.io.boxes.reader import BoxFile, read_boxes, survey_boxes
from occlog.io.files.csv_rows import first_line, is_header, read_plain, read_rows
from occlog.io.files.inputs import check_input
from occlog.records.tables import Truth, TruthBoxes

from .board import read_board
from .positions import COLUMNS, TruthOptions, csv_positions, gather, mot_positions
from .xml_boxes import read_xml_boxes

WHAT = "ground truth"


class TruthFormat(NamedTuple):
    """One format of ground truth."""

    detect: Callable[[list[str]], bool]
    read: Callable[[Path, TruthOptions], Iterator[Truth | TruthBoxes]]
    doc: str


def read_truth(path: Path, options: TruthOptions) -> Iterator[Truth | TruthBoxes]:
    """Tables of the truth in a file; InputError or UsageError where it cannot be understood."""
    check_input(path, WHAT)
    name = options.format
    if name == "auto":
        name = _detect(path)
    if name not in FORMATS:
        raise UsageError(f"truth format {name!r} is not known; known: auto, {', '.join(FORMATS)}")
    return FORMATS[name].read(path, options)


def _detect(path: Path) -> str:
    head = first_line(path, WHAT)
    for name, entry in FORMATS.items():
        if entry.detect([cell.lower() for cell in head]):
            return name
    raise InputError(
        f"{path}: not ground truth of a known format ({', '.join(FORMATS)}); name its columns in a header line"
    )


def _one_camera(path: Path, options: TruthOptions) -> str:
    """The camera whose boxes a file holds."""
    if options.camera is not None:
        return options.camera
    if len(options.cameras) == 1:
        return options.cameras[0]
    raise UsageError(f"{path}: holds boxes of one camera and does not name it; give it as CAMERA={path.name}")


def _read_boxes(path: Path, options: TruthOptions, camera: str | None) -> Iterator[TruthBoxes]:
    files = [BoxFile(path, camera)]
    # In ground truth a confidence of 0 marks boxes that do not count.
    how = replace(options.boxes, drop_zero=True)
    survey = survey_boxes(files, options.cameras, how)
    times = {**survey.times, **options.times}
    yield from read_boxes(files, survey, times, options.cameras, how, TruthBoxes)


def _read_csv(path: Path, options: TruthOptions) -> Iterator[Truth | TruthBoxes]:
    header = [cell.lower() for cell in first_line(path, WHAT)]
    if any(name in header for name in BOX_COLUMNS["left"]):
        named = any(name in header for name in BOX_COLUMNS["camera"])
        yield from _read_boxes(path, options, None if named else _one_camera(path, options))
        return
    parts = [
        csv_positions(rows, options) for rows in read_rows(path, COLUMNS, WHAT, ignore_extra=options.boxes.ignore_extra)
    ]
    yield gather(path, parts)


def _read_mot(path: Path, options: TruthOptions) -> Iterator[Truth | TruthBoxes]:
    camera = _one_camera(path, options)
    options = replace(options, camera=camera)
    parts = [p for rows in read_plain(path, WHAT) if (p := mot_positions(rows, options)) is not None]
    if parts:
        yield gather(path, parts)
    yield from _read_boxes(path, options, camera)


def _read_xml(path: Path, options: TruthOptions) -> Iterator[Truth | TruthBoxes]:
    camera = _one_camera(path, options)
    if camera not in options.times:
        raise UsageError(f"{path}: counts frames, and nothing says when they were taken; give the frame rate")
    return read_xml_boxes(path, camera, options.times, options.boxes)


def _read_caliscope(path: Path, options: TruthOptions) -> Iterator[Truth | TruthBoxes]:
    yield read_board(path, options.sync_ns)


def _is_table(head: list[str]) -> bool:
    return is_header(head) and any(name in head for name in (*COLUMNS["x"], *BOX_COLUMNS["left"]))


FORMATS: dict[str, TruthFormat] = {
    "xml": TruthFormat(lambda head: head[:1] != [] and head[0].startswith("<"), _read_xml, "frames of boxes (PETS)"),
    "caliscope": TruthFormat(lambda head: {"sync_index", "x_coord"} <= set(head), _read_caliscope, "board corners"),
    "csv": TruthFormat(_is_table, _read_csv, "CSV with a header"),
    "mot": TruthFormat(lambda head: not is_header(head) and 7 <= len(head) <= 10, _read_mot, "MOTChallenge"),
}
"""Every format of ground truth; the order is that of detection."""
