"""Regions of a detector as ellipses, moment by moment, from tables of boxes or of clusters."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints, Strings
from occlog.records.tables import Boxes, Views


class Regions(NamedTuple):
    """Regions of some frames, in the order of time."""

    t_ns: Ints  # (N,)
    sensor: Strings  # (N,)
    ellipse: Floats  # (N, 5) see `occlog.core.image.ellipse`
    there: Bools  # (N,) false: the row is no region, and says only that the detector looked at the frame


def inscribed(left: Floats, top: Floats, width: Floats, height: Floats) -> Floats:
    """(N, 5) the ellipses inscribed in boxes."""
    rows = [left + 0.5 * width, top + 0.5 * height, 0.5 * width, 0.5 * height, np.zeros(len(left))]
    return np.column_stack(rows)


def regions_of_boxes(chunks: Iterable[Boxes], min_confidence: float) -> Iterator[Regions]:
    """Read boxes of a detector; the detector did not look at frames without a row."""
    for c in chunks:
        there = (c.box >= 0) & ~(c.confidence < min_confidence)
        yield Regions(c.t_ns, c.sensor, inscribed(c.left_px, c.top_px, c.width_px, c.height_px), there)


def regions_of_views(chunks: Iterable[Views]) -> Iterator[Regions]:
    """Read the clusters of every frame, without those that the fusion of detections put in or took out."""
    for c in chunks:
        there = ~np.isin(c.cause, ("recovered", "removed"))
        yield Regions(c.t_ns, c.sensor, inscribed(c.left_px, c.top_px, c.width_px, c.height_px), there)


@dataclass
class RegionStream:
    """Regions in the order of time, given out moment by moment.

    Attributes:
        chunks: regions in the order of time.
        sparse: the detector looked at frames without a row too, and found no region there.
        met: number of regions of the time of a frame.
        read: number of regions read.
    """

    chunks: Iterator[Regions]
    sparse: bool
    met: int = 0
    read: int = 0
    _rows: OrderedDict[tuple[str, int], list[Floats]] = field(default_factory=OrderedDict)  # by (camera, time)
    _until: int | None = None  # time of the last row read
    _done: bool = False  # all rows are read

    def at(self, names: Sequence[str], t_ns: Ints) -> list[Floats | None]:
        """Take the (K, 5) regions of each view's frame; None: it has no frame, or the detector did not look at it.

        Args:
            names: of the views.
            t_ns: (V,) times of their frames, -1: none; times must not go back from call to call.
        """
        latest = int(t_ns.max())
        while not self._done and (self._until is None or self._until <= latest):
            self._pull()
        found = [self._take(name, t) if t >= 0 else None for name, t in zip(names, t_ns.tolist(), strict=True)]
        while self._rows and next(iter(self._rows))[1] <= latest:
            self._rows.popitem(last=False)
        return found

    def _pull(self) -> None:
        """Read one more chunk."""
        chunk = next(self.chunks, None)
        if chunk is None:
            self._done = True
            return
        columns = (chunk.t_ns.tolist(), chunk.sensor.tolist(), chunk.ellipse, chunk.there.tolist())
        for t, name, ellipse, there in zip(*columns, strict=True):
            rows = self._rows.setdefault((name, t), [])
            if there:
                rows.append(ellipse)
        self.read += int(chunk.there.sum())
        if len(chunk.t_ns):
            self._until = int(chunk.t_ns[-1])

    def _take(self, name: str, t_ns: int) -> Floats | None:
        """Take the regions of one camera and time out of those read."""
        rows = self._rows.pop((name, t_ns), [] if self.sparse else None)
        if rows is None:
            return None
        self.met += len(rows)
        return np.array(rows).reshape(-1, 5)
