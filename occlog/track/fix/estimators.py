"""Where lines of sight meet: a position from the bearings of one moment alone ([Lenth] 1981).

Lenth, R. V. (1981), On finding the source of a signal, Technometrics 23(2):149-154.  Bearings
have von Mises errors of one concentration kappa, which is found from their residuals; where the
sensors state standard deviations that differ, the bearings' concentrations are in proportion.

    mle       maximum likelihood
    huber     M-estimate, psi(t) = t up to a bend, constant beyond
    andrews   M-estimate, psi(t) = c sin(t/c) up to c pi, zero beyond: far outliers do not count
    rmr       repeated median of the points where the lines cross
    jrmr      the same, its bias removed by the jackknife

t is sqrt(2 kappa (1 - cos r)) of a residual r.  Angles are from +x to +y, in radians.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats

from .config import BENDS, ESTIMATORS
from .repeated_median import repeated_median, repeated_median_jackknife

ITERATIONS = 300
TIGHT = 1e-10


class Fix(NamedTuple):
    """A position and how sure it is."""

    xy: Floats  # (2,)
    covariance: Floats  # (2, 2) of the estimator as published, or from the stated standard deviations
    weights: Floats  # (n,) of the bearings, 0 to 1; 1 for the medians
    kappa: float  # concentration of a bearing of average precision
    estimated: bool  # the spread is from the residuals; false: as stated


class _Equations(NamedTuple):
    """Lenth's estimating equations at a position."""

    matrix: Floats  # (2, 2)
    right: Floats  # (2,)


def fix(
    places: Floats,
    bearings: Floats,
    sigma: Floats,
    estimator: str,
    bend: float = BENDS["huber"],
    estimated: bool = True,
) -> Fix | None:
    """The position that a set of bearings points at; None where they do not tell one.

    Args:
        places: (n, 2) where the bearings were taken, n >= 2.
        bearings: (n,) [rad].
        sigma: (n,) stated standard deviations [rad], above 0.
        estimator: one of `ESTIMATORS`.
        bend: of huber and andrews.
        estimated: find the spread of the errors from the residuals, which takes at least three
            bearings; otherwise, and with two, it is as stated.
    """
    if estimator not in ESTIMATORS:
        raise ValueError(f"estimator {estimator!r} is not one of {', '.join(ESTIMATORS)}")
    precision = 1.0 / sigma**2
    stated = float(precision.mean())
    share = precision / stated
    learned = estimated and len(bearings) > 2
    if estimator in ("rmr", "jrmr"):
        found = _median(places, bearings, share, stated, estimator == "jrmr", learned)
    else:
        found = _m_estimate(places, bearings, share, stated, _psi(estimator, bend), learned)
    return found if found is not None and _ahead(places, bearings, found) else None


def _psi(estimator: str, bend: float) -> Callable[[Floats], Floats]:
    """psi(t)/t of an estimator."""
    if estimator == "huber":
        return lambda t: np.minimum(1.0, bend / np.maximum(t, 1e-300))
    if estimator == "andrews":
        return lambda t: np.where(t < bend * np.pi, np.sinc(t / (bend * np.pi)), 0.0)
    return np.ones_like


def inverse_kappa(mean_cosine: float) -> float:
    """1/kappa of von Mises errors with that mean cosine in (0, 1], by Lenth's approximation."""
    c = min(max(mean_cosine, 1e-6), 1.0 - 1e-15)
    return 2.0 * (1.0 - c) + (1.0 - c) ** 2 * (0.48794 - 0.82905 * c - 1.3915 * c * c) / c


def _m_estimate(
    places: Floats, bearings: Floats, share: Floats, stated: float, psi: Callable[[Floats], Floats], learned: bool
) -> Fix | None:
    """From the least-squares point; where that does not settle, from the repeated median."""
    for start in (None, repeated_median(places, bearings)):
        found = _iterate(places, bearings, share, stated, psi, learned, start)
        if found is not None:
            return found
    return None


def _iterate(
    places: Floats,
    bearings: Floats,
    share: Floats,
    stated: float,
    psi: Callable[[Floats], Floats],
    learned: bool,
    start: Floats | None,
) -> Fix | None:
    """Fixed point of Lenth's equations, the weights and kappa found along with the position."""
    n = len(bearings)
    weights, kappa, xy = np.ones(n), stated, start
    for iteration in range(ITERATIONS):
        # Concentration kappa from the residuals, and the M-estimate's weights
        if xy is not None and (iteration or start is not None):
            cosine = np.cos(bearings - _directions(places, xy))
            if learned:
                kappa = 1.0 / inverse_kappa(float(np.average(cosine, weights=weights * share)))
            # The first weights would be those of a bad start.
            weights = psi(np.sqrt(2.0 * kappa * share * (1.0 - cosine))) if iteration > 1 else weights
        # Solve the estimating equations, linear in the position for fixed distances
        equations = _equations(places, bearings, weights * share, xy)
        new = _solved(equations)
        if new is None:
            return None
        # Converged: the position hardly moves
        scale = 1.0 + float(np.abs(places - new).max())
        if xy is not None and iteration > 2 and float(np.abs(new - xy).max()) < TIGHT * scale:
            return _fix_at(new, equations, weights, kappa, learned)
        xy = new
    return None


def _fix_at(xy: Floats, equations: _Equations, weights: Floats, kappa: float, learned: bool) -> Fix | None:
    """The fix with the published covariance: 1/kappa times the inverse of the symmetric part."""
    information = 0.5 * (equations.matrix + equations.matrix.T)
    if not np.linalg.det(information) > 0.0 or not information[0, 0] > 0.0:
        return None
    return Fix(xy, np.asarray(np.linalg.inv(information) / kappa, np.float64), weights, kappa, learned)


def _directions(places: Floats, xy: Floats) -> Floats:
    return np.asarray(np.arctan2(xy[1] - places[:, 1], xy[0] - places[:, 0]), np.float64)


def _equations(places: Floats, bearings: Floats, weights: Floats, xy: Floats | None) -> _Equations:
    """The equations at a position; None: for sensors that are all equally far away."""
    s, c = np.sin(bearings), np.cos(bearings)
    # Relative to the sensors' centre, or large coordinates of maps would cost digits.
    centre = places.mean(axis=0)
    z = s * (places[:, 0] - centre[0]) - c * (places[:, 1] - centre[1])
    if xy is None:
        rise, run = s, c
    else:
        away = xy - places
        cubed = np.maximum(np.hypot(away[:, 0], away[:, 1]), 1e-12) ** 3
        rise, run = away[:, 1] / cubed, away[:, 0] / cubed
    w = weights
    matrix = np.array([[(w * s * rise).sum(), -(w * c * rise).sum()], [-(w * s * run).sum(), (w * c * run).sum()]])
    right = np.array([(w * rise * z).sum(), -(w * run * z).sum()])
    return _Equations(matrix, right + matrix @ centre)


def _solved(equations: _Equations) -> Floats | None:
    """The solution; None where the lines are parallel or the numbers not finite."""
    size = float(np.abs(equations.matrix).max())
    if not np.isfinite(size) or size == 0.0 or abs(np.linalg.det(equations.matrix / size)) < 1e-12:
        return None
    found = np.asarray(np.linalg.solve(equations.matrix, equations.right), np.float64)
    return found if np.isfinite(found).all() else None


def _median(
    places: Floats, bearings: Floats, share: Floats, stated: float, jackknife: bool, learned: bool
) -> Fix | None:
    """Repeated median; its covariance is that of the jackknife, or from the stated standard deviations."""
    xy = repeated_median(places, bearings)
    if xy is None:
        return None
    folded = repeated_median_jackknife(places, bearings) if learned or jackknife else None
    ones = np.ones(len(bearings))
    if jackknife and folded is not None:
        xy = folded.xy
    if learned and folded is not None:
        cosine = np.cos(bearings - _directions(places, xy))
        return Fix(xy, folded.covariance, ones, 1.0 / inverse_kappa(float(cosine.mean())), True)
    return _fix_at(xy, _fisher(places, xy, share), ones, stated, False)


def _fisher(places: Floats, xy: Floats, share: Floats) -> _Equations:
    """Information about a position for kappa 1."""
    away = xy - places
    squared = np.maximum((away**2).sum(axis=1), 1e-24)
    across = np.column_stack([-away[:, 1], away[:, 0]]) / squared[:, None]
    return _Equations((across * share[:, None]).T @ across, np.zeros(2))


def _ahead(places: Floats, bearings: Floats, found: Fix) -> bool:
    """Whether it is in front of most of the sensors that count, two of them at least."""
    ahead: Bools = np.cos(bearings - _directions(places, found.xy)) > 0.0
    counted = found.weights[ahead].sum()
    finite = bool(np.isfinite(found.covariance).all() and np.isfinite(found.xy).all())
    return finite and int(ahead.sum()) >= 2 and bool(counted > 0.5 * found.weights.sum())
