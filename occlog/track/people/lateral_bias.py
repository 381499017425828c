"""How far to one side a camera's boxes are of the people whom the cameras find together: a pose that is wrong."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.core.metrics.normalised_squares import BatchMeans
from occlog.records.scene import Camera
from occlog.track.methods.jipda.interface import STATE_SIZE, TrackSnapshot
from occlog.track.methods.jipda.kernels.body_box import pack_views, project

from .frame_detections import FrameDetectionsWithIds

MAX_FRAMES = 200
"""Number of a camera's frames that count, evenly spread; at most twice as many are kept."""
MIN_BOXES = 50
"""Minimum number of a camera's boxes of people that other cameras see, for a check."""
MIN_ASSOCIATION_PROBABILITY = 0.9
"""A box that is so probably of one person alone counts."""
MAX_BIAS_HEIGHTS = 0.5
"""Clipping of offsets in the mean, in heights of people: farther boxes are of another person."""


class LateralBias:
    """Accumulates horizontal innovations of boxes, over a stream of time steps."""

    def __init__(self, cameras: Sequence[Camera]) -> None:
        """Start without innovations."""
        self._cameras = cameras
        self._kept: list[list[Floats]] = [[] for _ in cameras]  # of each frame, (k,) in heights of the expected boxes
        self._every, self._count = [1] * len(cameras), [0] * len(cameras)

    def add(self, snapshot: TrackSnapshot, frames: Sequence[FrameDetectionsWithIds], counts: Bools) -> None:
        """Keep a time step; `counts` (m, C) masks the people and cameras with boxes."""
        views = None
        for frame in (each.detections for each in frames):
            c = frame.camera
            due, self._count[c] = self._count[c] % self._every[c] == 0, self._count[c] + 1
            if not due or not len(frame.row):
                continue
            s = snapshot.support
            mine = (
                (s.camera == c)
                & (s.probability >= MIN_ASSOCIATION_PROBABILITY)
                & (s.joint <= 1.0 - MIN_ASSOCIATION_PROBABILITY)
                & np.isin(s.row, frame.row)
            )
            mine &= counts[s.person, c]
            if not mine.any():
                continue
            views = pack_views(self._cameras) if views is None else views
            found = np.zeros((int(mine.sum()), 8))
            project(views, c, snapshot.mean[s.person[mine]], np.zeros((len(found), STATE_SIZE, STATE_SIZE)), 0.0, found)
            order = np.argsort(frame.row)
            boxes = frame.boxes[order[np.searchsorted(frame.row, s.row[mine], sorter=order)]]
            off = 0.5 * (boxes[:, 0] + boxes[:, 2] - found[:, 0] - found[:, 2])
            self._kept[c].append((off / (found[:, 3] - found[:, 1]))[found[:, 7] > 0.0])
            if len(self._kept[c]) > 2 * MAX_FRAMES:
                self._kept[c] = self._kept[c][::2]
                self._every[c] *= 2

    def medians(self) -> tuple[Floats, Floats]:
        """How far boxes of each camera are to the right, in heights of people, and how sure that is.

        Returns:
            (C,) medians; NaN: too few boxes.  (C,) means in standard errors, which are those of means of
            neighbours in time, so that errors that go on for a while do not count as many.
        """
        values = [np.concatenate([np.zeros(0), *kept]) for kept in self._kept]
        median, sure = np.full((2, len(values)), np.nan)
        for c, each in enumerate(values):
            if len(each) >= MIN_BOXES:
                means = BatchMeans()
                means.add(np.clip(each, -MAX_BIAS_HEIGHTS, MAX_BIAS_HEIGHTS), np.ones(len(each)))
                median[c], sure[c] = np.median(each), means.ratio.value / means.ratio.error if each.any() else 0.0
        return median, sure
