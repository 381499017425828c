"""People-sized clusters of foreground: seeds, EM, and how many clusters there are.

Seeds are the places with the most foreground in a person-sized window, taken one after
another; there are rather too many.  EM (`occlog.vision.em`) is run, the pair of clusters
whose union explains the pixels best is merged, and so on while the penalised objective
rises.  Clusters with too little foreground for a person, even a hidden one, are dropped.
Nothing is drawn at random.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.jit import kernel
from .em import Mixture, Statistics, run_em
from .person_size import SizeMap

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

MAX_CLUSTERS = 64
MAX_STEPS = 12  # of EM between two merges
TOLERANCE = 1e-3  # rise of J per pixel at which EM stops
NEIGHBOUR2 = 16.0  # squared Mahalanobis distance up to which two clusters may be merged
SEED_MASS = 0.06  # of a person's foreground in the window of a seed
SEED_REACH2 = 4.0  # squared Mahalanobis distance of the pixels that a seed takes


class Prior(NamedTuple):
    """What clustering knows of people: a size map, and how strongly to believe in it."""

    cov: Floats  # (grid cells, 3) [px^2]
    mass: Floats  # (grid cells,) foreground pixels of a person
    log_range: Floats  # (grid cells,) largest logarithm of a size relative to the map
    rows: int
    columns: int
    width: int  # of the image [px]
    height: int
    strength: float  # nu_k in persons' pixels
    penalty: float  # cost of a cluster in J, in persons' pixels
    least: float  # smallest cluster that is kept, in persons' pixels


class Clusters(NamedTuple):
    """Clusters of one frame, by falling mass."""

    means: Floats  # (K, 2) [px]
    covs: Floats  # (K, 3) covariance xx, xy, yy of the pixels [px^2]
    mass: Floats  # (K,) pixels
    fill: Floats  # (K,) mass relative to a person in full view at this place
    person: Floats  # (K, 3) covariance of a person's pixels at this place [px^2]
    labels: Ints  # (N,) cluster of each cell, -1 = none


def make_prior(sizes: SizeMap, strength: float, penalty: float, least: float) -> Prior:
    """The prior for the images of one camera; see `Prior`."""
    width, height = sizes.image_size
    rows, columns = sizes.shape
    return Prior(
        np.ascontiguousarray(sizes.cov), np.ascontiguousarray(sizes.mass), 2.0 * sizes.spread,
        rows, columns, width, height, float(strength), float(penalty), float(least),
    )  # fmt: skip


def cell_side(sizes: SizeMap) -> int:
    """Side of the cells [px]: a tenth of a person's width, 2 to 16."""
    return int(np.clip(round(sizes.width_px / 10.0), 2, 16))


@kernel
def place(prior: Prior, x: float, y: float) -> int:
    """Grid cell of the size map at a pixel; positions off the image take the nearest cell."""
    column = min(max(int((x + 0.5) * prior.columns / prior.width), 0), prior.columns - 1)
    row = min(max(int((y + 0.5) * prior.rows / prior.height), 0), prior.rows - 1)
    return row * prior.columns + column


@kernel
def seeds(cells: Floats, corners: Ints, side: int, prior: Prior) -> Floats:
    """(K, 2) centres of person-sized windows with much foreground, greedily.

    Args:
        cells: (N, 6) cell table.
        corners: (N, 2) its cells' corners.
        side: of the cells [px].
        prior: of the camera.
    """
    rows, columns = (prior.height + side - 1) // side, (prior.width + side - 1) // side
    left = cells[:, 0].copy()
    centres = np.empty((MAX_CLUSTERS, 2))
    integral = np.zeros((rows + 1, columns + 1))
    for k in range(MAX_CLUSTERS):
        _integrate_into(integral, left, corners, side)
        best, best_mass = -1, SEED_MASS
        for i in range(cells.shape[0]):
            if left[i] > 0.0:
                mass = _window_mass(integral, cells[i, 1], cells[i, 2], side, prior)
                if mass > best_mass:
                    best, best_mass = i, mass
        if best < 0:
            return centres[:k].copy()
        _take_into(left, centres[k], cells, cells[best, 1], cells[best, 2], prior)
    return centres


@kernel
def _integrate_into(integral: Floats, counts: Floats, corners: Ints, side: int) -> None:
    """Integral image of the counts: [r, c] is the sum over rows < r and columns < c."""
    integral[:] = 0.0
    for i in range(counts.shape[0]):
        integral[corners[i, 1] // side + 1, corners[i, 0] // side + 1] = counts[i]
    for r in range(1, integral.shape[0]):
        run = 0.0
        for c in range(1, integral.shape[1]):
            run += integral[r, c]
            integral[r, c] = integral[r - 1, c] + run


@kernel
def _window_mass(integral: Floats, x: float, y: float, side: int, prior: Prior) -> float:
    """Foreground within one standard deviation of a person's box around a place, in persons' pixels."""
    at = place(prior, x, y)
    rx, ry = math.sqrt(prior.cov[at, 0]), math.sqrt(prior.cov[at, 2])
    rows, columns = integral.shape[0] - 1, integral.shape[1] - 1
    c0, c1 = max(int((x - rx) / side), 0), min(int((x + rx) / side) + 1, columns)
    r0, r1 = max(int((y - ry) / side), 0), min(int((y + ry) / side) + 1, rows)
    inside = integral[r1, c1] - integral[r0, c1] - integral[r1, c0] + integral[r0, c0]
    return float(inside / prior.mass[at])


@kernel
def _take_into(left: Floats, centre: Floats, cells: Floats, x: float, y: float, prior: Prior) -> None:
    """Take the foreground of a person at (x, y) out of `left`; write its mean to `centre`."""
    xx, xy, yy = prior.cov[place(prior, x, y)]
    det = xx * yy - xy * xy
    n = sx = sy = 0.0
    for i in range(cells.shape[0]):
        dx, dy = cells[i, 1] - x, cells[i, 2] - y
        if (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / det <= SEED_REACH2:
            n += left[i]
            sx += left[i] * cells[i, 1]
            sy += left[i] * cells[i, 2]
            left[i] = 0.0
    # The window's own cell is always taken, so n > 0.
    centre[0], centre[1] = sx / n, sy / n


@kernel
def _prior_at(means: Floats, log_sizes: Floats, prior: Prior) -> tuple[Floats, Floats]:
    """Covariance (K, 3) and pixels (K,) of people at the means, scaled by exp(log_sizes)."""
    covs, mass = np.empty((means.shape[0], 3)), np.empty(means.shape[0])
    for k in range(means.shape[0]):
        at = place(prior, means[k, 0], means[k, 1])
        area = math.exp(2.0 * log_sizes[k])
        covs[k] = prior.cov[at] * area
        mass[k] = prior.mass[at] * area
    return covs, mass


@kernel
def _resize_into(log_sizes: Floats, mixture: Mixture, prior: Prior) -> None:
    """Sizes that maximise the prior: exp(2 log_size) = 2 / tr(Sigma^-1 S), within the map's range."""
    for k in range(log_sizes.shape[0]):
        at = place(prior, mixture.means[k, 0], mixture.means[k, 1])
        xx, xy, yy = mixture.covs[k]
        sxx, sxy, syy = prior.cov[at]
        trace = (yy * sxx - 2.0 * xy * sxy + xx * syy) / (xx * yy - xy * xy)
        limit = prior.log_range[at]
        log_sizes[k] = min(max(0.5 * math.log(2.0 / trace), -limit), limit)


@kernel
def _worth(n: float, cxx: float, cxy: float, cyy: float, x: float, y: float, log_size: float, prior: Prior) -> float:
    """Share of a cluster in the penalised objective, with pixels that belong to it alone.

    With Sigma at its maximum, sum_i log N - 1/2 nu (tr(Sigma^-1 S) - log det(Sigma^-1 S)) is
    -1/2 (n + nu) log det Sigma + 1/2 nu log det S up to terms that add up to the same
    before and after a merge, and its share of the pixels adds n log n.
    """
    at = place(prior, x, y)
    area = math.exp(2.0 * log_size)
    person = prior.mass[at] * area
    nu = prior.strength * person
    sxx, sxy, syy = prior.cov[at] * area
    w = n + nu
    xx, xy, yy = (cxx + nu * sxx) / w, (cxy + nu * sxy) / w, (cyy + nu * syy) / w
    fit = -0.5 * w * math.log(xx * yy - xy * xy) + 0.5 * nu * math.log(sxx * syy - sxy * sxy)
    return float(fit + n * math.log(n) - prior.penalty * person)


@kernel
def _merge_best_into(statistics: Statistics, log_sizes: Floats, covs: Floats, alive: Ints, prior: Prior) -> bool:
    """Merge the pair whose union raises the objective most; False if none does."""
    mass, means, scatter = statistics
    best, best_a, best_b = 0.0, -1, -1
    for a in range(means.shape[0]):
        for b in range(a):
            if alive[a] and alive[b] and mass[a] > 0.0 and mass[b] > 0.0:
                gain = _merge_gain(a, b, statistics, log_sizes, covs, prior)
                if gain > best:
                    best, best_a, best_b = gain, a, b
    if best_a < 0:
        return False
    n, x, y, xx, xy, yy = _union(best_a, best_b, statistics)
    mass[best_a] = n
    means[best_a] = x, y
    scatter[best_a] = xx, xy, yy
    alive[best_b] = 0
    mass[best_b] = 0.0
    return True


@kernel
def _union(a: int, b: int, statistics: Statistics) -> tuple[float, float, float, float, float, float]:
    """Mass, mean and scatter of two clusters together."""
    mass, means, scatter = statistics
    n = mass[a] + mass[b]
    share = mass[b] / n
    dx, dy = means[b, 0] - means[a, 0], means[b, 1] - means[a, 1]
    reduced = mass[a] * share
    return (
        n, means[a, 0] + share * dx, means[a, 1] + share * dy,
        scatter[a, 0] + scatter[b, 0] + reduced * dx * dx,
        scatter[a, 1] + scatter[b, 1] + reduced * dx * dy,
        scatter[a, 2] + scatter[b, 2] + reduced * dy * dy,
    )  # fmt: skip


@kernel
def _merge_gain(a: int, b: int, statistics: Statistics, log_sizes: Floats, covs: Floats, prior: Prior) -> float:
    """Rise of the objective by merging clusters a and b; 0 if they are too far apart."""
    mass, means, scatter = statistics
    dx, dy = means[b, 0] - means[a, 0], means[b, 1] - means[a, 1]
    xx, xy, yy = covs[a, 0] + covs[b, 0], covs[a, 1] + covs[b, 1], covs[a, 2] + covs[b, 2]
    if (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy) > NEIGHBOUR2:
        return 0.0
    apart = 0.0
    for k in (a, b):
        apart += _worth(
            mass[k], scatter[k, 0], scatter[k, 1], scatter[k, 2], means[k, 0], means[k, 1], log_sizes[k], prior
        )
    n, x, y, uxx, uxy, uyy = _union(a, b, statistics)
    heavier = a if mass[a] >= mass[b] else b
    return _worth(n, uxx, uxy, uyy, x, y, log_sizes[heavier], prior) - apart


@kernel
def _keep(mixture: Mixture, keep: Ints) -> Mixture:
    """The clusters with keep != 0; the mass of the others goes to the specks."""
    chosen = np.flatnonzero(keep)
    mass = np.empty(len(chosen) + 1)
    mass[:-1] = mixture.mass[:-1][chosen]
    mass[-1] = mixture.mass.sum() - mass[:-1].sum()
    return Mixture(mixture.means[chosen], mixture.covs[chosen], mass)


@kernel
def find_clusters(cells: Floats, corners: Ints, side: int, prior: Prior) -> Clusters:
    """The people-sized clusters of a frame.

    Args:
        cells: (N, 6) cell table.
        corners: (N, 2) its cells' corners.
        side: of the cells [px].
        prior: of the camera.

    Returns:
        Clusters by falling mass; none where nothing is large enough.
    """
    labels = np.full(cells.shape[0], -1, dtype=np.int64)
    means = seeds(cells, corners, side, prior)
    log_sizes = np.zeros(means.shape[0])
    area = float(prior.width * prior.height)
    covs, person = _prior_at(means, log_sizes, prior)
    mass = np.empty(means.shape[0] + 1)
    mass[:-1] = person
    mass[-1] = 0.05 * person.sum()
    mixture = Mixture(means, covs, mass)
    statistics = Statistics(mass, means, covs)
    while mixture.means.shape[0] > 0:
        covs, person = _prior_at(mixture.means, log_sizes, prior)
        mixture, statistics = run_em(cells, mixture, covs, prior.strength * person, area, labels, MAX_STEPS, TOLERANCE)
        _resize_into(log_sizes, mixture, prior)
        covs, person = _prior_at(mixture.means, log_sizes, prior)
        alive = np.ones(mixture.means.shape[0], dtype=np.int64)
        merged = False
        while _merge_best_into(statistics, log_sizes, mixture.covs, alive, prior):
            merged = True
        if not merged:
            # No union left to try: now drop what is too small for a person.
            for k in range(alive.shape[0]):
                alive[k] = mixture.mass[k] >= prior.least * person[k]
            if alive.all():
                break
        w = prior.strength * person
        for k in range(alive.shape[0]):
            mixture.covs[k] = (w[k] * covs[k] + statistics.scatter[k]) / (w[k] + statistics.mass[k])
        mixture = _keep(Mixture(statistics.means, mixture.covs, statistics.mass), alive)
        log_sizes = log_sizes[np.flatnonzero(alive)]
    if mixture.means.shape[0] == 0:
        labels[:] = -1
    return _sorted_clusters(statistics, mixture, log_sizes, labels, prior)


@kernel
def _sorted_clusters(
    statistics: Statistics, mixture: Mixture, log_sizes: Floats, labels: Ints, prior: Prior
) -> Clusters:
    """The clusters by falling mass, and the cells' labels renumbered."""
    n_clusters = mixture.means.shape[0]
    order = np.argsort(-statistics.mass[:n_clusters], kind="mergesort")
    rank = np.empty(n_clusters, dtype=np.int64)
    covs = np.empty((n_clusters, 3))
    expected, person = _prior_at(mixture.means, log_sizes, prior)
    for new in range(n_clusters):
        rank[order[new]] = new
        covs[new] = statistics.scatter[order[new]] / max(statistics.mass[order[new]], 1.0)
    for i in range(labels.shape[0]):
        if labels[i] >= 0:
            labels[i] = rank[labels[i]]
    mass = statistics.mass[:-1][order]
    return Clusters(statistics.means[order], covs, mass, mass / person[order], expected[order], labels)
