"""Prior of a person's covariance and size in an image, and the worth of a cluster under it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.core.numerics.jit import kernel

from .person_size import SizeMap

SIZE_STEPS = 3  # of the fixed point for the size of a person


class Prior(NamedTuple):
    """A size map of people for one camera, and how strongly to believe in it."""

    cov: Floats  # (grid cells, 3) covariance xx, xy, yy of a person's pixels [px^2]
    mass: Floats  # (grid cells,) foreground pixels of a person in full view
    log_range: Floats  # (grid cells,) largest logarithm of a size relative to the map
    rows: int
    columns: int
    width: int  # of the image [px]
    height: int
    strength: float  # nu_k in persons' pixels
    penalty: float  # cost of a cluster in J, in persons' pixels
    least: float  # smallest cluster that is kept, in persons' pixels


def make_prior(sizes: SizeMap, strength: float, penalty: float, least: float) -> Prior:
    """The prior for the images of one camera; see `Prior`."""
    width, height = sizes.image_size
    rows, columns = sizes.shape
    return Prior(
        np.ascontiguousarray(sizes.cov),
        np.ascontiguousarray(sizes.mass),
        2.0 * sizes.spread,
        rows,
        columns,
        width,
        height,
        float(strength),
        float(penalty),
        float(least),
    )


@kernel
def place(prior: Prior, x: float, y: float) -> int:
    """Grid cell of the size map at a pixel; positions off the image take the nearest cell."""
    column = min(max(int((x + 0.5) * prior.columns / prior.width), 0), prior.columns - 1)
    row = min(max(int((y + 0.5) * prior.rows / prior.height), 0), prior.rows - 1)
    return row * prior.columns + column


@kernel
def person_at(means: Floats, log_sizes: Floats, prior: Prior) -> tuple[Floats, Floats]:
    """Covariance (K, 3) and pixels (K,) of people at the means (K, 2), scaled by exp(log_sizes)."""
    covs, mass = np.empty((means.shape[0], 3)), np.empty(means.shape[0])
    for k in range(means.shape[0]):
        at = place(prior, means[k, 0], means[k, 1])
        area = math.exp(2.0 * log_sizes[k])
        covs[k] = prior.cov[at] * area
        mass[k] = prior.mass[at] * area
    return covs, mass


@kernel
def best_size(n: float, cxx: float, cxy: float, cyy: float, at: int, prior: Prior) -> float:
    """Logarithm of the size, relative to the map, that suits a cluster best, within the map's range.

    The size s and the covariance Sigma = (nu s^2 S + C) / (nu + n) maximise the prior in turn;
    for given Sigma that is s^2 = 2 / tr(Sigma^-1 S).

    Args:
        n: pixels of the cluster.
        cxx: their scatter, as cxy and cyy [px^2].
        cxy: see cxx.
        cyy: see cxx.
        at: grid cell of the map.
        prior: of the camera.
    """
    sxx, sxy, syy = prior.cov[at]
    limit = prior.log_range[at]
    log_size = 0.0
    for _ in range(SIZE_STEPS):
        area = math.exp(2.0 * log_size)
        nu = prior.strength * prior.mass[at] * area
        xx, xy, yy = cxx + nu * area * sxx, cxy + nu * area * sxy, cyy + nu * area * syy
        trace = (yy * sxx - 2.0 * xy * sxy + xx * syy) / (xx * yy - xy * xy) * (nu + n)
        log_size = min(max(0.5 * math.log(2.0 / trace), -limit), limit)
    return log_size


@kernel
def worth(n: float, x: float, y: float, cxx: float, cxy: float, cyy: float, prior: Prior) -> float:
    """Share of a cluster in the penalised objective, if its pixels belong to it alone.

    With Sigma at its maximum, sum_i log N - 1/2 nu (tr(Sigma^-1 S) - log det(Sigma^-1 S)) is
    -1/2 (n + nu) log det Sigma + 1/2 nu log det S up to terms that add up to the same
    before and after a merge or split, and its share of all pixels adds n log n.

    Args:
        n: pixels, > 0.
        x: their mean, as y [px].
        y: see x.
        cxx: their scatter, as cxy and cyy [px^2].
        cxy: see cxx.
        cyy: see cxx.
        prior: of the camera.
    """
    at = place(prior, x, y)
    area = math.exp(2.0 * best_size(n, cxx, cxy, cyy, at, prior))
    person = prior.mass[at] * area
    nu = prior.strength * person
    sxx, sxy, syy = prior.cov[at] * area
    w = n + nu
    xx, xy, yy = (cxx + nu * sxx) / w, (cxy + nu * sxy) / w, (cyy + nu * syy) / w
    fit = -0.5 * w * math.log(xx * yy - xy * xy) + 0.5 * nu * math.log(sxx * syy - sxy * sxy)
    return float(fit + n * math.log(n) - prior.penalty * person)
