"""Covariances of places whose views may contradict each other.

Each view is on the target or on somebody else, at even odds unless set otherwise.  A hypothesis
is the set of views that are on the target.  Its weight is the marginal likelihood of all
centres: the views of the set meet at one place (Laplace's approximation of the integral over the
places), and the others may be anywhere in their images.  The covariance is the second moment of
the mixture of the hypotheses' places about the place that is reported.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats

from .place import MET, Height, Meeting, Rig, Sights, fit_places

ALL_SUBSETS = 5
"""With more views, only sets that leave out at most two of them, and single views and pairs, are hypotheses."""
HEIGHTS = 30.0
"""Heights of places that several views find are uniform over so many standard deviations of the height."""


class Odds(NamedTuple):
    """How likely views are right, and how well they agree if they are."""

    right: float  # probability that a view is on the target, in (0, 1]; 1: all are
    agreement: float  # variance of the residuals of views on one target, in units of the stated one, > 0
    areas: Floats  # (V,) sizes of the images [px^2]


class Contest(NamedTuple):
    """Covariances of N places, and how far their views contradict each other."""

    covariance: Floats  # (N, 3, 3) NaN where there is no place
    contested: Floats  # (N,) probability that a view is on something else; 0 for one view, 1 if no views agree


def contest_places(met: Meeting, sights: Sights, rig: Rig, height: Height | None, odds: Odds, sine: float) -> Contest:
    """Find the covariances of places by all hypotheses on which views are on the target.

    Args:
        met: the places as reported.
        sights: N points in V views.
        rig: the views.
        height: of points that one view shows; None: single views are no hypotheses.
        odds: of the views.
        sine: least sine of the angle at which sight lines cross.
    """
    covariance, contested = met.covariance.copy(), np.where(met.status == MET, 0.0, 1.0)
    several = sights.there.sum(axis=1) > 1
    contested[~several] = 0.0
    if odds.right >= 1.0:
        return Contest(covariance, contested)
    for pattern in np.unique(sights.there[several & (met.status == MET)], axis=0):
        rows = np.flatnonzero((sights.there == pattern).all(axis=1) & (met.status == MET))
        some = sights.take(rows)
        spread, everyone = _mixture(met.xyz[rows], some, pattern, rig, height, odds, sine)
        # Where no hypothesis has a place the covariance stays
        known = np.isfinite(spread).all(axis=(1, 2))
        covariance[rows[known]] = spread[known]
        contested[rows] = 1.0 - everyone
    return Contest(covariance, contested)


def _mixture(
    xyz: Floats, sights: Sights, pattern: Bools, rig: Rig, height: Height | None, odds: Odds, sine: float
) -> tuple[Floats, Floats]:
    """(N, 3, 3) second moments about the places (N, 3) in the views `pattern`, and (N,) weight of all views."""
    density = np.log(2.0 * np.pi) + 0.5 * np.linalg.slogdet(sights.covariance)[1] + np.log(odds.agreement)
    logs, moments = [], []
    for views in _sets(pattern):
        fit = fit_places(sights._replace(there=np.broadcast_to(views, sights.there.shape)), rig, height, sine)
        found = fit.status == MET
        cov = np.where(found[:, None, None], fit.covariance, np.eye(3))
        # Laplace: the integral of the likelihood over the places
        free = 2.0 if views.sum() == 1 else 3.0
        log = -0.5 * fit.misfit / odds.agreement + 0.5 * np.linalg.slogdet(cov)[1] + 0.5 * free * np.log(odds.agreement)
        if views.sum() > 1 and height is not None:
            log = log + np.log(np.sqrt(2.0 * np.pi) / HEIGHTS)
        # Views of the set are right, the others anywhere in their images
        log = log + (views * (np.log(odds.right) - density)).sum(axis=1)
        log = log + ((pattern & ~views) * (np.log1p(-odds.right) - np.log(odds.areas))).sum()
        off = np.where(found[:, None], fit.xyz - xyz, 0.0)
        logs.append(np.where(found, log, -np.inf))
        moments.append(cov + off[:, :, None] * off[:, None, :])
    stacked = np.stack(logs)
    top = stacked.max(axis=0)
    weights = np.exp(stacked - np.where(np.isfinite(top), top, 0.0))
    total = weights.sum(axis=0)
    weights = weights / np.where(total > 0.0, total, np.nan)
    # The first set holds all the views
    return np.einsum("hn,hnij->nij", weights, np.stack(moments)), np.nan_to_num(weights[0])


def _sets(pattern: Bools) -> Iterator[Bools]:
    """Sets of the views of a pattern, as (V,) masks, the largest first."""
    views = np.flatnonzero(pattern)
    for size in range(len(views), 0, -1):
        if len(views) <= ALL_SUBSETS or size >= len(views) - 2 or size <= 2:
            for chosen in combinations(views.tolist(), size):
                mask = np.zeros(len(pattern), dtype=np.bool_)
                mask[list(chosen)] = True
                yield mask
