"""Where a target can be if no room says so: in what sensors see, drawn by the sight lines of a first scan.

The prior is a mixture: for each sensor a wedge in which all directions and all distances up to a far limit are
equally likely (its density falls with 1 / distance), and a box around the sensors.  Equal distances, not equal areas:
one bearing then leaves the distance evenly spread, and a far limit that is too large does little harm.

A prior that reaches as far as cameras see is diffuse, and bearings are sharp.  First places are therefore drawn where
sight lines lead (`first_places`), each with the weight that the prior over the density of the draws gives it
(importance sampling).
"""

from __future__ import annotations

import math
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import Floats, Ints
from occlog.core.sight.camera import wrap_angle

AROUND_SENSORS = 0.1
"""Share of the prior that is even in the box around the sensors."""
BLIND = 0.1
"""Share of the first places that does not look at the scan."""
CROSSING = 0.6
"""Share of the other first places that is drawn where sight lines cross, if some do."""
WIDER = 1.5
"""Draws at a crossing are spread wider than the crossing's own errors by this factor."""
LEAST_SINE = 0.02
"""Sight lines that cross at a smaller angle (about 1 degree) have no crossing."""
MOST_CROSSINGS = 200
"""Of more crossings so many are taken at random."""
NEAREST = 1e-6
"""Least distance, as a share of the far limit, in densities."""


class ViewPrior(NamedTuple):
    """Where a target can be, from S sensors in the order of the scene; all lengths in one unit."""

    origin: Floats  # (S, 2) where they stand
    axis: Floats  # (S,) azimuth of the middle of the view [rad]
    fov: Floats  # (S,) full field of view [rad], up to 2 pi
    far: Floats  # (S,) far limit, > 0, finite
    share: Floats  # (S,) of the sensor in the mixture, sum 1; 0 for one without a pose
    low: Floats  # (2,) of the box around the sensors
    high: Floats  # (2,)


class SightLines(NamedTuple):
    """R directions in which sensors saw something at one time."""

    origin: Floats  # (R, 2)
    azimuth: Floats  # (R,) [rad]
    sigma: Floats  # (R,) standard deviation of the azimuth, > 0 [rad]
    sigma_origin: Floats  # (R,) standard deviation of the sensor's place, per axis
    far: Floats  # (R,) no target is seen farther off
    sensor: Ints  # (R,) lines of one sensor do not cross

    def sigma_at(self, distance: Floats) -> Floats:
        """(..., R) standard deviation [rad] of the azimuth of a target at distances (..., R)."""
        return np.asarray(np.hypot(self.sigma, self.sigma_origin / np.maximum(distance, NEAREST * self.far)))


def draw(n: int, prior: ViewPrior, rng: Generator) -> Floats:
    """(n, 2) places drawn from the prior."""
    which = rng.choice(len(prior.far), size=n, p=prior.share)
    r, turn = prior.far[which] * rng.random(n), prior.axis[which] + prior.fov[which] * (rng.random(n) - 0.5)
    xy = prior.origin[which] + r[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    box = rng.random(n) < AROUND_SENSORS
    anywhere = prior.low + (prior.high - prior.low) * rng.random((n, 2))
    return np.where(box[:, None], anywhere, xy)


def log_density(xy: Floats, prior: ViewPrior) -> Floats:
    """(N,) log density of the prior at (N, 2) places; -inf where no sensor sees and outside the box."""
    away = xy[:, None] - prior.origin
    r = np.hypot(away[..., 0], away[..., 1])
    off = np.abs(wrap_angle(np.arctan2(away[..., 1], away[..., 0]) - prior.axis))
    inside = (r <= prior.far) & (off <= 0.5 * prior.fov)
    wedge = np.where(inside, 1.0 / (prior.fov * prior.far * np.maximum(r, NEAREST * prior.far)), 0.0)
    in_box = np.all((xy >= prior.low) & (xy <= prior.high), axis=1)
    box = np.where(in_box, 1.0 / np.prod(prior.high - prior.low), 0.0)
    with np.errstate(divide="ignore"):
        return np.asarray(np.log((1.0 - AROUND_SENSORS) * (wedge @ prior.share) + AROUND_SENSORS * box))


def first_places(n: int, lines: SightLines, prior: ViewPrior, rng: Generator) -> tuple[Floats, Floats]:
    """Places at which a target may be that was seen along sight lines, and what each stands for.

    The places are drawn from a mixture: along each line, evenly in distance; around the crossings of lines of
    different sensors; and from the prior itself.  Weighted by the returned weights they are a sample of the prior, in
    which the surroundings of the lines are sampled densely; the likelihood of the scan is not in the weights.

    Args:
        n: number of places.
        lines: what was seen; no line gives draws from the prior.
        prior: where a target can be.
        rng: draws.

    Returns:
        (n, 2) places and (n,) log weights, of the prior's density over the density of the draws.
    """
    centre, covariance = crossings(lines, rng)
    # Shares of the mixture
    R, K = len(lines.azimuth), len(centre)
    blind = math.ceil(BLIND * n) if R else n
    crossing = round(CROSSING * (n - blind)) if K else 0
    along = n - blind - crossing
    # Propose: prior, lines, crossings
    parts = [draw(blind, prior, rng)]
    if along:
        parts.append(_along(along, lines, rng))
    if crossing:
        which = rng.integers(K, size=crossing)
        root = np.linalg.cholesky(covariance)[which]
        parts.append(centre[which] + np.einsum("nij,nj->ni", root, rng.standard_normal((crossing, 2))))
    xy = np.concatenate(parts)
    # Weigh: prior over the density of the mixture
    log_prior = log_density(xy, prior)
    density = blind / n * np.exp(log_prior)
    if along:
        density += along / n * _density_along(xy, lines)
    if crossing:
        density += crossing / n * _density_at(xy, centre, covariance)
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = np.where(np.isneginf(log_prior), -np.inf, log_prior - np.log(density))
    return xy, weights


def crossings(lines: SightLines, rng: Generator) -> tuple[Floats, Floats]:
    """(K, 2) places where lines of different sensors cross ahead of both, and (K, 2, 2) covariances of draws there."""
    pairs = [(i, j) for i, j in combinations(range(len(lines.azimuth)), 2) if lines.sensor[i] != lines.sensor[j]]
    if not pairs:
        return np.empty((0, 2)), np.empty((0, 2, 2))
    i, j = np.array(pairs).T
    e = np.column_stack([np.cos(lines.azimuth), np.sin(lines.azimuth)])
    sine = e[i, 0] * e[j, 1] - e[i, 1] * e[j, 0]
    base = lines.origin[j] - lines.origin[i]
    with np.errstate(divide="ignore", invalid="ignore"):
        ri = (base[:, 0] * e[j, 1] - base[:, 1] * e[j, 0]) / sine
        rj = (base[:, 0] * e[i, 1] - base[:, 1] * e[i, 0]) / sine
        good = (np.abs(sine) >= LEAST_SINE) & (ri > 0) & (rj > 0) & (ri <= lines.far[i]) & (rj <= lines.far[j])
    kept = np.flatnonzero(good)
    if len(kept) > MOST_CROSSINGS:
        kept = np.sort(rng.permutation(kept)[:MOST_CROSSINGS])
    information = np.zeros((len(kept), 2, 2))
    for rows, r in ((i[kept], ri[kept]), (j[kept], rj[kept])):
        across = np.column_stack([-e[rows, 1], e[rows, 0]])
        sigma = np.hypot(r * lines.sigma[rows], lines.sigma_origin[rows])
        information += across[:, :, None] * across[:, None, :] / sigma[:, None, None] ** 2
    covariance = np.asarray(WIDER**2 * np.linalg.inv(information), dtype=np.float64)
    return lines.origin[i[kept]] + ri[kept, None] * e[i[kept]], covariance


def _along(n: int, lines: SightLines, rng: Generator) -> Floats:
    """(n, 2) places along lines, evenly in distance."""
    which = rng.integers(len(lines.azimuth), size=n)
    r = lines.far[which] * rng.random(n)
    sigma = np.hypot(lines.sigma[which], lines.sigma_origin[which] / np.maximum(r, NEAREST * lines.far[which]))
    turn = lines.azimuth[which] + np.minimum(sigma, np.pi) * rng.standard_normal(n)
    return np.asarray(lines.origin[which] + r[:, None] * np.column_stack([np.cos(turn), np.sin(turn)]))


def _density_along(xy: Floats, lines: SightLines) -> Floats:
    """(N,) density of `_along` at (N, 2) places."""
    away = xy[:, None] - lines.origin
    r = np.maximum(np.hypot(away[..., 0], away[..., 1]), NEAREST * lines.far)
    off = wrap_angle(np.arctan2(away[..., 1], away[..., 0]) - lines.azimuth)
    sigma = np.minimum(lines.sigma_at(r), np.pi)
    each = np.exp(-0.5 * (off / sigma) ** 2) / (math.sqrt(2.0 * math.pi) * sigma * lines.far * r)
    return np.asarray(np.where(r <= lines.far, each, 0.0).mean(axis=1))


def _density_at(xy: Floats, centre: Floats, covariance: Floats) -> Floats:
    """(N,) density of the draws at the crossings, at (N, 2) places."""
    precision = np.linalg.inv(covariance)
    scale = np.sqrt(np.linalg.det(precision)) / (2.0 * math.pi * len(centre))
    total = np.zeros(len(xy))
    for c, p, s in zip(centre, precision, scale, strict=True):
        d = xy - c
        total += s * np.exp(-0.5 * (p[0, 0] * d[:, 0] ** 2 + 2 * p[0, 1] * d[:, 0] * d[:, 1] + p[1, 1] * d[:, 1] ** 2))
    return total
