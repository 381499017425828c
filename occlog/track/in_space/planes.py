"""The planes xy, yz and zx of projected planes selection ([Lee] Sec. 2.2).

Directions of a scan become angles of the planes (`plane_angles`), two planes are chosen (`choose_pair`),
particles of a plane are weighed (`log_likelihood`), and the two planes' estimates become one in space
(`combine`, Eqs. 2.17-2.21 and 2.26).
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.sight.projected_planes import (
    AXES,
    XY,
    YZ,
    blind_planes,
    direction,
    projected_angles,
    projected_covariance,
    select_as_printed,
    select_by_variance,
)
from occlog.track.in_space.kernels.likelihood import UNIFORM_AZIMUTH, Chances, log_in_plane, scan_log_likelihood

from .sensing import ScanDirections


class Flat(NamedTuple):
    """What the filter of a plane knows."""

    mean: Floats  # (4,) a, b, va, vb
    covariance: Floats  # (4, 4)
    log_evidence: float  # of the scan: log of the sum of the unnormalised weights
    ess: float


class Joined(NamedTuple):
    """What two planes know of the target in space."""

    mean: Floats  # (6,) x, y, z, vx, vy, vz
    axis: Floats  # (3, 2, 2) covariance of position and velocity on each axis
    covariance: Floats  # (3, 3) of the position


def shared_axis(p: int, q: int) -> int:
    """The axis that two different planes have in common."""
    return next(k for k in AXES[p] if k in AXES[q])


def combine(planes: tuple[int, int], flat: tuple[Flat, Flat], rule: str) -> Joined:
    """The state in space from two planes.

    The axis that both have is a weighted mean.  Both planes have seen the same noise and
    started from the same prior, so that their errors are taken as fully correlated: its standard
    deviation is the weighted mean of the two.  Correlations between axes are those of the
    plane that has both; between the two axes that no used plane has together it is the product of
    their correlations with the common one, as if they were independent given that one.

    Args:
        planes: two different ones.
        flat: what they know.
        rule: `inverse` weighs position and velocity by inverse variance, `planes-weighted` by the sums of the
            unnormalised weights (Eq. 2.19), `equal` evenly (Eq. 2.21).
    """
    # Eqs. 2.18 and 2.20: the axes that one plane alone has
    k = shared_axis(*planes)
    mean, axis = np.zeros(6), np.zeros((3, 2, 2))
    rows = [[AXES[p].index(k), AXES[p].index(k) + 2] for p in planes]
    shares = _shares(flat, rows, rule)
    for p, f in zip(planes, flat, strict=True):
        for place, i in enumerate(AXES[p]):
            mean[[i, i + 3]] = f.mean[[place, place + 2]]
            axis[i] = f.covariance[np.ix_([place, place + 2], [place, place + 2])]
    # Eqs. 2.19 and 2.21: the redundant axis
    mean[[k, k + 3]] = sum(w * f.mean[r] for w, f, r in zip(shares, flat, rows, strict=True))
    axis[k] = _shared_covariance(shares, [f.covariance[np.ix_(r, r)] for f, r in zip(flat, rows, strict=True)])
    return Joined(mean, axis, _position_covariance(planes, flat, axis))


def _shares(flat: tuple[Flat, Flat], rows: list[list[int]], rule: str) -> Floats:
    """(2, 2) weights of the two planes, for position and velocity of the common axis."""
    if rule == "equal":
        return np.full((2, 2), 0.5)
    if rule == "planes-weighted":
        gap = flat[1].log_evidence - flat[0].log_evidence
        first = 1.0 / (1.0 + math.exp(min(gap, 700.0))) if math.isfinite(gap) else 0.5
        return np.array([[first, first], [1.0 - first, 1.0 - first]])
    precision = np.array([1.0 / np.maximum(np.diag(f.covariance)[r], 1e-300) for f, r in zip(flat, rows, strict=True)])
    return np.asarray(precision / precision.sum(axis=0))


def _shared_covariance(shares: Floats, own: list[Floats]) -> Floats:
    """(2, 2) of position and velocity of the common axis."""
    sd = sum(w * np.sqrt(np.diag(c)) for w, c in zip(shares, own, strict=True))
    correlation = sum(float(w[0]) * _correlation(c, 0, 1) for w, c in zip(shares, own, strict=True))
    return np.asarray(np.outer(sd, sd) * np.array([[1.0, correlation], [correlation, 1.0]]))


def _position_covariance(planes: tuple[int, int], flat: tuple[Flat, Flat], axis: Floats) -> Floats:
    """(3, 3), positive semidefinite."""
    k = shared_axis(*planes)
    with_shared = np.ones(3)
    for p, f in zip(planes, flat, strict=True):
        with_shared[next(i for i in AXES[p] if i != k)] = _correlation(f.covariance, 0, 1)
    correlation = np.outer(with_shared, with_shared)
    np.fill_diagonal(correlation, 1.0)
    sd = np.sqrt(axis[:, 0, 0])
    return np.asarray(np.outer(sd, sd) * correlation)


def _correlation(covariance: Floats, i: int, j: int) -> float:
    scale = math.sqrt(covariance[i, i] * covariance[j, j])
    return float(np.clip(covariance[i, j] / scale, -1.0, 1.0)) if scale > 0 else 0.0


Pair = tuple[tuple[int, int], tuple[int, int]]
"""Two (sensor of the scan, plane); sensor -1: no sensor tells anything in that plane."""
NOTHING: Pair = ((-1, XY), (-1, YZ))


class Angles(NamedTuple):
    """The rows of a scan in the three planes."""

    angle: Floats  # (R, 3) [rad]
    sigma: Floats  # (R, 3) [rad]
    blind: Bools  # (R, 3) planes in which a row tells nothing, or not what its sigma says
    toward: Floats  # (R, 3) unit vectors in the world


def plane_angles(heard: ScanDirections) -> Angles:
    """Projected angles and their standard deviations; an azimuth alone is one of xy."""
    s = heard.sights
    phi = np.where(heard.flat, 0.5 * math.pi, s.phi)
    toward = np.einsum("rij,rj->ri", heard.rotation, direction(heard.theta, phi))
    noise = (heard.theta, phi, s.sigma_theta, s.sigma_phi, heard.rotation)
    variance = np.diagonal(projected_covariance(*noise, pole_term=True), axis1=1, axis2=2)
    blind = blind_planes(*noise)
    variance = np.where(heard.flat[:, None], s.sigma_theta[:, None] ** 2, variance)
    blind = np.where(heard.flat[:, None], np.array([False, True, True]), blind | ~(variance > 0))
    return Angles(projected_angles(toward), np.sqrt(np.where(blind, 1.0, variance)), blind, toward)


def choose_pair(rule: str, heard: ScanDirections, angles: Angles, near: Floats, before: Pair) -> Pair:
    """The two planes to use, with the sensor that tells most in each.

    Of the candidates of a sensor that one counts which points nearest to where the target should be.

    Args:
        rule: `variance` or `printed`.
        heard: the scan.
        angles: of its rows.
        near: (3,) where the target should be; NaN: unknown, each sensor's first row counts.
        before: what to use where the scan does not tell.
    """
    rows = nearest_rows(heard, angles, near)
    if not (rows >= 0).any():
        return before
    if rule == "printed":
        return _printed(heard, rows, before)
    variance = np.where(rows[:, None] >= 0, angles.sigma[rows] ** 2, np.nan)
    chosen = select_by_variance(variance, angles.blind[rows])
    return _filled([(int(s), int(p)) for s, p in chosen if p >= 0], before)


def _printed(heard: ScanDirections, rows: Ints, before: Pair) -> Pair:
    """By polar angles alone; a sensor without them is not asked."""
    phi = np.where(rows >= 0, heard.sights.phi[rows], np.nan)
    told = np.flatnonzero(~np.isnan(phi))
    if not len(told):
        return _filled([(int(np.flatnonzero(rows >= 0)[0]), XY)], before)
    (s, p), (t, q) = select_as_printed(phi[told])
    return (int(told[s]), int(p)), (int(told[t]), int(q))


def _filled(found: list[tuple[int, int]], before: Pair) -> Pair:
    """Two planes in any case: those found, those used before, and yz or xy."""
    planes = [p for _, p in found]
    spare = [p for _, p in (*before, *NOTHING) if p not in planes]
    found = [*found, *((-1, p) for p in dict.fromkeys(spare))]
    return found[0], found[1]


def nearest_rows(heard: ScanDirections, angles: Angles, near: Floats) -> Ints:
    """(N,) row of each sensor that points nearest to a place; -1 for a sensor that saw nothing."""
    first = heard.sights.first
    to = near - heard.sights.position
    away = -np.einsum("ri,ri->r", angles.toward, to) / np.maximum(np.linalg.norm(to, axis=1), 1e-300)
    away = np.where(np.isnan(away), 0.0, away)
    found = [a + int(np.argmin(away[a:b])) if b > a else -1 for a, b in pairwise(first.tolist())]
    return np.array(found, dtype=np.int64).reshape(-1)


def log_likelihood(
    cloud: Floats, plane: int, heard: ScanDirections, angles: Angles, chances: Chances, only: int | None = None
) -> Floats:
    """(L,) log likelihoods of a scan for (4, L) particles of a plane, up to a constant.

    A sensor counts if none of its candidates is blind in this plane: otherwise one that cannot be seen
    here might be the target's.

    Args:
        cloud: particles.
        plane: index in `planes.PLANES`.
        heard: the scan.
        angles: of its rows.
        chances: see `space.scan_log_likelihood`.
        only: the one sensor of the scan to use; None: all.
    """
    s = heard.sights
    counts = np.diff(s.first)
    of = np.repeat(np.arange(len(counts)), counts)
    usable = np.bincount(of, weights=angles.blind[:, plane], minlength=len(counts)) == 0
    if only is not None:
        usable &= np.arange(len(counts)) == only
    rows = usable[of]
    if not rows.any():
        return np.zeros(cloud.shape[1])
    first = np.concatenate([[0], np.cumsum(np.where(usable, counts, 0))])
    place = s.position[rows][:, list(AXES[plane])]
    each = log_in_plane(
        cloud[:2], place, angles.angle[rows, plane], angles.sigma[rows, plane], s.reach[rows], chances.soften
    )
    uniform = np.full(len(each), UNIFORM_AZIMUTH)
    return scan_log_likelihood(each, first, s.labelled, s.share[rows], uniform, chances)
