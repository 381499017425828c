"""What is checked of detections: each check on clean boxes, and on boxes with the fault that it is for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from people_boxes import SIZE, STEP_NS, boxes, hall

from occlog.measure.detect.checks import Checked
from occlog.measure.detect.from_boxes import detect_boxes
from occlog.records.tables import Boxes

SCENE = hall("abc")


def found(given: Boxes) -> dict[str, tuple[str, ...]]:
    """Sensors by the id of what is found."""
    checked = Checked(SCENE)
    for part in detect_boxes([given], SCENE):
        checked.add(part.views)
    frames = {name: len(np.unique(given.t_ns[given.sensor == name])) for name in "abc"}
    return {check.id: check.sensors for check in checked.checks(frames) if check.found}


@pytest.mark.parametrize(("people", "px"), [(1, 0.0), (4, 3.0), (7, 1.5)])
def test_nothing_is_found_in_clean_boxes(people: int, px: float) -> None:
    for seed in range(3):
        assert found(boxes(SCENE, 10.0, people=people, px=px, seed=seed, miss=0.1 * seed)) == {}


def without(given: Boxes, name: str) -> Boxes:
    """The boxes, with frames of one camera without any."""
    empty = given.sensor == name
    gone = {key: np.where(empty, np.nan, getattr(given, key)) for key in ("left_px", "top_px", "width_px")}
    gone |= {key: np.where(empty, np.nan, getattr(given, key)) for key in ("height_px", "confidence")}
    first = np.concatenate([[True], np.diff(given.t_ns) != 0]) | (given.sensor != np.roll(given.sensor, 1))
    box = np.where(empty, np.int32(-1), given.box)
    return replace(given, box=box, target_id=box, **gone).take(~empty | first)


def test_a_camera_that_detects_no_one_is_named() -> None:
    assert found(without(boxes(SCENE, 10.0), "b")) == {"no-detections": ("b",)}


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_false_box_that_stays_is_named(seed: int) -> None:
    clean = boxes(SCENE, 10.0, seed=seed)
    frames = np.arange(100)
    edges = np.random.default_rng(seed).normal([300, 200, 40, 110], 1.5, (100, 4)).T
    still = Boxes.of(
        t_ns=frames * STEP_NS,
        sensor=np.full(100, "c"),
        frame=frames,
        box=np.full(100, 50, dtype=np.int32),
        target_id=np.full(100, -1, dtype=np.int32),
        left_px=edges[0],
        top_px=edges[1],
        width_px=edges[2],
        height_px=edges[3],
        confidence=np.full(100, 0.9),
    )
    assert found(Boxes.merge([clean, still.take(frames % 33 != 0)])) == {"static-detection": ("c",)}


def test_boxes_outside_the_image_are_reported() -> None:
    clean = boxes(SCENE, 10.0)
    moved = replace(clean, left_px=clean.left_px + np.where(clean.sensor == "a", 0.5 * SIZE[0], 0.0))
    assert found(moved) == {"boxes-outside-image": ("a",)}
