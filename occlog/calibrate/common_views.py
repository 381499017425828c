"""Whether calibrated cameras agree: a person whom one places in the image of another must have a box there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from occlog.array_types import NS, Floats
from occlog.records.scene import Camera
from occlog.track.people.camera_checks.pair_overlap import (
    MIN_OVERLAP,
    BoxesOfCamera,
    in_image,
    located,
    overlaps_at,
    projected_people,
)
from occlog.track.people.frame_detections import FrameDetectionsWithIds

from .adjustment import Clocks

MAX_PEOPLE = 4000
"""Boxes of a camera that are compared at most; they are spread evenly over the recording."""


def detected_by_others(
    cameras: Sequence[Camera], clocks: Clocks, frames: Sequence[FrameDetectionsWithIds], person_height: float
) -> tuple[Floats, Floats]:
    """Count how many people whom one camera places inside the image of another are detected there.

    Frames without boxes count, since a person in plain view should be detected in them, too.

    Args:
        cameras: C calibrated cameras.
        clocks: of the cameras.
        frames: boxes of all cameras.
        person_height: mean height of people, in scene units.

    Returns:
        (C, C) number of people whom camera a (row) places inside the image of camera b (column), and how many of them
        overlap a box of b in its nearest frame.
    """
    C = len(cameras)
    times: list[Floats] = []
    views: list[BoxesOfCamera] = []
    for c, camera in enumerate(cameras):
        own = [each.detections for each in frames if each.detections.camera == c]
        stamps = np.array([each.t_ns / NS for each in own])
        times.append(stamps - clocks.errors(c, stamps))
        boxes = np.concatenate([np.zeros((0, 4)), *(each.boxes for each in own)])
        steps = np.repeat(np.arange(len(own)), [len(each.boxes) for each in own])
        views.append(BoxesOfCamera(camera, boxes, steps))
    expected, met = np.zeros((C, C)), np.zeros((C, C))
    for a, view in enumerate(views):
        step = max(1, -(-len(view.boxes) // MAX_PEOPLE))
        view = view._replace(boxes=view.boxes[::step], steps=view.steps[::step])
        people = located(view, person_height)
        known = np.isfinite(people).all(axis=1)
        when = times[a][view.steps[known]]
        for b, other in enumerate(views):
            if b == a or len(times[b]) < 2:
                continue
            nearest = np.clip(np.searchsorted(times[b], when), 1, len(times[b]) - 1)
            nearest -= when - times[b][nearest - 1] < times[b][nearest] - when
            boxes = projected_people(other.camera, people[known])
            seen = in_image(boxes, other.size) & (np.abs(times[b][nearest] - when) <= np.median(np.diff(times[b])))
            expected[a, b] = np.count_nonzero(seen)
            overlap = overlaps_at(boxes[seen], nearest[seen], other, len(times[b]))
            met[a, b] = np.count_nonzero(overlap >= MIN_OVERLAP)
    return expected, met
