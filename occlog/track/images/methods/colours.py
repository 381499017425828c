"""The colours of targets in images: of the whole ellipse, or of its upper and lower half apart.

People wear other colours above than below; with one histogram for both an ellipse may slide
down or over to a neighbour without looking any different.  A ball rolls and has no such order.
"""

from __future__ import annotations

import numpy as np

from occlog.array_types import Bools, Bytes, Floats, Ints
from occlog.core.image.histogram_bins import N_BINS
from occlog.track.images.kernels.ellipse_colour import half_histograms, half_likenesses, histograms, likenesses

WIDTH = 2 * N_BINS
"""Numbers in a target's colours: the histograms of its halves, or that of the whole and zeros."""


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


def colours_in(bins: Bytes, ellipses: Floats, split: Bools, step: int) -> Floats:
    """(n, WIDTH) colours in ellipses (n, 5), of their halves where `split` (n,); see `colour_likeness`."""
    out = np.zeros((len(ellipses), WIDTH))
    out[~split, :N_BINS] = histograms(bins, ellipses[~split], N_BINS, step)
    out[split] = half_histograms(bins, ellipses[split], N_BINS, step)
    return out


def colour_likeness(bins: Bytes, ellipses: Floats, owner: Ints, colours: Floats, split: Bools, step: int) -> Floats:
    """Bhattacharyya coefficients of the colours in ellipses with those of their targets.

    Args:
        bins: (H, W) bin number of each pixel.
        ellipses: (P, 5).
        owner: (P,) row of each one's target.
        colours: (n, WIDTH) of the targets.
        split: (n,) whether they are those of halves.
        step: only pixels whose column and row are multiples of it count.

    Returns:
        (P,), 0 (nothing in common) to 1 (equal).
    """
    if split.any():
        return half_likenesses(bins, ellipses, owner, colours, split, step)
    return likenesses(bins, ellipses, owner, np.ascontiguousarray(colours[:, :N_BINS]), step)
