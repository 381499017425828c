"""Columns of boxes under the names that programs give them, and what a file of boxes holds in these terms.

Boxes in text tables: CSV with a header line, and MOTChallenge text without one.

A MOTChallenge file holds one camera and has the columns frame (from 1), id, left, top, width, height, confidence; then
class and visible share (truth of MOT16 to MOT20), or a position in the world that is not used.  -1 represents what is
not known.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path, PurePosixPath
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.errors import InputError, option
from occlog.io.files.names import last_number
from occlog.io.files.texts.csv_rows import (
    MAX_CELL,
    ROWS_PER_CHUNK,
    CsvRows,
    commented_header,
    first_line,
    read_plain,
    read_rows,
)
from occlog.io.files.texts.formats import Probe
from occlog.io.files.timing.times import TIME_COLUMNS

from .mot_challenge import WITH_CLASSES

WHAT = "a table of boxes"
COLUMNS: dict[str, Sequence[str]] = {
    "frame": ("frame", "frame_id", "frame_number", "frame_index", "frame_idx"),
    "camera": ("camera", "cam", "cam_id", "camera_id", "view", "sensor"),
    "left": ("left", "x1", "xmin", "x_min", "bb_left", "left_px"),
    "top": ("top", "y1", "ymin", "y_min", "bb_top", "top_px"),
    "right": ("right", "x2", "xmax", "x_max", "right_px"),
    "bottom": ("bottom", "y2", "ymax", "y_max", "bottom_px"),
    "width": ("width", "w", "bb_width", "width_px"),
    "height": ("height", "h", "bb_height", "height_px"),
    "centre_x": ("cx", "xc", "x_center", "x_centre", "center_x", "centre_x", "xcenter", "bbox_center_x"),
    "centre_y": ("cy", "yc", "y_center", "y_centre", "center_y", "centre_y", "ycenter", "bbox_center_y"),
    "confidence": ("confidence", "conf", "score", "probability"),
    "id": ("id", "target_id", "track_id", "tracker_id", "object_id", "identity"),
    **TIME_COLUMNS,
}
CLASSES = ("class", "class_id", "class_name", "label", "category", "category_id", "name", "cls")
"""Columns that state what a box shows, by number or by name; a table may have several."""
ACROSS = (*COLUMNS["left"], *COLUMNS["centre_x"])
"""Columns of which a table of boxes has one."""
IMAGE = ("image", "image_name", "image_path", "img", "img_name", "file", "filename", "file_name")
"""Columns of files of images, in a table without numbers of frames: the last number of a name is that of the frame."""
IGNORED = ("visibility", "", "unnamed: 0", "area", "iscrowd", "segmentation", "segments", "keypoints")
CLASS_KEYS = {f"class:{name}": (name,) for name in CLASSES}
"""Columns of classes as `CsvRows` name them, so that none replaces another."""
BOX = "box"
"""One column with all edges, as Ultralytics writes it (`{'x1': 1.0, ...}`); occlog's own tables number boxes in it."""
LIST, LISTED = "bbox", ("left", "top", "width", "height")
"""One column with four numbers in each cell, as in COCO."""
EDGES = {"x1": "left", "y1": "top", "x2": "right", "y2": "bottom"}
"""Edges in such a column, and our names of them."""
SHARE_X, SHARE_Y, SHARE_WIDTH, SHARE_HEIGHT = "x (share)", "y (share)", "width (share)", "height (share)"
"""Centre and size in shares of the image's width and height, where a file has these; messages show these names."""
ROTATED = "is rotated; turned boxes cannot be used: export upright ones"
"""Message for a box that states a rotation in the image."""
SIZE_SLACK_PX = 1.5
"""Tolerance between the stated size and the edges of a box [px]: programs treat the last pixel differently."""


class BoxReadOptions(NamedTuple):
    """Options for reading a file of boxes.

    Attributes:
        camera: name of its camera; None: the file names its cameras.
        known: names of the cameras of the scene; empty: all cameras of the file are read.
        ignore_extra: skip unknown columns instead of refusing them.
    """

    camera: str | None
    known: Sequence[str]
    ignore_extra: bool

    def check_camera(self, path: Path, what: str) -> None:
        """InputError unless the camera is stated, for a format that holds one and does not name it.

        `path` is the file, `what` the format, for the message.
        """
        if self.camera is None:
            raise InputError(
                f"{path}: {what} holds one camera and does not name it; give CAMERA={path.name}",
                id="camera-not-named",
            )


class BoxSource(NamedTuple):
    """Content of a file or folder of boxes.

    Attributes:
        chunks: its rows, with columns named as in `COLUMNS`, `CLASS_KEYS` and `SHARE_X`, ...
        kind: the format, in words.
        listed: numbers of the frames that the file names, also those without a box, by label of the camera ("" if the
            user stated the camera); empty: it names only frames with boxes.
        cameras: labels of cameras that it names, also those without a box.
        first_number: number of frame 0, if the format states it; None: it does not.
        sizes: width and height [px] of the images that boxes are of, by label of the camera ("" if the user stated the
            camera); empty: not stated.
        unused: keys of the file that are not used, for a note.
    """

    chunks: Iterator[CsvRows]
    kind: str
    listed: Mapping[str, Ints] = MappingProxyType({})
    cameras: tuple[str, ...] = ()
    first_number: int | None = None
    sizes: Mapping[str, tuple[int, int]] = MappingProxyType({})
    unused: tuple[str, ...] = ()


def stated_sizes(found: Iterable[tuple[str, object, object]]) -> dict[str, tuple[int, int]]:
    """Image sizes (width, height) [px] by camera; cameras with several sizes are omitted.

    `found` yields (camera, width, height) for each row of a file; rows with an invalid size are skipped.
    """
    sizes: dict[str, set[tuple[int, int]]] = {}
    for camera, width, height in found:
        try:
            size = (int(str(width)), int(str(height)))
        except ValueError:
            continue
        if min(size) > 0:
            sizes.setdefault(camera, set()).add(size)
    return {camera: next(iter(each)) for camera, each in sizes.items() if len(each) == 1}


def disagree(size: Floats, near: Floats, far: Floats) -> Bools:
    """(n,) mask of boxes with a size that contradicts their edges by more than `SIZE_SLACK_PX`; False for NaN.

    A file that has all four edges and also `width` and `height` often means those of the image.

    Args:
        size: (n,) width or height [px].
        near: (n,) left or top edge [px].
        far: (n,) right or bottom edge [px].
    """
    with np.errstate(invalid="ignore", over="ignore"):
        return np.asarray(np.abs(near + size - far) > SIZE_SLACK_PX)


def both_sizes(size: str, value: float, far: str, edge: str, near: float) -> str:
    """Message for a box with a size that contradicts its edges.

    Args:
        size: name of the column with the size.
        value: its value [px].
        far: name of the column with the far edge.
        edge: its cell.
        near: near edge [px].
    """
    return (
        f"{size} is {value:g}, but {far} is {edge} and the near edge {near:g}; is {size} of the image? Omit one "
        "of the two columns"
    )


def check_columns(rows: CsvRows, camera: str | None) -> CsvRows:
    """Return the rows with left and top edges in place of centres, if they have these.

    `camera` is the one that the user states; None: the rows must have a column `camera`.

    Raises:
        InputError: a required column of boxes is missing.
    """
    if rows.has(SHARE_X):
        return rows
    rows = _from_centres(rows)
    missing = [name for name in ("frame", "left", "top") if not rows.has(name)]
    if not (rows.has("right") and rows.has("bottom")) and not (rows.has("width") and rows.has("height")):
        missing.append("right and bottom (or width and height)")
    if missing:
        remedy = "add it"
        if missing == ["frame"] and any(rows.has(name) for name in TIME_COLUMNS):
            remedy += ", or rename the column of times if it holds numbers of frames"
        raise InputError(f"{rows.path}: has no column {', '.join(missing)}; {remedy}", id="missing-column")
    if camera is None and not rows.has("camera"):
        raise InputError(
            f"{rows.path}: has no column camera; add it, or name the camera: CAMERA={rows.path.name}",
            id="camera-not-named",
        )
    return rows


def _from_centres(rows: CsvRows) -> CsvRows:
    """Copy of the rows with left and top edges computed from centres and sizes, if they have these.

    InputError if they have columns `left` or `top`, too.
    """
    cells = dict(rows.cells)
    for centre, size, edge in (("centre_x", "width", "left"), ("centre_y", "height", "top")):
        if rows.has(centre) and rows.has(edge):
            raise InputError(
                f"{rows.path}: has columns of both {edge} edges and centres; keep one", id="conflicting-values"
            )
        if rows.has(centre) and rows.has(size):
            near = rows.floats(centre, blank=True) - 0.5 * rows.floats(size, blank=True)
            cells[edge] = np.array([repr(value) for value in near.tolist()], dtype=np.str_)
    return replace(rows, cells=cells)


def rows_of(
    path: Path, records: Sequence[tuple[int, Mapping[str, str]]], location: str, files: Sequence[Path] = ()
) -> CsvRows:
    """Convert records, texts by column, to rows; missing cells are empty.

    Args:
        path: the file or folder.
        records: number of each in its file, from 1, and its cells by column.
        location: what is numbered, for messages: `line`, `entry`.
        files: the file of each record; empty: all are in `path`.

    Raises:
        InputError: a cell is too long; every row of a column takes as much memory as the longest cell.
    """
    for n, (line, cells) in enumerate(records):
        if max(map(len, cells.values()), default=0) > MAX_CELL:
            where = f"{files[n] if files else path}: {location} {line}"
            raise InputError(
                f"{where}: a cell of more than {MAX_CELL} characters; correct this {location}", id="input-too-large"
            )
    names = dict.fromkeys(name for _, cells in records for name in cells)
    columns = {name: np.array([cells.get(name, "") for _, cells in records], dtype=np.str_) for name in names}
    lines = np.array([line for line, _ in records], dtype=np.int64)
    return CsvRows(path, lines, columns, location, tuple(files))


def chunks_of(path: Path, records: Iterable[tuple[int, Mapping[str, str]]], location: str) -> Iterator[CsvRows]:
    """Yield the records of a file, texts by column, as rows, in chunks of bounded size (see `rows_of`)."""
    left = iter(records)
    while part := list(islice(left, ROWS_PER_CHUNK)):
        yield rows_of(path, part, location)


MOT_COLUMNS = ("frame", "id", "left", "top", "width", "height", "confidence")
_EDGE = re.compile(r"['\"](x1|y1|x2|y2|x3)['\"]\s*:\s*([^,}\s]+)")


def commented_columns(probe: Probe) -> list[str]:
    """Column names of a table of boxes, in lower case, in a first line that begins with `#`.

    Empty without such a line, and if the columns are in the order of MOTChallenge, which counts frames from 1.
    """
    names = [n.lower() for n in commented_header(probe.path, WHAT)] if probe.start.startswith(b"#") else []
    order = [next((name for name, aliases in COLUMNS.items() if each in aliases), each) for each in names[:6]]
    is_table = "frame" in order and {*names} & {*ACROSS, BOX, LIST}
    return names if is_table and tuple(order) != MOT_COLUMNS[:6] else []


def open_csv(path: Path, wanted: BoxReadOptions) -> BoxSource:
    """Open a table of boxes with a header line (CSV).

    It must have a column of cameras, unless `wanted` states the camera. Rows are read on demand.
    """
    return BoxSource(_csv(path, wanted.camera, wanted.ignore_extra), "CSV")


def _csv(path: Path, camera: str | None, ignore_extra: bool) -> Iterator[CsvRows]:
    known: dict[str, Sequence[str]] = {**COLUMNS, **CLASS_KEYS, BOX: (BOX,), LIST: (LIST,)}
    commented = commented_columns(Probe(path, WHAT))
    head = {*commented} or {cell.lower() for cell in first_line(path, WHAT)}
    if {"x", "y"} <= head and not head & {BOX, *COLUMNS["left"], *COLUMNS["width"]}:
        raise InputError(
            f"{path}: holds positions on the ground (x, y) and no boxes; give it as positions ({option('positions')})",
            id="wrong-content",
        )
    if not head & {*COLUMNS["frame"]}:
        known["image"] = IMAGE
    named = bool(commented)
    for rows in read_rows(path, known, WHAT, ignored=IGNORED, ignore_extra=ignore_extra, commented=named):
        yield check_columns(_split_box(_of_images(rows)), camera)


def _of_images(rows: CsvRows) -> CsvRows:
    """Copy of the rows with a column `frame` from the last number in the names of images, if they have such names.

    InputError for a name without a number.
    """
    if not rows.has("image"):
        return rows
    names, inverse = np.unique(rows.cells["image"], return_inverse=True)
    frames = [last_number(PurePosixPath(str(name).replace("\\", "/")).stem) for name in names]
    if None in frames:
        row = int(np.flatnonzero(inverse == frames.index(None))[0])
        raise rows.fail(row, f"image {str(rows.cells['image'][row])[:60]!r} has no number; add a column frame")
    return replace(rows, cells={**rows.cells, "frame": np.array(frames, dtype=np.str_)[inverse]})


def _split_box(rows: CsvRows) -> CsvRows:
    """Copy of the rows with a column that holds all four edges or sizes (`bbox`, `box`) split into four columns.

    Unchanged if they have neither, or have edges already.
    """
    if rows.has(LIST) and not rows.has("left"):
        numbers: list[list[str]] = []
        for n, text in enumerate(rows.cells[LIST]):
            numbers.append(re.findall(r"[-+.\w]+", str(text)))
            if len(numbers[-1]) != len(LISTED):
                raise rows.fail(n, f"{LIST} is {str(text)[:60]!r}; expected [left, top, width, height]")
        return replace(rows, cells={**rows.cells, **dict(zip(LISTED, np.array(numbers).T, strict=True))})
    if not rows.has(BOX) or rows.has("left"):
        return rows
    cells: dict[str, list[str]] = {name: [] for name in EDGES.values()}
    for n, text in enumerate(rows.cells[BOX]):
        found = dict(_EDGE.findall(str(text)))
        if set(found) != set(EDGES):
            raise rows.fail(n, f"box is {str(text)[:60]!r}; expected {{'x1': ..., 'y1': ..., 'x2': ..., 'y2': ...}}")
        for edge, name in EDGES.items():
            cells[name].append(found[edge])
    return replace(rows, cells={**rows.cells, **{name: np.array(column) for name, column in cells.items()}})


def open_mot(path: Path, wanted: BoxReadOptions) -> BoxSource:
    """Open MOTChallenge text (frames from 1) of the camera that `wanted` states; InputError if it states none."""
    wanted.check_camera(path, "a MOTChallenge file")
    return BoxSource(_mot(path), "MOTChallenge text", first_number=1)


def _mot(path: Path) -> Iterator[CsvRows]:
    for rows in read_plain(path, WHAT):
        columns = list(rows.cells.values())
        if not 7 <= len(columns) <= 10:
            raise InputError(
                f"{path}: {len(columns)} columns; MOTChallenge has 7 to 10 "
                "(frame,id,left,top,width,height,confidence,x,y,z), other tables need a header line",
                id="unknown-format",
            )
        cells = dict(zip(MOT_COLUMNS, columns, strict=False))
        if len(columns) in WITH_CLASSES:
            cells["class:class"] = columns[7]
        yield replace(rows, cells=cells)
