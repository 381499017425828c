"""Colours inside many ellipses at once: weighted histograms and their likenesses, the p_c of [Qu] Sec. 3.3.

The image comes as a map of bin numbers, made once a frame (`occlog.core.image.histogram_bins`).  A
pixel at squared ellipse distance q weighs 1 - q (Epanechnikov).  The sums are divided by
the weight of all pixels of the ellipse, those off the image included, so that the
histogram of an ellipse that reaches over the edge sums to less than 1 and is less alike.

A target's colours are those of the whole ellipse, or of its upper and lower half apart.  People
wear other colours above than below; with one histogram for both an ellipse may slide down or
over to a neighbour without looking any different.  A ball rolls and has no such order.
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Bools, Bytes, Floats, Ints
from occlog.core.image.ellipse import column_limits, holds_pixels, quadratic, row_limits
from occlog.core.image.histogram_bins import N_BINS
from occlog.core.numerics.jit import array_kernel, kernel

TWO, THREE, FOUR = np.uint64(2), np.uint64(3), np.uint64(4)

WHOLE, ABOVE, BELOW = 0, 1, 2
"""Parts of an ellipse."""

_SLOTS = 256
"""Length of the sums: bin numbers are bytes, so that no number in a map is out of bounds."""


@array_kernel
def _weigh(sums: Floats, weights: Floats, bins: Bytes, ellipse: Floats, step: int, half: int) -> float:
    """Add the weights 1 - q of the pixels of an ellipse to the sums of their bins.

    Four neighbours at a time, which mostly share a bin, go to four sums: no addition waits
    for another.  The weights of a row are worked out together before that.  Everything is in
    one function, because slices of rows would take half of the time.

    Args:
        sums: (4, 256) added to.
        weights: (W,) space for the weights of a row.
        bins: (H, W).
        ellipse: (5,).
        step: see `colours_in`.
        half: `ABOVE` its centre only, `BELOW` and level with it only, or `WHOLE`.

    Returns:
        The weight of all its pixels there, those off the image included.
    """
    mass = 0.0
    if not holds_pixels(ellipse):
        return mass
    # In units of the step every whole number is a pixel that counts, and no row needs a division of whole numbers.
    unit, cx, cy = 1.0 / step, ellipse[0] / step, ellipse[1] / step
    highest, rightmost = (bins.shape[0] - 1) // step, (bins.shape[1] - 1) // step
    one, two, three, four = sums[0], sums[1], sums[2], sums[3]
    a, b, c = quadratic(unit * ellipse[2], unit * ellipse[3], ellipse[4])
    first, last = row_limits(cy, unit * ellipse[2], unit * ellipse[3], ellipse[4])
    if half == ABOVE:
        last = min(last, math.ceil(cy) - 1)
    elif half == BELOW:
        first = max(first, math.ceil(cy))
    for y in range(first, last + 1):
        dy = y - cy
        left, right = column_limits(cx, dy, a, b, c)
        if left > right:
            continue
        # The weight rest - across dx - a dx^2 of the whole row: a sum over an arithmetic sequence of dx
        rest, across = 1.0 - c * dy * dy, 2.0 * b * dy
        n, mean = float(right - left + 1), 0.5 * (left + right) - cx
        mass += n * (rest - across * mean - a * (mean * mean + (n * n - 1.0) / 12.0))
        start, count = max(left, 0), min(right, rightmost) - max(left, 0) + 1
        if y < 0 or y > highest or count < 1:
            continue
        for i in range(count):
            dx = start - cx + i
            weights[i] = rest - dx * (across + a * dx)
        # Whole numbers without a sign spare the check for indices below 0.
        row, x, gap = np.uint64(y * step), np.uint64(start * step), np.uint64(step)
        for i in range(0, count - 3, 4):
            one[bins[row, x]] += weights[i]
            two[bins[row, x + gap]] += weights[i + 1]
            three[bins[row, x + TWO * gap]] += weights[i + 2]
            four[bins[row, x + THREE * gap]] += weights[i + 3]
            x += FOUR * gap
        for i in range(count & ~3, count):
            one[bins[row, x]] += weights[i]
            x += gap
    return mass


WIDTH = 2 * N_BINS
"""Numbers in a target's colours: the histograms of its halves, or that of the whole and zeros."""


@kernel
def colours_in(bins: Bytes, ellipses: Floats, split: Bools, step: int) -> Floats:
    """Weighted histograms of the colours in ellipses.

    Args:
        bins: (H, W) bin number of each pixel, all below `N_BINS` but those of pixels that belong to no target.
        ellipses: (n, 5).
        split: (n,) whether the upper and the lower half have a histogram each.
        step: only pixels whose column and row are multiples of it count; 1: all.

    Returns:
        (n, WIDTH), each summing to the share of its weight that is on the image: 1 for an ellipse inside
        it, 0 for one outside it, without a pixel centre or not an ellipse.
    """
    out = np.zeros((ellipses.shape[0], WIDTH))
    sums, weights = np.zeros((4, _SLOTS)), np.empty(bins.shape[1])
    for p in range(ellipses.shape[0]):
        mass = 0.0
        for part in range(2 if split[p] else 1):
            sums[:, :N_BINS] = 0.0
            mass += _weigh(sums, weights, bins, ellipses[p], step, ABOVE + part if split[p] else WHOLE)
            for k in range(N_BINS):
                out[p, part * N_BINS + k] = max(sums[0, k] + sums[1, k] + sums[2, k] + sums[3, k], 0.0)
        if mass > 0.0:
            out[p] /= mass
    return out


@kernel
def colour_likeness(bins: Bytes, ellipses: Floats, owner: Ints, colours: Floats, split: Bools, step: int) -> Floats:
    """Bhattacharyya coefficients of the colours in ellipses with those of their targets.

    The sums of sqrt(h_k m_k) of `colours_in` h and the targets' m, without the tables in between.

    Args:
        bins: (H, W) bin number of each pixel.
        ellipses: (P, 5).
        owner: (P,) row of each one's target.
        colours: (n, WIDTH) of the targets.
        split: (n,) whether they are those of halves.
        step: see `colours_in`.

    Returns:
        (P,), 0 (nothing in common) to 1 (equal).
    """
    out = np.empty(ellipses.shape[0])
    sums, weights = np.zeros((4, _SLOTS)), np.empty(bins.shape[1])
    for p in range(ellipses.shape[0]):
        mass, total = 0.0, 0.0
        model, halves = colours[owner[p]], split[owner[p]]
        for part in range(2 if halves else 1):
            sums[:, :N_BINS] = 0.0
            mass += _weigh(sums, weights, bins, ellipses[p], step, ABOVE + part if halves else WHOLE)
            for k in range(N_BINS):
                common = (sums[0, k] + sums[1, k] + sums[2, k] + sums[3, k]) * model[part * N_BINS + k]
                if common > 0.0:
                    total += math.sqrt(common)
        out[p] = min(total / math.sqrt(mass), 1.0) if mass > 0.0 else 0.0
    return out


def upright(ellipses: Floats, share: float) -> Bools:
    """(n,) whether ellipses (n, 5) are at least `share` times as high as wide; none for a share of 0."""
    a, b, s, c = ellipses[:, 2], ellipses[:, 3], np.sin(ellipses[:, 4]), np.cos(ellipses[:, 4])
    return np.asarray((np.hypot(a * s, b * c) >= share * np.hypot(a * c, b * s)) & (share > 0))


def level(ellipses: Floats) -> Floats:
    """The same ellipses (n, 5) with axis a nearer to the horizontal than axis b, and the angle in [-pi/2, pi/2)."""
    out = np.array(ellipses, dtype=np.float64)
    swap = np.abs(np.mod(out[:, 4] + 0.5 * np.pi, np.pi) - 0.5 * np.pi) > 0.25 * np.pi
    out[swap, 2:4] = out[swap, 3:1:-1]
    out[:, 4] = np.mod(out[:, 4] + np.where(swap, np.pi, 0.5 * np.pi), np.pi) - 0.5 * np.pi
    return out
