"""What would make the boxes of a camera fit the tracks of the others: its extrinsics, its images, or another camera's.

Tracks that the other cameras support are projected into a camera as it is calibrated, and as it would be after each
usual mistake; the mistake is named with which most of its boxes overlap a projected person.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.core.geometry.camera import array_rotation
from occlog.core.metrics.errors import intersection_over_union
from occlog.records.scene import Camera
from occlog.track.methods.jipda.interface import HEIGHT, WIDTH, TrackSnapshot, X, Y

from .frame_detections import FrameDetectionsWithIds

MAX_SAMPLES = 240
"""Time steps that are kept; beyond that every second one is dropped."""
MIN_OVERLAP = 0.3
"""Intersection over union of a box with a projected person, from which it fits."""
MIN_FIT, MIN_MORE = 0.6, 0.4
"""Share of boxes that fit with a mistake mended, and how much more that is than without."""
MIN_BOXES = 30
"""Boxes of a camera, at times when others detect people, that are compared at least."""
FLIPS = {
    "its images are mirrored": (True, False),
    "its images are turned by 180 degrees": (True, True),
    "its images are upside down": (False, True),
}
"""Mistakes with images: whether x and y are flipped."""
SCALES = (0.5, 2.0, 2.0 / 3.0, 1.5, 0.75, 4.0 / 3.0, 1.0 / 3.0, 3.0, 0.25, 4.0)
"""Factors between sizes of images."""
TURNS_DEG = (180.0, 90.0, -90.0)
"""Mistakes with the yaw of a camera."""


class FittingChange(NamedTuple):
    """A change of a camera: in words, share of its boxes that then fit, and share that fits without it."""

    words: str
    fit: float
    now: float


class CameraFaults:
    """Samples of tracks and boxes over a recording, and the search for what makes them fit."""

    def __init__(self, cameras: Sequence[Camera]) -> None:
        """Start without samples."""
        self._cameras = list(cameras)
        self._samples: list[tuple[Floats, Bools, dict[int, Floats]]] = []
        self._step = self._count = 0

    def add(self, snapshot: TrackSnapshot, by: Bools, frames: Sequence[FrameDetectionsWithIds]) -> None:
        """Take a time step, if it is one of those that are kept; `by` (m, C): which cameras detect each person."""
        self._count += 1
        if self._count % (1 << self._step) or not len(snapshot.ids):
            return
        boxes = {each.detections.camera: each.detections.boxes for each in frames if len(each.detections.boxes)}
        self._samples.append((snapshot.mean[:, [X, Y, HEIGHT, WIDTH]].copy(), by, boxes))
        if len(self._samples) > MAX_SAMPLES:
            self._samples, self._step = self._samples[1::2], self._step + 1

    def fitting(self, camera: int, *, beyond_chance: bool = False) -> FittingChange | None:
        """The change with which most boxes of a camera fit; None: there is none with which clearly more do.

        Args:
            camera: index of the camera.
            beyond_chance: clearly more than fit the people of other times, too, as where nothing else is wrong.
        """
        best, margin = None, 0.0
        for change in self._changes(camera):
            samples = self._supported_by_others(camera, change.other)
            if sum(len(boxes) for boxes, _ in samples) < MIN_BOXES:
                continue
            now = _fit(self._cameras[camera], samples, lambda boxes: boxes)
            fit = _fit(change.camera, samples, change.boxes)
            if fit < MIN_FIT or fit - now < max(MIN_MORE, margin):
                continue
            if not beyond_chance or fit - _fit(change.camera, _of_other_times(samples), change.boxes) >= MIN_MORE:
                best, margin = FittingChange(change.words, fit, now), fit - now
        return best

    def _supported_by_others(self, camera: int, other: int) -> list[tuple[Floats, Floats]]:
        """Boxes of a camera, and the people whom cameras other than these two detect: two of them, where there are."""
        others = [c for c in range(len(self._cameras)) if c not in (camera, other)]
        return [
            (boxes[camera], people[by[:, others].sum(axis=1) >= min(len(others), 2)])
            for people, by, boxes in self._samples
            if camera in boxes
        ]

    def _changes(self, camera: int) -> Iterator[_Change]:
        """Mistakes, the camera as it would be without, and its boxes."""
        own = self._cameras[camera]
        inverted = replace(own, rotation=own.rotation.T, position=-own.rotation.T @ own.position)
        yield _Change("its extrinsics are inverted (camera-to-world for world-to-camera)", inverted)
        for turn in TURNS_DEG:
            turned = replace(own, rotation=array_rotation(math.radians(turn), 0.0, 0.0) @ own.rotation)
            yield _Change(f"it is turned by {turn:.0f} degrees about the vertical", turned)
        for other, each in enumerate(self._cameras):
            if other != camera:
                yield _Change(f"they are boxes of camera {each.name}", each, other=other)
        if own.image_size is not None:
            size = np.array(own.image_size, dtype=np.float64)
            for words, axes in FLIPS.items():
                yield _Change(words, own, partial(_flipped, size=size, axes=axes))
        for scale in SCALES:
            yield _Change(f"they are scaled by {scale:.3g}", own, partial(np.multiply, scale))


def _of_other_times(samples: Sequence[tuple[Floats, Floats]]) -> list[tuple[Floats, Floats]]:
    """The boxes of each sample with the people of another one, half the recording away."""
    half = len(samples) // 2
    return [(boxes, samples[n - half][1]) for n, (boxes, _) in enumerate(samples)]


class _Change(NamedTuple):
    """A mistake in words, the camera as it would be without, what becomes of its boxes, and the other camera."""

    words: str
    camera: Camera
    boxes: Callable[[Floats], Floats] = np.array
    other: int = -1


def _flipped(boxes: Floats, size: Floats, axes: tuple[bool, bool]) -> Floats:
    """Boxes (n, 4: left, top, right, bottom) of an image of this size that is flipped in x, in y, or both."""
    out = boxes.copy()
    for axis, flipped in enumerate(axes):
        if flipped:
            out[:, axis], out[:, axis + 2] = size[axis] - boxes[:, axis + 2], size[axis] - boxes[:, axis]
    return out


def _fit(camera: Camera, samples: Sequence[tuple[Floats, Floats]], of_boxes: Callable[[Floats], Floats]) -> float:
    """Share of boxes that overlap a person who is projected into the camera."""
    people = np.concatenate([each for _, each in samples])
    projected = projected_people(camera, people)
    ends = np.cumsum([len(each) for _, each in samples])
    fit = total = 0
    for (boxes, _), persons in zip(samples, np.split(projected, ends[:-1]), strict=True):
        there = persons[np.isfinite(persons).all(axis=1)]
        changed = of_boxes(boxes)
        total += len(boxes)
        if len(there):
            sizes = [np.column_stack([b[:, :2], b[:, 2:] - b[:, :2]]) for b in (changed, there)]
            fit += int(np.count_nonzero(intersection_over_union(*sizes).max(axis=1) >= MIN_OVERLAP))
    return fit / max(total, 1)


def projected_people(camera: Camera, people: Floats) -> Floats:
    """(n, 4) boxes of upright people, from head and feet; NaN: behind the camera, or upside down.

    Args:
        camera: with a pose.
        people: (n, 4) x, y, height and width.
    """
    ground = np.column_stack([people[:, :2], np.zeros(len(people))])
    feet, head = camera.project(ground), camera.project(ground + people[:, 2:3] * [0.0, 0.0, 1.0])
    tall = feet[:, 1] - head[:, 1]
    middle, half = 0.5 * (feet[:, 0] + head[:, 0]), 0.5 * tall * people[:, 3] / np.maximum(people[:, 2], 1e-9)
    boxes = np.column_stack([middle - half, head[:, 1], middle + half, feet[:, 1]])
    return np.where((tall > 0.0)[:, None], boxes, np.nan)
