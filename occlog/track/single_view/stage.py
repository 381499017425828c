"""Boxes of each camera to its own tracker, frame by frame, and identities from it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import pairwise

import numpy as np

from occlog.array_types import Floats32, Ints
from occlog.errors import PluginError
from occlog.plugins.interface import BoxesInFrame, ViewTracker
from occlog.plugins.loading import Plugin, plugin_errors
from occlog.records.tables import Boxes, Views


class CameraTrackers:
    """Trackers of a plug-in, one per camera, with identities made unique over the cameras."""

    def __init__(self, plugin: Plugin, make: Callable[[str], ViewTracker]) -> None:
        """Start without frames.

        Args:
            plugin: that the trackers are from; errors name it.
            make: returns a new tracker for the camera of a name.
        """
        self._plugin, self._make = plugin, make
        self._own: dict[str, ViewTracker] = {}
        self.numbers: dict[tuple[str, int], int] = {}
        self.frames = self.boxes = self.unassigned = 0

    @property
    def cameras(self) -> list[str]:
        """Return the sorted names of the cameras with frames so far."""
        return sorted(self._own)

    def step(self, camera: str, found: BoxesInFrame) -> Ints:
        """(N,) identities, unique over all cameras, of the N boxes of a frame of `camera`; -1: of no person.

        Args:
            camera: name of the camera; its tracker is made at its first frame.
            found: boxes of the frame.

        Raises:
            PluginError: the tracker fails, or returns invalid identities.
        """
        if camera not in self._own:
            self._own[camera] = self._make(camera)
        with plugin_errors(self._plugin):
            ids = self._own[camera].step(found)
        wrong = fault_of(ids, len(found.boxes))
        if wrong is not None:
            raise PluginError(f"{self._plugin.label}: camera {camera}: frame {found.frame}: {wrong}")
        found_ids = np.array([self._number(camera, k) for k in np.asarray(ids).tolist()], dtype=np.int64)
        self.frames, self.boxes = self.frames + 1, self.boxes + len(found_ids)
        self.unassigned += int(np.count_nonzero(found_ids < 0))
        return found_ids

    def _number(self, camera: str, own: int) -> int:
        """Return the number, over all cameras, of identity `own` of a camera; -1 for no identity."""
        return -1 if own < 0 else self.numbers.setdefault((camera, own), len(self.numbers))


def fault_of(ids: object, count: int) -> str | None:
    """Return what is invalid in a tracker's result `ids` for `count` boxes, as text; None if valid."""
    try:
        array = np.asarray(ids)
    except ValueError:
        return "step gives lists of different lengths; an identity for each box was expected"
    if array.size == 0 and count == 0:
        return None
    if array.shape != (count,):
        return f"step gives the shape {array.shape}; ({count},) was expected, an identity for each box"
    if array.dtype.kind not in "iu":
        return f"step gives values of kind {array.dtype}; whole numbers were expected"
    own = array[array >= 0]
    if (array < -1).any():
        return f"identity {array.min()} must be at least 0, or -1 for a clutter box"
    if len(np.unique(own)) < len(own):
        twice = next(k for k in own.tolist() if (own == k).sum() > 1)
        return f"identity {twice} is twice in one frame"
    return None


def follow(
    chunks: Iterable[Boxes | Views], trackers: CameraTrackers, cameras: Callable[[str], bool]
) -> Iterator[Boxes]:
    """Generate the boxes with the identities that trackers give them; those of no person are omitted.

    A frame without any other box has a row without detection.

    Args:
        chunks: rows in the order of time.
        trackers: give the identities.
        cameras: returns whether the camera of a name is used; rows of others are omitted.
    """
    for chunk in _whole_times(chunks):
        used = np.array([cameras(name) for name in chunk.sensor.tolist()], dtype=np.bool_)
        rows = chunk.take(used)
        boxes, vectors = _boxes(rows)
        if not len(boxes):
            continue
        order = np.lexsort((boxes.box, boxes.sensor, boxes.t_ns))
        boxes, vectors = boxes.take(order), vectors[order]
        fresh = (np.diff(boxes.t_ns) != 0) | (boxes.sensor[1:] != boxes.sensor[:-1])
        starts = [0, *(np.flatnonzero(fresh) + 1).tolist(), len(boxes)]
        target = np.full(len(boxes), -1, dtype=np.int64)
        for first, stop in pairwise(starts):
            there = first + np.flatnonzero(boxes.box[first:stop] >= 0)
            edges = (boxes.left_px, boxes.top_px, boxes.width_px, boxes.height_px)
            found = BoxesInFrame(
                t_ns=int(boxes.t_ns[first]),
                frame=int(boxes.frame[first]),
                boxes=np.column_stack([edge[there] for edge in edges]),
                scores=boxes.confidence[there],
                embeddings=vectors[there],
            )
            target[there] = trackers.step(str(boxes.sensor[first]), found)
        kept = target >= 0
        empty = np.array([first for first, stop in pairwise(starts) if not kept[first:stop].any()], dtype=np.int64)
        kept[empty] = True
        columns = {c.name: np.array(getattr(boxes, c.name)) for c in Boxes.columns()}
        columns["target_id"] = target.astype(np.int32)
        columns["box"][empty] = -1
        for name in ("left_px", "top_px", "width_px", "height_px", "confidence"):
            columns[name][empty] = np.nan
        yield Boxes.of(**{name: values[kept] for name, values in columns.items()})


def _whole_times(chunks: Iterable[Boxes | Views]) -> Iterator[Boxes | Views]:
    """Generate the rows in chunks such that all rows of one time are in one chunk."""
    held: Boxes | Views | None = None
    for chunk in chunks:
        whole = chunk if held is None else type(chunk).concat([held, chunk])  # type: ignore[list-item]
        cut = int(np.searchsorted(whole.t_ns, whole.t_ns[-1])) if len(whole) else 0
        yield whole.take(slice(0, cut))
        held = whole.take(slice(cut, None))
    if held is not None:
        yield held


def _boxes(rows: Boxes | Views) -> tuple[Boxes, Floats32]:
    """Return rows as boxes, and their embeddings (n, K); K is 0 without any."""
    if isinstance(rows, Boxes):
        return rows, np.zeros((len(rows), 0), dtype=np.float32)
    boxes = Boxes.of(
        t_ns=rows.t_ns,
        sensor=rows.sensor,
        frame=rows.frame,
        box=rows.cluster,
        target_id=rows.target_id,
        left_px=rows.left_px,
        top_px=rows.top_px,
        width_px=rows.width_px,
        height_px=rows.height_px,
        confidence=rows.confidence,
    )
    return boxes, rows.embedding
