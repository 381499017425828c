"""Sources from unlabelled directions of arrival: which directions belong together, and where they meet.

With two arrays every direction of one crosses every direction of the other.  Crossings that
most arrays support are taken first, and of these the ones that fit best and are near a source that is
known already; every direction is used at most once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.plane.polygons import inside_polygon

from .camera import wrap_angle
from .triangulate import MET, sight_lines_meet

NO_SOURCE = np.empty((0, 2))


class Directions(NamedTuple):
    """R directions of one moment."""

    array: Ints  # (R,) which array each is of
    origin: Floats  # (R, 2) where that array is
    azimuth: Floats  # (R,) [rad]
    sigma: Floats  # (R,) [rad], > 0


class Sources(NamedTuple):
    """N places with their covariances and the number of arrays that support each."""

    xy: Floats  # (N, 2)
    covariance: Floats  # (N, 2, 2)
    arrays: Ints  # (N,)


def localise(d: Directions, known: Floats, spread: Floats, region: Floats, gate: float, min_crossing: float) -> Sources:
    """Locate sources.

    Args:
        d: directions, of any number of arrays.
        known: (K, 2) where sources are expected.
        spread: (K, 2, 2) covariances of that.
        region: (P, 2) polygon in which sources can be.
        gate: standard deviations within which a direction supports a place.
        min_crossing: directions that cross at a smaller angle give no place [rad].
    """
    # Cross: every two directions of different arrays, inside the region
    i, j = np.triu_indices(len(d.array), 1)
    other = d.array[i] != d.array[j]
    pairs = np.column_stack([i[other], j[other]])
    xy, cov = _meet(d, list(pairs), min_crossing)
    good = np.isfinite(xy[:, 0])
    good[good] = inside_polygon(np.ascontiguousarray(xy[good]), region)
    pairs, xy, cov = pairs[good], xy[good], cov[good]
    # Support: directions of other arrays that pass near a crossing form a group with it
    off = _misfit(d, xy, cov)
    rows = sorted({tuple(_support(d, pair, off[c], gate).tolist()) for c, pair in enumerate(pairs)})
    groups = [np.array(r, dtype=np.int64) for r in rows]
    # Fit: the place of each group, and the squared misfits of its directions
    xy, cov = _meet(d, groups, min_crossing)
    residual = _misfit(d, xy, np.zeros_like(cov))
    fit = np.array([np.sum(residual[g, r] ** 2) for g, r in enumerate(groups)])
    cost = fit + _nearest(xy, cov, known, spread, gate)
    # Gate: a group of n directions has n - 2 degrees of freedom
    good = np.isfinite(xy[:, 0]) & (fit <= gate**2 + np.array([len(r) - 2 for r in groups]))
    # Choose: groups that share no direction
    chosen = _choose([r if ok else r[:0] for r, ok in zip(groups, good, strict=True)], cost)
    counts = np.array([len(groups[g]) for g in chosen], dtype=np.int64)
    return Sources(xy[chosen], cov[chosen], counts)


def _choose(groups: list[Ints], cost: Floats) -> list[int]:
    """Groups that share no direction: those that use the most directions, and of these the cheapest.

    Every group is tried as the first; the others follow greedily, larger ones first.
    """
    order = sorted((g for g in range(len(groups)) if len(groups[g])), key=lambda g: (-len(groups[g]), cost[g], g))
    sets = [frozenset(r.tolist()) for r in groups]
    best: tuple[float, ...] = (0.0,)
    chosen: list[int] = []
    for first in order:
        taken, mine = set(sets[first]), [first]
        for g in order:
            if not taken & sets[g]:
                taken |= sets[g]
                mine.append(g)
        # A group of two directions always fits, so that larger groups go first here as well.
        score = (-sum(len(groups[g]) - 1 for g in mine), float(np.sum(cost[mine])), *sorted(map(float, mine)))
        if score < best or not chosen:
            best, chosen = score, sorted(mine)
    return chosen


def _meet(d: Directions, rows: list[Ints], min_crossing: float) -> tuple[Floats, Floats]:
    """Places (n, 2) and covariances (n, 2, 2) where groups of directions meet; NaN where they do not."""
    if not rows:
        return NO_SOURCE, np.empty((0, 2, 2))
    flat = np.concatenate(rows)
    starts = np.concatenate([[0], np.cumsum([len(r) for r in rows])])
    m = sight_lines_meet(d.origin[flat], d.azimuth[flat], d.sigma[flat], starts, "gauss", min_crossing)
    return np.where((m.status == MET)[:, None], m.xy, np.nan), m.covariance


def _misfit(d: Directions, xy: Floats, cov: Floats) -> Floats:
    """(C, R) how far each direction passes by each place, in standard deviations of both."""
    away = xy[:, None] - d.origin[None]
    r2 = np.maximum(np.sum(away**2, axis=2), 1e-300)
    gradient = np.stack([-away[:, :, 1], away[:, :, 0]], axis=2) / r2[:, :, None]
    variance = np.einsum("cri,cij,crj->cr", gradient, cov, gradient) + d.sigma**2
    residual = wrap_angle(d.azimuth - np.arctan2(away[:, :, 1], away[:, :, 0]))
    return np.asarray(np.abs(residual) / np.sqrt(variance))


def _support(d: Directions, pair: Ints, off: Floats, gate: float) -> Ints:
    """Rows that support a place: its own two, and of every other array the nearest within the gate."""
    rows = pair.tolist()
    for a in np.unique(d.array).tolist():
        if a in d.array[pair]:
            continue
        mine = np.flatnonzero((d.array == a) & (off <= gate))
        rows += [int(mine[np.argmin(off[mine])])] if len(mine) else []
    return np.array(sorted(rows), dtype=np.int64)


def _nearest(xy: Floats, cov: Floats, known: Floats, spread: Floats, gate: float) -> Floats:
    """(C,) squared standard deviations from each place to the nearest known source; at most those of the gate."""
    if not len(known) or not len(xy):
        return np.full(len(xy), gate**2)
    return np.asarray(np.minimum(distance2(xy, cov, known, spread).min(axis=1), gate**2))


def distance2(xy: Floats, cov: Floats, known: Floats, spread: Floats) -> Floats:
    """(C, K) squared distances, in standard deviations of both, between places and known sources."""
    away = xy[:, None] - known[None]
    both = cov[:, None] + spread[None]
    return np.asarray(np.einsum("cki,cki->ck", away, np.linalg.solve(both, away[..., None])[..., 0]))
