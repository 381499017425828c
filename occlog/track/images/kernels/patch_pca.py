"""Likelihood of the grey patch inside an ellipse, by principal components of the target's patches, [Qu] Sec. 3.3.

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

from occlog.array_types import Bytes, Floats, Ints
from occlog.core.numerics.jit import kernel

SIZE = 16
"""Width and height [px] of the square about the disc of a patch."""
FLAT = 1.0
"""Standard deviation [grey levels] below which a patch counts as flat, that is, as noise only."""
LEAST = 0.01
"""Least variance in any direction; few patches would give variances near 0."""

ROUNDING = 1e-12
"""Share of a patch's square that counts as rounding."""


class PatchModels(NamedTuple):
    """Densities of the patches of M targets, D numbers each."""

    mean: Floats  # (M, D)
    basis: Floats  # (M, K, D) orthonormal rows
    variance: Floats  # (M, K) along them
    rest: Floats  # (M,) in every other direction


def disc_points(size: int = SIZE) -> Floats:
    """(D, 2) points in the unit disc: middles of the pixels of a size x size square about it."""
    middles = (np.arange(size) + 0.5) * (2.0 / size) - 1.0
    y, x = (m.ravel() for m in np.meshgrid(middles, middles, indexing="ij"))
    return np.ascontiguousarray(np.column_stack([x, y])[x * x + y * y <= 1.0])


@kernel
def warp_patches(image: Bytes, ellipses: Floats, points: Floats) -> Floats:
    """Read the patches inside ellipses, with linear interpolation; beyond the image its edge goes on.

    Args:
        image: (H, W, C), the mean of the C colours is what counts.
        ellipses: (P, 5), of any finite numbers.
        points: (D, 2) places in the unit disc, x along axis a.

    Returns:
        (P, D) with mean 0 and variance 1 over each patch; 0 for flat ones.
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
        patches: (N, D) of the target, N >= 1.
        components: largest K; no more than N - 1 and D carry any variance.
        least: lower limit of all variances, > 0.

    Returns:
        K = min(components, N - 1, D), at least 0; `rest` is the mean of the variances that are left out.
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
    """Stack the models of several targets, in this order.

    Models with fewer components get directions of zeros, which add nothing, with the variance of their rest.
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
    """Log densities of patches, each under the model of its target.

    Args:
        patches: (P, D).
        owner: (P,) row of the models for each patch.
        mean: see `PatchModels`, as the rest.
        basis: (M, K, D).
        variance: (M, K).
        rest: (M,).

    Returns:
        (P,) -1/2 (sum_k y_k^2 / l_k + e^2 / rho + sum_k log l_k + (D - K) log rho + D log 2 pi) with y the
        coordinates along the components and e^2 the square of what they leave over.
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
    """(P,) log densities of the patches inside ellipses, under the models of their targets.

    The angle of an ellipse is known up to pi: of both ways round the likelier one counts.

    Args:
        image: (H, W, C) or (H, W).
        ellipses: (P, 5).
        owner: (P,) row of the models for each ellipse.
        models: of patches from `disc_points()`.
    """
    patches = warp_patches(np.atleast_3d(image), ellipses, disc_points())
    back = np.ascontiguousarray(patches[:, ::-1])  # the opposite points are in the opposite order
    return np.asarray(np.maximum(log_density(patches, owner, *models), log_density(back, owner, *models)))


def learn_target(image: Bytes, ellipse: Floats, jitter: Floats, components: int) -> PatchModels:
    """Learn the density of a target's patches (M = 1) from one image of it.

    Args:
        image: (H, W, C) or (H, W).
        ellipse: (5,) of the target.
        jitter: (N, 5) standard normal draws; ellipses that are off by a little are still the target.
        components: see `learn_patches`.
    """
    sizes = 0.5 * (ellipse[2] + ellipse[3]) * np.array([0.05, 0.05, 0.03, 0.03, 0.0]) + [0, 0, 0, 0, 0.05]
    near = np.vstack([ellipse, ellipse + jitter * sizes])
    return learn_patches(warp_patches(np.atleast_3d(image), near, disc_points()), components)
