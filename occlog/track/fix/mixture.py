"""A position from bearings of which some may be false: the modes of a mixture likelihood, and their spread.

Each bearing is true, with a Gaussian error of its stated standard deviation, or false, and then from anywhere; at
`bend` standard deviations both are as likely.  The likelihood of a position has a mode wherever enough bearings agree.
All of them are looked for, from where each two lines cross, by Gauss and Newton with reweighting.  The estimate is the
highest mode.  Its covariance is the second moment of all modes about it, by their heights, so that it is wide where it
cannot be told which bearing is false.  (Volumes do not count: lines that are next to parallel would meet at infinity.)

Few residuals tell little of the errors' scale: they are pooled with what is stated, which counts as much as `WORTH`
of them, and the covariance is that of Student's distribution with so many degrees of freedom.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats

from .repeated_median import crossings

WORTH = 10.0
"""What is stated counts as much as so many residuals."""
ITERATIONS, HALVINGS = 50, 8
TIGHT = 1e-9
"""Largest move of a mode in its last iteration, as a share of the distances."""
SAME = 1e-4
"""Modes that are nearer, as a share of the distances, are one."""
RARE = 0.01
"""Modes less probable than this do not count."""
FLAT = 1e-9
"""Modes whose information differs by a smaller factor along and across are no positions."""


class Modes(NamedTuple):
    """M modes, the most probable first."""

    xy: Floats  # (M, 2)
    covariance: Floats  # (M, 2, 2) with the stated standard deviations
    believed: Floats  # (M, n) probability that each bearing is true
    residual: Floats  # (M, n) in standard deviations
    probability: Floats  # (M,) sum 1
    elsewhere: float = 0.0  # share of the likelihood, volumes and rare modes included, that is not about the first


def pooled_factor(squares: float, freedom: float) -> float:
    """Factor of a covariance made with stated standard deviations: pooled scale, and Student's distribution.

    Args:
        squares: sum of the squared residuals in standard deviations.
        freedom: how many of them are more than were fitted, >= 0.
    """
    degrees = WORTH + freedom
    return (WORTH + squares) / degrees * degrees / (degrees - 2.0)


def modes(places: Floats, bearings: Floats, sigma: Floats, bend: float) -> Modes | None:
    """The modes of the likelihood of a position; None where the bearings do not tell one.

    Args:
        places: (n, 2) where the bearings were taken, n >= 2.
        bearings: (n,) [rad].
        sigma: (n,) standard deviations [rad], above 0.
        bend: standard deviations at which a bearing is as likely false as true.
    """
    points = crossings(places, bearings)
    both = np.isfinite(points[:, :, 0]) & np.isfinite(points[:, :, 0].T)  # in front of both
    i, j = np.nonzero(np.triu(both))
    if not len(i):
        return None
    xy = _climbed(points[i, j], places, bearings, sigma, bend)
    residual, believed, across = _at(xy, places, bearings, sigma, bend)
    information = np.einsum("mn,mni,mnj->mij", believed, across, across)
    size = np.linalg.eigvalsh(information)
    good = np.isfinite(xy).all(axis=1) & (size[:, 0] > FLAT * size[:, 1]) & (believed.sum(axis=1) > 1.5)
    if not good.any():
        return None
    xy, residual, believed, information = xy[good], residual[good], believed[good], information[good]
    log = -_cost(residual, bend)
    order = np.argsort(-log, kind="stable")
    scale = np.hypot(*(places - places.mean(axis=0)).T).max() + 1e-300
    kept: list[int] = []
    for m in order.tolist():
        if all(np.hypot(*(xy[m] - xy[k])) > SAME * scale for k in kept):
            kept.append(m)
    weight = np.exp(log[kept] - log[kept[0]])
    chosen = np.array(kept)[weight / weight.sum() >= RARE]
    weight = weight[: len(chosen)]
    covariance = _with_distances(xy[chosen], np.linalg.inv(information[chosen]), believed[chosen], places, sigma)
    return Modes(xy[chosen], covariance, believed[chosen], residual[chosen], weight / weight.sum())


def _with_distances(xy: Floats, covariance: Floats, believed: Floats, places: Floats, sigma: Floats) -> Floats:
    """(M, 2, 2) covariances that know how uncertain the distance of each sensor is.

    An error of the bearing puts the target aside by that times the distance, whose mean square is the estimate's plus
    its variance along the sight line.  Where that is large, as for sight lines that are nearly parallel, a mode
    next to a sensor would else seem sharp, since little is between them.
    """
    away = xy[:, None, :] - places[None]
    squared = np.maximum((away**2).sum(axis=2), 1e-24)
    along = away / np.sqrt(squared)[..., None]
    wide = squared + np.einsum("mni,mij,mnj->mn", along, covariance, along)
    across = np.stack([-along[..., 1], along[..., 0]], axis=2) / (np.sqrt(wide) * sigma)[..., None]
    return np.asarray(np.linalg.inv(np.einsum("mn,mni,mnj->mij", believed, across, across)))


def spread_of(found: Modes, *, pooled: bool) -> Floats:
    """(2, 2) second moment of all modes about the first, with scales that are pooled or as stated."""
    factor = np.ones(len(found.xy))
    if pooled:
        squares = np.einsum("mn,mn->m", found.believed, np.minimum(found.residual**2, 1e6))
        freedom = np.maximum(found.believed.sum(axis=1) - 2.0, 0.0)
        factor = np.array([pooled_factor(s, f) for s, f in zip(squares.tolist(), freedom.tolist(), strict=True)])
    away = found.xy - found.xy[0]
    each = factor[:, None, None] * found.covariance + away[:, :, None] * away[:, None, :]
    return np.asarray(np.einsum("m,mij->ij", found.probability, each))


def _at(xy: Floats, places: Floats, bearings: Floats, sigma: Floats, bend: float) -> tuple[Floats, Floats, Floats]:
    """Residuals (M, n), beliefs (M, n) and gradients (M, n, 2) of the predicted bearings, in standard deviations."""
    away = xy[:, None, :] - places[None]
    off = bearings - np.arctan2(away[..., 1], away[..., 0])
    residual = ((off + np.pi) % (2.0 * np.pi) - np.pi) / sigma
    believed = 1.0 / (1.0 + np.exp(np.minimum(0.5 * (residual**2 - bend**2), 700.0)))
    squared = np.maximum((away**2).sum(axis=2), 1e-24)
    across = np.stack([-away[..., 1], away[..., 0]], axis=2) / (squared * sigma)[..., None]
    return residual, believed, across


def _cost(residual: Floats, bend: float) -> Floats:
    """(M,) negative log likelihoods, up to a constant."""
    return np.asarray(-np.logaddexp(-0.5 * residual**2, -0.5 * bend**2).sum(axis=1))


def _climbed(xy: Floats, places: Floats, bearings: Floats, sigma: Floats, bend: float) -> Floats:
    """(M, 2) modes that starts lead to: Gauss and Newton with reweighting, and steps halved until the cost falls."""
    xy = xy.copy()
    scale = np.hypot(*(places - places.mean(axis=0)).T).max() + 1e-300
    for _ in range(ITERATIONS):
        residual, believed, across = _at(xy, places, bearings, sigma, bend)
        information = np.einsum("mn,mni,mnj->mij", believed, across, across)
        # A little of the trace keeps what only one line holds from flying off.
        ridge = 1e-9 * np.trace(information, axis1=1, axis2=2)[:, None, None] * np.eye(2) + 1e-300 * np.eye(2)
        slope = np.einsum("mn,mn,mni->mi", believed, residual, across)
        step = np.linalg.solve(information + ridge, slope[..., None])[..., 0]
        here = _cost(residual, bend)
        share = np.ones(len(xy))
        for _ in range(HALVINGS):
            worse = _cost(_at(xy + share[:, None] * step, places, bearings, sigma, bend)[0], bend) > here + 1e-12
            if not worse.any():
                break
            share[worse] *= 0.5
        else:
            share[worse] = 0.0
        move = share[:, None] * step
        xy += move
        if np.hypot(*move.T).max() < TIGHT * scale:
            break
    return xy
