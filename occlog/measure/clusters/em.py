"""EM for a mixture of Gaussians with a person's covariance as prior, [Rahimi] Sec. 7.

Model of a foreground pixel x: p(x) = sum_k pi_k N(x | mu_k, Sigma_k) + pi_0 / A, with A
the area of the image; the last term takes isolated specks.  Prior of each covariance: an
inverse Wishart with its mode at the covariance S_k of a person there, as strong as nu_k
pixels.  Maximised is

    J = sum_i n_i log p(x_i) - 1/2 sum_k nu_k (tr(Sigma_k^-1 S_k) - 2 - log det(Sigma_k^-1 S_k))

so a blob that is smaller than a person keeps nearly a person's covariance and takes in
the blobs near it.  Pixels come in cells (`occlog.measure.regions.regions`) that share their
responsibilities; with the cells' own scatter in both steps J never decreases.

Arrays: covariances and scatters are rows (xx, xy, yy) [px^2]; K clusters, N cells.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.jit import kernel

FAR2 = 40.0  # squared Mahalanobis distance from which a density counts as 0


class Mixture(NamedTuple):
    """State of EM."""

    means: Floats  # (K, 2) [px]
    covs: Floats  # (K, 3) [px^2]
    mass: Floats  # (K + 1,) pixels of each cluster, then of the specks


class Statistics(NamedTuple):
    """Sufficient statistics of the E-step."""

    mass: Floats  # (K + 1,)
    means: Floats  # (K, 2)
    scatter: Floats  # (K, 3) about the means


@kernel
def log_prior(covs: Floats, prior_covs: Floats, prior_mass: Floats) -> float:
    """Second term of J: logarithm of the inverse-Wishart kernels relative to their modes."""
    total = 0.0
    for k in range(covs.shape[0]):
        xx, xy, yy = covs[k]
        sxx, sxy, syy = prior_covs[k]
        det, sdet = xx * yy - xy * xy, sxx * syy - sxy * sxy
        trace = (yy * sxx - 2.0 * xy * sxy + xx * syy) / det
        total -= 0.5 * prior_mass[k] * (trace - 2.0 - math.log(sdet / det))
    return total


class _Shape(NamedTuple):
    """What the densities of the clusters need."""

    inverse: Floats  # (K, 3) of the covariances
    log_scale: Floats  # (K,) logarithm of share / (2 pi sqrt(det))
    speck: float  # density of the specks


@kernel
def _shape(mixture: Mixture, area: float) -> _Shape:
    n_clusters = mixture.means.shape[0]
    inverse, log_scale = np.empty((n_clusters, 3)), np.empty(n_clusters)
    total = mixture.mass.sum()
    for k in range(n_clusters):
        xx, xy, yy = mixture.covs[k]
        det = xx * yy - xy * xy
        inverse[k] = yy / det, -xy / det, xx / det
        share = mixture.mass[k] / total
        log_scale[k] = math.log(share / (2.0 * math.pi * math.sqrt(det))) if share > 0.0 else -np.inf
    return _Shape(inverse, log_scale, mixture.mass[n_clusters] / total / area)


@kernel
def _densities_into(density: Floats, cell: Floats, means: Floats, shape: _Shape) -> float:
    """Write the clusters' densities (K,) at a cell, shares included; returns their sum with the specks'."""
    n, x, y, cxx, cxy, cyy = cell
    total = shape.speck
    for k in range(means.shape[0]):
        a, b, c = shape.inverse[k]
        dx, dy = x - means[k, 0], y - means[k, 1]
        # Mean over the cell's pixels of the squared Mahalanobis distance
        d2 = a * dx * dx + 2.0 * b * dx * dy + c * dy * dy + (a * cxx + 2.0 * b * cxy + c * cyy) / n
        density[k] = math.exp(shape.log_scale[k] - 0.5 * d2) if d2 < FAR2 else 0.0
        total += density[k]
    return total


@kernel
def e_step(cells: Floats, mixture: Mixture, area: float, labels: Ints) -> tuple[float, Statistics]:
    """Log-likelihood of the pixels and the statistics of their responsibilities.

    Args:
        cells: (N, 6) cell table.
        mixture: current state; clusters without mass get nothing.
        area: of the image [px^2].
        labels: (N,) written: most responsible cluster of each cell, -1 for specks.

    Returns:
        First term of J at the current state, and the statistics.
    """
    means = mixture.means
    n_clusters = means.shape[0]
    shape = _shape(mixture, area)
    # Sums of 1, dx, dy, dx^2, dx dy, dy^2 about the old means, and each cell's scatter.
    sums = np.zeros((n_clusters, 6))
    speck_mass, log_likelihood = 0.0, 0.0
    density = np.empty(n_clusters)
    for i in range(cells.shape[0]):
        total = _densities_into(density, cells[i], means, shape)
        labels[i] = -1
        if total <= 0.0:
            continue
        n, x, y, cxx, cxy, cyy = cells[i]
        log_likelihood += n * math.log(total)
        speck_mass += n * shape.speck / total
        best = shape.speck
        for k in range(n_clusters):
            if density[k] > 0.0:
                if density[k] > best:
                    best = density[k]
                    labels[i] = k
                r = density[k] / total
                w = r * n
                dx, dy = x - means[k, 0], y - means[k, 1]
                sums[k, 0] += w
                sums[k, 1] += w * dx
                sums[k, 2] += w * dy
                sums[k, 3] += w * dx * dx + r * cxx
                sums[k, 4] += w * dx * dy + r * cxy
                sums[k, 5] += w * dy * dy + r * cyy
    return log_likelihood, _statistics(sums, means, speck_mass)


@kernel
def shared_entropy(cells: Floats, mixture: Mixture, area: float) -> Floats:
    """(K, K) entropy of which of two clusters a pixel is of, summed over the pixels that are of either.

    It is what J loses, beside the fit, when the two become one.
    """
    n_clusters = mixture.means.shape[0]
    shape = _shape(mixture, area)
    density = np.empty(n_clusters)
    out = np.zeros((n_clusters, n_clusters))
    for i in range(cells.shape[0]):
        total = _densities_into(density, cells[i], mixture.means, shape)
        for a in range(n_clusters):
            for b in range(a):
                if density[a] > 0.0 and density[b] > 0.0:
                    both = density[a] + density[b]
                    p = density[a] / both
                    if 1e-9 < p < 1.0 - 1e-9:
                        bits = -p * math.log(p) - (1.0 - p) * math.log(1.0 - p)
                        out[a, b] += cells[i, 0] * both / total * bits
            for b in range(a):
                out[b, a] = out[a, b]
    return out


@kernel
def _statistics(sums: Floats, origins: Floats, speck_mass: float) -> Statistics:
    n_clusters = origins.shape[0]
    mass, means, scatter = np.empty(n_clusters + 1), origins.copy(), np.zeros((n_clusters, 3))
    mass[n_clusters] = speck_mass
    for k in range(n_clusters):
        n = sums[k, 0]
        mass[k] = n
        if n > 0.0:
            mx, my = sums[k, 1] / n, sums[k, 2] / n
            means[k, 0] += mx
            means[k, 1] += my
            scatter[k, 0] = sums[k, 3] - n * mx * mx
            scatter[k, 1] = sums[k, 4] - n * mx * my
            scatter[k, 2] = sums[k, 5] - n * my * my
    return Statistics(mass, means, scatter)


@kernel
def m_step(statistics: Statistics, prior_covs: Floats, prior_mass: Floats) -> Mixture:
    """State that maximises J for given responsibilities: Sigma_k = (nu_k S_k + C_k) / (nu_k + n_k)."""
    covs = np.empty_like(prior_covs)
    for k in range(prior_covs.shape[0]):
        weight = prior_mass[k] + statistics.mass[k]
        covs[k] = (prior_mass[k] * prior_covs[k] + statistics.scatter[k]) / weight
    return Mixture(statistics.means, covs, statistics.mass)


@kernel
def run_em(
    cells: Floats,
    mixture: Mixture,
    prior_covs: Floats,
    prior_mass: Floats,
    area: float,
    labels: Ints,
    max_steps: int,
    tolerance: float,
) -> tuple[Mixture, Statistics, float]:
    """EM steps until J rises by less than `tolerance` per pixel, or `max_steps`; labels as in `e_step`.

    Returns:
        The state, the statistics of its responsibilities, and J.
    """
    total = cells[:, 0].sum()
    value, statistics = e_step(cells, mixture, area, labels)
    value += log_prior(mixture.covs, prior_covs, prior_mass)
    for _ in range(max_steps):
        # M-step: maximum a posteriori of means, covariances and shares
        mixture = m_step(statistics, prior_covs, prior_mass)
        # E-step: responsibilities, and J
        new, statistics = e_step(cells, mixture, area, labels)
        new += log_prior(mixture.covs, prior_covs, prior_mass)
        risen = new - value
        value = new
        if risen < tolerance * total:
            break
    return mixture, statistics, value
