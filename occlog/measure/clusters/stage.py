"""Clustering of a frame's foreground into people, with their number.

EM starts from seeds: greedily the positions with the most foreground in a person-sized window.
Then clusters are merged, split, or dropped as too small for a person, even a hidden one, and
EM runs again, until nothing changes.  The result depends on the frame alone: no step is
random, and no state is carried from frame to frame.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.jit import kernel

from .em import EmStatistics, Mixture, groups_of, merge, run_em, shared_entropy, split
from .person_size import Prior, SizeMap, best_size, grid_cell, person_at

MAX_STEPS = 12  # of EM between two changes
TOLERANCE = 1e-3  # rise of J per pixel at which EM stops
MAX_SPLITS = 2  # rounds of cutting in a frame
MAX_TRIALS = 2  # rounds of doing without an unclear cluster
MAX_DOUBTS = 3  # clusters tried in each
DOUBT = 0.3  # entropy per pixel from which a cluster is unclear; log 2 = 0.69 is complete doubt
SPECKS = 0.05  # share of the specks at the start
MAX_CLUSTERS = 64
SEED_MASS = 0.06  # of a person's foreground in the window of a seed
SEED_REACH2 = 4.0  # squared Mahalanobis distance of the pixels that a seed takes


class Clusters(NamedTuple):
    """K clusters of the foreground pixels of one frame, which are in N cells, by decreasing number of pixels.

    Attributes:
        means: (K, 2) mean x, y [px].
        covs: (K, 3) covariance xx, xy, yy of the pixels [px^2].
        mass: (K,) number of pixels.
        fill: (K,) number of pixels relative to a person in full view at this position.
        person: (K, 3) covariance of a person's pixels at this position [px^2].
        labels: (N,) cluster of each cell; -1: none.
    """

    means: Floats
    covs: Floats
    mass: Floats
    fill: Floats
    person: Floats
    labels: Ints


def cell_side(sizes: SizeMap) -> int:
    """Side of the cells [px]: a tenth of a person's median width in the image, from 2 to 16."""
    return int(np.clip(round(sizes.width_px / 10.0), 2, 16))


@kernel
def find_clusters(cells: Floats, corners: Ints, side: int, prior: Prior) -> Clusters:
    """Find the person-sized clusters of a frame's foreground: EM, then merging, splitting and dropping while J rises.

    Args:
        cells: (N, 6) cells: pixels, mean x, y [px], scatter xx, xy, yy [px^2].
        corners: (N, 2) left and upper pixel of each cell.
        side: side of a cell [px].
        prior: size map of people for the camera.

    Returns:
        Clusters by decreasing mass; none where no cluster is large enough.
    """
    # Seed: one group at each position with much foreground
    labels = np.full(cells.shape[0], -1, dtype=np.int64)
    groups = _groups_at(_seeds(cells, corners, side, prior), prior)
    splits, trials = 0, 0
    while groups.shape[0] > 0:
        # Fit: EM with the person's prior on each covariance ([Rahimi] Sec. 7)
        fit = _fit(cells, groups, labels, prior)
        before = groups_of(fit.statistics)
        entropy = shared_entropy(cells, fit.mixture, _area(prior))
        # Merge pairs, then split, then drop unclear groups: each only while J rises
        groups = merge(before, fit.mixture.covs, entropy, prior)
        if groups.shape[0] == before.shape[0] and splits < MAX_SPLITS:
            groups = split(cells, labels, groups, prior)
            splits += 1
        if groups.shape[0] == before.shape[0] and trials < MAX_TRIALS:
            groups = _without_the_unclear(cells, groups, entropy, fit.value, prior)
            trials += 1
        # Drop groups with too few pixels for a person; without a change the fit has converged
        if groups.shape[0] == before.shape[0]:
            groups = _large(groups, prior)
            if groups.shape[0] == before.shape[0]:
                return _sorted_clusters(groups, labels, prior)
    labels[:] = -1
    return _sorted_clusters(groups, labels, prior)


class _Fit(NamedTuple):
    """Result of an EM run: mixture, sufficient statistics, and the objective J less the cost of the clusters."""

    mixture: Mixture
    statistics: EmStatistics
    value: float  # of J without the cost of the clusters


@kernel
def _area(prior: Prior) -> float:
    return float(prior.width * prior.height)


@kernel
def _fit(cells: Floats, groups: Floats, labels: Ints, prior: Prior) -> _Fit:
    """Run EM from K groups of pixels, with people of the sizes that fit them best as prior.

    `groups` (K, 6) and `cells` (N, 6) have the columns pixels, mean x, y [px], scatter xx, xy, yy [px^2]. `labels`
    (N,), the cluster of each cell, -1 for none, is filled in place. The objective of the result includes the cost
    of the clusters.
    """
    means = groups[:, 1:3].copy()
    covs, person = person_at(means, _sizes_of(groups, prior), prior)
    nu = prior.strength * person
    mass = np.empty(groups.shape[0] + 1)
    mass[:-1] = groups[:, 0]
    total = cells[:, 0].sum()
    mass[-1] = max(total - groups[:, 0].sum(), SPECKS * total)
    posterior = np.empty((groups.shape[0], 3))
    for k in range(groups.shape[0]):
        posterior[k] = (nu[k] * covs[k] + groups[k, 3:]) / (nu[k] + groups[k, 0])
    start = Mixture(means, posterior, mass)
    mixture, statistics, value = run_em(cells, start, covs, nu, _area(prior), labels, MAX_STEPS, TOLERANCE)
    return _Fit(mixture, statistics, value - prior.penalty * person.sum())


@kernel
def _without_the_unclear(cells: Floats, groups: Floats, entropy: Floats, value: float, prior: Prior) -> Floats:
    """Drop the first cluster without which the penalised log posterior rises: rows (K - 1, 6) of that fit, or all.

    Between two people who touch there may be a third cluster that merging of pairs does not remove. The clusters with
    the highest assignment entropy per pixel are tried, at most `MAX_DOUBTS` of them.

    Args:
        cells: (N, 6) cells: pixels, mean x, y [px], scatter xx, xy, yy [px^2].
        groups: (K, 6) clusters, in the same columns.
        entropy: (K, K) assignment entropies of pairs [nats], by `shared_entropy`.
        value: penalised log posterior with all clusters.
        prior: size map of people for the camera.
    """
    doubt = entropy.sum(axis=1) / np.maximum(groups[:, 0], 1.0)
    for k in np.argsort(-doubt, kind="mergesort")[:MAX_DOUBTS]:
        if doubt[k] < DOUBT:
            break
        keep = np.ones(groups.shape[0], dtype=np.bool_)
        keep[k] = False
        fit = _fit(cells, groups[keep], np.empty(cells.shape[0], dtype=np.int64), prior)
        if fit.value > value:
            return groups_of(fit.statistics)
    return groups


@kernel
def _groups_at(centres: Floats, prior: Prior) -> Floats:
    """(K, 6) rows of people in full view at image positions `centres` (K, 2) [px].

    Columns: pixels, mean x, y [px], scatter xx, xy, yy [px^2].
    """
    covs, person = person_at(centres, np.zeros(centres.shape[0]), prior)
    groups = np.empty((centres.shape[0], 6))
    groups[:, 0] = person
    groups[:, 1:3] = centres
    for k in range(centres.shape[0]):
        groups[k, 3:] = covs[k] * person[k]
    return groups


@kernel
def _sizes_of(groups: Floats, prior: Prior) -> Floats:
    """Return the (K,) natural logs of the sizes of people, relative to the size map, that fit the groups (K, 6) best.

    Columns of the groups: pixels, mean x, y [px], scatter xx, xy, yy [px^2].
    """
    out = np.empty(groups.shape[0])
    for k in range(groups.shape[0]):
        n, x, y, xx, xy, yy = groups[k]
        out[k] = best_size(n, xx, xy, yy, grid_cell(prior, x, y), prior)
    return out


@kernel
def _large(groups: Floats, prior: Prior) -> Floats:
    """Select the groups (K, 6: pixels, mean, scatter) with at least `prior.least` of a person's pixels."""
    _, person = person_at(groups[:, 1:3].copy(), _sizes_of(groups, prior), prior)
    return groups[np.flatnonzero(groups[:, 0] >= prior.least * person)]


@kernel
def _sorted_clusters(groups: Floats, labels: Ints, prior: Prior) -> Clusters:
    """Clusters from groups (K, 6: pixels, mean x, y, scatter xx, xy, yy), sorted by decreasing mass.

    `labels` (N,), the group of each cell, -1 for none, are renumbered in place.
    """
    order = np.argsort(-groups[:, 0], kind="mergesort")
    rank = np.empty(order.shape[0], dtype=np.int64)
    groups = groups[order]
    covs = np.empty((order.shape[0], 3))
    for new in range(order.shape[0]):
        rank[order[new]] = new
        covs[new] = groups[new, 3:] / max(groups[new, 0], 1.0)
    for i in range(labels.shape[0]):
        if labels[i] >= 0:
            labels[i] = rank[labels[i]]
    means, mass = groups[:, 1:3].copy(), groups[:, 0].copy()
    expected, person = person_at(means, np.zeros(groups.shape[0]), prior)
    return Clusters(means, covs, mass, mass / person, expected, labels)


@kernel
def _seeds(cells: Floats, corners: Ints, side: int, prior: Prior) -> Floats:
    """(K, 2) initial centres [px] of clusters: person-sized windows with much foreground, selected greedily.

    At most `MAX_CLUSTERS`, each with at least `SEED_MASS` of a person's pixels not taken before.

    Args:
        cells: (N, 6) cells: pixels, mean x, y [px], scatter xx, xy, yy [px^2].
        corners: (N, 2) left and upper pixel of each cell.
        side: side of a cell [px].
        prior: size map of people for the camera.
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
    """Write the integral image of the cells' counts: [r, c] is the sum over rows < r and columns < c of cells.

    Args:
        integral: (rows + 1, columns + 1) filled in place.
        counts: (N,) foreground pixels of each cell.
        corners: (N, 2) left and upper pixel of each cell.
        side: side of a cell [px].
    """
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
    """Foreground within one standard deviation of a person around the pixel (x, y), in units of a person's pixels.

    The window is that of the cells touched by the deviations in x and y.

    Args:
        integral: (rows + 1, columns + 1) integral image of the cells' numbers of foreground pixels.
        x: column of the pixel.
        y: row of the pixel.
        side: side of a cell [px].
        prior: size map of people for the camera.
    """
    at = grid_cell(prior, x, y)
    rx, ry = math.sqrt(prior.cov[at, 0]), math.sqrt(prior.cov[at, 2])
    rows, columns = integral.shape[0] - 1, integral.shape[1] - 1
    c0, c1 = max(int((x - rx) / side), 0), min(int((x + rx) / side) + 1, columns)
    r0, r1 = max(int((y - ry) / side), 0), min(int((y + ry) / side) + 1, rows)
    inside = integral[r1, c1] - integral[r0, c1] - integral[r1, c0] + integral[r0, c0]
    return float(inside / prior.mass[at])


@kernel
def _take_into(left: Floats, centre: Floats, cells: Floats, x: float, y: float, prior: Prior) -> None:
    """Remove the foreground of a person at (x, y) [px] from `left`, in place; write its mean to `centre`.

    Args:
        left: (N,) foreground pixels of each cell that no person has taken, updated in place.
        centre: (2,) mean x, y of the removed pixels [px], filled in place.
        cells: (N, 6) cells: pixels, mean x, y [px], scatter xx, xy, yy [px^2].
        x: column of the person's centre [px], the mean of a cell with pixels left.
        y: row of the person's centre [px].
        prior: size map of people for the camera.
    """
    xx, xy, yy = prior.cov[grid_cell(prior, x, y)]
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
