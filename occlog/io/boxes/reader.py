"""Boxes of a person detector: CSV with a header, and MOTChallenge text.

A CSV file has the columns

    frame        number of the frame, from 0, or from another first number
    camera       name or number of the camera, where the file holds several
    left, top    corner of the box [px], and right, bottom or width, height
    confidence   0 to 1, if there is one
    id           identity, if the detector gives one
    time         time of the frame in seconds (or t_ns, t_ms, ...), if there is one

under these or the usual other names (`COLUMNS`).  A MOTChallenge file holds one camera and
has the columns frame (from 1), id, left, top, width, height, confidence and more that are
not used; -1 stands for what is not known.

Every frame from the first to the last one in the files is taken for a frame of each
camera: where it has no row, the camera looked and saw nobody.  `frames` states another range.
Where rows carry times, the times of all frames are made from these.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from occlog.array_types import Ints, Strings
from occlog.errors import InputError
from occlog.io.files.csv_rows import Rows, first_line, is_header, read_plain, read_rows
from occlog.io.files.frame_times import FrameTimes
from occlog.io.files.sensor_names import match_sensor
from occlog.io.files.timestamps import TIME_COLUMNS, parse_times, time_column
from occlog.records.tables import Boxes

from .rows import BoxRows, check_boxes, check_range, fill_frames, in_frames, join


def note_times(rows: Rows, boxes: BoxRows, cameras: list[str], stamps: dict[str, dict[int, int]]) -> None:
    """Remember the time of every frame of every camera; InputError where one frame has two."""
    unit = time_column(rows)
    if unit is None:
        return
    t_ns = parse_times(rows, unit, unit)
    for n, name in enumerate(cameras):
        found = stamps.setdefault(name, {})
        for row in np.flatnonzero(boxes.camera == n).tolist():
            frame, t = int(boxes.frame[row]), int(t_ns[row])
            if found.setdefault(frame, t) != t:
                raise rows.fail(row, f"frame {frame} of camera {name} has two times ({found[frame]} and {t} ns)")


def table_times(found: dict[int, int], first: int, stop: int, where: str) -> FrameTimes:
    """Times of all frames; those without a row lie evenly between their neighbours."""
    frames = np.array(sorted(found), dtype=np.int64)
    t_ns = np.array([found[int(f)] for f in frames], dtype=np.int64)
    if (np.diff(t_ns) <= 0).any():
        k = int(np.flatnonzero(np.diff(t_ns) <= 0)[0])
        raise InputError(
            f"{where}: frame {frames[k + 1]} has time {t_ns[k + 1]} ns, not after the {t_ns[k]} ns of frame {frames[k]}"
        )
    step = (t_ns[-1] - t_ns[0]) / max(int(frames[-1] - frames[0]), 1)
    if not step and stop - first > 1:
        raise InputError(
            f"{where}: only frame {frames[0]} has a time, which says nothing of the others; give the frame rate"
        )
    wanted = np.arange(stop)
    # Relative to the first time: float64 cannot hold ns since 1970 exactly.
    relative = np.interp(wanted, frames, (t_ns - t_ns[0]).astype(np.float64))
    before, after = wanted < frames[0], wanted > frames[-1]
    relative[before] = (wanted[before] - frames[0]) * step
    relative[after] = float(t_ns[-1] - t_ns[0]) + (wanted[after] - frames[-1]) * step
    table = np.round(relative).astype(np.int64) + t_ns[0]
    table[frames[frames < stop]] = t_ns[frames < stop]
    return FrameTimes("column of times", 0, table)


B = TypeVar("B", bound=Boxes)
WHAT = "a table of boxes"
COLUMNS: dict[str, Sequence[str]] = {
    "frame": ("frame", "frame_id", "frame_number", "frame_index"),
    "camera": ("camera", "cam", "cam_id", "camera_id", "view", "sensor"),
    "left": ("left", "x1", "xmin", "x_min", "bb_left", "left_px"),
    "top": ("top", "y1", "ymin", "y_min", "bb_top", "top_px"),
    "right": ("right", "x2", "xmax", "x_max", "right_px"),
    "bottom": ("bottom", "y2", "ymax", "y_max", "bottom_px"),
    "width": ("width", "w", "bb_width", "width_px"),
    "height": ("height", "h", "bb_height", "height_px"),
    "confidence": ("confidence", "conf", "score", "probability"),
    "id": ("id", "target_id", "track_id", "object_id", "identity"),
    **TIME_COLUMNS,
}
IGNORED = ("class", "class_id", "class_name", "label", "category", "visibility", "box")
MOT_COLUMNS = ("frame", "id", "left", "top", "width", "height", "confidence")


@dataclass(frozen=True)
class BoxOptions:
    """How box files are to be understood.

    Attributes:
        frames: first frame and the one after the last; None: from the first to the last in the files.
        first_number: number in a CSV file that is frame 0.
        confidence_scale: number by which confidences are divided.
        ignore_extra: skip unknown columns instead of refusing them.
        drop_zero: leave out boxes whose confidence is 0.
        use_confidence: false: confidences, which may then be any number, are not kept.
    """

    frames: tuple[int, int] | None = None
    first_number: int = 0
    confidence_scale: float = 1.0
    ignore_extra: bool = False
    drop_zero: bool = False
    use_confidence: bool = True


class BoxFile(NamedTuple):
    """A file of boxes; `camera` is None where the file itself names the cameras."""

    path: Path
    camera: str | None


@dataclass(frozen=True, eq=False)
class BoxSurvey:
    """What a first pass through the files has found.

    Attributes:
        cameras: names of the cameras.
        first: first frame.
        stop: frame after the last one.
        ordered: frames do not go back in any file.
        times: times of frames, from the files' own column of times.
        rows: number of boxes.
    """

    cameras: tuple[str, ...]
    first: int
    stop: int
    ordered: bool
    times: Mapping[str, FrameTimes]
    rows: int


def survey_boxes(files: Sequence[BoxFile], known: Sequence[str], options: BoxOptions) -> BoxSurvey:
    """Cameras, range of frames and times of the files.

    Args:
        files: the files, of any mix of formats.
        known: names of the cameras of the scene; labels in a file are matched with them,
            and are used as they are where `known` is empty.
        options: how to read the files.
    """
    cameras: list[str] = []
    stamps: dict[str, dict[int, int]] = {}
    low, high, rows, ordered = np.inf, -np.inf, 0, True
    for file in files:
        last = -1
        for chunk, boxes in _read(file, cameras, known, options):
            low, high = min(low, int(boxes.frame.min())), max(high, int(boxes.frame.max()))
            ordered = ordered and last <= boxes.frame[0] and bool((np.diff(boxes.frame) >= 0).all())
            last, rows = int(boxes.frame[-1]), rows + len(boxes.frame)
            note_times(chunk, boxes, cameras, stamps)
        if file.camera is not None and file.camera not in cameras:
            cameras.append(file.camera)
    where = ", ".join(str(f.path) for f in files)
    if not rows and options.frames is None:
        raise InputError(f"{where}: no row with a box; if nobody was seen in all frames, give the range of frames")
    first, stop = options.frames or (int(low), int(high) + 1)
    check_range(first, stop, where)
    times = {name: table_times(found, first, stop, where) for name, found in stamps.items()}
    return BoxSurvey(tuple(cameras), first, stop, ordered, times, rows)


def read_boxes(
    files: Sequence[BoxFile],
    survey: BoxSurvey,
    times: Mapping[str, FrameTimes],
    known: Sequence[str],
    options: BoxOptions,
    table: type[B],
) -> Iterator[B]:
    """Tables of boxes with a row for every frame of every camera.

    Memory does not grow with files whose frames are in order; others are sorted as a whole.

    Args:
        files: as for `survey_boxes`.
        survey: what it found.
        times: times of the frames of each camera.
        known: as for `survey_boxes`.
        options: how to read the files.
        table: `Boxes` or `TruthBoxes`.
    """
    for file in files:
        cameras = [file.camera] if file.camera is not None else list(survey.cameras)
        chunks: Iterator[BoxRows] = (boxes for _, boxes in _read(file, cameras, known, options))
        if not survey.ordered:
            chunks = iter([join(list(chunks))])
        whole = in_frames(chunks, survey.first, survey.stop)
        yield from fill_frames(whole, table, cameras, survey.first, survey.stop, times)


def _read(
    file: BoxFile, cameras: list[str], known: Sequence[str], options: BoxOptions
) -> Iterator[tuple[Rows, BoxRows]]:
    """Rows of a file as text and as numbers; cameras that are new are appended to `cameras`."""
    mot = not is_header(first_line(file.path, WHAT))
    chunks = _read_mot(file) if mot else _read_csv(file, options)
    if mot:
        options = replace(options, first_number=1)
    for rows in chunks:
        labels = rows.cells["camera"] if rows.has("camera") and file.camera is None else None
        camera = _number_cameras(file, rows, labels, cameras, known)
        boxes = check_boxes(rows, _numbers(rows, camera, options))
        if options.drop_zero and (boxes.confidence == 0).any():
            kept = np.flatnonzero(boxes.confidence != 0)
            rows, boxes = rows.pick(kept), boxes.pick(kept)
        if len(rows):
            yield rows, boxes


def _read_csv(file: BoxFile, options: BoxOptions) -> Iterator[Rows]:
    for rows in read_rows(file.path, COLUMNS, WHAT, ignored=IGNORED, ignore_extra=options.ignore_extra):
        missing = [name for name in ("frame", "left", "top") if not rows.has(name)]
        if not (rows.has("right") and rows.has("bottom")) and not (rows.has("width") and rows.has("height")):
            missing.append("right and bottom (or width and height)")
        if missing:
            raise InputError(f"{file.path}: has no column {', '.join(missing)}; add it")
        if file.camera is None and not rows.has("camera"):
            raise InputError(f"{file.path}: has no column camera; add it, or name the camera: CAMERA={file.path.name}")
        yield rows


def _read_mot(file: BoxFile) -> Iterator[Rows]:
    if file.camera is None:
        raise InputError(
            f"{file.path}: a MOTChallenge file holds one camera and does not name it; give CAMERA={file.path.name}"
        )
    for rows in read_plain(file.path, WHAT):
        if not 7 <= len(rows.cells) <= 10:
            raise InputError(
                f"{file.path}: {len(rows.cells)} columns; MOTChallenge has 7 to 10 "
                "(frame,id,left,top,width,height,confidence,x,y,z), other tables need a header line"
            )
        yield Rows(rows.path, rows.lines, dict(zip(MOT_COLUMNS, rows.cells.values(), strict=False)))


def _number_cameras(
    file: BoxFile, rows: Rows, labels: Strings | None, cameras: list[str], known: Sequence[str]
) -> Ints:
    """(n,) place of each row's camera in `cameras`."""
    if labels is None:
        name = file.camera or ""
        if name not in cameras:
            cameras.append(name)
        return np.full(len(rows), cameras.index(name), dtype=np.int64)
    unique, inverse = np.unique(labels, return_inverse=True)
    names = [match_sensor(str(label), known, str(file.path)) if known else str(label) for label in unique]
    for name in names:
        if name not in cameras:
            cameras.append(name)
    return np.array([cameras.index(name) for name in names], dtype=np.int64)[inverse]


def _numbers(rows: Rows, camera: Ints, options: BoxOptions) -> BoxRows:
    frame = rows.ints("frame") - options.first_number
    if (frame < 0).any():
        row = int(np.flatnonzero(frame < 0)[0])
        raise rows.fail(row, f"frame {rows.cells['frame'][row]}; the first one is {options.first_number}")
    left, top = rows.floats("left"), rows.floats("top")
    n = len(frame)
    given = rows.has("confidence") and options.use_confidence
    confidence = rows.floats("confidence", blank=True) if given else np.full(n, np.nan)
    return BoxRows(
        frame=frame,
        camera=camera,
        target_id=_identities(rows) if rows.has("id") else np.full(n, -1, dtype=np.int64),
        left=left,
        top=top,
        width=rows.floats("width") if rows.has("width") else rows.floats("right") - left,
        height=rows.floats("height") if rows.has("height") else rows.floats("bottom") - top,
        confidence=np.where(confidence == -1, np.nan, confidence / options.confidence_scale),
    )


def _identities(rows: Rows) -> Ints:
    blank = rows.floats("id", blank=True)
    return np.where(np.isnan(blank), -1, blank).astype(np.int64) if np.isnan(blank).any() else rows.ints("id")
