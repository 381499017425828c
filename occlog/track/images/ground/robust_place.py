"""Triangulation that leaves out single views whose tracker is on something else."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from occlog.array_types import Bools, Floats, Ints

from .place import APART, BEHIND, MET, Height, Meeting, Rig, Sights, fit_places


def meet_in_space(
    sights: Sights, rig: Rig, height: Height | None = None, gate: float = 1e-3, min_crossing: float = np.radians(5.0)
) -> Meeting:
    """Find the places of points, and leave out single views that are on something else.

    Views agree when their misfit passes a chi-square test.  Where they do not, the view without
    which the others agree best is left out, as long as at least two are left; two views that do
    not agree give no place, since either may be right.

    Args:
        sights: N points in V views.
        rig: the views.
        height: of points that one view shows; None: they have no place.
        gate: probability of the test to reject views that are all right.
        min_crossing: least angle [rad] at which sight lines cross, or at which a single one meets the plane.
    """
    # Gate: chi-square with 2 views - 3 degrees of freedom
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
    """Find for each point the best fit without one of its views."""
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
    """The rows of some points."""
    return Meeting(met.xyz[rows], met.covariance[rows], met.status[rows], met.used[rows], met.misfit[rows])


def _replaced(met: Meeting, rows: Ints, others: Meeting) -> Meeting:
    """The places with those of some rows replaced."""
    out = Meeting(met.xyz.copy(), met.covariance.copy(), met.status.copy(), met.used.copy(), met.misfit.copy())
    for old, new in zip(out, others, strict=True):
        old[rows] = new
    return out
