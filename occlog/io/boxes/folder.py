"""YOLO text: a folder with one file a frame, as detectors of the YOLO family write it (Ultralytics' `save_txt`).

A line is a class, then the box's centre x, y, width and height in shares of the image, and perhaps a confidence and an
identity: `0 0.51 0.43 0.08 0.31 0.92 7`.  The last number in a file's name is that of the frame.  No file is written
for a frame in which nothing was found.  Where a line has a sixth number only, it is an identity if these are whole
numbers in the whole folder, else a confidence.  Key points of a pose (17 with x, y, visibility) are passed over.

A folder without such files stands for its subfolders: one a camera, the files in it or in `labels/`.  `classes.txt`
names the classes, one a line from 0.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from occlog.errors import InputError
from occlog.io.files.names.last_number import last_number
from occlog.io.files.names.sensors import natural_sorted
from occlog.io.files.texts.csv_rows import Rows
from occlog.io.files.untrusted.inputs import check_input

from .columns import SHARE_HEIGHT, SHARE_WIDTH, SHARE_X, SHARE_Y, BoxSource, Wanted, rows_of

ROWS_PER_CHUNK = 16_384
MAX_BYTES = 4 * 2**20
CLASS_NAMES = "classes.txt"
LABELS = "labels"
POSE = 51
"""Numbers of the 17 key points of a person, each with x, y and how visible it is."""
SLACK = 1e-3
"""By how much a share may pass 1: labels are written with few digits."""
Line = tuple[Path, int, int, list[str]]
"""File, line, number of the frame, and the numbers as text."""


def camera_folders(path: Path) -> dict[str | None, Path]:
    """The folder of labels of each camera; the key None: the folder itself is that of one camera.

    Raises:
        InputError: there is no file of labels.
    """
    own = _labels(path)
    if own is not None:
        return {None: own}
    found = {p.name: _labels(p) for p in sorted(path.iterdir()) if p.is_dir() and not p.name.startswith(".")}
    cameras: dict[str | None, Path] = {name: folder for name, folder in found.items() if folder is not None}
    if not cameras:
        raise InputError(f"{path}: holds no file of labels (NAME_12.txt or 000012.txt, one a frame); name their folder")
    return {name: cameras[name] for name in natural_sorted(str(n) for n in cameras)}


def _labels(folder: Path) -> Path | None:
    """The folder itself or its `labels`, whichever holds files of labels."""
    return next((p for p in (folder, folder / LABELS) if p.is_dir() and label_files(p)), None)


def label_files(folder: Path) -> list[Path]:
    """Files of labels in natural order."""
    names = [p.name for p in folder.iterdir() if p.suffix.lower() == ".txt" and p.name.lower() != CLASS_NAMES]
    return [folder / name for name in natural_sorted(n for n in names if last_number(Path(n).stem))]


def open_folder(path: Path, wanted: Wanted) -> BoxSource:
    """Boxes of a folder; it names its cameras unless the camera is stated."""
    camera = wanted.camera
    folders = camera_folders(path)
    if camera is None and None in folders:
        raise InputError(f"{path}: holds the labels of one camera and does not name it; give CAMERA={path.name}")
    if camera is not None and None not in folders:
        names = ", ".join(str(name) for name in folders)
        raise InputError(f"{path}: holds the labels of several cameras ({names}); give it without a camera")
    numbers = {name: _numbered(folder) for name, folder in folders.items()}
    listed = np.unique(np.array([n for files in numbers.values() for n in files], dtype=np.int64))
    named = tuple(str(name) for name in folders if name is not None)
    chunks = (rows for name, files in numbers.items() for rows in _camera(folders[name], name, files))
    return BoxSource(chunks, "YOLO text", listed, named)


def _numbered(folder: Path) -> dict[int, Path]:
    """The file of each frame, by rising number; InputError where two files have the same one."""
    found: dict[int, Path] = {}
    for file in label_files(folder):
        number = int(last_number(file.stem) or 0)
        if number in found:
            raise InputError(
                f"{file}: is frame {number}, as {found[number].name} is; keep the files of one recording in a folder"
            )
        found[number] = file
    return dict(sorted(found.items()))


def _camera(folder: Path, camera: str | None, files: dict[int, Path]) -> Iterator[Rows]:
    lines = [line for number, file in files.items() for line in _read(file, number)]
    if not lines:
        return
    tail = _tail(folder, lines)
    names = _class_names(folder)
    for start in range(0, len(lines), ROWS_PER_CHUNK):
        part = lines[start : start + ROWS_PER_CHUNK]
        records = []
        for _, line, frame, numbers in part:
            cells = {"frame": str(frame), "class:class": numbers[0], SHARE_X: numbers[1], SHARE_Y: numbers[2]}
            cells |= {SHARE_WIDTH: numbers[3], SHARE_HEIGHT: numbers[4]}
            cells |= dict(zip(tail if len(numbers) < 7 else ("confidence", "id"), numbers[5:], strict=False))
            cells |= {} if camera is None else {"camera": camera}
            cells |= {"class:name": names[numbers[0]]} if numbers[0] in names else {}
            records.append((line, cells))
        rows = rows_of(folder, records, "line", [file for file, *_ in part])
        _check_shares(rows)
        yield rows


def _read(file: Path, frame: int) -> list[Line]:
    """Lines of one file; it may be empty: looked, and saw nobody."""
    if file.is_file() and file.stat().st_size == 0:
        return []
    check_input(file, "labels of a frame")
    if file.stat().st_size > MAX_BYTES:
        raise InputError(f"{file}: {file.stat().st_size} bytes; labels of a frame were expected, at most {MAX_BYTES}")
    try:
        text = file.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{file}: byte {error.start}: not UTF-8 text; labels of a frame were expected") from None
    out: list[Line] = []
    seen: set[str] = set()
    for number, line in enumerate(text.splitlines(), start=1):
        cells = line.split()
        if not cells:
            continue
        if len(cells) - POSE in (5, 6, 7):
            cells = cells[:5] + cells[5 + POSE :]
        if len(cells) not in (5, 6, 7):
            raise InputError(
                f"{file}: line {number}: {len(cells)} numbers; want class, x, y, width, height and perhaps confidence "
                "and identity; outlines and turned boxes cannot be used: write boxes (detect)"
            )
        if " ".join(cells) in seen:
            raise InputError(
                f"{file}: line {number}: this box stands here twice; Ultralytics appends to the files of an earlier "
                "run: empty the folder and detect again"
            )
        seen.add(" ".join(cells))
        out.append((file, number, frame, cells))
    return out


def _tail(folder: Path, lines: list[Line]) -> tuple[str, ...]:
    """What the sixth number of a line is, where there is no seventh; InputError where that cannot be said."""
    counts = {len(numbers) for *_, numbers in lines}
    if 7 in counts:
        if 5 in counts:
            raise InputError(f"{folder}: has lines of 5 and of 7 numbers; write all in one way")
        return ("confidence",)
    last = [numbers[5] for *_, numbers in lines if len(numbers) == 6]
    if last and all(text.isascii() and text.isdigit() and text.strip("0") for text in last):
        return ("id",)
    if last and 5 in counts:
        raise InputError(f"{folder}: has lines with and without a confidence; write all in one way")
    return ("confidence",)


def names_of_classes(folder: Path) -> Path | None:
    """The file with the names of classes of a folder of labels: in it or in the one above; None: there is none."""
    return next((p for p in (folder / CLASS_NAMES, folder.parent / CLASS_NAMES) if p.is_file()), None)


def _class_names(folder: Path) -> dict[str, str]:
    """Names of classes by number; empty where there are none."""
    place = names_of_classes(folder)
    if place is None:
        return {}
    names = place.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    return {str(n): name.strip() for n, name in enumerate(names)}


def _check_shares(rows: Rows) -> None:
    """Raise InputError for a centre or size that is no share of the image."""
    for name in (SHARE_X, SHARE_Y, SHARE_WIDTH, SHARE_HEIGHT):
        values = rows.floats(name)
        bad = np.flatnonzero((values < -SLACK) | (values > 1 + SLACK))
        if len(bad):
            row = int(bad[0])
            raise rows.fail(
                row,
                f"{name.removeprefix('share_')} is {values[row]:g}; YOLO text counts in shares of the image, 0 to 1; "
                "pixels belong into a CSV (frame,left,top,width,height)",
            )
