"""From centres in images to a place in space, robust to single views that are on something else."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from occlog.array_types import Bools, Floats, Ints

from .place import APART, BEHIND, MET, Height, Meeting, Rig, Sights, fit_places


def meet_in_space(
    sights: Sights, rig: Rig, height: Height | None = None, gate: float = 1e-3, min_crossing: float = np.radians(5.0)
) -> Meeting:
    """Places of points, robust to single views that are on something else.

    Where the views of a point do not agree the one without which the others agree best is
    left out, as long as more than two are left; two that do not agree give no place, since
    nothing tells which of them is right.

    Args:
        sights: N points in V views.
        rig: the views.
        height: of points that one view shows; None: they have no place.
        gate: chance at which a point whose views are all right is said to have one that is wrong.
        min_crossing: sight lines must cross, or a single one meet the plane, at this angle [rad] or more.
    """
    limits = np.array([np.inf, np.inf, *(chdtri(2 * n - 3, gate) for n in range(2, sights.there.shape[1] + 1))])
    met = fit_places(sights, rig, height, np.sin(min_crossing))
    for _ in range(sights.there.shape[1] - 2):
        count = met.used.sum(axis=1)
        again = np.flatnonzero(_bad(met, limits) & (count > 2))
        if not len(again):
            break
        met = _replaced(met, again, _without_one(sights.take(again), met.used[again], rig, np.sin(min_crossing)))
    apart = _bad(met, limits)
    return met._replace(
        xyz=np.where(apart[:, None], np.nan, met.xyz),
        covariance=np.where(apart[:, None, None], np.nan, met.covariance),
        status=np.where(apart & (met.status == MET), APART, met.status),
    )


def _bad(met: Meeting, limits: Floats) -> Bools:
    """Points whose views do not agree, or meet behind one of them."""
    bad: Bools = (met.status == BEHIND) | ((met.status == MET) & (met.misfit > limits[met.used.sum(axis=1)]))
    return bad


def _without_one(sights: Sights, used: Bools, rig: Rig, min_sine: float) -> Meeting:
    """The best fits of points without one of their views each."""
    best: Meeting | None = None
    for view in range(used.shape[1]):
        there = used.copy()
        there[:, view] = False
        trial = fit_places(sights._replace(there=there), rig, None, min_sine)
        ok = (trial.status == MET) & used[:, view]
        trial = trial._replace(misfit=np.where(ok, trial.misfit, np.inf))
        if best is None:
            best = trial
        else:
            better = np.flatnonzero(trial.misfit < best.misfit)
            best = _replaced(best, better, _taken(trial, better))
    if best is None:
        raise ValueError("points must have at least one view")
    return best


def _taken(met: Meeting, rows: Ints) -> Meeting:
    """Some points of a meeting."""
    return Meeting(met.xyz[rows], met.covariance[rows], met.status[rows], met.used[rows], met.misfit[rows])


def _replaced(met: Meeting, rows: Ints, others: Meeting) -> Meeting:
    """A meeting with some of its points replaced."""
    out = Meeting(met.xyz.copy(), met.covariance.copy(), met.status.copy(), met.used.copy(), met.misfit.copy())
    for old, new in zip(out, others, strict=True):
        old[rows] = new
    return out
