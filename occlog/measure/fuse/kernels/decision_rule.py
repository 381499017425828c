"""One decision from the detections of several cameras, and what becomes of each ([Lee] Ch. 4).

All cameras look for one and the same object.  Arrays have N times and J cameras.  A local detection is a
ground position; a NaN row says that the camera looked and detected nothing.  A camera that delivered no
frame, or cannot see the place, is marked in `looked` and has no part in the decision.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from occlog.array_types import Bools, Floats

Codes = NDArray[np.int8]

EDGE = 1e-12
"""Probabilities are kept this far from 0 and 1, so that every logarithm is finite (at most 27.6)."""

NOT_LOOKING = 0
NOTHING = 1
KEPT = 2
RECOVERED = 3
REMOVED_FALSE = 4
REMOVED_FAR = 5
CAUSES = (
    "camera did not look",
    "nothing detected, and no object declared",
    "detected near the global position",
    "missed by this camera, declared by the others",
    "no object declared",
    "far from the global position",
)
"""What the numbers in `Fusion.cause` say."""


class Fusion(NamedTuple):
    """The global decision of each time and what becomes of each local detection."""

    declared: Bools  # (N,) an object is there (G_1)
    value: Floats  # (N,) decision value, natural log
    xy: Floats  # (N, 2) global position; NaN where no detection was used
    prior: Floats  # (N,) P_1
    quality: Floats  # (N, J) W of each detection; NaN where there is none
    cause: Codes  # (N, J) see CAUSES

    @property
    def kept(self) -> Bools:
        """(N, J) local detections that stand."""
        return np.asarray(self.cause == KEPT)

    @property
    def recovered(self) -> Bools:
        """(N, J) cameras that missed a declared object; the global position is theirs to fill in."""
        return np.asarray(self.cause == RECOVERED)

    @property
    def removed(self) -> Bools:
        """(N, J) local detections that fall; for cause REMOVED_FAR the global position takes their place."""
        return np.asarray((self.cause == REMOVED_FALSE) | (self.cause == REMOVED_FAR))


def quality(positions: Floats, predicted: Floats, sigma: float) -> Floats:
    """(N, J) quality W in [0, 1] of local detections; NaN where there is none ([Lee] Eq. 4.20).

    Args:
        positions: (N, J, 2) ground positions of the local detections, NaN where missed.
        predicted: (N, 2) predicted position.  NaN: not known; every detection then has W = 1/2, which says nothing.
        sigma: spread of the position about the prediction [length], > 0.
    """
    weight = np.exp(-_exponent(positions, predicted[:, None, :], sigma))
    known = _detected(predicted)[:, None]
    return np.where(_detected(positions), np.where(known, weight, 0.5), np.nan)


def fused_position(positions: Floats, predicted: Floats, sigma: float) -> Floats:
    """(N, 2) mean of the detections weighted by quality; NaN with no detection ([Lee] Eq. 4.22).

    The weights are taken relative to the largest, so that detections so far away that all W
    underflow still have a mean.  Without a prediction (NaN) the weights are equal.
    Arguments as in `quality`.
    """
    detected = _detected(positions)
    exponent = np.where(detected, np.nan_to_num(_exponent(positions, predicted[:, None, :], sigma)), np.inf)
    least = np.min(exponent, axis=-1, keepdims=True, initial=np.inf)
    weight = np.exp(-(exponent - np.where(np.isfinite(least), least, 0.0)))
    total = weight.sum(axis=-1)[:, None]
    summed = (weight[..., None] * np.where(detected[..., None], positions, 0.0)).sum(axis=1)
    return np.where(total > 0.0, summed / np.where(total > 0.0, total, 1.0), np.nan)


def prior_present(fused: Floats, predicted: Floats, sigma: float, edge: float = EDGE) -> Floats:
    """(N,) prior P_1 = w(n) that the object is there, in [edge, 1 - edge] ([Lee] Eqs. 4.23-4.24).

    Where either position is NaN the dynamic model says nothing, and P_1 = 1/2.

    Args:
        fused: (N, 2) global position.
        predicted: (N, 2) predicted position.
        sigma: spread of the position about the prediction [length], > 0.
        edge: distance kept from 0 and 1, where P_1 / P_0 would be 0 or infinite.
    """
    weight = np.exp(-_exponent(fused, predicted, sigma))
    return np.clip(np.where(np.isfinite(weight), weight, 0.5), edge, 1.0 - edge)


def decision_value(
    detected: Bools,
    qualities: Floats,
    prior: ArrayLike,
    p_miss: ArrayLike,
    p_false: ArrayLike,
    looked: Bools | None = None,
    base: float = math.e,
    edge: float = EDGE,
) -> Floats:
    """(N,) log-likelihood ratio; above 0 the object is declared ([Lee] Eq. 4.13).

    The detecting cameras count log (1 - P_M)/P_F, as Eq. 4.11 must have it, where the thesis prints
    (1 - P_F)/P_F.  All probabilities are kept in [edge, 1 - edge]: an exact 0 or 1 gives a large but
    finite term, and two certainties that contradict each other cancel.  With no camera the prior decides.

    Args:
        detected: (N, J) the camera detected an object.
        qualities: (N, J) W; not used (may be NaN) where nothing was detected.
        prior: P_1, one number or (N,).
        p_miss: P_M, one number or (J,) or (N, J).
        p_false: P_F, likewise.
        looked: (N, J) false = the camera has no part in it.  None: all looked.
        base: of the logarithm; 10 for the values of the case studies.
        edge: distance kept from 0 and 1.
    """
    weight = _log_odds(np.where(detected, qualities, 0.5), edge)
    return weighted_value(detected, weight, prior, p_miss, p_false, looked=looked, edge=edge) / math.log(base)


def weighted_value(
    detected: Bools,
    weight: Floats,
    prior: ArrayLike,
    p_miss: ArrayLike,
    p_false: ArrayLike,
    *,
    looked: Bools | None = None,
    edge: float = EDGE,
) -> Floats:
    """(N,) prior log odds plus each camera's term, natural log; `weight` (N, J) is added to that of a detection.

    Without weights it is [Lee] Eq. 4.3, with log W/(1 - W) it is Eq. 4.13.  Other arguments as in `decision_value`.
    """
    miss, false = (np.clip(np.asarray(p, dtype=np.float64), edge, 1.0 - edge) for p in (p_miss, p_false))
    hit_term = np.log1p(-miss) - np.log(false) + weight
    miss_term = np.log(miss) - np.log1p(-false)
    term = np.where(detected, hit_term, miss_term)
    if looked is not None:
        term = np.where(looked, term, 0.0)
    return np.asarray(_log_odds(np.asarray(prior, dtype=np.float64), edge) + term.sum(axis=-1))


def fuse(
    positions: Floats,
    predicted: Floats,
    sigma: float,
    p_miss: ArrayLike,
    p_false: ArrayLike,
    gate: float,
    looked: Bools | None = None,
    reach: float = math.inf,
) -> Fusion:
    """Global decision of each time by [Lee] Eqs. 4.13 and 4.20-4.24, and what becomes of each local detection.

    With no detection there is nothing to declare, whatever the prior.  A lone detection counts by its quality
    twice, as W and as P_1: close to the prediction it outvotes several cameras that miss.  Without a prediction
    (NaN) all W and P_1 are 1/2: the rule of Eq. 4.3 with equal priors.

    Args:
        positions: (N, J, 2) ground positions of the local detections, NaN where missed.
        predicted: (N, 2) predicted position, NaN where not known.
        sigma: spread of the position about the prediction [length], > 0.
        p_miss: P_M, one number or (J,) or (N, J).
        p_false: P_F, likewise.
        gate: a detection farther than this from the global position of a declared object is removed [length].
        looked: (N, J) false = the camera has no part in it, its positions neither.  None: all looked.
        reach: a detection farther than this from the predicted position counts as missed in the decision and in
            the global position [length].  Infinite as in the thesis, where one far detection can outvote many
            good ones, because its log W/(1 - W) has no lower bound.
    """
    took_part = np.ones(positions.shape[:2], dtype=np.bool_) if looked is None else looked
    local = np.where(took_part[..., None], positions, np.nan)
    beyond = _distance(local, predicted[:, None, :]) > reach
    used = np.where(beyond[..., None], np.nan, local)
    xy = fused_position(used, predicted, sigma)
    prior = prior_present(xy, predicted, sigma)
    qualities = quality(local, predicted, sigma)
    detected = _detected(used)
    value = decision_value(detected, qualities, prior, p_miss, p_false, took_part)
    declared = (value > 0.0) & detected.any(axis=1)
    return Fusion(declared, value, xy, prior, qualities, _causes(local, xy, declared, took_part, gate))


def _causes(positions: Floats, xy: Floats, declared: Bools, looked: Bools, gate: float) -> Codes:
    """(N, J) what becomes of each local detection, see CAUSES."""
    far = _distance(positions, xy[:, None, :]) > gate
    if_declared = np.where(_detected(positions), np.where(far, REMOVED_FAR, KEPT), RECOVERED)
    if_not = np.where(_detected(positions), REMOVED_FALSE, NOTHING)
    cause = np.where(declared[:, None], if_declared, if_not)
    return np.where(looked, cause, NOT_LOOKING).astype(np.int8)


def _log_odds(p: Floats, edge: float) -> Floats:
    """Log odds log p/(1 - p), p kept in [edge, 1 - edge]."""
    inner = np.clip(p, edge, 1.0 - edge)
    return np.asarray(np.log(inner) - np.log1p(-inner))


def _exponent(a: Floats, b: Floats, sigma: float) -> Floats:
    """Squared distance over 2 sigma^2."""
    return np.asarray(((a - b) ** 2).sum(axis=-1) / (2.0 * sigma**2))


def _distance(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.hypot(a[..., 0] - b[..., 0], a[..., 1] - b[..., 1]))


def _detected(positions: Floats) -> Bools:
    """A position is there: both coordinates are finite."""
    return np.asarray(np.isfinite(positions).all(axis=-1))
