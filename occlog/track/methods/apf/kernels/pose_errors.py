"""Errors of the sensors' poses that stay the same: what the bearings of one scan say about each other.

[Ercan] Sec. 4.2 takes calibration errors for white noise and names two better ways: to estimate
them along with the state, or in an initialisation phase.  Here is what both need.

The error of a sensor is (dx, dy, dyaw), true minus stated.  A Gaussian is kept over the errors
of all sensors together, correlations included.  Three or more bearings of one target at one
time seldom meet in a point.  How they miss it depends on the errors but, to first order, not
on where the target is: the part of the residuals that a shift of the target could explain is
projected away.  So nothing is assumed about the target, a filter's estimate of it is not
counted a second time, and what cannot be observed (a shift, turn or change of scale of
everything together) keeps its prior uncertainty.  Two bearings always meet and say nothing.

Jacobians are taken at the stated positions of the sensors, always: with changing points of
linearisation the filter would think that it had observed the turn and the scale.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from occlog.array_types import Floats, Ints

GATE_SIGNIFICANCE = 1e-3
"""Scans with residuals less likely than this are omitted: some bearing is not the target's."""
PRIOR_COUNT = 30.0
"""Weight, in residuals, of the assumption that bearings are as noisy as they say."""
MAX_ITERATIONS = 20
RELATIVE_TOLERANCE = 1e-6
CONVERGENCE_SIGMAS = 1e-3
"""Change of the errors, in prior deviations, at which the fit stops."""
MIN_DISTANCE_RATIO = 0.02
"""Minimum relative distance of the target for linearised bearings."""
MIN_BEARINGS = 3


class PoseErrorBelief(NamedTuple):
    """Gaussian over the pose errors (true minus stated; dx, dy, dyaw [rad]) of S sensors, and statistics of the fit.

    `excess` over `counted` is the mean squared normalised residual of the bearings so far; `log_odds` compares constant
    errors with errors drawn independently at every scan, as [Ercan] Eq. 2 has them.
    """

    mean: Floats  # (S, 3) dx, dy, dyaw [rad]
    covariance: Floats  # (3 S, 3 S), rows in the order of mean.ravel()
    excess: float  # sum of squared normalised residuals
    counted: float  # number of them
    log_odds: float  # of errors that stay against errors resampled for every scan (Eq. 2), by what was measured
    prior: Floats  # (3 S,) variances before any measurement

    @property
    def scale(self) -> float:
        """Return the factor, at least 1, by which the variance of bearings exceeds its stated value.

        It starts at 1 with the weight of `PRIOR_COUNT` residuals, and is learned from the residuals.
        """
        return max(1.0, (PRIOR_COUNT + self.excess) / (PRIOR_COUNT + self.counted))

    @property
    def blocks(self) -> Floats:
        """Return the (S, 3, 3) covariance of each sensor's own error (dx, dy, dyaw [rad])."""
        S = len(self.mean)
        index = np.arange(S)
        return np.asarray(self.covariance.reshape(S, 3, S, 3)[index, :, index, :])


class LabelledBearings(NamedTuple):
    """n bearings of one target at one time, from n different sensors."""

    sensor: Ints  # (n,)
    bearing: Floats  # (n,) [rad], as computed with the stated yaw
    variance: Floats  # (n,) [rad^2] of the reading alone


def prior_belief(sigma_position: Floats, sigma_yaw: Floats) -> PoseErrorBelief:
    """Return the belief about the pose errors of S sensors before any bearing: independent, of mean 0.

    Args:
        sigma_position: (S,) standard deviation of the position per axis.
        sigma_yaw: (S,) standard deviation of the yaw [rad].
    """
    sigma = np.column_stack([sigma_position, sigma_position, sigma_yaw])
    variance = sigma.ravel() ** 2
    return PoseErrorBelief(
        mean=np.zeros_like(sigma), covariance=np.diag(variance), excess=0.0, counted=0.0, log_odds=0.0, prior=variance
    )


def jacobians(xy: Floats, positions: Floats) -> tuple[Floats, Floats]:
    """Return derivatives of n bearings [rad] by the target's position (n, 2), and by each sensor's dx, dy, dyaw (n, 3).

    Args:
        xy: (2,) position of the target.
        positions: (n, 2) positions of the sensors; none may be at the target.
    """
    away = xy - positions
    r2 = np.einsum("ij,ij->i", away, away)
    by_target = np.column_stack([-away[:, 1], away[:, 0]]) / r2[:, None]
    return by_target, np.column_stack([-by_target, np.full(len(positions), -1.0)])


def residuals(xy: Floats, sights: LabelledBearings, positions: Floats, mean: Floats) -> Floats:
    """Return (n,) measured minus expected bearings in [-pi, pi), for given pose errors.

    Args:
        xy: (2,) position of the target.
        sights: n bearings.
        positions: (S, 2) stated positions of the sensors.
        mean: (S, 3) errors dx, dy, dyaw [rad] by which the poses are corrected.
    """
    error = mean[sights.sensor]
    away = xy - positions[sights.sensor] - error[:, :2]
    difference = sights.bearing + error[:, 2] - np.arctan2(away[:, 1], away[:, 0])
    return np.asarray((difference + math.pi) % (2.0 * math.pi) - math.pi)


def spread(xy: Floats, which: Ints, positions: Floats, belief: PoseErrorBelief) -> Floats:
    """Return (n,) variances [rad^2] of bearings to a target that come from the pose errors of the sensors: J C J^T.

    This is the calibration part of [Ercan] Eq. 2 for any covariance C, in angles.

    Args:
        xy: (2,) position of the target.
        which: (n,) index of each bearing's sensor.
        positions: (S, 2) stated positions of all sensors.
        belief: Gaussian over the pose errors.
    """
    by_error = jacobians(xy, positions[which])[1]
    return np.asarray(np.einsum("ni,nij,nj->n", by_error, belief.blocks[which], by_error))


def intersection_point(sights: LabelledBearings, positions: Floats, mean: Floats, start: Floats) -> Floats | None:
    """Return the position (2,) that agrees best with bearings, by Gauss-Newton from `start`; None if there is none.

    It must be in front of every sensor and not much nearer to one of them than to the others.

    Args:
        sights: bearings of one time.
        positions: (S, 2) stated positions of the sensors.
        mean: (S, 3) errors dx, dy, dyaw [rad] by which the poses are corrected.
        start: (2,) first guess.
    """
    root = 1.0 / np.sqrt(sights.variance)
    centres = positions[sights.sensor] + mean[sights.sensor, :2]
    xy = start.copy()
    for _ in range(MAX_ITERATIONS):
        away = np.hypot(*(xy - centres).T)
        if away.min() < MIN_DISTANCE_RATIO * away.max():
            return None
        by_target = jacobians(xy, centres)[0] * root[:, None]
        move = np.linalg.lstsq(by_target, residuals(xy, sights, positions, mean) * root, rcond=1e-9)[0]
        # Long steps leave the range in which the bearings are linear.
        length, most = math.hypot(*move), 0.5 * float(away.min())
        xy = xy + move * min(1.0, most / length if length > 0 else 1.0)
        if length < RELATIVE_TOLERANCE * away.max():
            break
    else:
        return None
    near = np.hypot(*(xy - centres).T)
    facing = np.abs(residuals(xy, sights, positions, mean)) < 0.5 * math.pi
    return xy if facing.all() and near.min() >= MIN_DISTANCE_RATIO * near.max() else None


def evidence(sights: LabelledBearings, positions: Floats, mean: Floats, start: Floats) -> tuple[Floats, Floats] | None:
    """Return a linear measurement of the pose errors e by bearings of one time, for any target position: y and G.

    y = G (e - mean) + noise of unit variance. The part of the residuals that a shift of the target could explain is
    projected away.

    Args:
        sights: n bearings.
        positions: (S, 2) stated positions of the sensors.
        mean: (S, 3) errors to linearise at.
        start: (2,) roughly where the target is.

    Returns:
        (n - 2,) y and (n - 2, 3 S) G; None for fewer than three bearings or bearings that do not meet.
    """
    if len(sights.sensor) < MIN_BEARINGS:
        return None
    xy = intersection_point(sights, positions, mean, start)
    if xy is None:
        return None
    # Whiten, and project away what a shift of the target could explain
    root = 1.0 / np.sqrt(sights.variance)
    by_target, by_error = jacobians(xy, positions[sights.sensor])
    across = np.linalg.qr(by_target * root[:, None], mode="complete")[0][:, 2:].T
    y = across @ (residuals(xy, sights, positions, mean) * root)
    G = np.zeros((len(y), *mean.shape))
    G[:, sights.sensor] = across[:, :, None] * (by_error * root[:, None])
    return y, G.reshape(len(y), -1)


def update(belief: PoseErrorBelief, sights: LabelledBearings, positions: Floats, start: Floats) -> PoseErrorBelief:
    """Return the belief about pose errors after the bearings of one scan.

    It is an extended Kalman update with `evidence`, and an update of the log-odds by how well constant and independent
    errors predicted it. The noise variance is raised by `PoseErrorBelief.scale`. The belief is unchanged with fewer
    than three bearings, and where they do not meet or fail a chi-square test.

    Args:
        belief: belief before the scan.
        sights: bearings of one time.
        positions: (S, 2) stated positions of the sensors.
        start: (2,) roughly where the target is.
    """
    found = evidence(sights, positions, belief.mean, start)
    if found is None:
        return belief
    # Innovation covariance
    y, G = found
    C, unit = belief.covariance, np.eye(len(y))
    explained = G @ C @ G.T
    S = explained + belief.scale * unit
    # Gate: chi-squared
    if y @ np.linalg.solve(S, y) > chdtri(len(y), GATE_SIGNIFICANCE):
        return belief
    excess = float(y @ np.linalg.solve(explained + unit, y))
    # Kalman update
    gain = np.linalg.solve(S, G @ C).T
    rest = np.eye(len(C)) - gain @ G
    # Joseph's form keeps the covariance positive semi-definite.
    covariance = rest @ C @ rest.T + belief.scale * gain @ gain.T
    mean = belief.mean + (gain @ y).reshape(belief.mean.shape)
    # Odds of errors that stay: those resampled have their prior at every time; y is relative to the learned mean.
    white = _log_density(y + G @ belief.mean.ravel(), (G * belief.prior) @ G.T + unit)
    odds = belief.log_odds + _log_density(y, S) - white
    return belief._replace(
        mean=mean,
        covariance=0.5 * (covariance + covariance.T),
        excess=belief.excess + excess,
        counted=belief.counted + len(y),
        log_odds=odds,
    )


def _log_density(y: Floats, covariance: Floats) -> float:
    """Return the log density at y (n,) of a zero-mean Gaussian with `covariance` (n, n), without the term of 2 pi."""
    return float(-0.5 * (y @ np.linalg.solve(covariance, y) + np.linalg.slogdet(covariance)[1]))


def solve(
    belief: PoseErrorBelief,
    scans: Sequence[LabelledBearings],
    positions: Floats,
    starts: Floats,
    rounds: int = MAX_ITERATIONS,
) -> PoseErrorBelief:
    """Return the belief about pose errors after many scans at once, by Gauss-Newton with the trajectory eliminated.

    Every position of the trajectory is free (flat prior); errors have `belief` as their prior. Scans are linearised
    again in every round, and those with bearings that cannot be the target's are omitted.

    Args:
        belief: prior, of mean 0 and independent errors (`prior_belief`).
        scans: bearings of T scans.
        positions: (S, 2) stated positions of the sensors.
        starts: (T, 2) roughly where the target was.
        rounds: largest number of Gauss-Newton iterations.
    """
    deviation = np.sqrt(belief.prior)  # errors in units of their prior: also right where it is 0
    one_by_one = belief
    for sights, start in zip(scans, starts, strict=True):
        one_by_one = update(one_by_one, sights, positions, start)
    now = belief
    for _ in range(rounds):
        after = _round(now, scans, positions, starts, deviation)
        moved = np.abs(after.mean - now.mean).ravel()
        settled = abs(after.scale - now.scale) < CONVERGENCE_SIGMAS and bool(
            np.all(moved <= CONVERGENCE_SIGMAS * deviation)
        )
        now = after
        if settled:
            break
    return now._replace(log_odds=one_by_one.log_odds)


def _round(
    now: PoseErrorBelief, scans: Sequence[LabelledBearings], positions: Floats, starts: Floats, deviation: Floats
) -> PoseErrorBelief:
    """Return the belief after one Gauss-Newton iteration of `solve`.

    Args:
        now: belief of the previous iteration, at which scans are linearised.
        scans: T scans.
        positions: (S, 2) stated positions.
        starts: (T, 2) roughly where the target was.
        deviation: (3 S,) prior standard deviations of the errors, in the order of `mean.ravel()`.
    """
    information, pull = np.eye(len(deviation)), np.zeros(len(deviation))
    excess, count = 0.0, 0.0
    for sights, start in zip(scans, starts, strict=True):
        found = evidence(sights, positions, now.mean, start)
        if found is None:
            continue
        y, G = found
        S = G @ now.covariance @ G.T + now.scale * np.eye(len(y))
        if y @ np.linalg.solve(S, y) > chdtri(len(y), GATE_SIGNIFICANCE):
            continue
        scaled = G * deviation
        information += scaled.T @ scaled / now.scale
        pull += scaled.T @ (y + G @ now.mean.ravel()) / now.scale
        excess, count = excess + float(y @ y), count + len(y)
    inverse = np.linalg.inv(information)
    mean = (deviation * (inverse @ pull)).reshape(now.mean.shape)
    taken_up = len(deviation) - float(np.trace(inverse))  # residuals that the fit has explained
    covariance = deviation[:, None] * (0.5 * (inverse + inverse.T)) * deviation
    return now._replace(mean=mean, covariance=covariance, excess=excess, counted=max(count - taken_up, 0.0))
