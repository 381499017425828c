"""Of which track a box is, and whether a nearer person covers it."""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.assignment import assign
from occlog.records.scene import Camera

WIDTH = 0.3
"""Of an upright person, as a share of the height."""
AROUND = np.stack([np.cos(np.arange(8) * np.pi / 4), np.sin(np.arange(8) * np.pi / 4)], axis=-1)


def expected_boxes(camera: Camera, xy: Floats, height: float) -> Floats:
    """(K, 4) left, top, right, bottom [px] of upright people at (K, 2); NaN for those not wholly in front.

    A person is a cylinder on the floor, `WIDTH` as wide as high.
    """
    ring = xy[:, None] + 0.5 * WIDTH * height * AROUND
    rows = [np.concatenate([ring, np.full((*ring.shape[:2], 1), z)], axis=2) for z in (0.0, height)]
    points = np.concatenate(rows, axis=1)
    pixels: Floats = camera.project(points.reshape(-1, 3)).reshape(len(xy), -1, 2)
    return np.asarray(np.concatenate([pixels.min(axis=1), pixels.max(axis=1)], axis=1))


def overlaps(a: Floats, b: Floats) -> Floats:
    """(n, K) areas that boxes (n, 4) and (K, 4), as left, top, right, bottom, share; 0 where one is NaN."""
    corner = np.minimum(a[:, None, 2:], b[None, :, 2:]) - np.maximum(a[:, None, :2], b[None, :, :2])
    return np.asarray(np.nan_to_num(np.prod(np.maximum(corner, 0.0), axis=2)))


def areas(boxes: Floats) -> Floats:
    """(n,) areas of boxes (n, 4)."""
    return np.asarray((boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1]))


def tracks_of_boxes(boxes: Floats, expected: Floats, least_overlap: float) -> Ints:
    """(n,) place of the track of each box, -1 for none: one to one, the greatest sum of intersections over union.

    Args:
        boxes: (n, 4) of one frame.
        expected: (K, 4) of the tracks; NaN: not in the image.
        least_overlap: intersection over union of a box and its track.
    """
    out = np.full(len(boxes), -1, dtype=np.int64)
    shared = overlaps(boxes, expected)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = shared / (areas(boxes)[:, None] + areas(expected)[None, :] - shared)
    row, column = assign(1.0 - np.nan_to_num(share), 1.0 - least_overlap)
    out[row] = column
    return out


def covered(boxes: Floats) -> Floats:
    """(n,) greatest share of each box that a box of somebody nearer covers; who stands lower in the image is nearer."""
    nearer = boxes[None, :, 3] > boxes[:, None, 3]
    share = np.where(nearer, overlaps(boxes, boxes), 0.0) / areas(boxes)[:, None]
    return np.asarray(share.max(axis=1, initial=0.0))
