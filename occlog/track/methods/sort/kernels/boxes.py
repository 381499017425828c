"""Boxes and their states: centre, logarithm of the height, ratio of width to height; overlaps and visible shares."""

from __future__ import annotations

from typing import Final

import numpy as np

from occlog.array_types import Floats

X, Y, LOG_HEIGHT, ASPECT = range(4)
"""Columns of a state: centre [px], ln of the height [px], width over height."""
MIN_ASPECT: Final = 0.05
"""Smallest ratio of width to height."""
NEARER_HEIGHTS: Final = 0.05
"""Difference of lower edges, in box heights, at which it is known which of two people is nearer."""


def states_of(boxes: Floats) -> Floats:
    """Return the states (N, 4) of boxes (N, 4) left, top, right, bottom [px] of positive size.

    Columns are centre [px], ln of the height [px], and width over height.
    """
    left, top, right, bottom = boxes.T
    height = bottom - top
    return np.column_stack([0.5 * (left + right), 0.5 * (top + bottom), np.log(height), (right - left) / height])


def boxes_of(states: Floats) -> Floats:
    """Return the boxes (N, 4) left, top, right, bottom [px] of `states` (N, 4).

    A state is centre x and y [px], ln of the height [px], width / height, which counts as at least `MIN_ASPECT`.
    """
    height = np.exp(states[:, LOG_HEIGHT])
    half = 0.5 * np.column_stack([height * np.maximum(states[:, ASPECT], MIN_ASPECT), height])
    centre = states[:, :2]
    return np.concatenate([centre - half, centre + half], axis=1)


def areas(boxes: Floats) -> Floats:
    """Return (N,) areas [px^2] of boxes (N, 4): left, top, right, bottom [px]."""
    out: Floats = np.prod(boxes[:, 2:] - boxes[:, :2], axis=1)
    return out


def intersections(a: Floats, b: Floats) -> Floats:
    """Return (N, M) areas [px^2] that boxes `a` (N, 4) and boxes `b` (M, 4) have in common."""
    low = np.maximum(a[:, None, :2], b[None, :, :2])
    high = np.minimum(a[:, None, 2:], b[None, :, 2:])
    out: Floats = np.prod(np.maximum(high - low, 0.0), axis=2)
    return out


def overlaps(a: Floats, b: Floats) -> Floats:
    """Return (N, M) intersection over union of boxes `a` (N, 4) and boxes `b` (M, 4), 0 to 1."""
    shared = intersections(a, b)
    out: Floats = shared / (areas(a)[:, None] + areas(b)[None, :] - shared)
    return out


def inside_shares(boxes: Floats, size: tuple[float, float]) -> Floats:
    """Return (N,) shares of the areas of `boxes` (N, 4) inside an image of `size`, width and height [px]."""
    image = np.array([[0.0, 0.0, size[0], size[1]]])
    out: Floats = intersections(boxes, image)[:, 0] / areas(boxes)
    return out


def visible_shares(boxes: Floats, weights: Floats) -> Floats:
    """Return (N,) expected share of each box that no nearer box covers; the person with the lower feet is nearer.

    Covers count as independent, so that of two equal ones the second hides less.

    Args:
        boxes: (N, 4) left, top, right, bottom [px].
        weights: (N,) probability that the person of a box is there.
    """
    height = boxes[:, 3] - boxes[:, 1]
    lower = (boxes[None, :, 3] - boxes[:, None, 3]) / (NEARER_HEIGHTS * height[:, None])
    nearer = 1.0 / (1.0 + np.exp(-np.clip(lower, -30.0, 30.0)))
    covered = intersections(boxes, boxes) / areas(boxes)[:, None] * nearer * weights[None, :]
    np.fill_diagonal(covered, 0.0)
    out: Floats = np.prod(1.0 - np.clip(covered, 0.0, 1.0), axis=1)
    return out
