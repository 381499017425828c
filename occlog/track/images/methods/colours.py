"""The colours of targets in images: of the whole ellipse, or of its upper and lower half apart.

People wear other colours above than below; with one histogram for both an ellipse may slide
down or over to a neighbour without looking any different.  A ball rolls and has no such order.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from occlog.array_types import Bools, Floats, Ints
from occlog.core.image.histogram_bins import N_BINS
from occlog.track.images.kernels.ellipse_colour import half_histograms, half_likenesses, histograms, likenesses

WIDTH = 2 * N_BINS
"""Of a target's colours: those of its halves, or of the whole with zeros behind."""


def upright(ellipses: Floats, share: float) -> Bools:
    """(n,) which ellipses (n, 5) are at least `share` times higher than wide; none for 0."""
    a, b, s, c = ellipses[:, 2], ellipses[:, 3], np.sin(ellipses[:, 4]), np.cos(ellipses[:, 4])
    return np.asarray((np.hypot(a * s, b * c) >= share * np.hypot(a * c, b * s)) & (share > 0))


def level(ellipses: Floats) -> Floats:
    """The same ellipses (n, 5) with axis a nearer to the horizontal than axis b."""
    out = np.array(ellipses, dtype=np.float64)
    swap = np.abs(np.mod(out[:, 4] + 0.5 * np.pi, np.pi) - 0.5 * np.pi) > 0.25 * np.pi
    out[swap, 2:4] = out[swap, 3:1:-1]
    out[:, 4] = np.mod(out[:, 4] + np.where(swap, np.pi, 0.5 * np.pi), np.pi) - 0.5 * np.pi
    return out


def colours_in(bins: NDArray[np.uint8], ellipses: Floats, split: Bools, step: int) -> Floats:
    """(n, WIDTH) colours in ellipses (n, 5)."""
    out = np.zeros((len(ellipses), WIDTH))
    out[~split, :N_BINS] = histograms(bins, ellipses[~split], N_BINS, step)
    out[split] = half_histograms(bins, ellipses[split], N_BINS, step)
    return out


def alike(bins: NDArray[np.uint8], ellipses: Floats, owner: Ints, colours: Floats, split: Bools, step: int) -> Floats:
    """(P,) likeness, 0 to 1, of ellipses (P, 5) with their owners (P,) among targets with colours (n, WIDTH)."""
    if split.any():
        return half_likenesses(bins, ellipses, owner, colours, split, step)
    return likenesses(bins, ellipses, owner, np.ascontiguousarray(colours[:, :N_BINS]), step)
