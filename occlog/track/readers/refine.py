"""Visual refinement: sight lines of cameras improve a tag's coarse position ([Lee] Sec. 5.2.3, Figs. 5-34 and 5-36).

The thesis moves the coarse position by what two cameras see between it and the tag, on planes parallel to theirs
through the coarse position (`printed-1`, Eq. 5.39), and corrects for the tag's depth (`parallel`, Eq. 5.40).  `rays`
crosses the sight lines instead, with the coarse position as prior; it wants one camera at least, the others two.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats

PRINTED, PARALLEL, RAYS = "printed-1", "parallel", "rays"
FORMS = (RAYS, PRINTED, PARALLEL)
ITERATIONS = 40
"""Of Levenberg-Marquardt."""
FIRST_DAMPING = 1e-3
"""As a share of the trace of the information."""
NEAREST = 1e-6
"""Depth below which a camera says nothing of a place; sight lines more parallel than this do not cross."""


class Sights(NamedTuple):
    """What C cameras see of a tag in N windows; NaN: nothing."""

    place: Floats  # (C, 2) of the cameras on the ground
    yaw: Floats  # (C,) azimuth of their axes [rad]
    bearing: Floats  # (N, C) azimuths of the sight lines [rad]
    sigma: Floats  # (N, C) their standard deviations [rad]


class Refined(NamedTuple):
    """N positions; those that could not be refined are as they were."""

    xy: Floats  # (N, 2)
    covariance: Floats  # (N, 2, 2)
    used: Bools  # (N, C) cameras that it was refined by


def refine(xy: Floats, covariance: Floats, sights: Sights, form: str) -> Refined:
    """Refine coarse positions.

    Args:
        xy: (N, 2) coarse positions.
        covariance: (N, 2, 2) theirs.
        sights: what cameras see.
        form: `rays`, `printed-1` or `parallel`.
    """
    seen = np.isfinite(sights.bearing)
    if form == RAYS:
        return _by_rays(xy, covariance, sights, seen)
    return _by_planes(xy, covariance, sights, seen, deep=form == PARALLEL)


def _by_rays(xy: Floats, covariance: Floats, sights: Sights, seen: Bools) -> Refined:
    """Maximise the posterior of Gaussian bearings with the coarse position as prior, by Levenberg-Marquardt."""
    prior = np.linalg.inv(covariance)
    weight = np.where(seen, 1.0 / np.where(seen, sights.sigma, 1.0) ** 2, 0.0)
    bearing = np.where(seen, sights.bearing, 0.0)

    def residuals(at: Floats) -> tuple[Floats, Floats, Floats]:
        """Away from the cameras (N, C, 2), bearings less those of the places (N, C), and the cost (N,)."""
        away = at[:, None, :] - sights.place
        off = _wrapped(bearing - np.arctan2(away[..., 1], away[..., 0]))
        moved = at - xy
        cost = (weight * off**2).sum(axis=1) + np.einsum("ni,nij,nj->n", moved, prior, moved)
        return away, off, cost

    at, damping = xy.copy(), np.full(len(xy), FIRST_DAMPING)
    away, off, cost = residuals(at)
    information = prior
    for _ in range(ITERATIONS):
        squared = np.maximum((away**2).sum(axis=2), NEAREST**2)
        gradient = np.stack([-away[..., 1], away[..., 0]], axis=2) / squared[..., None]
        information = prior + np.einsum("nc,nci,ncj->nij", weight, gradient, gradient)
        score = np.einsum("nc,nci->ni", weight * off, gradient) - np.einsum("nij,nj->ni", prior, at - xy)
        size = np.trace(information, axis1=1, axis2=2)[:, None, None]
        step = np.linalg.solve(information + damping[:, None, None] * size * np.eye(2), score[..., None])[..., 0]
        tried = residuals(at + step)
        better = tried[2] <= cost
        at = np.where(better[:, None], at + step, at)
        damping = np.where(better, 0.1 * damping, np.minimum(10.0 * damping, 1e6))
        away, off, cost = residuals(at)
    used = np.asarray(seen.any(axis=1))
    return Refined(
        np.where(used[:, None], at, xy),
        np.where(used[:, None, None], np.linalg.inv(information), covariance),
        seen,
    )


def _by_planes(xy: Floats, covariance: Floats, sights: Sights, seen: Bools, *, deep: bool) -> Refined:
    """Move by what the first two cameras that see the tag see between it and the coarse position (Eqs. 5.39, 5.40).

    With cameras at a right angle, one along each axis, (dx, dy) = (du_2, du_1) as printed; else the two displacements
    across the cameras' axes are solved for.  The covariance is propagated to first order from that of the coarse
    position and of the bearings: an error across the planes is left, times the slope of the sight line.
    """
    n = len(xy)
    first = np.argsort(~seen, axis=1, kind="stable")[:, :2]
    rows = np.arange(n)[:, None]
    axis = np.stack([np.cos(sights.yaw), np.sin(sights.yaw)], axis=1)[first]  # (N, 2, 2) by camera
    across = np.stack([-axis[..., 1], axis[..., 0]], axis=2)
    bearing = np.where(seen, sights.bearing, 0.0)[rows, first]
    slope = np.tan(_wrapped(bearing - sights.yaw[first]))
    away = xy[:, None, :] - sights.place[first]
    depth = np.einsum("nci,nci->nc", axis, away)
    # Displacement on the object plane through the coarse position: du = tan(beta) d - offset
    shift = slope * depth - np.einsum("nci,nci->nc", across, away)
    determinant = across[:, 0, 0] * across[:, 1, 1] - across[:, 0, 1] * across[:, 1, 0]
    ahead = (np.abs(_wrapped(bearing - sights.yaw[first])) < 0.5 * np.pi) & (depth > NEAREST)
    good = (seen.sum(axis=1) >= 2) & (np.abs(determinant) > NEAREST) & ahead.all(axis=1)
    solve = np.where(good[:, None, None], across, np.eye(2))
    moved = np.linalg.solve(solve, shift[..., None])[..., 0]  # Eq. 5.39
    if deep:
        # Eq. 5.40: du_r = du (d + dd) / d, with the depth dd that Eq. 5.39 finds
        deeper = np.einsum("nci,ni->nc", axis, moved)
        scaled = shift * (depth + deeper) / np.where(ahead, depth, 1.0)
        moved = np.linalg.solve(solve, scaled[..., None])[..., 0]
    sigma = np.where(seen, sights.sigma, 0.0)[rows, first]
    turn = np.linalg.solve(solve, slope[..., None] * axis)
    noise = np.linalg.inv(solve) * (sigma * depth * (1.0 + slope**2))[:, None, :]
    spread = turn @ covariance @ np.swapaxes(turn, 1, 2) + noise @ np.swapaxes(noise, 1, 2)
    used = np.zeros_like(seen)
    used[rows, first] = good[:, None]
    return Refined(np.where(good[:, None], xy + moved, xy), np.where(good[:, None, None], spread, covariance), used)


def _wrapped(angle: Floats) -> Floats:
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)
