"""Ellipses in an image as states of trackers, [Qu] Sec. 3.1: size in a direction, neighbours, pixels inside.

An ellipse is a row (cx, cy, a, b, rho): centre [px], half axes a and b [px] and the angle
rho [rad] of axis a, from +x (to the right) to +y (down).  The axes may come in any order.
Pixel centres are at whole numbers.  `occlog.track.images.kernels.ellipse_colour`
compares the colours inside.
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.core.numerics.jit import kernel

CLOSE = 1.5
"""Targets are close when their centres are this many times nearer than touching ones."""

LARGEST = 1e4
"""Half axes above this [px] are not those of a thing in an image: such an ellipse holds nothing."""


def support_radius(ellipses: Floats, theta: Floats | float) -> Floats:
    """How far ellipses (..., 5) reach from their centre in direction theta [rad], measured along it [px].

    This is the support function sqrt(a^2 cos^2 + b^2 sin^2) of the angle to axis a: a line
    across theta at that distance touches the ellipse.
    """
    e = np.asarray(ellipses, dtype=np.float64)
    turn = np.asarray(theta, dtype=np.float64) - e[..., 4]
    return np.asarray(np.hypot(e[..., 2] * np.cos(turn), e[..., 3] * np.sin(turn)))


def nearness(ellipses: Floats) -> Floats:
    """Distances of centres over the sum of the support radii along the line between them.

    Args:
        ellipses: (N, 5).

    Returns:
        (N, N), symmetric: at most 1 = touching, at most `CLOSE` = close; inf on the diagonal
        and for a NaN ellipse.
    """
    e = np.asarray(ellipses, dtype=np.float64)
    ratio = nearness_between(e, e)
    np.fill_diagonal(ratio, np.inf)
    return np.minimum(ratio, ratio.T)  # both are the same but for rounding


def nearness_between(a: Floats, b: Floats) -> Floats:
    """(N, M) the same of ellipses a (N, 5) with ellipses b (M, 5); inf for a NaN ellipse."""
    dx, dy = b[None, :, 0] - a[:, None, 0], b[None, :, 1] - a[:, None, 1]
    theta = np.arctan2(dy, dx)
    reach = support_radius(a[:, None, :], theta) + support_radius(b[None, :, :], theta)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.hypot(dx, dy) / reach
    return np.where(np.isnan(ratio), np.inf, ratio)


def touching(ellipses: Floats) -> Bools:
    """(N, N) whether ellipses touch or overlap: d <= r_i + r_j; false on the diagonal."""
    return np.asarray(nearness(ellipses) <= 1.0)


@kernel
def quadratic(a: float, b: float, rho: float) -> tuple[float, float, float]:
    """A, B, C of the squared ellipse distance q = A dx^2 + 2 B dx dy + C dy^2, which is 1 on the ellipse."""
    c, s = math.cos(rho), math.sin(rho)
    ia, ib = 1.0 / (a * a), 1.0 / (b * b)
    return c * c * ia + s * s * ib, c * s * (ia - ib), s * s * ia + c * c * ib


@kernel
def holds_pixels(ellipse: Floats) -> bool:
    """Whether the numbers (5,) are an ellipse of a size that can be in an image."""
    a, b = ellipse[2], ellipse[3]
    if not (math.isfinite(ellipse[0]) and math.isfinite(ellipse[1]) and math.isfinite(ellipse[4])):
        return False
    return bool(0.0 < a <= LARGEST and 0.0 < b <= LARGEST and abs(ellipse[0]) < 1e7 and abs(ellipse[1]) < 1e7)


@kernel
def row_limits(cy: float, a: float, b: float, rho: float) -> tuple[int, int]:
    """First and last row that meet an ellipse for which `holds_pixels`; first > last: none."""
    reach = math.hypot(a * math.sin(rho), b * math.cos(rho))
    return math.ceil(cy - reach), math.floor(cy + reach)


@kernel
def column_limits(cx: float, dy: float, a: float, b: float, c: float) -> tuple[int, int]:
    """First and last column inside an ellipse in one row; first > last where the row misses it.

    Args:
        cx: column of the centre.
        dy: the row minus the row of the centre.
        a: A of `quadratic`.
        b: B.
        c: C.
    """
    root = b * b * dy * dy - a * (c * dy * dy - 1.0)
    if root < 0.0:
        return 1, 0
    half, middle = math.sqrt(root) / a, cx - b * dy / a
    return math.ceil(middle - half), math.floor(middle + half)
