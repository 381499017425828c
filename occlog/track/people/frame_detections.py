"""Group boxes of all cameras into frames, and frames of about the same time into time steps."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush, merge
from itertools import chain, pairwise
from typing import ClassVar, NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints, Ints32, Strings
from occlog.errors import InputError, did_you_mean
from occlog.records.columns import ColumnTable, column
from occlog.records.scene import Camera
from occlog.records.tables import APPEARANCE_BINS, Boxes, Positions, Views
from occlog.track.methods.jipda.interface import FrameDetections

DUPLICATE_IOU = 0.9
"""Intersection over union from which two boxes of one frame are one box that is reported twice."""
MIN_FRAME_PAIRS = 10
"""Minimum number of successive frames that determine the step of frame numbers."""
SHORTEST_NS = 100_000
"""Minimum interval between frames of a camera."""


class FrameDetectionsWithIds(NamedTuple):
    """Detections of one frame of a camera or position sensor, with their numbers in the input tables.

    `frame` is the frame's number in the camera's stream, `box` (n,) the numbers of the n detections in the frame.
    """

    detections: FrameDetections
    frame: int  # number in the camera's stream
    box: Ints  # (n,) numbers of the boxes in the frame


class DetectionFrameRows(NamedTuple):
    """R rows of a table of boxes of all cameras, sorted by time, as columns; a frame without boxes is one row.

    `t_ns`, `sensor` (camera name), `frame` number, `number` of the box in the frame (-1: the frame has none), `edges`
    (R, 4) left, top, right, bottom [px], `score` (confidence 0 to 1, NaN: none), `tracklet_id`, and `appearance`
    (R, K).
    """

    t_ns: Ints  # (R,)
    sensor: Strings  # (R,)
    frame: Ints  # (R,)
    number: Ints32  # (R,) of the box in the frame; -1: the frame has none
    edges: Floats  # (R, 4) left, top, right, bottom [px]
    score: Floats  # (R,)
    tracklet_id: Ints32  # (R,)
    appearance: Floats  # (R, K)

    def take(self, rows: Ints | Bools | slice) -> DetectionFrameRows:
        """Return the rows selected by a mask (R,), a slice or an index array."""
        return DetectionFrameRows._make(column[rows] for column in self)


def rows_of_boxes(chunks: Iterable[Boxes]) -> Iterator[DetectionFrameRows]:
    """Generate the chunks of table `boxes` as detection rows, one for each chunk; they have no appearance (K = 0)."""
    for c in chunks:
        yield DetectionFrameRows(
            t_ns=c.t_ns,
            sensor=c.sensor,
            frame=c.frame,
            number=c.box,
            edges=_edges(c),
            score=c.confidence,
            tracklet_id=c.target_id,
            appearance=np.zeros((len(c), 0)),
        )


def rows_of_views(chunks: Iterable[Views], colours_of_boxes: bool = True) -> Iterator[DetectionFrameRows]:
    """Generate the chunks of table `views` (regions) as detection rows, one for each chunk.

    Regions that the fusion of detections added or removed get the number -1 (no box). The appearance is the embedding,
    or colours if the table has none.

    Args:
        chunks: rows in the order of time.
        colours_of_boxes: take the colours of regions that have a detector's confidence, too; else they are NaN.
    """
    for c in chunks:
        colours = c.appearance
        if not colours_of_boxes:
            colours = np.where(np.isnan(c.confidence)[:, None], colours, np.float32(np.nan))
        yield DetectionFrameRows(
            t_ns=c.t_ns,
            sensor=c.sensor,
            frame=c.frame,
            number=np.where(np.isin(c.cause, ("recovered", "removed")), np.int32(-1), c.cluster),
            edges=_edges(c),
            score=c.confidence,
            tracklet_id=c.tracklet_id,
            # Network embeddings are more informative than colours.
            appearance=(c.embedding if c.embedding.shape[1] else colours).astype(np.float64),
        )


def _edges(table: Boxes | Views) -> Floats:
    """Return the edges (R, 4) left, top, right, bottom [px] of the boxes or regions of a table."""
    left, top = table.left_px, table.top_px
    return np.column_stack([left, top, left + table.width_px, top + table.height_px])


@dataclass(frozen=True, slots=True, eq=False)
class RegionFrameTimes(ColumnTable):
    """The columns of table `views` that identify a frame with regions: time, camera and frame number.

    Only these are read to find frames without regions.
    """

    NAME: ClassVar[str] = Views.NAME
    VERSION: ClassVar[int] = Views.VERSION
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "sensor")

    t_ns: Ints = column("time of the frame since the Unix epoch", "ns")
    sensor: Strings = column("name of the camera in the scene")
    frame: Ints = column("number of the frame in the camera's stream, from 0")


@dataclass
class FrameNumbers:
    """Frame numbering of a camera, estimated from the frames that have rows.

    Attributes:
        step: greatest common divisor of the differences between successive frame numbers; 0: no pair yet.
        pairs: number of pairs of successive frames with rows.
        left_out: number of these pairs with missing frames (without rows) between them.
    """

    step: int = 0
    pairs: int = 0
    left_out: int = 0

    def add(self, step: int) -> None:
        """Count a pair of successive frames with rows; `step` is the difference of their frame numbers, > 0."""
        self.step = math.gcd(self.step, step)
        self.pairs += 1

    @property
    def counted_in(self) -> int:
        """Step of the camera's frame numbers: their greatest common difference, or 1 before `MIN_FRAME_PAIRS` pairs.

        Numbers between two multiples of it are of no frame.
        """
        return self.step if self.pairs >= MIN_FRAME_PAIRS else 1


def frames_without_boxes(
    chunks: Iterable[RegionFrameTimes], cameras: Mapping[str, int], numbers: dict[str, FrameNumbers] | None = None
) -> Iterator[FrameDetectionsWithIds]:
    """Generate the frames without detections that a table omits, sorted by time, with zero boxes each.

    They are the frame numbers missing between two frames of a camera, at times evenly spaced between these two. If
    frames of a camera are numbered in steps, numbers between two steps are not frames. Frames before a camera's first
    row and after its last are unknown. All rows are read before the first frame is generated; memory grows with the
    number of gaps.

    Args:
        chunks: rows in the order of time.
        cameras: index of each camera in use, by name.
        numbers: filled with the frame numbering of each camera; None: not wanted.

    Raises:
        InputError: so many numbers are missing that frames would be less than `SHORTEST_NS` apart.
    """
    last: dict[str, tuple[int, int]] = {}
    gaps: list[_Gap] = []
    found = {} if numbers is None else numbers
    for c in chunks:
        for t_ns, sensor, frame in dict.fromkeys(
            zip(c.t_ns.tolist(), c.sensor.tolist(), c.frame.tolist(), strict=True)
        ):
            before = last.get(sensor)
            if before is not None and frame > before[1] and sensor in cameras:
                found.setdefault(sensor, FrameNumbers()).add(frame - before[1])
                if frame > before[1] + 1:
                    gaps.append(_Gap(*before, t_ns, frame, cameras[sensor]))
            last[sensor] = (t_ns, frame)
    steps = {cameras[sensor]: each.counted_in for sensor, each in found.items()}
    gaps = [gap._replace(step=steps[gap.camera]) for gap in gaps if gap.last > gap.first + steps[gap.camera]]
    names = {index: name for name, index in cameras.items()}
    for gap in gaps:
        found[names[gap.camera]].left_out += 1
        interval = (gap.end_ns - gap.start_ns) * gap.step / (gap.last - gap.first)
        if interval < SHORTEST_NS:
            raise InputError(
                f"boxes: camera {names[gap.camera]}: frames {gap.first} and {gap.last} are "
                f"{(gap.end_ns - gap.start_ns) / NS:g} s apart, too near for the frames between them (a frame in "
                f"{SHORTEST_NS / NS:g} s at most); number frames one after the other",
                id="time-out-of-range",
            )
    # The next empty frame of each gap that has begun
    waiting: list[tuple[int, int, int]] = []
    for n in sorted(range(len(gaps)), key=lambda n: gaps[n]):
        yield from _until(gaps[n].start_ns, waiting, gaps)
        following = gaps[n].first + gaps[n].step
        heappush(waiting, (gaps[n].time(following), following, n))
    yield from _until(None, waiting, gaps)


class _Gap(NamedTuple):
    """A gap in a camera's rows: two successive frames with rows, and missing frame numbers between them.

    `start_ns` and `first` are time and number of the frame before, `end_ns` and `last` of the one after; `camera` is
    its index, `step` the difference of successive frame numbers.
    """

    start_ns: int
    first: int
    end_ns: int
    last: int
    camera: int
    step: int = 1

    def time(self, frame: int) -> int:
        """Return the time [ns] of frame number `frame` of the gap, interpolated linearly."""
        return self.start_ns + (self.end_ns - self.start_ns) * (frame - self.first) // (self.last - self.first)


def _until(
    limit_ns: int | None, waiting: list[tuple[int, int, int]], gaps: Sequence[_Gap]
) -> Iterator[FrameDetectionsWithIds]:
    """Generate the frames without boxes up to the time `limit_ns` in order; all of them if it is None.

    `waiting` is a heap of (time, frame number, index in `gaps`), the next missing frame of each gap; it is changed.
    """
    nothing, none = np.zeros((0, 4)), np.zeros(0, dtype=np.int64)
    while waiting and (limit_ns is None or waiting[0][0] <= limit_ns):
        t_ns, frame, n = heappop(waiting)
        following = frame + gaps[n].step
        if following < gaps[n].last:
            heappush(waiting, (gaps[n].time(following), following, n))
        detections = FrameDetections(
            t_ns=t_ns,
            camera=gaps[n].camera,
            boxes=nothing,
            score=np.zeros(0),
            tracklet_id=none,
            appearance=np.zeros((0, APPEARANCE_BINS)),
            row=none,
        )
        yield FrameDetectionsWithIds(detections, frame, none)


@dataclass
class BoxStatistics:
    """Counts of frames and boxes over a stream of frames, arrays (C,) by camera index.

    Attributes:
        frames: number of frames.
        boxes: number of boxes.
        outside: number of boxes omitted because they lie outside the image.
        twice: number of boxes omitted because another box of the frame is nearly the same.
        first_ns, last_ns: times of the first and the last frame; -1: none.
    """

    frames: Ints
    boxes: Ints
    outside: Ints
    twice: Ints
    first_ns: Ints
    last_ns: Ints

    @classmethod
    def of(cls, cameras: int) -> BoxStatistics:
        """Return the counts of `cameras` cameras before the first frame."""
        zero = np.zeros(cameras, dtype=np.int64)
        return cls(zero, zero.copy(), zero.copy(), zero.copy(), zero - 1, zero - 1)

    def saw(self, frame: FrameDetections) -> None:
        """Count a frame and its boxes, and update the camera's first and last time, in place."""
        c = frame.camera
        self.frames[c] += 1
        self.boxes[c] += len(frame.boxes)
        self.first_ns[c] = frame.t_ns if self.first_ns[c] < 0 else self.first_ns[c]
        self.last_ns[c] = frame.t_ns


def frame_detections(
    chunks: Iterable[DetectionFrameRows], cameras: Sequence[Camera], known: Sequence[str], tally: BoxStatistics
) -> Iterator[FrameDetectionsWithIds]:
    """Generate the frames with detections of the cameras in use, in the order of time, then of cameras.

    Boxes that lie outside the image, and boxes that another one of the same frame repeats, are omitted and counted.

    Args:
        chunks: rows in the order of time.
        cameras: cameras in use; rows of others are skipped.
        known: names of all cameras of the scene.
        tally: counts of frames and boxes, updated in place.

    Raises:
        InputError: a camera that is not in `known`, or times that decrease.
    """
    index_of = {camera.name: c for c, camera in enumerate(cameras)}
    seen = 0
    for part in _whole_times(chunks):
        names, code = np.unique(part.sensor, return_inverse=True)
        if unknown := [name for name in names.tolist() if name not in known]:
            raise InputError(
                f"boxes: no camera {unknown[0]!r} in the scene; {did_you_mean(unknown[0], tuple(known), 'it has')}",
                id="unknown-sensor",
            )
        numbers = np.array([index_of.get(name, -1) for name in names.tolist()], dtype=np.int64)[code.reshape(-1)]
        order = np.lexsort((part.number, numbers, part.t_ns))
        rows, camera = part.take(order), numbers[order]
        row = seen + order
        seen += len(order)
        starts = np.flatnonzero(np.append(True, (np.diff(rows.t_ns) != 0) | (np.diff(camera) != 0)))
        for first, stop in pairwise([*starts.tolist(), len(order)]):
            if camera[first] >= 0:
                yield _detections_of_frame(
                    rows.take(slice(first, stop)), int(camera[first]), row[first:stop], cameras, tally
                )


def frames_of_positions(
    chunks: Iterable[Positions], index_of: Mapping[str, int], tally: BoxStatistics
) -> Iterator[FrameDetectionsWithIds]:
    """Generate the frames of position sensors, sorted by time, then by sensor.

    Their boxes are (x, y, x, y) in the scene's unit, with covariances.

    Args:
        chunks: rows of positions in the order of time.
        index_of: index of each sensor in use among cameras and sensors, by name; rows of others are skipped.
        tally: counts of frames and positions, updated in place.
    """
    held: list[Positions] = []
    seen = 0
    for chunk in chain(chunks, [None]):
        if chunk is not None:
            held.append(chunk)
            rows = Positions.concat(held)
            # The last time may go on in the next chunk
            cut = int(np.searchsorted(rows.t_ns, rows.t_ns[-1])) if len(rows) else 0
            whole, held = rows.take(slice(0, cut)), [rows.take(slice(cut, None))]
        else:
            whole = Positions.concat(held) if held else Positions.empty()
        starts = np.flatnonzero(np.append(True, (np.diff(whole.t_ns) != 0) | (whole.sensor[1:] != whole.sensor[:-1])))
        for first, stop in pairwise([*starts.tolist(), len(whole)] if len(whole) else []):
            c = index_of.get(str(whole.sensor[first]))
            if c is not None:
                rows = whole.take(slice(first, stop))
                kept = np.flatnonzero(rows.detection >= 0)
                position = np.column_stack([rows.x, rows.y])[kept]
                frame = FrameDetections(
                    t_ns=int(rows.t_ns[0]),
                    camera=c,
                    boxes=np.concatenate([position, position], axis=1),
                    score=rows.confidence[kept],
                    tracklet_id=rows.target_id[kept].astype(np.int64),
                    appearance=np.zeros((len(kept), 0)),
                    row=seen + first + kept,
                    covariance=np.column_stack([rows.cov_xx, rows.cov_xy, rows.cov_yy])[kept],
                )
                tally.saw(frame)
                yield FrameDetectionsWithIds(frame, int(rows.frame[0]), rows.detection[kept].astype(np.int64))
        seen += len(whole)


def _whole_times(chunks: Iterable[DetectionFrameRows]) -> Iterator[DetectionFrameRows]:
    """Generate the rows in chunks such that rows of one time are in one chunk, and no chunk is empty.

    Raises:
        InputError: times decrease.
    """
    held: list[DetectionFrameRows] = []
    for chunk in chunks:
        if not len(chunk.t_ns):
            continue
        if (np.diff(chunk.t_ns) < 0).any() or (held and chunk.t_ns[0] < held[-1].t_ns[-1]):
            raise InputError("boxes: times go back; sort the rows by t_ns", id="unsorted-times")
        cut = int(np.searchsorted(chunk.t_ns, chunk.t_ns[-1]))
        if cut or (held and held[-1].t_ns[-1] != chunk.t_ns[0]):
            yield _joined([*held, chunk.take(slice(0, cut))])
            held = []
        held.append(chunk.take(slice(cut, None)))
    if held:
        yield _joined(held)


def _joined(parts: Sequence[DetectionFrameRows]) -> DetectionFrameRows:
    """Return several parts of rows as one, in their order."""
    return DetectionFrameRows._make(np.concatenate(columns) for columns in zip(*parts, strict=True))


def _detections_of_frame(
    rows: DetectionFrameRows, c: int, row: Ints, cameras: Sequence[Camera], tally: BoxStatistics
) -> FrameDetectionsWithIds:
    """Build the detections of one frame of a camera from its rows.

    Boxes outside the image, and repeated ones, are omitted and counted.

    Args:
        rows: R rows of the frame.
        c: index of the camera.
        row: (R,) numbers of the rows in the table.
        cameras: cameras in use.
        tally: counts of frames and boxes, updated in place.
    """
    there = rows.number >= 0
    outside = there & _outside(rows.edges, cameras[c])
    kept = np.flatnonzero(there & ~outside)
    twice = duplicate_boxes(rows.edges[kept], rows.score[kept])
    kept = kept[~twice]
    tally.outside[c] += int(outside.sum())
    tally.twice[c] += int(twice.sum())
    frame = FrameDetections(
        t_ns=int(rows.t_ns[0]),
        camera=c,
        boxes=rows.edges[kept],
        score=rows.score[kept],
        tracklet_id=rows.tracklet_id[kept].astype(np.int64),
        appearance=rows.appearance[kept],
        row=row[kept],
    )
    tally.saw(frame)
    return FrameDetectionsWithIds(frame, int(rows.frame[0]), rows.number[kept].astype(np.int64))


def _outside(edges: Floats, camera: Camera) -> Bools:
    """Return a mask (R,) of boxes that lie entirely outside the image; all False if its size is unknown.

    `edges` (R, 4) are left, top, right, bottom [px].
    """
    if camera.image_size is None:
        return np.zeros(len(edges), dtype=np.bool_)
    w, h = camera.image_size
    left, top, right, bottom = edges.T
    beyond: Bools = (right <= -0.5) | (bottom <= -0.5) | (left >= w - 0.5) | (top >= h - 0.5)
    return beyond


def duplicate_boxes(edges: Floats, score: Floats) -> Bools:
    """Return a mask (n,) of boxes of one frame that repeat one with a higher score (or an earlier one, if equal).

    Their intersection over union is at least `DUPLICATE_IOU`. `edges` (n, 4) are left, top, right, bottom [px], `score`
    (n,) the confidences (NaN counts as 0).
    """
    n = len(edges)
    if n < 2:
        return np.zeros(n, dtype=np.bool_)
    corner = np.minimum(edges[:, None, 2:], edges[None, :, 2:]) - np.maximum(edges[:, None, :2], edges[None, :, :2])
    shared = np.prod(np.maximum(corner, 0.0), axis=2)
    area = np.prod(edges[:, 2:] - edges[:, :2], axis=1)
    same = shared >= DUPLICATE_IOU * (area[:, None] + area[None, :] - shared)
    out = np.zeros(n, dtype=np.bool_)
    order = np.argsort(-np.nan_to_num(score, nan=0.0), kind="stable")
    for k, i in enumerate(order.tolist()):
        before = order[:k]
        out[i] = bool((same[i, before] & ~out[before]).any())
    return out


def group_time_steps(
    frames: Iterable[FrameDetectionsWithIds], window_ns: int
) -> Iterator[list[FrameDetectionsWithIds]]:
    """Generate time steps: lists of successive frames within `window_ns` of the first one, at most one of each camera.

    The frames must be in the order of time.
    """
    held: list[FrameDetectionsWithIds] = []
    cameras: set[int] = set()
    for each in frames:
        if held and (each.detections.t_ns - held[0].detections.t_ns > window_ns or each.detections.camera in cameras):
            yield held
            held, cameras = [], set()
        held.append(each)
        cameras.add(each.detections.camera)
    if held:
        yield held


def in_order(*streams: Iterable[FrameDetectionsWithIds]) -> Iterator[FrameDetectionsWithIds]:
    """Merge several time-ordered streams of frames into one, sorted by time, then by camera index."""
    return merge(*streams, key=lambda each: (each.detections.t_ns, each.detections.camera))
