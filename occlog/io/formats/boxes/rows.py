"""Conversion of box rows to tables: sizes checked, empty frames inserted, times added, classes selected."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from occlog.array_types import Bools, Floats, Ints, Uints
from occlog.errors import InputError, UsageError, option
from occlog.io.files.texts.csv_rows import CsvRows
from occlog.io.files.timing.frame_times import FrameTimes
from occlog.records.declared.sensors import MAX_EDGE_PX
from occlog.records.losses import Loss
from occlog.records.tables import Boxes

from .columns import CLASS_KEYS

B = TypeVar("B", bound=Boxes)
FRAMES_PER_CHUNK = 4096
NO_SIZE, COPIES = "boxes without a size", "copies of another box of the frame"
TOO_FAR = f"boxes that reach beyond {MAX_EDGE_PX:g} px"
"""Kinds of boxes that cannot be used."""
MAX_UNUSABLE = 0.5
"""Share of unusable boxes in a file, from which its columns are no edges of boxes."""


class FileBoxRows(NamedTuple):
    """Boxes as listed in a file, in columns (n,), before they become a table.

    `camera` is an index among the names in use; left, top, width and height are in px. Frames count from 0; the
    identity is -1 and the confidence NaN if there is none.
    """

    frame: Ints
    camera: Ints
    target_id: Ints
    left: Floats
    top: Floats
    width: Floats
    height: Floats
    confidence: Floats

    def pick(self, rows: Ints) -> FileBoxRows:
        """The rows with the given indices, in the order of these."""
        return FileBoxRows._make(column[rows] for column in self)


@dataclass
class UnusableBoxes:
    """Counts of unusable boxes in a file, by camera and kind of fault.

    Detectors write some: without a width, with NaN or infinite values, twice. If they are more than `MAX_UNUSABLE` of a
    file, its columns mean something else, and the first of them is an error.

    Attributes:
        counts: number of boxes by (camera, kind of fault).
        first: position of the first box, by (camera, kind of fault).
        error: error for the first box without a size or too far away; None: there is none.
        rows: number of all boxes.
        frames: lowest and highest frames of such boxes, by camera.
    """

    counts: Counter[tuple[str, str]] = field(default_factory=Counter)
    first: dict[tuple[str, str], str] = field(default_factory=dict)
    error: InputError | None = None
    rows: int = 0
    frames: dict[str, list[int]] = field(default_factory=dict)

    def add(self, camera: str, kind: str, count: int, place: str) -> None:
        """Count `count` unusable boxes of a camera; `kind` is why, `place` the position of the first of them."""
        self.counts[camera, kind] += count
        self.first.setdefault((camera, kind), place)

    def check(self) -> None:
        """Raise the error for the first unusable box if more than `MAX_UNUSABLE` of all boxes are unusable."""
        if self.error is not None and self.counts.total() > MAX_UNUSABLE * self.rows:
            raise self.error

    def losses(self) -> list[Loss]:
        """One loss for each camera and kind of fault."""
        return [
            Loss(camera, f"boxes, first {self.first[camera, kind]}", kind, count, self.rows)
            for (camera, kind), count in sorted(self.counts.items())
        ]


def usable(
    rows: CsvRows, boxes: FileBoxRows, cameras: Sequence[str], unusable: UnusableBoxes | None
) -> tuple[CsvRows, FileBoxRows]:
    """The boxes with a valid size and position, as text and as numbers; others are counted in `unusable`.

    Args:
        rows: n rows of a file, as text.
        boxes: the same rows as numbers.
        cameras: names by index.
        unusable: updated; None: the first unusable box is an error.

    Raises:
        InputError: a box has an impossible size, identity or confidence; with its line.
    """
    far = np.max(np.abs([boxes.left, boxes.top, boxes.width, boxes.height]), axis=0)
    sizeless = ~((boxes.width > 0) & (boxes.height > 0) & np.isfinite(boxes.left) & np.isfinite(boxes.top))
    sizeless &= ~(far > MAX_EDGE_PX)
    for kind, wrong in ((NO_SIZE, sizeless), (TOO_FAR, far > MAX_EDGE_PX)):
        if not wrong.any():
            continue
        row = int(np.flatnonzero(wrong)[0])
        error = rows.fail(
            row,
            f"box of {boxes.width[row]:g} x {boxes.height[row]:g} px; both must be above 0; correct or remove it"
            if kind == NO_SIZE
            else f"box that reaches to {far[row]:g} px; no image is larger than {MAX_EDGE_PX:g} px; correct or remove "
            "it",
        )
        if unusable is None:
            raise error
        unusable.error = unusable.error or error
        for camera in np.unique(boxes.camera[wrong]).tolist():
            own = np.flatnonzero(wrong & (boxes.camera == camera))
            place = f"{rows.location} {int(rows.lines[own[0]])}"
            unusable.add(cameras[camera], kind, len(own), place)
            ends = [int(boxes.frame[own].min()), int(boxes.frame[own].max())]
            unusable.frames.setdefault(cameras[camera], []).extend(ends)
    bad = sizeless | (far > MAX_EDGE_PX)
    if unusable is not None:
        unusable.rows += len(boxes.frame)
    good = np.flatnonzero(~bad)
    rows, boxes = (rows.pick(good), boxes.pick(good)) if bad.any() else (rows, boxes)
    return rows, check_boxes(rows, boxes)


def check_boxes(rows: CsvRows, boxes: FileBoxRows) -> FileBoxRows:
    """Return `boxes`; InputError, with the line in `rows`, for an impossible identity or confidence (0 to 1)."""
    bad = (np.abs(boxes.target_id) >= 2**31) | (boxes.target_id < -1)
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise rows.fail(row, f"identity {boxes.target_id[row]}; it must be -1 (none) to {2**31 - 1}; renumber it")
    bad = (boxes.confidence < 0) | (boxes.confidence > 1)
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise rows.fail(
            row,
            f"confidence {boxes.confidence[row]:g}; it must be 0 to 1; give {option('confidence_scale')}, which "
            f"divides it, or {option('score_type')} logit or unknown (not used)",
        )
    return boxes


def fingerprints(columns: Sequence[Floats | Ints]) -> Uints:
    """(n,) 64-bit hashes of rows, given as columns (n,): equal for equal rows, and almost never for others."""
    out = np.zeros(len(columns[0]), dtype=np.uint64)
    for column in columns:
        bits = column + 0.0 if column.dtype.kind == "f" else column.astype(np.int64)  # -0 is 0
        # The constants of splitmix64 (Steele, Lea and Flood, 2014)
        out = (out ^ bits.view(np.uint64)) + np.uint64(0x9E3779B97F4A7C15)
        out = (out ^ (out >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        out = (out ^ (out >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        out ^= out >> np.uint64(31)
    return out


def without_copies(
    chunks: Iterator[FileBoxRows], cameras: Sequence[str], path: Path, unusable: UnusableBoxes | None
) -> Iterator[FileBoxRows]:
    """Yield the chunks without exact duplicates of boxes in a frame.

    Args:
        chunks: rows, with whole frames in each chunk.
        cameras: names by index.
        path: the file, for messages.
        unusable: duplicates are counted in it; None: the first one is an InputError.
    """
    for rows in chunks:
        _, first = np.unique(fingerprints(rows), return_index=True)
        if len(first) == len(rows.frame):
            yield rows
            continue
        copies = np.setdiff1d(np.arange(len(rows.frame)), first)
        for row in copies.tolist():
            camera, place = cameras[rows.camera[row]], f"frame {rows.frame[row]}"
            if unusable is None:
                raise InputError(
                    f"{path}: camera {camera}, {place} (from 0): the box at ({rows.left[row]:g}, {rows.top[row]:g}) px "
                    "is a duplicate; remove the copies",
                    id="duplicate-row",
                )
            unusable.add(camera, COPIES, 1, place)
        yield rows.pick(np.sort(first))


def check_identities(chunks: Iterator[FileBoxRows], cameras: Sequence[str], path: Path) -> Iterator[FileBoxRows]:
    """Yield the chunks unchanged; InputError if an identity has two boxes in one frame of a camera.

    Args:
        chunks: rows, with whole frames in each chunk.
        cameras: names by index.
        path: the file, for messages.
    """
    for rows in chunks:
        named = rows.pick(np.flatnonzero(rows.target_id >= 0))
        named = named.pick(np.lexsort((named.target_id, named.camera, named.frame)))
        same = (np.diff(named.frame) == 0) & (np.diff(named.camera) == 0) & (np.diff(named.target_id) == 0)
        if same.any():
            row = int(np.flatnonzero(same)[0])
            raise InputError(
                f"{path}: camera {cameras[named.camera[row]]}, frame {named.frame[row]} (from 0): identity "
                f"{named.target_id[row]} has two boxes; keep one, or leave the identities out",
                id="duplicate-row",
            )
        yield rows


def join(parts: Sequence[FileBoxRows]) -> FileBoxRows:
    """Concatenate the rows of several parts, sorted by frame and camera (stable)."""
    whole = FileBoxRows._make(np.concatenate(columns) for columns in zip(*parts, strict=True))
    return whole.pick(np.lexsort((whole.camera, whole.frame)))


def in_frames(chunks: Iterator[FileBoxRows], first: int, stop: int) -> Iterator[FileBoxRows]:
    """Rechunk the rows of frames first <= frame < stop so that no frame is split; rows are sorted by frame and camera.

    Raises:
        ValueError: frame numbers decrease.
    """
    held: list[FileBoxRows] = []
    last = first - 1
    for chunk in chunks:
        kept = chunk.pick(np.flatnonzero((chunk.frame >= first) & (chunk.frame < stop)))
        if not len(kept.frame):
            continue
        if kept.frame[0] < last or (np.diff(kept.frame) < 0).any():
            raise ValueError("frames are not in order")
        last = int(kept.frame[-1])
        complete = int(np.searchsorted(kept.frame, last))
        if complete:
            yield join([*held, kept.pick(np.arange(complete))])
            held = []
        held.append(kept.pick(np.arange(complete, len(kept.frame))))
    if held:
        yield join(held)


def fill_frames(
    chunks: Iterator[FileBoxRows],
    table: type[B],
    cameras: Sequence[str],
    ranges: Sequence[range],
    times: Mapping[str, FrameTimes],
) -> Iterator[B]:
    """Yield tables of boxes in which every frame of every camera has at least one row.

    A frame without a box gets a row with `box` = -1: the frame has no detection.

    Args:
        chunks: rows sorted by frame, with whole frames in each chunk (`in_frames`).
        table: `Boxes` or `TruthBoxes`.
        cameras: names by index.
        ranges: frames of each camera.
        times: frame times by camera.
    """
    done = min((each.start for each in ranges), default=0)
    for chunk in chunks:
        end = int(chunk.frame[-1]) + 1
        yield from _blocks(chunk, table, cameras, done, end, times, ranges)
        done = end
    none, nothing = np.zeros(0, dtype=np.int64), np.zeros(0)
    empty = FileBoxRows(none, none, none, *[nothing] * 5)
    yield from _blocks(empty, table, cameras, done, max((each.stop for each in ranges), default=0), times, ranges)


def _blocks(
    rows: FileBoxRows,
    table: type[B],
    cameras: Sequence[str],
    first: int,
    stop: int,
    times: Mapping[str, FrameTimes],
    ranges: Sequence[range],
) -> Iterator[B]:
    for start in range(first, stop, FRAMES_PER_CHUNK):
        end = min(start + FRAMES_PER_CHUNK, stop)
        low, high = np.searchsorted(rows.frame, [start, end])
        yield _table(rows.pick(np.arange(low, high)), table, cameras, start, end, times, ranges)


def _table(
    rows: FileBoxRows,
    table: type[B],
    cameras: Sequence[str],
    first: int,
    stop: int,
    times: Mapping[str, FrameTimes],
    ranges: Sequence[range],
) -> B:
    """Table of the frames first <= frame < stop in the cameras' ranges; a frame without a box has a row, too.

    Args:
        rows: boxes of these frames, sorted by frame and camera.
        table: type of the table.
        cameras: names by index.
        first: first frame.
        stop: frame after the last.
        times: frame times by camera.
        ranges: frames of each camera, in the order of `cameras`.
    """
    cell = (rows.frame - first) * len(cameras) + rows.camera
    counts = np.bincount(cell, minlength=(stop - first) * len(cameras))
    start, end, step = np.array([(each.start, each.stop, each.step) for each in ranges]).T
    numbers = np.arange(first, stop)[:, None]
    is_frame = (numbers >= start) & (numbers < end) & ((numbers - start) % step == 0)
    empty = np.flatnonzero((counts == 0) & is_frame.ravel())
    frame = np.concatenate([rows.frame, first + empty // len(cameras)])
    camera = np.concatenate([rows.camera, empty % len(cameras)])
    # Rows are sorted by cell, so the position within a cell is the distance from its first row.
    number = np.arange(len(cell)) - np.searchsorted(cell, cell)
    blank = np.full(len(empty), np.nan)
    t_ns = np.zeros(len(frame), dtype=np.int64)
    for n, name in enumerate(cameras):
        mine = camera == n
        t_ns[mine] = times_of(name, times).at(frame[mine])
    box = np.concatenate([number, np.full(len(empty), -1)])
    sensor = np.array(cameras, dtype=np.str_)[camera]
    order = np.lexsort((box, sensor, t_ns))
    values = {
        "t_ns": t_ns,
        "sensor": sensor,
        "frame": frame,
        "box": box,
        "target_id": np.concatenate([rows.target_id, np.full(len(empty), -1)]),
        "left_px": np.concatenate([rows.left, blank]),
        "top_px": np.concatenate([rows.top, blank]),
        "width_px": np.concatenate([rows.width, blank]),
        "height_px": np.concatenate([rows.height, blank]),
        "confidence": np.concatenate([rows.confidence, blank]),
    }
    return table.of(**{name: column[order] for name, column in values.items()})


def times_of(camera: str, times: Mapping[str, FrameTimes]) -> FrameTimes:
    """Frame times of a camera; UsageError if unknown."""
    if camera not in times:
        raise UsageError(
            f"camera {camera}: its frames have no times; give {option('fps')} or {option('timestamps')}",
            id="missing-times",
        )
    return times[camera]


MAX_RANGE = 100_000_000
"""Largest number of frames from the first to the last one of a camera."""


def check_range(first: int, stop: int, where: str) -> None:
    """InputError if no frame is in first <= frame < stop, or more than 100 million are.

    `where` names the files, for the message.
    """
    if stop <= first:
        raise InputError(
            f"{where}: no row is in frames {first} to {stop}; give another range ({option('frames')})",
            id="empty-input",
        )
    if stop - first > MAX_RANGE:
        raise InputError(f"{where}: frames {first} to {stop - 1} are more than {MAX_RANGE}; correct the frame numbers")


def class_labels(rows: CsvRows) -> list[tuple[str, ...]]:
    """Labels of each row's class from all columns of classes, in lower case: `("0", "person")`.

    Empty without such columns.
    """
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


def wanted_rows(rows: CsvRows, classes: Sequence[str]) -> Bools:
    """(n,) mask of the rows with one of the given classes (number or name); InputError if the file has no classes."""
    labels = class_labels(rows)
    if not labels and len(rows):
        raise InputError(
            f"{rows.path}: has no classes; leave {option('class')} out, or add a column class", id="missing-column"
        )
    wanted = {_plain(name) for name in classes}
    return np.array([bool(wanted & set(label)) for label in labels], dtype=np.bool_)


def in_words(classes: Counter[tuple[str, ...]]) -> str:
    """Text with classes and their numbers of boxes: `0 person (12), 2 car (3)`."""
    return ", ".join(f"{' '.join(label) or 'none'} ({count})" for label, count in sorted(classes.items()))


def check_classes(
    where: str, wanted: Sequence[str], kept: Counter[tuple[str, ...]], all_: Counter[tuple[str, ...]]
) -> None:
    """InputError if no class is selected and boxes are of several, or no box is of a selected class.

    Args:
        where: the files, for messages.
        wanted: selected classes, by number or name; empty: none.
        kept: number of boxes that are read, by class.
        all_: number of all boxes, by class.
    """
    if wanted and all_ and not kept:
        numbered = all(name.isdigit() for label in all_ for name in label)
        hint = "; here classes have numbers only: give the number" if numbered else ""
        raise InputError(
            f"{where}: no box is of class {', '.join(wanted)}; there are {in_words(all_)}{hint}", id="empty-input"
        )
    if not wanted and len(all_) > 1:
        raise InputError(
            f"{where}: boxes of {len(all_)} classes: {in_words(all_)}; choose that of people ({option('class')} NAME)",
            id="ambiguous-input",
        )
