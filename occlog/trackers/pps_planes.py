"""Directions of a scan as angles of the planes xy, yz and zx, and the two planes to use ([Lee] Sec. 2.2)."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ..columns import Bools, Floats, Ints
from ..core.planes import (
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
from ..core.space import UNIFORM_AZIMUTH, Chances, log_in_plane, scan_log_likelihood
from .space_sensing import Heard

Pair = tuple[tuple[int, int], tuple[int, int]]
"""Two (sensor of the scan, plane); sensor -1: nobody tells anything in that plane."""
NOTHING: Pair = ((-1, XY), (-1, YZ))


class Angles(NamedTuple):
    """The rows of a scan in the three planes."""

    angle: Floats  # (R, 3) [rad]
    sigma: Floats  # (R, 3) [rad]
    blind: Bools  # (R, 3) planes in which a row tells nothing, or not what its sigma says
    toward: Floats  # (R, 3) unit vectors in the world


def plane_angles(heard: Heard) -> Angles:
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


def choose_pair(rule: str, heard: Heard, angles: Angles, near: Floats, before: Pair) -> Pair:
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


def _printed(heard: Heard, rows: Ints, before: Pair) -> Pair:
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


def nearest_rows(heard: Heard, angles: Angles, near: Floats) -> Ints:
    """(N,) row of each sensor that points nearest to a place; -1 for a sensor that saw nothing."""
    first = heard.sights.first
    to = near - heard.sights.position
    away = -np.einsum("ri,ri->r", angles.toward, to) / np.maximum(np.linalg.norm(to, axis=1), 1e-300)
    away = np.where(np.isnan(away), 0.0, away)
    found = [a + int(np.argmin(away[a:b])) if b > a else -1 for a, b in pairwise(first.tolist())]
    return np.array(found, dtype=np.int64).reshape(-1)


def log_likelihood(
    cloud: Floats, plane: int, heard: Heard, angles: Angles, chances: Chances, only: int | None = None
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
