"""Densities of colours and their likeness: m-bin histograms and the Bhattacharyya coefficient ([Lee] Sec. 5.2.1).

With L levels there are m = L (L + 1) bins: L x L of hue and saturation, then L of brightness for pixels without a hue.
Eight levels are the 72 bins of `histogram_bins`.
"""

from __future__ import annotations

import numpy as np

from occlog.array_types import Bytes, Floats, Ints

from .histogram_bins import as_colour


def bins_of(levels: int) -> int:
    """Number m of bins of so many levels."""
    return levels * (levels + 1)


def colour_bins(image: Bytes, levels: int) -> Ints:
    """(height, width) number of the bin of each pixel, 0 to m - 1.

    Args:
        image: (height, width, 3) BGR or (height, width) grey.
        levels: of hue, of saturation and of brightness, at least 2.
    """
    blue, green, red = np.moveaxis(as_colour(image).astype(np.int64), -1, 0)
    high = np.maximum(np.maximum(blue, green), red)
    spread = high - np.minimum(np.minimum(blue, green), red)
    grey = (10 * spread <= high) | (5 * high <= 255)
    # Hue times the spread, in sextants of the colour circle
    sextants = np.select(
        [high == red, high == green],
        [green - blue + np.where(green < blue, 6 * spread, 0), 2 * spread + blue - red],
        4 * spread + red - green,
    )
    some, most = np.maximum(spread, 1), levels - 1
    hue = np.minimum(levels * sextants // (6 * some), most)
    saturation = np.minimum(levels * spread // np.maximum(high, 1), most)
    return np.asarray(np.where(grey, levels * levels + high * levels // 256, hue * levels + saturation))


def colour_counts(image: Bytes, mask: Bytes, levels: int) -> Ints:
    """(m,) pixels of each colour where a mask (height, width) is not 0."""
    return np.bincount(colour_bins(image, levels)[mask != 0], minlength=bins_of(levels))


def density(counts: Ints | Floats) -> Floats:
    """(..., m) counts divided by their sum ([Lee] 5.1, 5.2, 5.4); NaN where there are none."""
    total = np.sum(counts, axis=-1, keepdims=True, dtype=np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(total > 0, counts / total, np.nan))


def bhattacharyya(a: Floats, b: Floats) -> Floats:
    """(K, R) coefficients of densities (K, m) and (R, m), 0 (no colour in common) to 1 (equal) ([Lee] 5.5)."""
    return np.asarray(np.clip(np.sqrt(a) @ np.sqrt(b).T, 0.0, 1.0))


def bias(bins: Ints | float, a: Ints | Floats | float, b: Ints | Floats | float) -> Floats:
    """How far the coefficient of two samples of one density lies below 1 in the mean: (m - 1) / 8 (1 / a + 1 / b).

    The second-order term of the expansion of sqrt at the density: it holds while every bin has several counts.

    Args:
        bins: number m of bins that have colours.
        a: independent values of one sample.
        b: of the other.
    """
    return np.asarray((np.asarray(bins) - 1.0) / 8.0 * (1.0 / np.asarray(a) + 1.0 / np.asarray(b)))


def corrected(a: Floats, b: Floats, pixels_a: Ints, pixels_b: Ints) -> tuple[Floats, Floats]:
    """(K, R) Bhattacharyya coefficients, and the same plus their `bias`.

    The number of bins is that of the colours that one of the two has: colours that neither has add no bias.

    Args:
        a: (K, m) densities.
        b: (R, m) densities.
        pixels_a: (K,) pixels that made them.
        pixels_b: (R,)
    """
    none = (a == 0).astype(np.float64) @ (b == 0).T.astype(np.float64)
    rho = bhattacharyya(a, b)
    return rho, rho + bias(a.shape[-1] - none, pixels_a[:, None], pixels_b[None, :])
