"""Ellipses in images and histograms of their colours.

Densities of colours and their similarity: m-bin histograms and the Bhattacharyya coefficient ([Lee] Sec. 5.2.1).

With L levels there are m = L (L + 1) bins: L x L of hue and saturation, then L of brightness for pixels without a hue;
72 bins with 8 levels. [Qu] compares targets by colour histograms without stating the bins; these are the project's. A
pixel too grey (saturation <= 0.1) or too dark (value <= 0.2) to have a hue goes to bin 64 + floor(8 * value), every
other one to bin 8 * floor(hue / 45 deg) + floor(8 * saturation), with OpenCV's hue, saturation = (max - min) / max and
value = max / 255. All limits are compared in whole numbers, so that a pixel's bin does not depend on rounding.

Ellipses in an image as states of trackers, [Qu] Sec. 3.1: size in a direction, neighbours, pixels inside.

An ellipse is a row (cx, cy, a, b, rho): centre [px], half axes a and b [px] and the angle
rho [rad] of axis a, from +x (to the right) to +y (down).  The axes may come in any order.
Pixel centres are at whole numbers.  `occlog.track.methods.images.kernels.appearance`
compares the colours inside.
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Bools, Bytes, Floats, Ints

from .numerics.jit import kernel

HUE_BINS = 8
SATURATION_BINS = 8
BRIGHTNESS_BINS = 8
GREY_BIN = HUE_BINS * SATURATION_BINS
N_BINS = GREY_BIN + BRIGHTNESS_BINS

_OVER = np.concatenate([[0.0], 1.0 / np.arange(1, 256)])
"""1 / n; the half added to each whole numerator keeps the quotients far from whole numbers, so that none rounds up."""


@kernel
def pixel_bin(blue: int, green: int, red: int) -> int:
    """Return the histogram bin, 0 to 71, of a pixel with blue, green and red values, 0 to 255 each.

    Bins 0 to 63 are 8 x 8 bins of hue and saturation (8 hue + saturation), bins 64 to 71 the brightness of grey and
    dark pixels.
    """
    high, low = max(blue, green, red), min(blue, green, red)
    spread = high - low
    if 10 * spread <= high or 5 * high <= 255:
        return GREY_BIN + high * BRIGHTNESS_BINS // 256
    # Hue times `spread`, in sextants of the colour circle; a sextant holds 4/3 bins
    if high == red:
        sextants = green - blue if green >= blue else green - blue + 6 * spread
    elif high == green:
        sextants = 2 * spread + blue - red
    else:
        sextants = 4 * spread + red - green
    # floor(4 sextants / (3 spread)) and floor(8 spread / high) by multiplication, which is faster than division
    hue = min(int((4 * sextants + 0.5) * (_OVER[spread] / 3.0)), HUE_BINS - 1)
    saturation = min(int((spread * SATURATION_BINS + 0.5) * _OVER[high]), SATURATION_BINS - 1)
    return hue * SATURATION_BINS + saturation


def as_colour(image: Bytes) -> Bytes:
    """Return an image as (height, width, 3) BGR; a grey one (height, width) as a read-only view with B = G = R."""
    if image.ndim == 3:
        return image
    return np.broadcast_to(image[:, :, None], (*image.shape, 3))


def update_bins(bins: Bytes, image: Bytes, boxes: Ints, step: int = 1) -> None:
    """Compute the colour bins (0 to 71) of the pixels inside boxes, once per frame for all particles of all trackers.

    Args:
        bins: (height, width) bin numbers, changed in place; pixels outside all boxes keep theirs.
        image: (height, width, 3) BGR or (height, width) grey.
        boxes: (K, 4) left, top, right, bottom [px], right and bottom excluded; boxes may overlap and exceed the image.
        step: only pixels with column and row that are multiples of it.
    """
    colour, (height, width) = as_colour(image), bins.shape
    for left, top, right, bottom in boxes.tolist():
        start = max(left, 0) + -max(left, 0) % step, max(top, 0) + -max(top, 0) % step
        _bins_into(bins, colour, *start, min(right, width), min(bottom, height), step)


@kernel
def _bins_into(bins: Bytes, image: Bytes, left: int, top: int, right: int, bottom: int, step: int) -> None:
    """Write the colour bins (0 to 71) of the pixels of one box to `bins`, in place.

    Args:
        bins: (height, width) bin numbers.
        image: (height, width, 3) BGR.
        left: first column.
        top: first row.
        right: column after the last.
        bottom: row after the last.
        step: step between columns and between rows.
    """
    for y in range(top, bottom, step):
        for x in range(left, right, step):
            bins[y, x] = pixel_bin(int(image[y, x, 0]), int(image[y, x, 1]), int(image[y, x, 2]))


def bins_of(levels: int) -> int:
    """Return the number of colour bins for L levels: L (L + 1), of hue x saturation and of brightness without a hue."""
    return levels * (levels + 1)


def colour_bins(image: Bytes, levels: int) -> Ints:
    """Return the (height, width) colour bin of each pixel, 0 to L (L + 1) - 1 for L levels.

    A pixel with a hue has the bin L hue + saturation, with levels 0 to L - 1 of both; a grey or dark one L^2 +
    brightness.

    Args:
        image: (height, width, 3) BGR or (height, width) grey.
        levels: number L of levels of hue, of saturation and of brightness, at least 2.
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
    """Return the (m,) number of masked pixels in each of m = levels (levels + 1) colour bins.

    Args:
        image: (height, width, 3) BGR or (height, width) grey.
        mask: (height, width); pixels with 0 do not count.
        levels: number of levels of hue, of saturation and of brightness, at least 2.
    """
    return np.bincount(colour_bins(image, levels)[mask != 0], minlength=bins_of(levels))


def density(counts: Ints | Floats) -> Floats:
    """Return histograms (..., m) normalised to sum 1 ([Lee] 5.1, 5.2, 5.4); NaN for one without counts."""
    total = np.sum(counts, axis=-1, keepdims=True, dtype=np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(total > 0, counts / total, np.nan))


def bhattacharyya(a: Floats, b: Floats) -> Floats:
    """Return the (K, R) Bhattacharyya coefficients of densities a (K, m) and b (R, m) ([Lee] 5.5).

    They are 0 for disjoint and 1 for equal densities; NaN for a density that is NaN.
    """
    return np.asarray(np.clip(np.sqrt(a) @ np.sqrt(b).T, 0.0, 1.0))


def bias(bins: Ints | float, a: Ints | Floats | float, b: Ints | Floats | float) -> Floats:
    """Return the expected shortfall below 1 of the Bhattacharyya coefficient of two samples of one density.

    It is (m - 1) / 8 (1 / a + 1 / b), the second-order term of the expansion of the square root at the density, and is
    valid if every bin has several counts.

    Args:
        bins: number m of bins that have colours.
        a: number of independent values in one sample.
        b: number of independent values in the other.
    """
    return np.asarray((np.asarray(bins) - 1.0) / 8.0 * (1.0 / np.asarray(a) + 1.0 / np.asarray(b)))


def corrected(a: Floats, b: Floats, pixels_a: Ints, pixels_b: Ints) -> tuple[Floats, Floats]:
    """Return the (K, R) Bhattacharyya coefficients of densities, without and with a correction for small samples.

    The correction adds the expected shortfall of two samples of one density (`bias`), with the bins of colours present
    in either histogram.

    Args:
        a: (K, m) densities.
        b: (R, m) densities.
        pixels_a: (K,) numbers of pixels of the densities `a`.
        pixels_b: (R,) numbers of pixels of the densities `b`.
    """
    none = (a == 0).astype(np.float64) @ (b == 0).T.astype(np.float64)
    rho = bhattacharyya(a, b)
    return rho, rho + bias(a.shape[-1] - none, pixels_a[:, None], pixels_b[None, :])


CLOSE_RADII = 1.5
"""Targets are close when their centres are this many times nearer than touching ones."""

MAX_AXIS_PX = 1e4
"""Half axes above this [px] are not those of a thing in an image: such an ellipse holds nothing."""


def support_radius(ellipses: Floats, theta: Floats | float) -> Floats:
    """Return the support function (...) [px] of ellipses: half their extent in the direction theta.

    It is sqrt(a^2 cos^2 + b^2 sin^2) of the angle between theta and axis a.

    Args:
        ellipses: (..., 5) cx, cy, half axes a and b [px], angle rho of axis a from +x towards +y (down) [rad].
        theta: directions [rad] from +x towards +y.
    """
    e = np.asarray(ellipses, dtype=np.float64)
    turn = np.asarray(theta, dtype=np.float64) - e[..., 4]
    return np.asarray(np.hypot(e[..., 2] * np.cos(turn), e[..., 3] * np.sin(turn)))


def nearness(ellipses: Floats) -> Floats:
    """Return the (N, N) distances of centres over the sum of support radii along the line between them; symmetric.

    At most 1: the ellipses touch; at most `CLOSE_RADII`: they are close. Infinite on the diagonal and for a NaN
    ellipse.

    Args:
        ellipses: (N, 5) cx, cy, half axes a and b [px], angle of axis a [rad].
    """
    e = np.asarray(ellipses, dtype=np.float64)
    ratio = nearness_between(e, e)
    np.fill_diagonal(ratio, np.inf)
    return np.minimum(ratio, ratio.T)  # both are the same but for rounding


def nearness_between(a: Floats, b: Floats) -> Floats:
    """Return the (N, M) distances of centres over the sum of support radii, of ellipses a (N, 5) and b (M, 5).

    At most 1: the ellipses touch. Infinite for a NaN ellipse. Rows are cx, cy, half axes a and b [px], angle of axis a
    [rad].
    """
    dx, dy = b[None, :, 0] - a[:, None, 0], b[None, :, 1] - a[:, None, 1]
    theta = np.arctan2(dy, dx)
    reach = support_radius(a[:, None, :], theta) + support_radius(b[None, :, :], theta)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.hypot(dx, dy) / reach
    return np.where(np.isnan(ratio), np.inf, ratio)


def touching(ellipses: Floats) -> Bools:
    """Return the (N, N) mask of ellipses that touch or overlap; False on the diagonal.

    Their centres are no farther apart than the sum of their support radii. `ellipses` (N, 5): cx, cy, half axes a and b
    [px], angle of axis a [rad].
    """
    return np.asarray(nearness(ellipses) <= 1.0)


@kernel
def quadratic(a: float, b: float, rho: float) -> tuple[float, float, float]:
    """Return A, B, C of the quadratic form A dx^2 + 2 B dx dy + C dy^2 about the centre, which is 1 on an ellipse.

    Args:
        a: half axis [px].
        b: half axis at a right angle to it [px].
        rho: angle of axis a from +x towards +y [rad].
    """
    c, s = math.cos(rho), math.sin(rho)
    ia, ib = 1.0 / (a * a), 1.0 / (b * b)
    return c * c * ia + s * s * ib, c * s * (ia - ib), s * s * ia + c * c * ib


@kernel
def holds_pixels(ellipse: Floats) -> bool:
    """Return whether an ellipse (cx, cy, a, b, rho) is finite and of a plausible size in an image.

    Half axes a and b are above 0 and at most `MAX_AXIS_PX`, centre coordinates are below 1e7 px.
    """
    a, b = ellipse[2], ellipse[3]
    if not (math.isfinite(ellipse[0]) and math.isfinite(ellipse[1]) and math.isfinite(ellipse[4])):
        return False
    return bool(0.0 < a <= MAX_AXIS_PX and 0.0 < b <= MAX_AXIS_PX and abs(ellipse[0]) < 1e7 and abs(ellipse[1]) < 1e7)


@kernel
def row_limits(cy: float, a: float, b: float, rho: float) -> tuple[int, int]:
    """Return the first and the last pixel row that an ellipse of plausible size meets; first > last if there is none.

    Args:
        cy: row of the centre [px].
        a: half axis [px].
        b: half axis at a right angle to it [px].
        rho: angle of axis a from +x towards +y [rad].
    """
    reach = math.hypot(a * math.sin(rho), b * math.cos(rho))
    return math.ceil(cy - reach), math.floor(cy + reach)


@kernel
def column_limits(cx: float, dy: float, a: float, b: float, c: float) -> tuple[int, int]:
    """Return the first and the last pixel column inside an ellipse in one row; first > last if there is none.

    Args:
        cx: column of the centre [px].
        dy: the row minus the row of the centre [px].
        a: coefficient of dx^2 in the quadratic form that is 1 on the ellipse (`quadratic`).
        b: half of the coefficient of dx dy.
        c: coefficient of dy^2.
    """
    root = b * b * dy * dy - a * (c * dy * dy - 1.0)
    if root < 0.0:
        return 1, 0
    half, middle = math.sqrt(root) / a, cx - b * dy / a
    return math.ceil(middle - half), math.floor(middle + half)
