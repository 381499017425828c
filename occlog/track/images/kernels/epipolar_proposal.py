"""Particles drawn on epipolar lines: the proposal of the colour-based multicamera tracker of [Qu] Sec. 4.2."""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.jit import kernel

from .epipolar_bands import anchor, line_of, reach_across


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
    """Move some particles near the epipolar lines of the target's counterparts, to one line after the other in turn.

    They are spread about the point of the line that is nearest to the estimate.  A tracker
    without such a line keeps its particles.

    Args:
        particles: (n, N, 5).
        estimate: (n, 5) where the targets should be now.
        affine: (n, 2, 3), see `bands`.
        view: (n,).
        counterpart: (n, V) tracker of the same target in another view; -1: none.
        fundamental: (V, V, 3, 3).
        bottom: which point of an ellipse stands for the target.
        count: (n,) how many of the particles are moved, 0 to N.
        along: standard deviation along the line [px].
        across: standard deviation across it, over the ellipse's reach across it.
        normals: (n, N, 2) standard normal numbers.

    Returns:
        (n, N, 5).
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
    """Set the first rows of `lines` (V, 3) to the epipolar lines of a tracker's counterparts; return their number."""
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
