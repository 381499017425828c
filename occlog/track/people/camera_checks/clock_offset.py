"""Clock delay of a camera: the offset of its clock at which its boxes match people detected by the other cameras."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from occlog.array_types import NS, Bools, Bytes, Floats
from occlog.records.scene import Camera
from occlog.track.methods.jipda.interface import HEIGHT, STATE_SIZE, WIDTH, TrackSnapshot, X, Y
from occlog.track.methods.jipda.kernels.body_box import pack_views, project

from ..frame_detections import FrameDetectionsWithIds

MAX_STEPS = 1200
"""Maximum number of time steps kept from the beginning; more add no information."""
MAX_FRAMES = 60
"""Number of a camera's frames that are compared, evenly spread; at most twice as many are kept."""
MIN_FRAMES = 20
"""Minimum number of frames that overlap after an offset."""
MATCH_DISTANCE_HEIGHTS = 0.15
"""A box is where a person was if its middle is this near to that of the expected box, in its heights."""
BODY = [X, Y, HEIGHT, WIDTH]
"""Indices of the state that determine the predicted box of a person."""
MIN_ASSOCIATED_SHARE, MIN_SHARE_GAIN = 0.5, 0.2
"""Minimum share of boxes explained by a reported offset, and minimum gain over no offset and over the median offset."""


class _Spread:
    """Evenly spaced subset of one camera's frames: times [ns] and centres of the boxes [px]."""

    def __init__(self) -> None:
        """Start without frames."""
        self.kept: list[tuple[int, Floats]] = []  # times [ns], (n, 2) middles of boxes [px]
        self._every, self._count = 1, 0

    def add(self, t_ns: int, middles: Floats) -> None:
        """Add a frame at `t_ns` with the centres of its boxes (n, 2) [px].

        At most twice `MAX_FRAMES` frames are kept, evenly spaced.
        """
        if self._count % self._every == 0:
            self.kept.append((t_ns, middles))
            if len(self.kept) > 2 * MAX_FRAMES:
                self.kept = self.kept[::2]
                self._every *= 2
        self._count += 1


class ClockOffsetSearch:
    """Keeps tracks and boxes from the beginning of a recording, and searches for clock offsets of cameras in them."""

    def __init__(self, cameras: Sequence[Camera]) -> None:
        """Start without people and boxes, for the cameras to which frames refer by index."""
        self._cameras = cameras
        self._t_ns: list[int] = []
        # This is most of what a run keeps for minutes, so it is kept small
        self._people: list[NDArray[np.float32]] = []  # (m, 4) x, y, height, width
        self._by: list[Bytes] = []  # (m, C / 8) who has a box of them
        self._frames = [_Spread() for _ in cameras]

    def add(self, snapshot: TrackSnapshot, frames: Sequence[FrameDetectionsWithIds], by: Bools) -> None:
        """Keep the people and boxes of a time step; nothing is kept after `MAX_STEPS` time steps.

        Args:
            snapshot: m tracks after the time step.
            frames: camera frames of the time step.
            by: (m, C) whether each camera has a box of each person.
        """
        if len(self._t_ns) >= MAX_STEPS:
            return
        self._t_ns.append(snapshot.t_ns)
        self._people.append(snapshot.mean[:, BODY].astype(np.float32))
        self._by.append(np.packbits(by, axis=1))
        for frame in (each.detections for each in frames):
            if len(frame.boxes):
                self._frames[frame.camera].add(frame.t_ns, 0.5 * (frame.boxes[:, :2] + frame.boxes[:, 2:]))

    def late(self, camera: int, fewest: int) -> float:
        """Return the delay [s] of a camera's boxes against the people that others detect; negative: ahead.

        NaN if no offset explains clearly more boxes than 0.

        Args:
            camera: index of the camera.
            fewest: number of other cameras that must detect a person, for the person to count.
        """
        frames = self._frames[camera].kept
        if len(frames) < MIN_FRAMES or len(self._t_ns) < MIN_FRAMES:
            return float("nan")
        frames = [frames[k] for k in np.unique(np.linspace(0, len(frames) - 1, MAX_FRAMES).astype(np.int64))]
        times = np.array(self._t_ns, dtype=np.int64)
        step = max(int(np.median(np.diff(times))), 1)
        people, heights = self._expected(camera, fewest)
        boxes, frame_ns = _padded([b for _, b in frames]), np.array([t for t, _ in frames], dtype=np.int64)
        span = int(times[-1] - times[0]) // step
        offsets = np.arange(-span, span + 1)
        shares, fits = np.full((2, len(offsets)), np.nan)
        # No offset first: where it explains the boxes, none can explain so many more
        for k in sorted(range(len(offsets)), key=lambda k: k != span):
            if shares[span] > 1.0 - MIN_SHARE_GAIN:
                return float("nan")
            offset = int(offsets[k])
            asked = frame_ns - offset * step
            near = np.clip(np.searchsorted(times, asked - step // 2), 0, len(times) - 1)
            good = np.abs(times[near] - asked) <= step
            if np.count_nonzero(good) >= MIN_FRAMES:
                shares[k], fits[k] = _explained(boxes[good], people[near[good]], heights[near[good]])
        finite = np.flatnonzero(np.isfinite(shares))
        if not len(finite):
            return float("nan")
        best = finite[np.argmax(fits[finite])]
        usual = np.nanmax([np.median(shares[finite]), shares[span]])
        if shares[best] < max(MIN_ASSOCIATED_SHARE, float(usual) + MIN_SHARE_GAIN):
            return float("nan")
        return float(offsets[best]) * step / NS

    def _expected(self, camera: int, fewest: int) -> tuple[Floats, Floats]:
        """Return people that at least `fewest` other cameras detect, projected into a camera, for each of M time steps.

        Box centres (M, P, 2) [px] and box heights (M, P) [px], padded with NaN.
        """
        views = pack_views(self._cameras)
        middles, heights = [], []
        for body, bits in zip(self._people, self._by, strict=True):
            by = np.unpackbits(bits, axis=1, count=len(self._cameras))
            there = np.flatnonzero(by.sum(axis=1) - by[:, camera] >= fewest)
            own = np.zeros((len(there), STATE_SIZE))
            own[:, BODY] = body[there]
            found = np.zeros((len(own), 8))
            project(views, camera, own, np.zeros((len(own), STATE_SIZE, STATE_SIZE)), 0.0, found)
            found = found[found[:, 7] > 0.0]
            middles.append(0.5 * (found[:, :2] + found[:, 2:4]))
            heights.append(found[:, 3] - found[:, 1])
        return _padded(middles), _padded([h[:, None] for h in heights])[..., 0]


def _padded(parts: Sequence[Floats]) -> Floats:
    """Stack N arrays (n, K) of different lengths to (N, largest n, K), padded with NaN."""
    out = np.full((len(parts), max((len(p) for p in parts), default=0), parts[0].shape[1]), np.nan)
    for row, part in enumerate(parts):
        out[row, : len(part)] = part
    return out


def _explained(boxes: Floats, people: Floats, heights: Floats) -> tuple[float, float]:
    """Return two shares, 0 to 1, of boxes that match an expected box of their frame.

    The first counts boxes within `MATCH_DISTANCE_HEIGHTS` of the nearest expected one; the second weights each from 1
    at distance 0 to 0 at this limit.

    Args:
        boxes: (L, B, 2) centres of the boxes of L frames [px]; NaN: none.
        people: (L, P, 2) centres of expected boxes [px]; NaN: none.
        heights: (L, P) heights of expected boxes [px].
    """
    if not people.shape[1]:
        return 0.0, 0.0
    away = np.linalg.norm(boxes[:, :, None] - people[:, None], axis=-1) / heights[:, None]
    nearest = np.where(np.isfinite(away), away, np.inf).min(axis=2)
    whole = np.count_nonzero(np.isfinite(boxes[..., 0]))
    near = np.maximum(1.0 - nearest / MATCH_DISTANCE_HEIGHTS, 0.0)
    return float(np.count_nonzero(nearest <= MATCH_DISTANCE_HEIGHTS) / whole), float(near.sum() / whole)
