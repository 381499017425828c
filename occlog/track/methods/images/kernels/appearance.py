"""Colours inside many ellipses at once: weighted histograms and their similarities, the p_c of [Qu] Sec. 3.3.

The image comes as a map of bin numbers, made once a frame (`occlog.core.image`).  A
pixel at squared ellipse distance q weighs 1 - q (Epanechnikov).  The sums are divided by
the weight of all pixels of the ellipse, those off the image included, so that the
histogram of an ellipse that reaches over the edge sums to less than 1 and is less alike.

A target's colours are those of the whole ellipse, or of its upper and lower half apart.  People
wear other colours above than below; with one histogram for both an ellipse may slide down or
over to a neighbour without looking any different.  A ball rolls and has no such order.

Likelihood of the grey patch inside an ellipse, by principal components of the target's patches, [Qu] Sec. 3.3.

Moghaddam and Pentland, "Probabilistic visual learning for object representation" (PAMI 1997):
the density of a patch is a Gaussian in the space of the first K components times one, of equal
variance in all directions, in the rest.  The first is the distance in feature space (DIFS),
the second the distance from it (DFFS).

A patch is the inside of an ellipse, turned and scaled to a disc, as grey values of mean 0 and
variance 1: neither brightness nor contrast counts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Bytes, Floats, Ints
from occlog.core.image import N_BINS, column_limits, holds_pixels, quadratic, row_limits
from occlog.core.numerics.jit import array_kernel, kernel

TWO, THREE, FOUR = np.uint64(2), np.uint64(3), np.uint64(4)

WHOLE, ABOVE, BELOW = 0, 1, 2
"""Parts of an ellipse."""

_SLOTS = 256
"""Length of the sums: bin numbers are bytes, so that no number in a map is out of bounds."""


@array_kernel
def _weigh(sums: Floats, weights: Floats, bins: Bytes, ellipse: Floats, step: int, half: int) -> float:
    """Add the weights 1 - q of the pixels inside an ellipse to the sums of their colour bins, in place.

    q is the squared ellipse distance, 0 at the centre and 1 on the outline (Epanechnikov kernel). Four neighbours at a
    time, which mostly share a bin, go to four separate sums, so that no addition waits for another.

    Args:
        sums: (4, 256) weights by colour bin, added to; the four rows belong together.
        weights: (W,) work space for the weights of a row of pixels.
        bins: (H, W) colour bin of each pixel.
        ellipse: (5,) centre and half axes [px], angle of the first axis [rad].
        step: every `step`-th pixel of both directions counts.
        half: `ABOVE`: rows above the centre only; `BELOW`: level with it and below; `WHOLE`: all.

    Returns:
        The total weight of the pixels of that part of the ellipse, those outside the image included.
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
    """Return weighted colour histograms of ellipses, one of the whole or two of the halves, [Qu] Sec. 3.3.

    Args:
        bins: (H, W) bin number of each pixel, all below `N_BINS` but those of pixels that belong to no target.
        ellipses: (n, 5) centre and half axes [px], angle of the first axis [rad].
        split: (n,) whether the upper and the lower half have a histogram each, one after the other; else zeros follow.
        step: only pixels with column and row that are multiples of it count; 1: all.

    Returns:
        (n, WIDTH) histograms, each summing to the share of the ellipse's weight on pixels of the image with a bin: 1
        for an ellipse inside the image; 0 for one outside it, without a pixel centre or not an ellipse.
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
def colour_similarity(bins: Bytes, ellipses: Floats, owner: Ints, colours: Floats, split: Bools, step: int) -> Floats:
    """Return (P,) Bhattacharyya coefficients of the colours in ellipses with the colours of their targets.

    The coefficient is sum_k sqrt(h_k m_k) of the histograms h in the ellipse and m of the target, limited to 0 (nothing
    in common) to 1 (equal).

    Args:
        bins: (H, W) colour bin of each pixel.
        ellipses: (P, 5) centre and half axes [px], angle of the first axis [rad].
        owner: (P,) row of each ellipse's target.
        colours: (n, WIDTH) histograms of the targets, as `colours_in` makes them.
        split: (n,) whether a target's histograms are those of the upper and lower half.
        step: every `step`-th pixel of both directions counts.
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
    """Return (n,) booleans: whether ellipses (n, 5) are at least `share` times as high as wide; False for share 0.

    Height and width are those of the upright box around an ellipse (centre, half axes, angle).
    """
    a, b, s, c = ellipses[:, 2], ellipses[:, 3], np.sin(ellipses[:, 4]), np.cos(ellipses[:, 4])
    return np.asarray((np.hypot(a * s, b * c) >= share * np.hypot(a * c, b * s)) & (share > 0))


def level(ellipses: Floats) -> Floats:
    """Return ellipses (n, 5) rewritten with axis a nearer to the horizontal than axis b; the outlines stay.

    An ellipse is (cx, cy, a, b, rho) with the angle rho [rad] of axis a; the angle returned is in [-pi/2, pi/2).
    """
    out = np.array(ellipses, dtype=np.float64)
    swap = np.abs(np.mod(out[:, 4] + 0.5 * np.pi, np.pi) - 0.5 * np.pi) > 0.25 * np.pi
    out[swap, 2:4] = out[swap, 3:1:-1]
    out[:, 4] = np.mod(out[:, 4] + np.where(swap, np.pi, 0.5 * np.pi), np.pi) - 0.5 * np.pi
    return out


SIZE = 16
"""Width and height [px] of the square about the disc of a patch."""
FLAT = 1.0
"""Standard deviation [grey levels] below which a patch counts as flat, that is, as noise only."""
LEAST = 0.01
"""Least variance in any direction; few patches would give variances near 0."""

ROUNDING = 1e-12
"""Share of a patch's square that counts as rounding."""


class PatchModels(NamedTuple):
    """Principal-component densities of the grey image patches of M targets, D pixels each.

    A model is Gaussian: a mean patch, K principal directions with a variance along each, and one variance (`rest`) in
    all other directions.
    """

    mean: Floats  # (M, D)
    basis: Floats  # (M, K, D) orthonormal rows
    variance: Floats  # (M, K) along them
    rest: Floats  # (M,) in every other direction


def disc_points(size: int = SIZE) -> Floats:
    """Return (D, 2) points in the unit disc: pixel centres of a size x size square that lie inside it."""
    middles = (np.arange(size) + 0.5) * (2.0 / size) - 1.0
    y, x = (m.ravel() for m in np.meshgrid(middles, middles, indexing="ij"))
    return np.ascontiguousarray(np.column_stack([x, y])[x * x + y * y <= 1.0])


@kernel
def warp_patches(image: Bytes, ellipses: Floats, points: Floats) -> Floats:
    """Read the grey patches inside ellipses, turned and scaled to the unit disc, by linear interpolation.

    Pixels beyond the image take the value of its edge.

    Args:
        image: (H, W, C); the mean of the C colours is the grey value.
        ellipses: (P, 5) centre and half axes [px], angle of the first axis [rad]; any finite numbers.
        points: (D, 2) positions in the unit disc, x along the first axis.

    Returns:
        (P, D) grey values scaled to mean 0 and variance 1 over each patch; 0 for flat ones (deviation below `FLAT`).
    """
    height, width, colours = image.shape
    out = np.empty((ellipses.shape[0], points.shape[0]))
    for p in range(ellipses.shape[0]):
        c, s = math.cos(ellipses[p, 4]), math.sin(ellipses[p, 4])
        total, square = 0.0, 0.0
        for k in range(points.shape[0]):
            u, v = ellipses[p, 2] * points[k, 0], ellipses[p, 3] * points[k, 1]
            x = min(max(ellipses[p, 0] + c * u - s * v, 0.0), width - 1.0)
            y = min(max(ellipses[p, 1] + s * u + c * v, 0.0), height - 1.0)
            left, top = int(x), int(y)
            right, low = min(left + 1, width - 1), min(top + 1, height - 1)
            fx, fy, grey = x - left, y - top, 0.0
            for b in range(colours):
                up = (1.0 - fx) * image[top, left, b] + fx * image[top, right, b]
                down = (1.0 - fx) * image[low, left, b] + fx * image[low, right, b]
                grey += (1.0 - fy) * up + fy * down
            out[p, k] = grey / colours
            total += out[p, k]
            square += out[p, k] * out[p, k]
        mean = total / points.shape[0]
        spread = math.sqrt(max(square / points.shape[0] - mean * mean, 0.0))
        for k in range(points.shape[0]):
            out[p, k] = (out[p, k] - mean) / spread if spread >= FLAT else 0.0
    return out


def learn_patches(patches: Floats, components: int, least: float = LEAST) -> PatchModels:
    """Learn the density of one target's patches (M = 1) by principal components.

    Args:
        patches: (N, D) grey values of N >= 1 patches of the target, mean 0 and variance 1 each.
        components: largest number K of components; no more than N - 1 and D carry any variance.
        least: lower limit of all variances, > 0.

    Returns:
        The model with K = min(components, N - 1, D), at least 0; `rest` is the mean of the variances that are omitted.
    """
    n, d = patches.shape
    k = max(min(components, n - 1, d), 0)
    mean = patches.mean(axis=0)
    _, lengths, rows = np.linalg.svd(patches - mean, full_matrices=False)
    variance = lengths**2 / n
    rest = max(float(variance[k:].sum()) / max(d - k, 1), least)
    kept = np.maximum(variance[:k], least)
    return PatchModels(mean[None], np.ascontiguousarray(rows[None, :k]), kept[None], np.array([rest]))


def stack_models(models: Sequence[PatchModels]) -> PatchModels:
    """Concatenate the patch models of several targets into one, in order.

    Models with fewer components are padded with zero directions of the variance `rest`, which change no density.
    """
    k = max(m.basis.shape[1] for m in models)
    basis, variance = [], []
    for m in models:
        more = ((0, 0), (0, k - m.basis.shape[1]))
        basis.append(np.pad(m.basis, (*more, (0, 0))))
        variance.append(np.where(np.pad(m.variance, more) > 0.0, np.pad(m.variance, more), m.rest[:, None]))
    mean, rest = np.concatenate([m.mean for m in models]), np.concatenate([m.rest for m in models])
    return PatchModels(mean, np.concatenate(basis), np.concatenate(variance), rest)


@kernel
def log_density(patches: Floats, owner: Ints, mean: Floats, basis: Floats, variance: Floats, rest: Floats) -> Floats:
    """Return (P,) log densities of patches, each under the Gaussian model of its target.

    They are -1/2 (sum_k y_k^2 / l_k + e^2 / rho + sum_k log l_k + (D - K) log rho + D log 2 pi) with y the coordinates
    along the components and e^2 the squared distance from their space (Moghaddam and Pentland 1997).

    Args:
        patches: (P, D) patches as vectors.
        owner: (P,) row of the models for each patch.
        mean: (M, D) means of the patches of M targets.
        basis: (M, K, D) their K principal components, orthonormal.
        variance: (M, K) variances l along the components.
        rest: (M,) variance rho in every other direction.
    """
    d, components = patches.shape[1], basis.shape[1]
    out = np.empty(patches.shape[0])
    for p in range(patches.shape[0]):
        m = owner[p]
        over = 0.0
        for i in range(d):
            over += (patches[p, i] - mean[m, i]) ** 2
        whole = over
        total = d * math.log(2.0 * math.pi) + (d - components) * math.log(rest[m])
        for k in range(components):
            y = 0.0
            for i in range(d):
                y += basis[m, k, i] * (patches[p, i] - mean[m, i])
            total += y * y / variance[m, k] + math.log(variance[m, k])
            over -= y * y
        # With all D components nothing is left over but rounding.
        out[p] = -0.5 * (total + (over / rest[m] if over > ROUNDING * whole else 0.0))
    return out


def patch_log_likelihood(image: Bytes, ellipses: Floats, owner: Ints, models: PatchModels) -> Floats:
    """Return (P,) log densities of the grey patches inside ellipses under the models of their targets.

    An ellipse's angle is known up to pi: the likelier of the two orientations counts.

    Args:
        image: (H, W, C) or (H, W).
        ellipses: (P, 5) centre and half axes [px], angle of the first axis [rad].
        owner: (P,) row of the models for each ellipse.
        models: densities of the patches of each target, with pixels at `disc_points()`.
    """
    patches = warp_patches(np.atleast_3d(image), ellipses, disc_points())
    back = np.ascontiguousarray(patches[:, ::-1])  # the opposite points are in the opposite order
    return np.asarray(np.maximum(log_density(patches, owner, *models), log_density(back, owner, *models)))


def learn_target(image: Bytes, ellipse: Floats, jitter: Floats, components: int) -> PatchModels:
    """Learn the density of a target's grey patches (a model with M = 1) from one image of it.

    The patches are those of its ellipse and of N ellipses shifted and scaled a little at random, so that slightly
    misplaced ellipses still fit.

    Args:
        image: (H, W, C) or (H, W).
        ellipse: (5,) of the target: centre and half axes [px], angle of the first axis [rad].
        jitter: (N, 5) standard normal numbers, scaled here to a few per cent of the size and 0.05 rad.
        components: number of principal components.
    """
    sizes = 0.5 * (ellipse[2] + ellipse[3]) * np.array([0.05, 0.05, 0.03, 0.03, 0.0]) + [0, 0, 0, 0, 0.05]
    near = np.vstack([ellipse, ellipse + jitter * sizes])
    return learn_patches(warp_patches(np.atleast_3d(image), near, disc_points()), components)
