"""What epipolar lines say of ellipses: bands for particles and the loop check, [Qu] Secs. 3.2 and 3.4.2, and draws.

The point of an ellipse that represents the target is its centre, or its lowest point where
people stand.  Each tracker has an affine map (2, 3) from recorded pixels to those of a camera
without distortion, which is the distortion linearised at the target.  `drawn_on_lines` is the
proposal of the colour-based multicamera tracker that [Qu] Sec. 4.2 compares with.
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel

UNKNOWN, APART, TOGETHER = -1, 0, 1
"""Outcomes of `loop_check`: it cannot be made, it fails, it holds."""


@kernel
def anchor(ellipse: Floats, affine: Floats, bottom: bool) -> tuple[float, float]:
    """Return the reference point (x, y) of an ellipse, its centre or lowest point, in undistorted pixels.

    Args:
        ellipse: (5,) centre and half axes [px], angle of the first axis [rad], in recorded pixels.
        affine: (2, 3) transformation of the ellipse's tracker from recorded to undistorted pixels.
        bottom: whether it is the lowest point; else the centre.
    """
    x, y = ellipse[0], ellipse[1]
    if bottom:
        # Where the tangent is horizontal
        a, b = ellipse[2], ellipse[3]
        s, c = math.sin(ellipse[4]), math.cos(ellipse[4])
        down = math.hypot(a * s, b * c)
        x, y = x + (a * a - b * b) * s * c / down, y + down
    px = affine[0, 0] * x + affine[0, 1] * y + affine[0, 2]
    return px, affine[1, 0] * x + affine[1, 1] * y + affine[1, 2]


@kernel
def line_of(matrix: Floats, x: float, y: float) -> tuple[float, float, float]:
    """Return the epipolar line F (x, y, 1) = (l1, l2, l3) of an undistorted pixel, scaled to l1^2 + l2^2 = 1.

    F is the fundamental `matrix` (3, 3) from the pixel's view to the line's. NaN at the epipole or for an unknown
    matrix.
    """
    l1 = matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2]
    l2 = matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2]
    l3 = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2]
    norm = math.hypot(l1, l2)
    if not norm > 0.0:
        return np.nan, np.nan, np.nan
    return l1 / norm, l2 / norm, l3 / norm


@kernel
def reach_across(ellipse: Floats, l1: float, l2: float) -> float:
    """Return the support radius [px] of an ellipse (5,) along the unit vector (l1, l2), the normal of an epipolar line.

    It is half the length of the ellipse's projection onto the normal, and the half width of the line's band.
    """
    turn = math.atan2(l2, l1) - ellipse[4]
    return math.hypot(ellipse[2] * math.cos(turn), ellipse[3] * math.sin(turn))


@kernel
def add_band(
    log_weights: Floats, particles: Floats, affine: Floats, bottom: bool, line: tuple[float, float, float], sigma: float
) -> None:
    """Add, in place, the log weights of the distances of particles from an epipolar line, [Qu] Eq. 5.

    The weight is exp(-d^2 / (2 sigma^2)), without a constant, with the distance d of a particle's reference point from
    the line.

    Args:
        log_weights: (N,) changed in place.
        particles: (N, 5) ellipses of one tracker.
        affine: (2, 3) transformation of the tracker from recorded to undistorted pixels.
        bottom: the reference points are the lowest points of ellipses; else their centres.
        line: (l1, l2, l3) with unit normal (l1, l2), the middle of the epipolar band.
        sigma: standard deviation of the distance from the line [px], > 0.
    """
    scale = 0.5 / (sigma * sigma)
    for p in range(particles.shape[0]):
        x, y = anchor(particles[p], affine, bottom)
        d = line[0] * x + line[1] * y + line[2]
        log_weights[p] -= scale * d * d


@kernel
def loop_check(
    estimate: Floats, affine: Floats, view: Ints, counterpart: Ints, fundamental: Floats, bottom: bool
) -> Ints:
    """Check whether each tracker and its counterparts lie on each other's epipolar band, [Qu] Sec. 3.4.2.

    A counterpart is the tracker of the same target in another view.

    Args:
        estimate: (n, 5) estimated ellipses of the trackers.
        affine: (n, 2, 3) transformations of the trackers from recorded to undistorted pixels.
        view: (n,) view of each tracker.
        counterpart: (n, V) row of the tracker of the same target in each other view; -1: none.
        fundamental: (V, V, 3, 3), [a, b] from view a to lines in view b.
        bottom: compare the lowest points of ellipses with epipolar lines; else their centres.

    Returns:
        (n, V): `TOGETHER` when both points are at most the support radius of their ellipse from their line, `APART`
        when one is farther, `UNKNOWN` without counterpart, matrix or line.
    """
    n, views = counterpart.shape
    out = np.full((n, views), UNKNOWN, dtype=np.int64)
    for i in range(n):
        xi, yi = anchor(estimate[i], affine[i], bottom)
        for v in range(views):
            j = counterpart[i, v]
            if j < 0:
                continue
            xj, yj = anchor(estimate[j], affine[j], bottom)
            there, here = line_of(fundamental[view[i], v], xi, yi), line_of(fundamental[v, view[i]], xj, yj)
            if math.isnan(there[0]) or math.isnan(here[0]):
                continue
            far_i = abs(here[0] * xi + here[1] * yi + here[2]) > reach_across(estimate[i], here[0], here[1])
            far_j = abs(there[0] * xj + there[1] * yj + there[2]) > reach_across(estimate[j], there[0], there[1])
            out[i, v] = APART if far_i or far_j else TOGETHER
    return out


def hysteresis(check: Ints, good: Bools, streak: Ints, bad_after: int, good_after: int) -> tuple[Bools, Ints]:
    """Change the good or bad status of counterparts when enough loop checks in a row contradict it.

    Args:
        check: outcomes of `loop_check`, of any shape.
        good: status before the check; of that shape.
        streak: number of checks in a row that contradicted the status; of that shape.
        bad_after: number of failed checks in a row at which a good counterpart becomes bad.
        good_after: number of passed checks in a row at which a bad counterpart becomes good.

    Returns:
        `good` and `streak` after the check; an unknown outcome changes neither.
    """
    known = check != UNKNOWN
    against = known & ((check == TOGETHER) != good)
    longer = np.where(against, streak + 1, np.where(known, 0, streak))
    flip = against & (longer >= np.where(good, bad_after, good_after))
    return np.where(flip, ~good, good), np.where(flip, 0, longer)


@kernel
def drawn_on_lines(
    particles: Floats,
    estimate: Floats,
    affine: Floats,
    view: Ints,
    counterpart: Ints,
    fundamental: Floats,
    bottom: bool,
    count: Ints,
    along: float,
    across: float,
    normals: Floats,
) -> Floats:
    """Return particles, some of which are moved near the epipolar lines of the tracker's counterparts, in turn.

    Moved ones are normally distributed about the point of the line nearest to the estimate; only their centres change.
    A tracker without such a line keeps its particles.

    Args:
        particles: (n, N, 5) ellipses, N particles of each tracker.
        estimate: (n, 5) ellipses expected in this frame.
        affine: (n, 2, 3) transformations of the trackers from recorded to undistorted pixels.
        view: (n,) view of each tracker.
        counterpart: (n, V) row of the tracker of the same target in another view; -1: none.
        fundamental: (V, V, 3, 3) fundamental matrices, [a, b] from view a to lines in view b.
        bottom: the lowest point of an ellipse is moved to the line; else its centre.
        count: (n,) how many of the particles are moved, 0 to N.
        along: standard deviation along the line [px].
        across: standard deviation across it, as a multiple of the support radius of the estimate in that direction.
        normals: (n, N, 2) standard normal numbers.

    Returns:
        (n, N, 5) ellipses.
    """
    out = particles.copy()
    lines = np.empty((counterpart.shape[1], 3))
    for i in range(particles.shape[0]):
        known = lines_into(lines, i, estimate, affine, view, counterpart, fundamental, bottom)
        x0, y0 = anchor(estimate[i], affine[i], bottom)
        for p in range(count[i] if known > 0 else 0):
            l1, l2, l3 = lines[p % known]
            # From the estimate's point to the line, off it by noise, and along it by noise
            off = across * reach_across(estimate[i], l1, l2) * normals[i, p, 1] - (l1 * x0 + l2 * y0 + l3)
            x, y = anchor(out[i, p], affine[i], bottom)
            dx = x0 + off * l1 - along * normals[i, p, 0] * l2 - x
            dy = y0 + off * l2 + along * normals[i, p, 0] * l1 - y
            # Back through the affine map to recorded pixels
            a, b, c, d = affine[i, 0, 0], affine[i, 0, 1], affine[i, 1, 0], affine[i, 1, 1]
            area = a * d - b * c
            out[i, p, 0] += (d * dx - b * dy) / area
            out[i, p, 1] += (a * dy - c * dx) / area
    return out


@kernel
def lines_into(
    lines: Floats,
    i: int,
    estimate: Floats,
    affine: Floats,
    view: Ints,
    counterpart: Ints,
    fundamental: Floats,
    bottom: bool,
) -> int:
    """Write the epipolar lines of a tracker's counterparts to the first rows of `lines`, and return their number.

    Args:
        lines: (V, 3) changed in place; a line is (l1, l2, l3) of unit normal (l1, l2), in undistorted pixels.
        i: row of the tracker.
        estimate: (n, 5) estimated ellipses of the trackers.
        affine: (n, 2, 3) from recorded to undistorted pixels.
        view: (n,) view of each tracker.
        counterpart: (n, V) tracker of the same target in another view; -1: none.
        fundamental: (V, V, 3, 3), [a, b] from view a to lines in view b.
        bottom: the lowest point of an ellipse represents the target; else its centre.
    """
    known = 0
    for v in range(counterpart.shape[1]):
        j = counterpart[i, v]
        if j < 0:
            continue
        x, y = anchor(estimate[j], affine[j], bottom)
        line = line_of(fundamental[v, view[i]], x, y)
        if not math.isnan(line[0]):
            lines[known, 0], lines[known, 1], lines[known, 2] = line
            known += 1
    return known
