"""Overlaps of people located by one camera with the boxes of another."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.array_types import Floats
from occlog.core.geometry.camera import rotation_from_angles
from occlog.records.scene import Camera
from occlog.track.people.camera_checks.pair_overlap import (
    BoxesOfCamera,
    Overlap,
    PairOverlaps,
    in_image,
    located,
    projected_people,
)

STEPS, HEIGHT = 12, 1.7


def views() -> list[BoxesOfCamera]:
    """Three cameras with noisy boxes of five people at random places, of which each camera misses some."""
    rng = np.random.default_rng(3)
    out = []
    states = np.column_stack(
        [rng.uniform(2.0, 6.0, 5 * STEPS), rng.uniform(1.5, 4.5, 5 * STEPS), np.full(5 * STEPS, HEIGHT)]
    )
    states = np.column_stack([states, np.full(5 * STEPS, 0.5)])
    for n, (x, y, yaw) in enumerate(((0.0, 0.0, 40.0), (8.0, 0.0, 140.0), (8.0, 6.0, 215.0))):
        camera = Camera(
            name=f"cam{n + 1}",
            position=np.array([x, y, 2.5]),
            rotation=rotation_from_angles(np.radians(yaw), np.radians(-20.0), 0.0),
            focal_px=np.array([700.0, 700.0]),
            principal_px=np.array([640.0, 360.0]),
            image_size=(1280, 720),
        )
        boxes = projected_people(camera, states) + rng.normal(0.0, 4.0, (len(states), 4))
        own = in_image(boxes, np.array([1280.0, 720.0])) & (rng.random(len(boxes)) < 0.8)
        out.append(BoxesOfCamera(camera, boxes[own], np.repeat(np.arange(STEPS), 5)[own]))
    return out


def largest(box: Floats, others: Floats) -> float:
    """Largest intersection over union of a box (4,) with others (n, 4)."""
    best = 0.0
    for other in others:
        width = min(box[2], other[2]) - max(box[0], other[0])
        height = min(box[3], other[3]) - max(box[1], other[1])
        common = max(width, 0.0) * max(height, 0.0)
        areas = sum((each[2] - each[0]) * (each[3] - each[1]) for each in (box, other))
        best = max(best, common / (areas - common))
    return best


def by_loops(source: BoxesOfCamera, target: BoxesOfCamera) -> list[tuple[int, float, float]]:
    """Step, overlap and overlap by chance of each person whom `source` locates in the image of `target`."""
    out = []
    frames = np.unique(target.steps)
    for person, step in zip(located(source, HEIGHT), source.steps.tolist(), strict=True):
        box = projected_people(target.camera, person[None])[0]
        if step in frames and np.isfinite(person).all() and in_image(box[None], target.size)[0]:
            later = frames[(np.searchsorted(frames, step) + len(frames) // 2) % len(frames)]
            out.append((step, *(largest(box, target.boxes[target.steps == t]) for t in (step, later))))
    return out


def test_overlaps_are_those_of_each_person_with_each_box() -> None:
    given = views()
    found = PairOverlaps(given, STEPS, HEIGHT).overlap([0], {}, [1])
    want = np.array(by_loops(given[0], given[1]) + by_loops(given[1], given[0]))
    assert len(want) > 60
    np.testing.assert_array_equal(found.steps, want[:, 0])
    np.testing.assert_allclose(found.met, want[:, 1], rtol=1e-12)
    np.testing.assert_allclose(found.chance, want[:, 2], rtol=1e-12)


def equal(a: Overlap, b: Overlap) -> bool:
    return all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


@pytest.mark.parametrize("change", ["boxes", "camera", "size", "exchange"])
def test_overlaps_of_changed_cameras_do_not_depend_on_earlier_comparisons(change: str) -> None:
    given = views()
    own = given[1]
    changed = {
        "boxes": {1: own._replace(boxes=0.5 * own.boxes)},
        "camera": {1: own._replace(camera=given[2].camera)},
        "size": {1: own._replace(boxes=own.boxes[::2], steps=own.steps[::2])},
        "exchange": {1: own.with_boxes_of(given[0]), 0: given[0].with_boxes_of(own)},
    }[change]
    pairs = PairOverlaps(given, STEPS, HEIGHT)
    before = pairs.of_each()
    found = pairs.overlap(changed, changed)
    now = [changed.get(c, view) for c, view in enumerate(given)]
    assert equal(found, PairOverlaps(now, STEPS, HEIGHT).overlap(changed, {}))
    assert not equal(found, pairs.overlap(changed, {}))
    assert all(equal(*each) for each in zip(before, pairs.of_each(), strict=True))
