"""Frozen cameras: a stream that repeats one frame, after it has lost its source, while other cameras continue."""

from __future__ import annotations

from collections.abc import Hashable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS
from occlog.records.tables import Boxes

MIN_FROZEN_NS, MIN_FROZEN_FRAMES = 3 * NS, 10
"""Duration [ns] and number of identical frames from which a camera counts as frozen."""
MAX_COMMON_SHARE = 0.5
"""Share of that time in which another camera may be frozen, too, and still counts as moving."""


class FrozenFrames(NamedTuple):
    """A run of identical frames of one camera: first and last time [ns], and number of frames."""

    camera: str
    first_ns: int
    last_ns: int
    frames: int


@dataclass
class _CameraRuns:
    """State of one camera: content of its last frame, current run of identical frames, and earlier long runs (`runs`).

    `first_ns` and `last_ns` are the times of its first and last frame [ns].
    """

    first_ns: int
    last_ns: int
    content: Hashable = None
    run: FrozenFrames | None = None
    runs: list[FrozenFrames] = field(default_factory=list)


class FrozenCameras:
    """Finds runs of identical frames of each camera; frames of a camera are added in the order of time."""

    def __init__(self) -> None:
        """Start without frames."""
        self._cameras: dict[str, _CameraRuns] = {}

    def add(self, camera: str, t_ns: int, content: Hashable) -> None:
        """Add the next frame of a camera at time `t_ns` [ns].

        `content` is equal for frames with equal pictures or boxes, None if the frame is empty.
        """
        known = self._cameras.setdefault(camera, _CameraRuns(t_ns, t_ns))
        if known.run is not None and content is not None and content == known.content:
            known.run = known.run._replace(last_ns=t_ns, frames=known.run.frames + 1)
        else:
            self._end(known)
            known.content, known.run = content, FrozenFrames(camera, t_ns, t_ns, 1)
        known.last_ns = t_ns

    def add_boxes(self, boxes: Boxes) -> None:
        """Add the boxes of complete frames, in the order of time; frames are equal if number and sums of boxes are."""
        for name in np.unique(boxes.sensor).tolist():
            own = boxes.take(np.flatnonzero(boxes.sensor == name))
            first = np.flatnonzero(np.diff(own.t_ns, prepend=-1) != 0)
            edges = np.column_stack([own.left_px, own.top_px, own.width_px, own.height_px])
            sums = np.add.reduceat(edges, first) if len(first) else edges
            counts = np.diff(np.append(first, len(own)))
            for t_ns, count, values in zip(own.t_ns[first].tolist(), counts.tolist(), sums.tolist(), strict=True):
                self.add(name, t_ns, (count, *values) if values[0] == values[0] else None)

    def found(self) -> Iterator[FrozenFrames]:
        """Generate the longest run of each camera that is frozen while another camera is not.

        Cameras without such a run are skipped. Call it after the last frame.
        """
        for known in self._cameras.values():
            self._end(known)
        for name, known in sorted(self._cameras.items()):
            runs = [run for run in known.runs if any(self._moves(o, run) for o in self._cameras if o != name)]
            if runs:
                yield max(runs, key=lambda run: run.last_ns - run.first_ns)

    def _moves(self, camera: str, run: FrozenFrames) -> bool:
        """Return whether `camera` has frames during the run of another camera, most of which differ from each other."""
        other = self._cameras[camera]
        common = min(run.last_ns, other.last_ns) - max(run.first_ns, other.first_ns)
        still = sum(max(min(run.last_ns, o.last_ns) - max(run.first_ns, o.first_ns), 0) for o in other.runs)
        return common >= MIN_FROZEN_NS and still <= MAX_COMMON_SHARE * common

    @staticmethod
    def _end(known: _CameraRuns) -> None:
        """End the current run of identical frames of a camera, and keep it if it is long enough."""
        run = known.run
        if run is not None and run.last_ns - run.first_ns >= MIN_FROZEN_NS and run.frames >= MIN_FROZEN_FRAMES:
            known.runs.append(run)
        known.run = None
