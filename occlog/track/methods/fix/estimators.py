"""Where lines of sight meet: a position from the bearings of one time step alone ([Lenth] 1981).

Lenth, R. V. (1981), On finding the source of a signal, Technometrics 23(2):149-154.  Bearings
have von Mises errors of one concentration kappa, which is found from their residuals; where the
sensors state standard deviations that differ, the bearings' concentrations are in proportion.

    mle       maximum likelihood
    huber     M-estimate, psi(t) = t up to a bend, constant beyond
    andrews   M-estimate, psi(t) = c sin(t/c) up to c pi, zero beyond: far outliers do not count
    rmr       repeated median of the points where the lines cross
    jrmr      the same, its bias removed by the jackknife

t is sqrt(2 kappa (1 - cos r)) of a residual r.  Angles are from +x to +y, in radians.

Repeated median of crossings of lines of sight, and its jackknife ([Lenth] 1981).

A position from bearings of which some may be false: the modes of a mixture likelihood, and their spread.

Each bearing is true, with a Gaussian error of its stated standard deviation, or false, and then from anywhere; at
`loss_threshold` standard deviations both are as likely.  The likelihood of a position has a mode wherever enough
bearings agree.
All of them are searched, from where each two lines cross, by Gauss and Newton with reweighting.  The estimate is the
highest mode.  Its covariance is the second moment of all modes about it, by their heights, so that it is wide where
it cannot be decided which bearing is false.  (Volumes do not count: lines that are next to parallel would meet at
infinity.)

Few residuals tell little of the errors' scale: they are pooled with what is stated, which counts as much as
`PRIOR_RESIDUALS` of them, and the covariance is that of Student's distribution with so many degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats

from .config import BENDS, ESTIMATORS

PARALLEL = 1e-12


class Folded(NamedTuple):
    """Result of the jackknife of an estimated position: bias-corrected mean and its covariance."""

    xy: Floats  # (2,) mean of the pseudo-values: bias removed to the first order
    covariance: Floats  # (2, 2) of that mean


def crossings(positions: Floats, bearings: Floats) -> Floats:
    """Return (n, n, 2) points where line of sight i is crossed by line j, if ahead of sensor i; NaN elsewhere.

    They need not be ahead of sensor j: Lenth's published figures come out only if the half-line of the sensor that the
    median is taken for meets whole lines. `positions` (n, 2) are the sensors', `bearings` (n,) in [rad].
    """
    towards = np.column_stack([np.cos(bearings), np.sin(bearings)])
    dx, dy = towards[:, 0], towards[:, 1]
    across = dx[:, None] * dy[None, :] - dy[:, None] * dx[None, :]
    difference = positions[None, :, :] - positions[:, None, :]
    top = difference[:, :, 0] * dy[None, :] - difference[:, :, 1] * dx[None, :]
    meets = np.abs(across) > PARALLEL
    along = np.where(meets, top / np.where(meets, across, 1.0), np.nan)
    points: Floats = positions[:, None, :] + along[:, :, None] * towards[:, None, :]
    points[~(along > 0.0)] = np.nan
    return points


def repeated_median(positions: Floats, bearings: Floats) -> Floats | None:
    """Return the repeated median (2,) of the crossings of lines of sight ([Lenth]); None without any crossing.

    It is the median, over the lines, of the median of each line's crossings, by coordinate.

    Args:
        positions: (n, 2) positions of the sensors.
        bearings: (n,) bearings [rad].
    """
    points = crossings(positions, bearings)
    lines = [own[~np.isnan(own[:, 0])] for own in points]
    middle = [np.median(own, axis=0) for own in lines if len(own)]
    return np.median(np.array(middle), axis=0) if middle else None


def repeated_median_jackknife(positions: Floats, bearings: Floats) -> Folded | None:
    """Return the jackknife of the repeated median; None if it is not defined without some bearing, or for n < 3.

    Args:
        positions: (n, 2) positions of the sensors.
        bearings: (n,) bearings [rad].
    """
    n = len(bearings)
    whole = repeated_median(positions, bearings)
    if whole is None or n < 3:
        return None
    pseudo = np.empty((n, 2))
    for i in range(n):
        rest = repeated_median(np.delete(positions, i, axis=0), np.delete(bearings, i))
        if rest is None:
            return None
        pseudo[i] = n * whole - (n - 1) * rest
    return Folded(pseudo.mean(axis=0), np.cov(pseudo.T) / n)


ITERATIONS = 300
RELATIVE_TOLERANCE = 1e-10


class Fix(NamedTuple):
    """A position estimate with covariance, weights of the bearings, and the concentration kappa."""

    xy: Floats  # (2,)
    covariance: Floats  # (2, 2) of the estimator as published, or from the stated standard deviations
    weights: Floats  # (n,) of the bearings, 0 to 1; 1 for the medians
    kappa: float  # concentration of a bearing of average precision
    estimated: bool  # the spread is from the residuals; false: as stated


class _Equations(NamedTuple):
    """Lenth's estimating equations for a position, matrix @ xy = right, linear for fixed distances of the sensors."""

    matrix: Floats  # (2, 2)
    right: Floats  # (2,)


def fix(
    positions: Floats,
    bearings: Floats,
    sigma: Floats,
    estimator: str,
    bend: float = BENDS["huber"],
    estimated: bool = True,
) -> Fix | None:
    """Return the position at which several bearings point, by an estimator of [Lenth]; None if undetermined.

    Args:
        positions: (n, 2) positions where the bearings were taken, n >= 2.
        bearings: (n,) bearings [rad].
        sigma: (n,) stated standard deviations [rad], above 0.
        estimator: one of `ESTIMATORS`.
        bend: tuning constant of `huber` and `andrews`, in standard deviations.
        estimated: find the spread of the errors from the residuals, which takes at least three bearings; otherwise, and
            with two, it is as stated.

    Raises:
        ValueError: an unknown estimator.
    """
    if estimator not in ESTIMATORS:
        raise ValueError(f"estimator {estimator!r} is not one of {', '.join(ESTIMATORS)}")
    precision = 1.0 / sigma**2
    stated = float(precision.mean())
    share = precision / stated
    learned = estimated and len(bearings) > 2
    if estimator in ("rmr", "jrmr"):
        found = _median(positions, bearings, share, stated, estimator == "jrmr", learned)
    else:
        found = _m_estimate(positions, bearings, share, stated, _psi(estimator, bend), learned)
    return found if found is not None and _ahead(positions, bearings, found) else None


def _psi(estimator: str, bend: float) -> Callable[[Floats], Floats]:
    """Return the weight function psi(t) / t of an M-estimator, of an array of normalised residuals t >= 0; `mle`: 1.

    `bend` is the tuning constant, in standard deviations.
    """
    if estimator == "huber":
        return lambda t: np.minimum(1.0, bend / np.maximum(t, 1e-300))
    if estimator == "andrews":
        return lambda t: np.where(t < bend * np.pi, np.sinc(t / (bend * np.pi)), 0.0)
    return np.ones_like


def inverse_kappa(mean_cosine: float) -> float:
    """Return 1/kappa of a von Mises distribution with mean cosine in (0, 1], by Lenth's approximation."""
    c = min(max(mean_cosine, 1e-6), 1.0 - 1e-15)
    return 2.0 * (1.0 - c) + (1.0 - c) ** 2 * (0.48794 - 0.82905 * c - 1.3915 * c * c) / c


def _m_estimate(
    positions: Floats, bearings: Floats, share: Floats, stated: float, psi: Callable[[Floats], Floats], learned: bool
) -> Fix | None:
    """Return the M-estimate of a position, from the least-squares point or, if that diverges, the repeated median.

    None if both diverge.

    Args:
        positions: (n, 2) positions of the sensors.
        bearings: (n,) bearings [rad].
        share: (n,) precisions of the bearings, relative to their mean.
        stated: mean stated precision, the concentration kappa unless it is learned [1/rad^2].
        psi: returns the weights of bearings by their normalised residuals.
        learned: estimate kappa from the residuals.
    """
    for start in (None, repeated_median(positions, bearings)):
        found = _iterate(positions, bearings, share, stated, psi, learned, start)
        if found is not None:
            return found
    return None


def _iterate(
    positions: Floats,
    bearings: Floats,
    share: Floats,
    stated: float,
    psi: Callable[[Floats], Floats],
    learned: bool,
    start: Floats | None,
) -> Fix | None:
    """Iterate Lenth's equations to a fixed point, with new weights and kappa at each position; None if they diverge.

    Args:
        positions: (n, 2) positions of the sensors.
        bearings: (n,) bearings [rad].
        share: (n,) precisions of the bearings, relative to their mean.
        stated: mean stated precision, the concentration kappa unless it is learned [1/rad^2].
        psi: returns the weights of bearings by their normalised residuals.
        learned: estimate kappa from the residuals.
        start: (2,) first position; None: the least-squares point.
    """
    n = len(bearings)
    weights, kappa, xy = np.ones(n), stated, start
    for iteration in range(ITERATIONS):
        # Concentration kappa from the residuals, and the M-estimate's weights
        if xy is not None and (iteration or start is not None):
            cosine = np.cos(bearings - _directions(positions, xy))
            if learned:
                kappa = 1.0 / inverse_kappa(float(np.average(cosine, weights=weights * share)))
            # The first weights would be those of a bad start.
            weights = psi(np.sqrt(2.0 * kappa * share * (1.0 - cosine))) if iteration > 1 else weights
        # Solve the estimating equations, linear in the position for fixed distances
        equations = _equations(positions, bearings, weights * share, xy)
        new = _solved(equations)
        if new is None:
            return None
        # Converged: the position hardly moves
        scale = 1.0 + float(np.abs(positions - new).max())
        if xy is not None and iteration > 2 and float(np.abs(new - xy).max()) < RELATIVE_TOLERANCE * scale:
            return _fix_at(new, equations, weights, kappa, learned)
        xy = new
    return None


def _fix_at(xy: Floats, equations: _Equations, weights: Floats, kappa: float, learned: bool) -> Fix | None:
    """Return the position `xy` (2,) with Lenth's covariance; None if that is not positive definite.

    The covariance is 1/kappa times the inverse of the symmetric part of the equations' matrix. `weights` (n,) of the
    bearings, and `learned` (kappa is from the residuals), are passed on.
    """
    information = 0.5 * (equations.matrix + equations.matrix.T)
    if not np.linalg.det(information) > 0.0 or not information[0, 0] > 0.0:
        return None
    return Fix(xy, np.asarray(np.linalg.inv(information) / kappa, np.float64), weights, kappa, learned)


def _directions(positions: Floats, xy: Floats) -> Floats:
    """Return (n,) azimuths [rad] of the position `xy` (2,) as seen from `positions` (n, 2)."""
    return np.asarray(np.arctan2(xy[1] - positions[:, 1], xy[0] - positions[:, 0]), np.float64)


def _equations(positions: Floats, bearings: Floats, weights: Floats, xy: Floats | None) -> _Equations:
    """Return Lenth's estimating equations at the position `xy` (2,); None: as if all sensors were equally far away.

    `positions` (n, 2) are the sensors', `bearings` (n,) in [rad], `weights` (n,) those of the bearings.
    """
    s, c = np.sin(bearings), np.cos(bearings)
    # Relative to the sensors' centre, or large coordinates of maps would cost digits.
    centre = positions.mean(axis=0)
    z = s * (positions[:, 0] - centre[0]) - c * (positions[:, 1] - centre[1])
    if xy is None:
        rise, run = s, c
    else:
        away = xy - positions
        cubed = np.maximum(np.hypot(away[:, 0], away[:, 1]), 1e-12) ** 3
        rise, run = away[:, 1] / cubed, away[:, 0] / cubed
    w = weights
    matrix = np.array([[(w * s * rise).sum(), -(w * c * rise).sum()], [-(w * s * run).sum(), (w * c * run).sum()]])
    right = np.array([(w * rise * z).sum(), -(w * run * z).sum()])
    return _Equations(matrix, right + matrix @ centre)


def _solved(equations: _Equations) -> Floats | None:
    """Return the solution (2,) of the linear equations; None for parallel lines or non-finite values."""
    size = float(np.abs(equations.matrix).max())
    if not np.isfinite(size) or size == 0.0 or abs(np.linalg.det(equations.matrix / size)) < 1e-12:
        return None
    found = np.asarray(np.linalg.solve(equations.matrix, equations.right), np.float64)
    return found if np.isfinite(found).all() else None


def _median(
    positions: Floats, bearings: Floats, share: Floats, stated: float, jackknife: bool, learned: bool
) -> Fix | None:
    """Return the repeated-median position, with covariance by the jackknife or from the stated standard deviations.

    None if no lines cross, or if the covariance is not defined.

    Args:
        positions: (n, 2) positions of the sensors.
        bearings: (n,) bearings [rad].
        share: (n,) precisions of the bearings, relative to their mean.
        stated: mean stated precision [1/rad^2].
        jackknife: correct the position's bias by the jackknife, if it is defined.
        learned: take covariance and kappa from the residuals, if the jackknife is defined.
    """
    xy = repeated_median(positions, bearings)
    if xy is None:
        return None
    folded = repeated_median_jackknife(positions, bearings) if learned or jackknife else None
    ones = np.ones(len(bearings))
    if jackknife and folded is not None:
        xy = folded.xy
    if learned and folded is not None:
        cosine = np.cos(bearings - _directions(positions, xy))
        return Fix(xy, folded.covariance, ones, 1.0 / inverse_kappa(float(cosine.mean())), True)
    return _fix_at(xy, _fisher(positions, xy, share), ones, stated, False)


def _fisher(positions: Floats, xy: Floats, share: Floats) -> _Equations:
    """Return equations with the Fisher information of the position `xy` (2,) for kappa = 1 as their matrix (2, 2).

    Their right side is 0.

    Args:
        positions: (n, 2) positions of the sensors.
        xy: (2,) position.
        share: (n,) precisions of the bearings, relative to their mean.
    """
    away = xy - positions
    squared = np.maximum((away**2).sum(axis=1), 1e-24)
    across = np.column_stack([-away[:, 1], away[:, 0]]) / squared[:, None]
    return _Equations((across * share[:, None]).T @ across, np.zeros(2))


def _ahead(positions: Floats, bearings: Floats, found: Fix) -> bool:
    """Return whether a position is finite, and in front of two sensors or more with most of the bearings' weight.

    `positions` (n, 2) are the sensors', `bearings` (n,) in [rad]; `found` is the position with its weights.
    """
    ahead: Bools = np.cos(bearings - _directions(positions, found.xy)) > 0.0
    counted = found.weights[ahead].sum()
    finite = bool(np.isfinite(found.covariance).all() and np.isfinite(found.xy).all())
    return finite and int(ahead.sum()) >= 2 and bool(counted > 0.5 * found.weights.sum())


PRIOR_RESIDUALS = 10.0
"""Weight of the stated variances, in residuals."""
MAX_EM_ITERATIONS, HALVINGS = 50, 8
EM_TOLERANCE = 1e-9
"""Largest move of a mode in its last iteration, as a share of the distances."""
MODE_MERGE_DISTANCE = 1e-4
"""Modes that are nearer, as a share of the distances, are one."""
MIN_MODE_PROBABILITY = 0.01
"""Modes less probable than this do not count."""
MIN_INFORMATION_RATIO = 1e-9
"""Modes with information that differs by a smaller factor along and across are no positions."""


class Modes(NamedTuple):
    """M modes of the likelihood of a position given n bearings (and distances), the most probable first."""

    xy: Floats  # (M, 2)
    covariance: Floats  # (M, 2, 2) with the stated standard deviations
    inlier_probability: Floats  # (M, n) probability that each bearing is true
    residual: Floats  # (M, n) in standard deviations
    probability: Floats  # (M,) sum 1
    elsewhere: float = 0.0  # share of the likelihood, volumes and rare modes included, that is not about the first


def pooled_factor(squares: float, freedom: float) -> float:
    """Return the factor by which a covariance made with stated standard deviations is scaled by residuals.

    The scale is pooled from the residuals and `PRIOR_RESIDUALS` stated ones, times the variance of Student's
    distribution.

    Args:
        squares: sum of the squared residuals in standard deviations.
        freedom: degrees of freedom of that sum, >= 0.
    """
    degrees = PRIOR_RESIDUALS + freedom
    return (PRIOR_RESIDUALS + squares) / degrees * degrees / (degrees - 2.0)


def modes(positions: Floats, bearings: Floats, sigma: Floats, bend: float) -> Modes | None:
    """Return the modes of the mixture likelihood of a position given bearings that may be false; None if undetermined.

    Args:
        positions: (n, 2) positions where the bearings were taken, n >= 2.
        bearings: (n,) bearings [rad].
        sigma: (n,) standard deviations [rad], above 0.
        bend: standard deviations at which a bearing is as likely false as true.
    """
    points = crossings(positions, bearings)
    both = np.isfinite(points[:, :, 0]) & np.isfinite(points[:, :, 0].T)  # in front of both
    i, j = np.nonzero(np.triu(both))
    if not len(i):
        return None
    xy = _climbed(points[i, j], positions, bearings, sigma, bend)
    residual, inlier, across = _at(xy, positions, bearings, sigma, bend)
    information = np.einsum("mn,mni,mnj->mij", inlier, across, across)
    size = np.linalg.eigvalsh(information)
    good = np.isfinite(xy).all(axis=1) & (size[:, 0] > MIN_INFORMATION_RATIO * size[:, 1]) & (inlier.sum(axis=1) > 1.5)
    if not good.any():
        return None
    xy, residual, inlier, information = xy[good], residual[good], inlier[good], information[good]
    log = -_cost(residual, bend)
    order = np.argsort(-log, kind="stable")
    scale = np.hypot(*(positions - positions.mean(axis=0)).T).max() + 1e-300
    kept: list[int] = []
    for m in order.tolist():
        if all(np.hypot(*(xy[m] - xy[k])) > MODE_MERGE_DISTANCE * scale for k in kept):
            kept.append(m)
    weight = np.exp(log[kept] - log[kept[0]])
    chosen = np.array(kept)[weight / weight.sum() >= MIN_MODE_PROBABILITY]
    weight = weight[: len(chosen)]
    covariance = _with_distances(xy[chosen], np.linalg.inv(information[chosen]), inlier[chosen], positions, sigma)
    return Modes(xy[chosen], covariance, inlier[chosen], residual[chosen], weight / weight.sum())


def _with_distances(xy: Floats, covariance: Floats, inlier: Floats, positions: Floats, sigma: Floats) -> Floats:
    """Return (M, 2, 2) covariances of modes, including the uncertainty of the sensors' distances.

    An error of a bearing displaces the target across by the error times the distance; the mean square of the distance
    is that of the estimate plus its variance along the line of sight. For nearly parallel lines of sight, a mode next
    to a sensor would otherwise appear too precise.

    Args:
        xy: (M, 2) modes.
        covariance: (M, 2, 2) without that uncertainty.
        inlier: (M, n) probability that each bearing is true.
        positions: (n, 2) positions of the sensors.
        sigma: (n,) standard deviations of the bearings [rad].
    """
    away = xy[:, None, :] - positions[None]
    squared = np.maximum((away**2).sum(axis=2), 1e-24)
    along = away / np.sqrt(squared)[..., None]
    wide = squared + np.einsum("mni,mij,mnj->mn", along, covariance, along)
    across = np.stack([-along[..., 1], along[..., 0]], axis=2) / (np.sqrt(wide) * sigma)[..., None]
    return np.asarray(np.linalg.inv(np.einsum("mn,mni,mnj->mij", inlier, across, across)))


def spread_of(found: Modes, *, pooled: bool) -> Floats:
    """Return the (2, 2) second moment of all modes about the first, by their probabilities.

    `pooled`: scale each mode's covariance by its residuals (`pooled_factor`); otherwise it is as stated.
    """
    factor = np.ones(len(found.xy))
    if pooled:
        squares = np.einsum("mn,mn->m", found.inlier_probability, np.minimum(found.residual**2, 1e6))
        freedom = np.maximum(found.inlier_probability.sum(axis=1) - 2.0, 0.0)
        factor = np.array([pooled_factor(s, f) for s, f in zip(squares.tolist(), freedom.tolist(), strict=True)])
    away = found.xy - found.xy[0]
    each = factor[:, None, None] * found.covariance + away[:, :, None] * away[:, None, :]
    return np.asarray(np.einsum("m,mij->ij", found.probability, each))


def _at(xy: Floats, positions: Floats, bearings: Floats, sigma: Floats, bend: float) -> tuple[Floats, Floats, Floats]:
    """Return normalised residuals (M, n), inlier probabilities (M, n) and gradients (M, n, 2) of n bearings.

    Gradients are those of the expected bearings by the position, over sigma.

    Args:
        xy: (M, 2) positions.
        positions: (n, 2) positions of the sensors.
        bearings: (n,) bearings [rad].
        sigma: (n,) standard deviations [rad].
        bend: standard deviations at which a bearing is as likely false as true.
    """
    away = xy[:, None, :] - positions[None]
    off = bearings - np.arctan2(away[..., 1], away[..., 0])
    residual = ((off + np.pi) % (2.0 * np.pi) - np.pi) / sigma
    inlier = 1.0 / (1.0 + np.exp(np.minimum(0.5 * (residual**2 - bend**2), 700.0)))
    squared = np.maximum((away**2).sum(axis=2), 1e-24)
    across = np.stack([-away[..., 1], away[..., 0]], axis=2) / (squared * sigma)[..., None]
    return residual, inlier, across


def _cost(residual: Floats, bend: float) -> Floats:
    """Return (M,) negative log likelihoods of normalised residuals (M, n), up to a constant.

    `bend`: standard deviations at which a bearing is as likely false as true.
    """
    return np.asarray(-np.logaddexp(-0.5 * residual**2, -0.5 * bend**2).sum(axis=1))


def _climbed(xy: Floats, positions: Floats, bearings: Floats, sigma: Floats, bend: float) -> Floats:
    """Return (M, 2) modes of the likelihood reached from start positions `xy` (M, 2), which are not changed.

    The search is reweighted Gauss-Newton with step halving until the cost falls.

    Args:
        xy: (M, 2) start positions.
        positions: (n, 2) positions of the sensors.
        bearings: (n,) bearings [rad].
        sigma: (n,) standard deviations [rad].
        bend: standard deviations at which a bearing is as likely false as true.
    """
    xy = xy.copy()
    scale = np.hypot(*(positions - positions.mean(axis=0)).T).max() + 1e-300
    for _ in range(MAX_EM_ITERATIONS):
        residual, inlier, across = _at(xy, positions, bearings, sigma, bend)
        information = np.einsum("mn,mni,mnj->mij", inlier, across, across)
        # A little of the trace keeps what only one line holds from flying off.
        ridge = 1e-9 * np.trace(information, axis1=1, axis2=2)[:, None, None] * np.eye(2) + 1e-300 * np.eye(2)
        slope = np.einsum("mn,mn,mni->mi", inlier, residual, across)
        step = np.linalg.solve(information + ridge, slope[..., None])[..., 0]
        here = _cost(residual, bend)
        share = np.ones(len(xy))
        for _ in range(HALVINGS):
            worse = _cost(_at(xy + share[:, None] * step, positions, bearings, sigma, bend)[0], bend) > here + 1e-12
            if not worse.any():
                break
            share[worse] *= 0.5
        else:
            share[worse] = 0.0
        move = share[:, None] * step
        xy += move
        if np.hypot(*move.T).max() < EM_TOLERANCE * scale:
            break
    return xy
