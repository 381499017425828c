"""Sources of `occlog evaluate`: tables in chunks, read repeatedly, in whole or in part."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from occlog.array_types import Ints
from occlog.errors import InputError, UsageError, option
from occlog.io.files.spill import SpilledTable
from occlog.io.open import Opened, open_input
from occlog.records.columns import ColumnTable
from occlog.records.declared.sensors import Measurements
from occlog.records.scene import Scene
from occlog.records.tables import (
    Bearings,
    Boxes,
    Cooperation,
    Diagnostics,
    Doa,
    Tracks,
    Truth,
    TruthBoxes,
    Views,
    times,
    whole_times,
)
from occlog.scans.config import DistanceMeasurementConfig
from occlog.scans.distance_measurements import Radio
from occlog.scans.sources import bearings_of_doa, within_times

from .verdict import TrackProvenance

AT_ONCE = 1 << 16
"""Rows that are worked on at once, at least where there are as many: a table with fewer is one chunk."""
T = TypeVar("T", bound=ColumnTable)
N = TypeVar("N", Views, TruthBoxes)
Span = tuple[int, int]
"""First time, and that after the last one [ns]."""
Chunks = Callable[[], Iterator[T]]
"""Gives all rows of a table in the order of time, as often as asked."""


class MeasuredSource(NamedTuple):
    """Distance measurements that can be read repeatedly.

    `rows`: returns an iterator over chunks; `config`: settings for what they do not state; `radio`: fitted path loss
    model, None: from the settings.
    """

    rows: Chunks[Measurements]
    config: DistanceMeasurementConfig
    radio: Radio | None


@dataclass(frozen=True)
class EvaluationSources:
    """Inputs of an evaluation, each a function that returns an iterator over chunks of rows; None: not given.

    Attributes:
        tracks: estimates.
        truth: true positions.
        bearings: bearings of all sensors.
        diagnostics: filter diagnostics of the tracks.
        measured: distance measurements.
        views: silhouettes from clusters or a detector, to be compared with true boxes.
        truth_boxes: true boxes.
        cooperation: requests to cameras.
        boxes: detections of all people, among them those of held-out cameras.
        made: provenance of the tracks: method, smoothing, length of a scan.
        frames: first frame that is evaluated, and the one after the last; None: all.
    """

    tracks: Chunks[Tracks] | None = None
    truth: Chunks[Truth] | None = None
    bearings: Chunks[Bearings] | None = None
    diagnostics: Chunks[Diagnostics] | None = None
    measured: MeasuredSource | None = None
    views: Chunks[Views] | None = None
    truth_boxes: Chunks[TruthBoxes] | None = None
    cooperation: Chunks[Cooperation] | None = None
    boxes: Chunks[Boxes | Views] | None = None
    made: TrackProvenance = TrackProvenance()
    frames: tuple[int, int] | None = None

    def in_frames(self, frames: tuple[int, int]) -> EvaluationSources:
        """Return the sources restricted to the frames first <= number < stop.

        Views and true boxes have frame numbers. All other rows are taken from the time of the first frame up to that of
        the one after the last, where frames are the times of true targets, else of true boxes, bearings, boxes or
        tracks.

        Raises:
            InputError: there are no such frames.
        """
        views, truth_boxes = _numbered(self.views, frames), _numbered(self.truth_boxes, frames)
        out = replace(self, frames=frames, views=views, truth_boxes=truth_boxes)
        timed = ("tracks", "truth", "bearings", "diagnostics", "cooperation", "boxes")
        if self.measured is None and all(getattr(self, name) is None for name in timed):
            return out
        spans = (span_of_frames(times, frames) for times in self._times_of_frames())
        span = next((span for span in spans if span is not None), None)
        if span is None:
            raise missing_frames_message(frames, 0)
        given = {name: chunks for name in timed if (chunks := getattr(self, name)) is not None}
        during: dict[str, Any] = {name: partial(_during, chunks, span) for name, chunks in given.items()}
        if self.measured is not None:
            during["measured"] = self.measured._replace(rows=partial(_during, self.measured.rows, span))
        return replace(out, **during)

    def _times_of_frames(self) -> Iterator[Iterator[Ints]]:
        """Generate for each source the times [ns] that may number the frames: true targets first, then the others."""
        yield (rows.t_ns[rows.role == "target"] for rows in rows_of(self.truth))
        for chunks in (self.truth_boxes, self.bearings, self.boxes, self.tracks):
            yield (times(rows) for rows in rows_of(chunks))


def rows_of(chunks: Chunks[T] | None) -> Iterator[T]:
    """Return an iterator over the chunks of a source; empty without a source (None)."""
    return iter(()) if chunks is None else chunks()


def in_memory(table: T | None) -> Chunks[T] | None:
    """Return a function that generates a table in memory as one chunk; None for None."""
    return None if table is None else lambda: iter([table])


def opened_rows(opened: Opened | None, table: type[T]) -> Chunks[T] | None:
    """Return a function that generates the rows of a table in chunks; None without a file, or if it lacks the table.

    Rows of a recording or an external table, which are slow to read, are buffered on disk in the first pass.
    """
    if opened is None or not opened.has(table):
        return None
    rows = partial(opened.rows, table)
    slow = opened.recording is not None or opened.external_table is not None
    return partial(_collected, SpilledTable(table, rows).chunks if slow else rows)


def _collected(chunks: Chunks[T]) -> Iterator[T]:
    """Generate the rows in larger chunks, of at least `AT_ONCE` rows except for the last one."""
    parts, rows = list[T](), 0
    for chunk in chunks():
        parts.append(chunk)
        rows += len(chunk)
        if rows >= AT_ONCE:
            yield type(chunk).concat(parts)
            parts, rows = [], 0
    if rows:
        yield type(parts[0]).concat(parts)


def _during(chunks: Chunks[T], span: Span) -> Iterator[T]:
    """Generate the chunks restricted to rows with times [ns] in `span` (begin, end), the end excluded."""
    for chunk in chunks():
        yield chunk.take((times(chunk) >= span[0]) & (times(chunk) < span[1]))


def _numbered(chunks: Chunks[N] | None, frames: tuple[int, int]) -> Chunks[N] | None:
    """Return a function that generates the rows with frame numbers first <= number < stop; None for None."""
    if chunks is None:
        return None
    return lambda: (rows.take((rows.frame >= frames[0]) & (rows.frame < frames[1])) for rows in chunks())


def streamed_bearings(path: Path | None, doa: Path | None, labels: bool, scene: Scene) -> Chunks[Bearings] | None:
    """Return a function that generates all bearings in the order of time, as in `occlog track`; None without any input.

    Directions of arrival are converted to bearings. Those of a recording are used along with its bearings unless others
    are named.

    Args:
        path: bearings, table or recording.
        doa: directions of arrival.
        labels: directions keep their labels; UsageError without directions.
        scene: poses of the arrays.
    """
    measured = None if path is None else open_input(path)
    directions = None if doa is None else open_input(doa)
    recorded = measured is not None and measured.recording is not None
    if directions is None and recorded and measured is not None and measured.has(Doa):
        directions = measured
    own = measured is not None and (not recorded or directions is None or measured.has(Bearings))
    if directions is None and labels:
        raise UsageError(
            f"{option('doa_labels')} requires directions of arrival; give some ({option('doa')})", id="missing-option"
        )
    for opened, table in ((measured if own else None, Bearings), (directions, Doa)):
        if opened is not None:
            opened.require(table)

    def rows() -> Iterator[Bearings]:
        streams: list[Iterable[Bearings]] = [measured.rows(Bearings)] if own and measured is not None else []
        if directions is None:
            yield from streams[0]
            return
        streams.append(bearings_of_doa(directions.rows(Doa), scene, labels, directions.scene))
        if len(streams) == 1:
            yield from streams[0]
            return
        for piece in whole_times(within_times(streams)):
            yield piece.sorted()

    if not own and directions is None:
        return None
    aside = any(each is not None and each.recording is not None for each in (measured, directions))
    return partial(_collected, SpilledTable(Bearings, rows).chunks if aside else rows)


def span_of_frames(chunks: Iterable[Ints], frames: tuple[int, int]) -> Span | None:
    """Return the time [ns] of the first of a range of frames, and that of the one after its last.

    None without any times.

    Args:
        chunks: times that are frames, in ascending order, repeated or not; frames are numbered from 0.
        frames: first frame, and the one after the last.

    Raises:
        InputError: there are no such frames.
    """
    first, stop = frames
    count, latest = 0, None
    low, high = 0, int(np.iinfo(np.int64).max)
    for t_ns in chunks:
        found = np.unique(t_ns)
        found = found if latest is None else found[found > latest]
        if not len(found):
            continue
        if count <= first < count + len(found):
            low = int(found[first - count])
        if 0 <= first < stop and count <= stop < count + len(found):
            return low, int(found[stop - count])
        count, latest = count + len(found), int(found[-1])
    if not count:
        return None
    if not 0 <= first < min(stop, count):
        raise missing_frames_message(frames, count)
    return low, high


def missing_frames_message(frames: tuple[int, int], count: int) -> InputError:
    """Return the error that no frame is in the range `frames` (first, stop); `count`: number of frames there are."""
    return InputError(f"frames {frames[0]}:{frames[1]}: there are {count} of them, numbered from 0", id="empty-input")


def no_true_box_message(frames: tuple[int, int]) -> InputError:
    """Return the error that the range `frames` (first, stop) has no true box."""
    return InputError(f"frames {frames[0]}:{frames[1]}: no true box is in them", id="empty-input")
