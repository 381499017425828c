"""KITTI's text of tracked boxes in the images of one camera.

A line is frame (from 0), identity, type, truncated, occluded, alpha, left, top, right, bottom, height, width and length
of the object, its position and turn in the camera's frame, and perhaps a score.  What is not in the image is not used,
nor are regions of the type `DontCare`, with unspecified content.

Text of the annotation tool VATIC, as of the CAMPUS data set: boxes of one view, with identities.

A line is identity, xmin, ymin, xmax, ymax, frame (from 0), lost, occluded, generated, and the label in quotes.  A box
that is lost is outside the view and skipped; one that is occluded or interpolated is there.

WILDTRACK's annotations: a folder with one JSON file a frame, of people with a position and a box in each view.

    [{"personID": 122, "positionID": 456826,
      "views": [{"viewNum": 0, "xmin": 1510, "ymin": 139, "xmax": 1561, "ymax": 288}]}]

The number in a file's name is that of the frame (00000000, 00000005, ...).  View 0 is camera C1; -1 represents a view
in which the person is not.  A position p is a point of a grid: x = -3 m + 2.5 cm (p mod 480), y = -9 m + 2.5 cm (p div
480), on the floor.

YOLO text: a folder with one file a frame, as detectors of the YOLO family write it (Ultralytics' `save_txt`).

A line is a class, then the box's centre x, y, width and height in shares of the image, and perhaps a confidence and an
identity: `0 0.51 0.43 0.08 0.31 0.92 7`.  The last number in a file's name is that of the frame.  No file is written
for a frame in which nothing was found.  Where a line has a sixth number only, it is an identity if these are whole
numbers in the whole folder, else a confidence.  Key points of a pose (17 with x, y, visibility) are passed over.

A folder without such files represents its subfolders: one a camera, the files in it or in `labels/`.  `classes.txt`
names the classes, one a line from 0.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError
from occlog.io.files.limits import HIVE_CSV, bounded_text, check_input, folder_hint
from occlog.io.files.names import is_hidden, last_number, match_sensor, natural_sorted
from occlog.io.files.programs import refuse_unread
from occlog.io.files.texts.csv_rows import ROWS_PER_CHUNK, CsvRows, text_lines
from occlog.io.files.texts.documents import parse_json
from occlog.io.files.texts.formats import Probe, is_folder

from .columns import SHARE_HEIGHT, SHARE_WIDTH, SHARE_X, SHARE_Y, BoxReadOptions, BoxSource, chunks_of, rows_of

COLUMNS = 17
"""Without the score."""
KITTI_COLUMNS = {0: "frame", 1: "id", 2: "class:label", 6: "left", 7: "top", 8: "right", 9: "bottom", 17: "confidence"}
TYPE = 2
DONT_CARE = "DontCare"


def is_kitti(head: Sequence[str]) -> bool:
    """Whether the cells of a first line are those of KITTI's tracking text: 17 or 18, all numbers except the type."""
    if len(head) not in (COLUMNS, COLUMNS + 1) or not head[TYPE].isalpha():
        return False
    try:
        [float(cell) for n, cell in enumerate(head) if n != TYPE]
    except ValueError:
        return False
    return True


def open_kitti(path: Path, wanted: BoxReadOptions) -> BoxSource:
    """Open KITTI's tracking text (frames from 0) of the camera that `wanted` states.

    Raises:
        InputError: no camera is stated.
    """
    wanted.check_camera(path, "KITTI's text")
    return BoxSource(chunks_of(path, _kitti(path), "line"), "KITTI text", first_number=0)


def _kitti(path: Path) -> Iterator[tuple[int, dict[str, str]]]:
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        for number, line in text_lines(path, file):
            cells = line.split()
            if not cells or cells[TYPE : TYPE + 1] == [DONT_CARE]:
                continue
            if len(cells) not in (COLUMNS, COLUMNS + 1):
                raise InputError(
                    f"{path}: line {number}: {len(cells)} columns; KITTI's text of tracks has {COLUMNS}, and perhaps "
                    "a score",
                    id="unknown-format",
                )
            yield number, {name: cells[n] for n, name in KITTI_COLUMNS.items() if n < len(cells)}


VATIC_COLUMNS = ("id", "left", "top", "right", "bottom", "frame")
_LINE = re.compile(r'^\s*((?:-?\d+(?:\.\d+)?\s+){6})([01])\s+([01])\s+([01])\s+"([^"]*)"(.*)$')


def is_vatic(head: Sequence[str]) -> bool:
    """Whether the cells of a first line are those of VATIC text (six numbers, three flags, a label)."""
    # The label is in quotation marks, which cells do not have
    return len(head) > 9 and _LINE.match(" ".join([*head[:9], f'"{head[9].strip(chr(34))}"'])) is not None


def open_vatic(path: Path, wanted: BoxReadOptions) -> BoxSource:
    """Open VATIC text (frames from 0) of the camera that `wanted` states.

    Raises:
        InputError: no camera is stated.
    """
    wanted.check_camera(path, "VATIC text")
    return BoxSource(_vatic_chunks(path), "VATIC text", first_number=0)


def _vatic_chunks(path: Path) -> Iterator[CsvRows]:
    records: list[tuple[int, dict[str, str]]] = []
    # Lines are by identity: they are brought into the order of frames
    for number, line in enumerate(path.read_text(encoding="utf-8-sig", errors="replace").splitlines(), start=1):
        if not line.strip():
            continue
        found = _LINE.match(line)
        if found is None:
            raise InputError(
                f'{path}: line {number}: expected id xmin ymin xmax ymax frame lost occluded generated "label"'
            )
        if found[2] == "0":
            cells = dict(zip(VATIC_COLUMNS, found[1].split(), strict=True))
            records.append((number, {**cells, "class:label": found[5]}))
    records.sort(key=lambda record: float(record[1]["frame"]))
    yield from chunks_of(path, records, "line")


ACROSS, ALONG = 480, 1440
"""Points of the grid."""
ORIGIN, STEP = (-3.0, -9.0), 0.025
"""First point and spacing of the grid [m]."""
EDGES = {"xmin": "left", "ymin": "top", "xmax": "right", "ymax": "bottom"}
MAX_ANNOTATION_BYTES = 16 * 2**20
FRAMES_PER_CHUNK = 256


class AnnotatedPerson(NamedTuple):
    """A person of WILDTRACK in one frame: number in the file, identity, number of the grid point, box edges by view.

    Edges are texts [px] by `left`, `top`, `right` and `bottom`; empty in a view in which the person is not.
    """

    entry: int
    identity: int
    position: int
    views: dict[int, dict[str, str]]


def frame_files(folder: Path) -> dict[int, Path]:
    """JSON file of each frame in a folder, by frame number (the last number in its name), sorted; empty without any.

    InputError if two files have one number.
    """
    names = [
        p.name for p in folder.iterdir() if p.suffix.lower() == ".json" and not is_hidden(p) and last_number(p.stem)
    ]
    found: dict[int, Path] = {}
    for name in natural_sorted(names):
        number = int(last_number(Path(name).stem) or 0)
        if number in found:
            raise InputError(
                f"{folder / name}: has frame number {number}, as {found[number].name} has; keep one", id="duplicate-row"
            )
        found[number] = folder / name
    return dict(sorted(found.items()))


def is_annotations(probe: Probe) -> bool:
    """Whether a folder holds annotations as those of WILDTRACK: JSON files with frame numbers in their names."""
    return is_folder(probe) and bool(frame_files(probe.path))


def open_annotations(path: Path, wanted: BoxReadOptions) -> BoxSource:
    """Open the boxes in WILDTRACK's annotations, with the identities of the people; view 0 is camera C1.

    Args:
        path: folder with a JSON file for each frame.
        wanted: names the known cameras, of which boxes are read; of all views if it names none.
    """
    known = wanted.known
    files = frame_files(path)
    listed = np.array(list(files), dtype=np.int64)
    first = read_people(next(iter(files.values())))
    named = {view: f"C{view + 1}" for view in sorted({view for person in first for view in person.views})}
    cameras = {view: name for view, name in named.items() if not known or _is_known(name, known)}
    kind = "WILDTRACK's annotations"
    names = tuple(cameras.values())
    return BoxSource(_wildtrack_chunks(path, files, cameras), kind, dict.fromkeys(names, listed), names)


def _is_known(name: str, known: Sequence[str]) -> bool:
    try:
        match_sensor(name, known, "")
    except InputError:
        return False
    return True


def _wildtrack_chunks(path: Path, files: dict[int, Path], cameras: Mapping[int, str]) -> Iterator[CsvRows]:
    numbers = list(files)
    for start in range(0, len(numbers), FRAMES_PER_CHUNK):
        records, sources = [], []
        for frame in numbers[start : start + FRAMES_PER_CHUNK]:
            for person in read_people(files[frame]):
                for view, edges in person.views.items():
                    if edges and view in cameras:
                        cells = {"frame": str(frame), "camera": cameras[view], "id": str(person.identity), **edges}
                        records.append((person.entry, cells))
                        sources.append(files[frame])
        if records:
            yield rows_of(path, records, "person", sources)


def read_people(file: Path) -> list[AnnotatedPerson]:
    """Read the people in WILDTRACK's annotation file of one frame.

    Raises:
        InputError: the file is not of this form.
    """
    check_input(file, "annotations of a frame")
    if file.stat().st_size > MAX_ANNOTATION_BYTES:
        raise InputError(
            f"{file}: {file.stat().st_size} bytes; annotations of a frame have at most {MAX_ANNOTATION_BYTES} bytes",
            id="input-too-large",
        )
    value = parse_json(file.read_bytes(), file, "annotations of a frame")
    if isinstance(value, dict) and isinstance(value.get("people"), list):
        raise InputError(
            f"{file}: keypoints of OpenPose, which are not read; write a table of boxes around people",
            id="unsupported-format",
        )
    if not isinstance(value, list):
        raise InputError(
            f"{file}: a list of people was expected, with personID, positionID and views", id="unknown-format"
        )
    return [_person(file, n, person) for n, person in enumerate(value, start=1)]


def _person(file: Path, n: int, person: Any) -> AnnotatedPerson:
    where = f"{file}: person {n}"
    try:
        identity, position, views = person["personID"], person["positionID"], person["views"]
        found = {view["viewNum"]: [view[edge] for edge in EDGES] for view in views}
    except (TypeError, KeyError) as error:
        missing = f"has no {error}; " if isinstance(error, KeyError) else ""
        raise InputError(
            f"{where}: {missing}expected personID, positionID and views with viewNum, {', '.join(EDGES)}",
            id="unknown-format",
        ) from None
    numbers = [identity, position, *found, *(edge for edges in found.values() for edge in edges)]
    if not all(isinstance(v, int | float) and not isinstance(v, bool) for v in numbers):
        raise InputError(f"{where}: personID, positionID, viewNum and edges must be numbers")
    for name, number in (("personID", identity), *(("viewNum", view) for view in found)):
        if not isinstance(number, int) or not 0 <= number < 2**31:
            raise InputError(f"{where}: {name} is {str(number)[:40]}; a whole number from 0 was expected")
    if not isinstance(position, int) or not 0 <= position < ACROSS * ALONG:
        raise InputError(
            f"{where}: positionID {position}; WILDTRACK's grid has the points 0 to {ACROSS * ALONG - 1}; correct it"
        )
    edges = {
        int(view): {} if all(v == -1 for v in values) else dict(zip(EDGES.values(), map(repr, values), strict=True))
        for view, values in found.items()
    }
    return AnnotatedPerson(n, int(identity), position, edges)


def grid_places(position: Floats) -> tuple[Floats, Floats]:
    """Coordinates x and y, (n,) each [m], of points of WILDTRACK's grid, given by their numbers (n,)."""
    return ORIGIN[0] + STEP * (position % ACROSS), ORIGIN[1] + STEP * (position // ACROSS)


MAX_LABEL_BYTES = 4 * 2**20
CLASS_NAMES = "classes.txt"
LABELS = "labels"
LABELS_TRIED = 3
"""Files by which a folder of labels is recognised."""
POSE = 51
"""Numbers of the 17 key points of a person, each with x, y and how visible it is."""
SLACK = 1e-3
"""Tolerance of normalised coordinates beyond 1: labels have few digits."""
MIN_LABELS, INSIDE, INSIDE_OF_OTHERS, BEYOND = 20, 0.95, 0.99, 0.02
"""Labels of a camera of which the order of columns is checked, least share of boxes that are inside the image, least
share in another order that is stated, and how far a box may end beyond the image, in sides of it."""
CENTRE = ("x", "y", "width", "height")
ORDERS = (
    ("left", "top", "right", "bottom"),
    ("top", "left", "bottom", "right"),
    ("confidence", *CENTRE),
    ("left", "top", "width", "height"),
    ("confidence", "left", "top", "right", "bottom"),
    ("confidence", "left", "top", "width", "height"),
    ("width", "height", "x", "y"),
    ("x", "y", "height", "width"),
    ("y", "x", "height", "width"),
    ("x", "width", "y", "height"),
)
"""Other orders of the columns after the class, the usual ones first."""
Line = tuple[Path, int, int, list[str]]
"""File, line, number of the frame, and the numbers as text."""


def camera_folders(path: Path) -> dict[str | None, Path]:
    """Folder with YOLO label files for each camera, named by the subfolders of `path`.

    The only key is None if `path` itself (or its subfolder `labels`) holds the files of one camera.

    Raises:
        InputError: there is no label file.
    """
    own = _labels(path)
    if own is not None:
        return {None: own}
    found = {p.name: _labels(p) for p in sorted(path.iterdir()) if p.is_dir() and not is_hidden(p)}
    cameras: dict[str | None, Path] = {name: folder for name, folder in found.items() if folder is not None}
    if not cameras:
        for folder in (path, *(path / name for name in found)):
            refuse_unread(folder)
        if any(path.glob(HIVE_CSV)):
            raise InputError(f"{path}: is a folder{folder_hint(path)}", id="not-a-file")
        raise InputError(
            f"{path}: holds no YOLO labels (one text for each frame, NAME_12.txt or 000012.txt); name their folder",
            id="unknown-format",
        )
    return {name: cameras[name] for name in natural_sorted(str(n) for n in cameras)}


def _labels(folder: Path) -> Path | None:
    """The folder itself or its subfolder `labels`, whichever holds YOLO label files; None if neither does."""
    return next((p for p in (folder, folder / LABELS) if p.is_dir() and label_files(p)), None)


def label_files(folder: Path) -> list[Path]:
    """YOLO label files in a folder (`.txt` with a number in the name, except `classes.txt`), in natural order."""
    names = [
        p.name
        for p in folder.iterdir()
        if p.suffix.lower() == ".txt" and not is_hidden(p) and p.name.lower() != CLASS_NAMES
    ]
    return [folder / name for name in natural_sorted(n for n in names if last_number(Path(n).stem))]


def is_labels(folder: Path) -> bool:
    """Whether a folder itself holds YOLO label files, by the lines of its first non-empty files."""
    files = [file for file in label_files(folder) if file.stat().st_size][:LABELS_TRIED]
    try:
        lines = [line for file in files for line in _read(file, 0)]
        return bool(lines) and all(_is_label(numbers) for *_, numbers in lines)
    except InputError:
        return False


def _is_label(numbers: Sequence[str]) -> bool:
    """Whether the cells of a line are a class number and a box in shares of the image size."""
    try:
        return numbers[0].isdigit() and all(-SLACK <= float(number) <= 1 + SLACK for number in numbers[1:5])
    except ValueError:
        return False


def open_folder(path: Path, wanted: BoxReadOptions) -> BoxSource:
    """Open the boxes in a folder of YOLO label files, of the stated camera or with a subfolder for each camera.

    Args:
        path: the folder.
        wanted: has the name of the camera, if the folder is of one.

    Raises:
        InputError: the folder is of one camera, which is not stated; or one is stated, and the folder is of several.
    """
    camera = wanted.camera
    folders = camera_folders(path)
    if camera is None and None in folders:
        raise InputError(
            f"{path}: holds the labels of one camera and does not name it; give CAMERA={path.name}",
            id="camera-not-named",
        )
    if camera is not None and None not in folders:
        names = ", ".join(str(name) for name in folders)
        raise InputError(
            f"{path}: holds the labels of several cameras ({names}); give it without {camera}=", id="ambiguous-input"
        )
    numbers = {name: _numbered(folder) for name, folder in folders.items()}
    listed = {str(name or ""): np.array(list(files), dtype=np.int64) for name, files in numbers.items()}
    named = tuple(str(name) for name in folders if name is not None)
    chunks = (rows for name, files in numbers.items() for rows in _camera(folders[name], name, files))
    return BoxSource(chunks, "YOLO text", listed, named)


def _numbered(folder: Path) -> dict[int, Path]:
    """YOLO label file of each frame, by the last number in its name, sorted.

    InputError if two files have one number.
    """
    found: dict[int, Path] = {}
    for file in label_files(folder):
        number = int(last_number(file.stem) or 0)
        if number in found:
            raise InputError(
                f"{file}: has frame number {number}, as {found[number].name} has; put each recording into its own "
                "folder",
                id="duplicate-row",
            )
        found[number] = file
    return dict(sorted(found.items()))


def _camera(folder: Path, camera: str | None, files: dict[int, Path]) -> Iterator[CsvRows]:
    lines = [line for number, file in files.items() for line in _read(file, number)]
    if not lines:
        return
    tail = _tail(folder, lines)
    _check_order(folder, lines)
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


def _check_order(folder: Path, lines: list[Line]) -> None:
    """InputError if boxes are inside the image with another order of YOLO's columns, but not with the usual one.

    Of several such orders the first is named in which most boxes have a larger share of the height than of the width,
    as people have.

    Args:
        folder: for the message.
        lines: all lines of one camera.
    """
    count = min(len(numbers) for *_, numbers in lines) - 1
    try:
        values = np.array([numbers[1 : count + 1] for *_, numbers in lines], dtype=np.float64)
    except ValueError:
        return  # stated with its line where the value is read
    now, _ = _share_inside(CENTRE, values)
    if len(values) < MIN_LABELS or now >= INSIDE:
        return
    shares = {order: _share_inside(order, values) for order in ORDERS if len(order) <= count}
    fitting = {order: tall > 0.5 for order, (inside, tall) in shares.items() if inside >= INSIDE_OF_OTHERS}
    if fitting:
        best = max(fitting, key=fitting.__getitem__)
        raise InputError(
            f"{folder}: {now:.0%} of boxes are inside the image, but {shares[best][0]:.0%} would be if columns were "
            f"class, {', '.join(best)}; write class, {', '.join(CENTRE)}, confidence",
            id="unsupported-format",
        )


def _share_inside(order: Sequence[str], values: Floats) -> tuple[float, float]:
    """Shares, 0 to 1, of n boxes that are inside the image, and that are tall, if columns of `values` mean `order`.

    A box is tall if its share of the image's height is larger than that of the width.

    Args:
        order: meanings of the first columns.
        values: (n, K) in shares of the image size, and not checked yet: infinity and NaN are outside.
    """
    column = dict(zip(order, values.T, strict=False))
    with np.errstate(over="ignore", invalid="ignore"):
        if "x" in column:
            column["left"] = column["x"] - 0.5 * column["width"]
            column["top"] = column["y"] - 0.5 * column["height"]
        near = np.array([column["left"], column["top"]])
        far = np.array(
            [column["right"], column["bottom"]]
            if "right" in column
            else near + np.array([column["width"], column["height"]])
        )
        across, down = far - near
    inside = (near > -BEYOND) & (far < 1.0 + BEYOND) & (far > near)
    return float(inside.all(axis=0).mean()), float((down > across).mean())


def _read(file: Path, frame: int) -> list[Line]:
    """Parse the YOLO label file of the frame number `frame`; no lines for an empty file (a frame without detections).

    Key points of a pose are dropped.

    Raises:
        InputError: a line has another number of cells, no class, or is repeated.
    """
    if file.is_file() and file.stat().st_size == 0:
        return []
    text = bounded_text(file, "a text with the labels of a frame", limit=MAX_LABEL_BYTES, encoding="utf-8-sig")
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
                f"{file}: line {number}: {len(cells)} numbers; expected class, x, y, width, height, [confidence] "
                "and identity; outlines and turned boxes cannot be used: write boxes (detect)",
                id="unsupported-format",
            )
        if not _whole(cells[0]):
            raise InputError(
                f"{file}: line {number}: class is {cells[0]!r}; a whole number was expected: the order is class, x, y, "
                "width, height, [confidence] and identity",
                id="unsupported-format",
            )
        if " ".join(cells) in seen:
            raise InputError(
                f"{file}: line {number}: duplicate box; Ultralytics appends to the files of an earlier "
                "run: empty the folder and detect again",
                id="duplicate-row",
            )
        seen.add(" ".join(cells))
        out.append((file, number, frame, cells))
    return out


def _whole(text: str) -> bool:
    """Whether a class is a whole number, also as `0.0`, or a name (any text that is not a number)."""
    try:
        return float(text).is_integer()
    except ValueError:
        return True


def _tail(folder: Path, lines: list[Line]) -> tuple[str, ...]:
    """Meaning of the sixth number in lines of YOLO text without a seventh: ("id",) or ("confidence",).

    It is an identity if it is a positive whole number in all lines.

    Raises:
        InputError: lines have different numbers of cells, so that the meaning is unclear.
    """
    counts = {len(numbers) for *_, numbers in lines}
    if 7 in counts:
        if 5 in counts:
            raise InputError(
                f"{folder}: has lines of 5 and of 7 numbers; write confidence and identity in all lines, or in none",
                id="incompatible-inputs",
            )
        return ("confidence",)
    last = [numbers[5] for *_, numbers in lines if len(numbers) == 6]
    if last and all(text.isascii() and text.isdigit() and text.strip("0") for text in last):
        return ("id",)
    if last and 5 in counts:
        raise InputError(
            f"{folder}: has lines with and without a confidence; write it in all lines, or in none",
            id="incompatible-inputs",
        )
    return ("confidence",)


def names_of_classes(folder: Path) -> Path | None:
    """Path of `classes.txt` with the class names, in a label folder or its parent; None if missing."""
    return next((p for p in (folder / CLASS_NAMES, folder.parent / CLASS_NAMES) if p.is_file()), None)


def _class_names(folder: Path) -> dict[str, str]:
    """Class names by number (as text, from 0) for a label folder; empty without a file of names."""
    path = names_of_classes(folder)
    if path is None:
        return {}
    names = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    return {str(n): name.strip() for n, name in enumerate(names)}


def _check_shares(rows: CsvRows) -> None:
    """InputError, with the line, for a centre or size of a box that is not a share of the image size, 0 to 1."""
    for name in (SHARE_X, SHARE_Y, SHARE_WIDTH, SHARE_HEIGHT):
        values = rows.floats(name)
        bad = np.flatnonzero((values < -SLACK) | (values > 1 + SLACK))
        if len(bad):
            row = int(bad[0])
            raise rows.fail(
                row,
                f"{name.partition(' ')[0]} is {values[row]:g}; YOLO text has fractions of the image size, 0 to 1; "
                "write pixels to a CSV (frame,left,top,width,height)",
            )
