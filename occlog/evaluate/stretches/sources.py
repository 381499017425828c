"""Streams of what `occlog evaluate` compares: opened inputs that are gone through several times, whole or in part."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from occlog.array_types import Ints
from occlog.errors import InputError, UsageError
from occlog.io.files.tables.header import describe
from occlog.io.open import Opened, open_input
from occlog.records.columns import Table
from occlog.records.declared.measurements import Measurements
from occlog.records.pieces import times, whole_times
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Diagnostics, Doa, Reads, Tracks, Truth, TruthBoxes, Views
from occlog.scans.config import MeasuredConfig
from occlog.scans.measured import Radio
from occlog.scans.sources import bearings_of_doa, in_time

LONG = 200_000
"""Rows of a table from which on a recording beside it is gone through several times, so that memory stays flat."""
T = TypeVar("T", bound=Table)
Span = tuple[int, int]
"""First time, and that after the last one [ns]."""


class MeasuredSource(NamedTuple):
    """Measurements of distances that are gone through as often as wanted, with what must be known of them."""

    rows: Callable[[], Iterator[Measurements]]
    config: MeasuredConfig
    radio: Radio | None

    def read(self) -> tuple[Measurements, MeasuredConfig, Radio | None]:
        """All of them."""
        return Measurements.concat(self.rows()), self.config, self.radio


@dataclass(frozen=True)
class Sources:
    """Tracks, truth, bearings, diagnostics and measurements of distances; None where not given.

    Attributes:
        during: rows of other times are left out; None: of none.
    """

    tracks: Opened | None
    truth: Opened | None
    bearings: Callable[[], Iterator[Bearings]] | None = None
    diagnostics: Opened | None = None
    measured: MeasuredSource | None = None
    during: Span | None = None

    def rows_of_tracks(self) -> Iterator[Tracks]:
        """All estimates; none without tracks."""
        return self._rows(self.tracks, Tracks)

    def rows_of_truth(self) -> Iterator[Truth]:
        """All true positions; none without a truth."""
        return self._rows(self.truth, Truth)

    def rows_of_bearings(self) -> Iterator[Bearings]:
        """All bearings; none without any."""
        return iter(()) if self.bearings is None else rows_during(self.bearings(), self.during)

    def rows_of_diagnostics(self) -> Iterator[Diagnostics]:
        """All diagnostics; none without any."""
        return self._rows(self.diagnostics, Diagnostics)

    def rows_of_measurements(self) -> Iterator[Measurements]:
        """All measurements of distances; none without any."""
        return iter(()) if self.measured is None else rows_during(self.measured.rows(), self.during)

    def _rows(self, opened: Opened | None, table: type[T]) -> Iterator[T]:
        return iter(()) if opened is None else rows_during(opened.rows(table), self.during)


def rows_during(chunks: Iterable[T], span: Span | None) -> Iterator[T]:
    """The chunks without rows of other times; None: as they are."""
    for chunk in chunks:
        yield chunk if span is None else chunk.take((times(chunk) >= span[0]) & (times(chunk) < span[1]))


def streamed_bearings(
    path: Path | None, doa: Path | None, labels: bool, scene: Scene
) -> Callable[[], Iterator[Bearings]] | None:
    """All bearings, and directions of arrival as such: as `occlog track` reads them, as often as wanted.

    Those of a recording are used along with its bearings unless others are named.
    """
    measured = None if path is None else open_input(path)
    directions = None if doa is None else open_input(doa)
    recorded = measured is not None and measured.recording is not None
    if directions is None and recorded and measured is not None and measured.has(Doa):
        directions = measured
    own = measured is not None and (not recorded or directions is None or measured.has(Bearings))
    if directions is None and labels:
        raise UsageError("doa_labels wants directions of arrival; give some (doa)")
    for opened, table in ((measured if own else None, Bearings), (directions, Doa)):
        if opened is not None:
            opened.require(table)

    def rows() -> Iterator[Bearings]:
        streams: list[Iterable[Bearings]] = [measured.rows(Bearings)] if own and measured is not None else []
        if directions is None:
            yield from streams[0]
            return
        streams.append(bearings_of_doa(directions.rows(Doa), scene, labels))
        if len(streams) == 1:
            yield from streams[0]
            return
        for piece in whole_times(in_time(streams)):
            yield piece.sorted()

    return rows if own or directions is not None else None


def span_of_frames(chunks: Iterable[Ints], frames: tuple[int, int]) -> Span | None:
    """Times from the first of these frames on, up to that of the one after the last; None: there is no frame at all.

    Args:
        chunks: times by which frames are numbered, in their order, each as often as may be.
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
        raise no_frames(frames, count)
    return low, high


def no_frames(frames: tuple[int, int], count: int) -> InputError:
    """What is said of frames that are not there."""
    return InputError(f"frames {frames[0]}:{frames[1]}: there are {count} of them, numbered from 0")


def no_true_box(frames: tuple[int, int]) -> InputError:
    """What is said of frames of views that have no true box."""
    return InputError(f"frames {frames[0]}:{frames[1]}: no true box is in them")


def any_long(*inputs: Opened | None) -> bool:
    """Whether a table is so long that it is worth to go through a recording, which has images too, more than once."""
    return any(opened is not None and rows_in(opened) > LONG for opened in inputs)


def rows_in(opened: Opened) -> int:
    """How many rows an input has; of a recording the number of messages of the table that has most."""
    if opened.recording is not None:
        tables = (Bearings, Views, TruthBoxes, Truth, Measurements, Reads)
        return max(opened.recording.messages(table) for table in tables)
    return 0 if opened.foreign is not None else describe(opened.path)["rows"]
