"""People of two colours, front and back, who walk back and forth before a camera; drawn as upright ellipses."""

from __future__ import annotations

import numpy as np

from occlog.core.geometry.camera import rotation_from_angles
from occlog.io.files.provenance import Provenance
from occlog.io.frames.codec import encode_image
from occlog.io.recording.writer import RecordingWriter
from occlog.measure.appearance.sightings import expected_boxes
from occlog.records.scene import Camera, Scene
from occlog.records.tables import Boxes, Truth, TruthBoxes

RED, GREEN, BLUE = (40, 30, 220), (40, 200, 30), (220, 60, 30)
STEP = 100_000_000
HEIGHT = 1.7
CAMERA = Camera(
    "hall",
    np.array([0.0, 0.0, 2.0]),
    rotation_from_angles(0.0, -0.15, 0.0),
    np.array([160.0, 160.0]),
    np.array([99.5, 74.5]),
    image_size=(200, 150),
)
SCENE = Scene(cameras=(CAMERA,), length_unit="m")
DRESSED = {0: (RED, GREEN), 1: (GREEN, RED)}
"""Front and back: from all sides together the two are alike."""


def places(steps: int, numbers=(0, 1)) -> np.ndarray:
    """(steps, n, 2) side by side; they come nearer for half of the time and then go away."""
    half = steps // 2
    x = np.concatenate([9.0 - 0.1 * np.arange(half), 9.1 - 0.1 * half + 0.1 * np.arange(steps - half)])
    return np.stack([np.column_stack([x + 0.3 * n, np.full(steps, 1.2 - 2.4 * n)]) for n in numbers], axis=1)


def truth(steps: int, numbers=(0, 1)) -> Truth:
    """Where they truly are."""
    xy = places(steps, numbers)
    return Truth.of(
        t_ns=np.repeat(np.arange(steps) * STEP, len(numbers)),
        target_id=np.tile(np.array(numbers), steps),
        role=["target"] * (steps * len(numbers)),
        x=xy[..., 0].ravel(),
        y=xy[..., 1].ravel(),
        z=np.full(steps * len(numbers), np.nan),
    )


def frames(steps: int, dressed=None, numbers=(0, 1)):
    """Images (steps, 150, 200, 3) and boxes (steps, n, 4) left, top, right, bottom."""
    dressed = DRESSED if dressed is None else dressed
    rows, columns = np.mgrid[0:150, 0:200]
    images, boxes = [], []
    for k, xy in enumerate(places(steps, numbers)):
        image = np.full((150, 200, 3), 128, dtype=np.uint8)
        edges = expected_boxes(CAMERA, xy, HEIGHT)
        side = 0 if k < steps // 2 else 1
        for number, (left, top, right, bottom) in zip(numbers, edges.tolist(), strict=True):
            x, y = (2 * columns - left - right) / (right - left), (2 * rows - top - bottom) / (bottom - top)
            image[x**2 + y**2 <= 1] = dressed[number][side]
        images.append(image)
        boxes.append(edges)
    return np.array(images), np.array(boxes)


def box_table(edges: np.ndarray, identity, table=Boxes):
    """A table of boxes (steps, n, 4); identities (n,)."""
    steps, n = edges.shape[:2]
    flat = edges.reshape(-1, 4)
    return table.of(
        t_ns=np.repeat(np.arange(steps) * STEP, n),
        sensor=["hall"] * (steps * n),
        frame=np.repeat(np.arange(steps), n),
        box=np.tile(np.arange(n), steps),
        target_id=np.tile(np.array(identity), steps),
        left_px=flat[:, 0],
        top_px=flat[:, 1],
        width_px=flat[:, 2] - flat[:, 0],
        height_px=flat[:, 3] - flat[:, 1],
        confidence=np.full(steps * n, np.nan),
    )


def write(path, steps=40, *, dressed=None, numbers=(0, 1), true=True, images=True, identity=None) -> None:
    """A recording: frames, boxes (true ones, or of a detector), and where everybody is if `true`."""
    pictures, edges = frames(steps, dressed, numbers)
    table = box_table(edges, numbers if identity is None else identity, TruthBoxes if true else Boxes)
    with RecordingWriter(path, SCENE, Provenance("test")) as writer:
        for k, picture in enumerate(pictures):
            if images:
                writer.image("hall", k * STEP, k, encode_image(picture, "png", 0), "png")
        writer.table(table)
        if true:
            writer.table(truth(steps, numbers))
