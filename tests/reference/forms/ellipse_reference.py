"""Ellipses in an image pixel by pixel."""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats, Ints


def ellipse_distance(ellipse: Floats, x: Floats, y: Floats) -> Floats:
    """Squared distances of points from the centre of an ellipse (5,), in units of the ellipse: 1 on its outline."""
    c, s = math.cos(ellipse[4]), math.sin(ellipse[4])
    dx, dy = x - ellipse[0], y - ellipse[1]
    return ((c * dx + s * dy) / ellipse[2]) ** 2 + ((-s * dx + c * dy) / ellipse[3]) ** 2


def pixels_inside(ellipse: Floats, step: int = 1) -> Ints:
    """(K, 2) columns and rows, multiples of `step`, of the pixels in an ellipse: every pixel around it is tested."""
    reach = max(ellipse[2], ellipse[3]) + 1
    first, last = np.floor(ellipse[:2] - reach).astype(int), np.ceil(ellipse[:2] + reach).astype(int)
    x, y = np.meshgrid(np.arange(first[0], last[0] + 1), np.arange(first[1], last[1] + 1))
    inside = (ellipse_distance(ellipse, x, y) <= 1.0) & (x % step == 0) & (y % step == 0)
    return np.column_stack([x[inside], y[inside]])
