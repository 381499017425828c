"""EM for a mixture of Gaussians with a person's covariance as prior, [Rahimi] Sec. 7.

Model of a foreground pixel x: p(x) = sum_k pi_k N(x | mu_k, Sigma_k) + pi_0 / A, with A the area of the image; the last
term models isolated noise pixels. The prior of each covariance is inverse Wishart with its mode at the covariance S_k
of a person at this position, and the weight of nu_k pixels. The objective is

    J = sum_i n_i log p(x_i) - 1/2 sum_k nu_k (tr(Sigma_k^-1 S_k) - 2 - log det(Sigma_k^-1 S_k))

so that a region smaller than a person keeps nearly a person's covariance and merges with regions nearby. Pixels come in
cells (`occlog.measure.regions.regions`) that share their responsibilities; with the cells' own scatter in both steps J
never decreases.

Arrays: covariances and scatters are rows (xx, xy, yy) [px^2]; K clusters, N cells.

Merge and split clusters while the penalised objective (`person_size.worth`) rises.

A group is a row (n, x, y, xx, xy, yy): pixels, mean and scatter about it, like a cell.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.jit import kernel

from .person_size import Prior, grid_cell, worth

FAR2 = 40.0  # squared Mahalanobis distance from which a density counts as 0


class Mixture(NamedTuple):
    """State of EM for K Gaussian clusters: means (K, 2) [px], covariances xx, xy, yy (K, 3) [px^2] and weights.

    `mass` (K + 1,) is the number of pixels of each cluster, then of the uniform term for noise pixels.
    """

    means: Floats  # (K, 2) [px]
    covs: Floats  # (K, 3) [px^2]
    mass: Floats  # (K + 1,) pixels of each cluster, then of the specks


class EmStatistics(NamedTuple):
    """Sufficient statistics for the M-step of K clusters: pixels weighted by responsibility.

    `mass` (K + 1,) is the number of pixels of each cluster, then of the uniform noise term; `means` (K, 2) [px];
    `scatter` (K, 3) the sums xx, xy, yy of products about the means [px^2].
    """

    mass: Floats  # (K + 1,)
    means: Floats  # (K, 2)
    scatter: Floats  # (K, 3) about the means


@kernel
def log_prior(covs: Floats, prior_covs: Floats, prior_mass: Floats) -> float:
    """Log inverse-Wishart prior of the covariances of K clusters relative to its mode, summed: the second term of J.

    Args:
        covs: (K, 3) xx, xy, yy of the covariances Sigma_k [px^2].
        prior_covs: (K, 3) S_k, those of people at the positions of the clusters [px^2].
        prior_mass: (K,) nu_k, pixels that the prior counts for.
    """
    total = 0.0
    for k in range(covs.shape[0]):
        xx, xy, yy = covs[k]
        sxx, sxy, syy = prior_covs[k]
        det, sdet = xx * yy - xy * xy, sxx * syy - sxy * sxy
        trace = (yy * sxx - 2.0 * xy * sxy + xx * syy) / det
        total -= 0.5 * prior_mass[k] * (trace - 2.0 - math.log(sdet / det))
    return total


class _Shape(NamedTuple):
    """Precomputed parameters of the weighted densities of K clusters.

    `inverse` (K, 3): inverse covariances xx, xy, yy [1/px^2]; `log_scale` (K,): log of mixing weight / (2 pi
    sqrt(det)); `speck`: weighted uniform density of noise pixels [1/px^2].
    """

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
    """Write the weighted densities of K clusters at a cell to `density` (K,); return their sum with the uniform term.

    Cluster densities are geometric means over the cell's pixels, and 0 from the squared Mahalanobis distance `FAR2` on.

    Args:
        density: (K,) filled in place.
        cell: (6,) pixels, mean x, y [px] and scatter xx, xy, yy [px^2] of the cell.
        means: (K, 2) of the clusters [px].
        shape: inverse covariances, scales, and uniform density.
    """
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
def e_step(cells: Floats, mixture: Mixture, area: float, labels: Ints) -> tuple[float, EmStatistics]:
    """E-step: log-likelihood of the foreground pixels, and the sufficient statistics of their responsibilities.

    Args:
        cells: (N, 6) cells: pixels, mean x, y [px], scatter xx, xy, yy [px^2].
        mixture: current state; clusters without mass get no pixels.
        area: area of the image [px^2], for the uniform noise term.
        labels: (N,) filled in place: most responsible cluster of each cell, -1 for noise.
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
    """(K, K) symmetric assignment entropies [nats] between pairs of K clusters, summed over their pixels.

    When two are merged, the classification log-likelihood loses this in addition to the worse fit.

    Args:
        cells: (N, 6) cells: pixels, mean x, y [px], scatter xx, xy, yy [px^2].
        mixture: the K clusters.
        area: area of the image [px^2], for the uniform noise term.
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
def _statistics(sums: Floats, origins: Floats, speck_mass: float) -> EmStatistics:
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
    return EmStatistics(mass, means, scatter)


@kernel
def m_step(statistics: EmStatistics, prior_covs: Floats, prior_mass: Floats) -> Mixture:
    """M-step: maximum a posteriori mixture of K clusters, Sigma_k = (nu_k S_k + C_k) / (nu_k + n_k).

    Args:
        statistics: sums over the pixels weighted by responsibility; C_k is the scatter, n_k the mass.
        prior_covs: (K, 3) S_k, xx, xy, yy of people's covariances [px^2].
        prior_mass: (K,) nu_k, pixels that the prior counts for.
    """
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
) -> tuple[Mixture, EmStatistics, float]:
    """Run EM until the log posterior J rises by less than `tolerance` per pixel, or for `max_steps` steps.

    J is the log-likelihood of the foreground pixels plus the log prior of the clusters' covariances.

    Args:
        cells: (N, 6) cells: pixels, mean x, y [px], scatter xx, xy, yy [px^2].
        mixture: initial state with K clusters.
        prior_covs: (K, 3) xx, xy, yy of people's covariances [px^2].
        prior_mass: (K,) pixels that the prior counts for.
        area: area of the image [px^2], for the uniform noise term.
        labels: (N,) filled in place: most responsible cluster of each cell, -1 for noise.
        max_steps: limit, at least 0.
        tolerance: rise of J per pixel.

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


NEIGHBOUR2 = 16.0  # squared Mahalanobis distance up to which two clusters may be merged


@kernel
def union(a: Floats, b: Floats) -> Floats:
    """Return the union (6,) of two groups of pixels a and b (6,): number, mean x, y [px], scatter xx, xy, yy [px^2].

    At least one of them has pixels.
    """
    n = a[0] + b[0]
    share = b[0] / n
    dx, dy = b[1] - a[1], b[2] - a[2]
    reduced = a[0] * share
    out = np.empty(6)
    out[0], out[1], out[2] = n, a[1] + share * dx, a[2] + share * dy
    out[3] = a[3] + b[3] + reduced * dx * dx
    out[4] = a[4] + b[4] + reduced * dx * dy
    out[5] = a[5] + b[5] + reduced * dy * dy
    return out


@kernel
def groups_of(statistics: EmStatistics) -> Floats:
    """Return the (K, 6) rows of the clusters' statistics: pixels, mean x, y [px], scatter xx, xy, yy [px^2].

    The uniform noise term is omitted.
    """
    out = np.empty((statistics.means.shape[0], 6))
    out[:, 0] = statistics.mass[:-1]
    out[:, 1:3] = statistics.means
    out[:, 3:] = statistics.scatter
    return out


@kernel
def group_worth(g: Floats, prior: Prior) -> float:
    """Contribution to the objective of a group `g` (6,): pixels, mean x, y, scatter xx, xy, yy; 0 without pixels."""
    return worth(g[0], g[1], g[2], g[3], g[4], g[5], prior) if g[0] > 0.0 else 0.0


@kernel
def merge(groups: Floats, covs: Floats, entropy: Floats, prior: Prior) -> Floats:
    """Merge pairs of clusters, the best first, as long as the penalised objective rises; return the (M, 6) remaining.

    A union must gain more than the entropy between both, since pixels between two clusters are explained by both
    together. The given arrays are not changed.

    Args:
        groups: (K, 6) pixels, mean x, y [px] and scatter xx, xy, yy [px^2] of the clusters, by responsibilities.
        covs: (K, 3) covariances of the clusters [px^2]; only pairs within `NEIGHBOUR2` are tried.
        entropy: (K, K) assignment entropies of pairs, by `shared_entropy`.
        prior: sizes of people in the camera's image.
    """
    groups, entropy = groups.copy(), entropy.copy()
    worths = np.array([group_worth(groups[k], prior) for k in range(groups.shape[0])])
    while True:
        # Search: the pair of neighbours with the union that gains most
        best, best_a, best_b = 0.0, -1, -1
        for a in range(groups.shape[0]):
            for b in range(a):
                if groups[a, 0] > 0.0 and groups[b, 0] > 0.0 and _near(groups[a], groups[b], covs[a], covs[b]):
                    separate_worth = worths[a] + worths[b] + entropy[a, b]
                    gain = group_worth(union(groups[a], groups[b]), prior) - separate_worth
                    if gain > best:
                        best, best_a, best_b = gain, a, b
        if best_a < 0:
            return groups[np.flatnonzero(groups[:, 0] > 0.0)]
        groups[best_a] = union(groups[best_a], groups[best_b])
        groups[best_b, 0] = 0.0
        worths[best_a] = group_worth(groups[best_a], prior)
        # The entropy between the union and a third group is at least the sum of both
        entropy[best_a] += entropy[best_b]
        entropy[:, best_a] = entropy[best_a]


@kernel
def _near(a: Floats, b: Floats, cov_a: Floats, cov_b: Floats) -> bool:
    dx, dy = b[1] - a[1], b[2] - a[2]
    xx, xy, yy = cov_a[0] + cov_b[0], cov_a[1] + cov_b[1], cov_a[2] + cov_b[2]
    return bool((yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy) <= NEIGHBOUR2)


@kernel
def split(cells: Floats, labels: Ints, groups: Floats, prior: Prior) -> Floats:
    """Split each cluster in two if the halves have a higher penalised objective; return (K to 2 K, 6) rows.

    The cut is a straight line, parallel to the axis of a person who stands there, at the best position. The rows of
    clusters that are not split are unchanged.

    Args:
        cells: (N, 6) cells: pixels, mean x, y [px], scatter xx, xy, yy [px^2].
        labels: (N,) cluster of each cell; -1: none.
        groups: (K, 6) pixels, mean and scatter of the clusters, in the columns of `cells`.
        prior: sizes of people in the camera's image.
    """
    out = np.empty((2 * groups.shape[0], 6))
    n_out = 0
    for k in range(groups.shape[0]):
        mine = cells[np.flatnonzero(labels == k)]
        halves = _halves(mine, grid_cell(prior, groups[k, 1], groups[k, 2]), prior)
        for half in halves:
            out[n_out] = half
            n_out += 1
        if halves.shape[0] == 0:
            out[n_out] = groups[k]
            n_out += 1
    return out[:n_out].copy()


@kernel
def _halves(cells: Floats, at: int, prior: Prior) -> Floats:
    """(2, 6) best halves of a cluster's cells, cut along a person's axis; (0, 6) if the whole has a higher objective.

    Args:
        cells: (N, 6) cells of the cluster: pixels, mean x, y [px], scatter xx, xy, yy [px^2].
        at: index of the size map's cell at the cluster's mean.
        prior: sizes of people in the camera's image.
    """
    # Direction across a person: the minor axis of its covariance.
    xx, xy, yy = prior.cov[at]
    angle = 0.5 * math.atan2(2.0 * xy, xx - yy) + 0.5 * math.pi
    # Sweep: statistics of all cells left and right of every cut
    order = np.argsort(math.cos(angle) * cells[:, 1] + math.sin(angle) * cells[:, 2], kind="mergesort")
    n = cells.shape[0]
    from_left, from_right = np.zeros((n + 1, 6)), np.zeros((n + 1, 6))
    for i in range(n):
        from_left[i + 1] = union(cells[order[i]], from_left[i])
        from_right[n - 1 - i] = union(cells[order[n - 1 - i]], from_right[n - i])
    best, best_cut = 0.0, -1
    whole = group_worth(from_left[n], prior)
    for i in range(1, n):
        gain = group_worth(from_left[i], prior) + group_worth(from_right[i], prior) - whole
        if gain > best:
            best, best_cut = gain, i
    out = np.empty((2 if best_cut >= 0 else 0, 6))
    if best_cut >= 0:
        out[0], out[1] = from_left[best_cut], from_right[best_cut]
    return out
