"""How the three filters take measurements in: linearised, by sigma points, and at the most probable position.

Each update is that of a state with mean m and covariance P by rows with independent noise.  Only the position is
measured; what is learned of it moves the velocity by their covariance.

Update by the rows of one sensor, in polar coordinates about it.

lines of sight of one sensor say nothing of the distance.  In Cartesian coordinates they seem to: what was learned of
one line is kept as a strip of constant width, two such strips of different directions cross at the sensor, and
linearised each at a position of its own they draw the estimate to it, with a covariance that is too small (Aidala
1979).  Where the state is azimuth and log distance instead, rows measure the azimuth alone, the strip is a wedge,
and the maximum a posteriori needs no search.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.core.geometry.camera import wrap_angle
from occlog.filtering.gaussian import Gaussian, log_normal, symmetric, updated
from occlog.filtering.likelihood.directions import MIN_DEPTH
from occlog.filtering.likelihood.measurement_model import (
    Linearisation,
    LinearisedRows,
    MeasurementWorld,
    azimuths,
    linearise,
    linearised,
    measured,
    residuals,
    visible,
)

from .config import MULTISTART, NONE, VISIBLE, IekfConfig, UkfConfig


def polar_update(state: Gaussian, rows: LinearisedRows, world: MeasurementWorld) -> Gaussian | None:
    """Return the state after rows of one sensor; None where the prediction is around the sensor.

    The position is Gaussian in azimuth and log distance from the sensor, with the moments of `state` to first order;
    the velocity stays Cartesian. The noise of a row is that on its own ray, at the distance of the prediction.

    Args:
        state: the prediction.
        rows: measurements of directions, all by one sensor.
        world: the sensors.
    """
    sensor = world.sensors.xy[rows.sensor[0]]
    away = state.mean[:2] - sensor
    distance, azimuth = float(np.hypot(*away)), float(np.arctan2(away[1], away[0]))
    if distance < MIN_DEPTH or distance**2 < float(np.linalg.eigvalsh(state.covariance[:2, :2])[0]):
        return None
    # Prediction in azimuth, log distance and velocity
    J = np.eye(4)
    J[:2, :2] = np.linalg.inv(_outwards(azimuth, distance))
    P = J @ state.covariance @ J.T
    mean = np.array([azimuth, np.log(distance), *state.mean[2:]])
    # Rows one by one, as their noise is independent
    for k, azimuth_read in enumerate(azimuths(rows, world)):
        row = rows.take(np.array([k]))
        frame = _outwards(float(azimuth_read), distance)
        H, R = linearised(sensor + frame[:, 1], row, world)
        variance = float(R[0] / (H[0] @ frame[:, 0]) ** 2)
        gain = P[:, 0] / (P[0, 0] + variance)
        mean = mean + gain * float(wrap_angle(np.array([azimuth_read - mean[0]]))[0])
        left = np.eye(4)
        left[:, 0] -= gain
        P = left @ P @ left.T + variance * np.outer(gain, gain)
    back = np.eye(4)
    back[:2, :2] = _outwards(mean[0], float(np.exp(mean[1])))
    return Gaussian(np.array([*(sensor + back[:2, 1]), *mean[2:]]), symmetric(back @ P @ back.T))


def _outwards(azimuth: float, distance: float) -> Floats:
    """Return (2, 2) derivatives of the position, relative to the sensor, by azimuth [rad] and log distance.

    The second column is that relative position itself.
    """
    c, s = np.cos(azimuth), np.sin(azimuth)
    return distance * np.array([[-s, c], [c, s]])


SIGMA_POINT_SPREAD = math.sqrt(3.0)
"""Distance of sigma points in standard deviations: n + kappa = 3, which suits a Gaussian's fourth moment."""
WEIGHTS = np.array([1.0 / 3.0, *[1.0 / 6.0] * 4])
"""Weights of the mean and of the four sigma points about it."""
HALVINGS = 12
"""A step of the search is halved at most so often."""
STEP_SIGMA_TOLERANCE = 1e-6
"""The search ends where a step is shorter than this share of the standard deviation of the prediction."""
MAX_RELATIVE_DISTANCE_SIGMA = 1.0
"""A position is close to a sensor if the standard deviation of its distance exceeds this multiple of the distance."""
MIN_SQUARE = 1e-30
"""Lower bound of a squared distance, to avoid division by 0."""
INFEASIBLE, NO_SIGMA_POINTS = "infeasible", "no_sigma_points"
"""Values of `fallback`: the search ended at the border of the feasible set; no sigma point was left."""


class Updated(NamedTuple):
    """A state after an update, the log-likelihood of the rows, and a value for the column `fallback` (empty: none)."""

    state: Gaussian
    score: float  # log-likelihood of the rows
    fallback: str = ""


def gated_rows(state: Gaussian, rows: LinearisedRows, near: Linearisation, gate: float) -> Bools:
    """Return (R,) booleans: the row's innovation is within the gate; of a sensor's candidates, the nearest alone.

    Args:
        state: the prediction.
        rows: R measurements of directions.
        near: the rows linearised at its mean.
        gate: largest innovation [standard deviations].
    """
    spread = np.einsum("ri,ij,rj->r", near.H, state.covariance[:2, :2], near.H) + near.R
    squared = np.where(near.ahead, near.residual**2 / spread, np.inf)
    inside = squared <= gate**2
    if rows.labelled.all():
        return np.asarray(inside)
    for sensor in np.unique(rows.sensor[~rows.labelled]):
        own = np.flatnonzero((rows.sensor == sensor) & ~rows.labelled)
        inside[np.delete(own, np.argmin(squared[own]))] = False
    return np.asarray(inside)


def ekf(state: Gaussian, rows: LinearisedRows, world: MeasurementWorld) -> Updated:
    """Return the state after measurements of directions, linearised at its mean (extended Kalman filter)."""
    return linear(state, state.mean[:2], rows, world)


def linear(state: Gaussian, at: Floats, rows: LinearisedRows, world: MeasurementWorld) -> Updated:
    """Return the state after measurements of directions, linearised at position `at` (2,), in Joseph's form."""
    return by_linearisation(state, rows, linearise(at, rows, world), world)


def by_linearisation(state: Gaussian, rows: LinearisedRows, near: Linearisation, world: MeasurementWorld) -> Updated:
    """Return the state after measurements of directions that `near` has linearised, in Joseph's form.

    Near a sensor, the variances of its rows are inflated. `rows` and `world` give the positions of their sensors.
    """
    H = np.zeros((len(near.R), 4))
    H[:, :2] = near.H
    off = near.innovation(state.mean)
    found = updated(state, H, off, near.R)
    wedge = _near_sensor_inflation(near.at, rows, world, found[0].covariance[:2, :2])
    return Updated(*(found if (wedge == 1.0).all() else updated(state, H, off, near.R * wedge)))


def _near_sensor_inflation(at: Floats, rows: LinearisedRows, world: MeasurementWorld, covariance: Floats) -> Floats:
    """Return (R,) factors, at least 1, for the variances of rows of sensors close to the position.

    The error across a line of sight is its angle times the distance r, with second moment r^2 + v; linearised at the
    position it is taken for r alone, and next to a sensor the line would have no width.

    Args:
        at: (2,) position of the linearisation.
        rows: R measurements of directions.
        world: the sensors.
        covariance: (2, 2) covariance of the position.
    """
    away = at - world.sensors.xy[rows.sensor]
    r2 = np.maximum((away**2).sum(axis=1), MIN_SQUARE)
    along = np.einsum("ri,ij,rj->r", away, covariance, away) / r2
    return np.where(along > MAX_RELATIVE_DISTANCE_SIGMA**2 * r2, 1.0 + along / r2, 1.0)


def ukf(state: Gaussian, rows: LinearisedRows, world: MeasurementWorld, config: UkfConfig) -> Updated:
    """Update a state row by row by sigma points (unscented Kalman filter, Julier and Uhlmann 1997, kappa = 3 - n).

    Points of the position alone are drawn: the rest of the 2 n + 1 points of the whole state lie at its mean, and give
    the same moments. A point that does not count for a row (behind the camera; invisible, with the setting `visible`)
    adds nothing to its second moments, so that the covariance stays positive; without any point the row is omitted.
    """
    score, left = 0.0, 0
    for k in range(len(rows.sensor)):
        row = rows.take(np.array([k]))
        points = sigma_points(state)
        expected, counts = measured(points, row, world)
        if config.sigma_points == VISIBLE:
            counts = counts & visible(points, row, world)
        w = np.where(counts[:, 0], WEIGHTS, 0.0)
        if not w.sum() > 0.0:
            left += 1
            continue
        _, R = linearised(points[int(np.argmax(w))], row, world)
        state, log_p = by_sigma_points(state, points, w, residuals(expected, row)[:, 0], float(R[0]))
        score += log_p
    return Updated(state, score, NO_SIGMA_POINTS if left == len(rows.sensor) else "")


def sigma_points(state: Gaussian) -> Floats:
    """Return (5, 2) sigma points of the position: the mean, and four at sqrt(3) standard deviations.

    Their weights are `WEIGHTS`.
    """
    root = SIGMA_POINT_SPREAD * np.linalg.cholesky(state.covariance[:2, :2])
    return np.asarray(state.mean[:2] + np.vstack([np.zeros(2), root.T, -root.T]))


def by_sigma_points(state: Gaussian, points: Floats, w: Floats, innovation: Floats, R: float) -> tuple[Gaussian, float]:
    """Return the state after one measurement and its log-likelihood, by moments over sigma points.

    Args:
        state: the prediction.
        points: (5, 2) from `sigma_points`.
        w: (5,) their weights, 0 for points that do not count.
        innovation: (5,) measured minus expected value at each point.
        R: variance of the measurement noise.
    """
    # Mean and variance of the innovation over the points that count
    off = float(w @ innovation / w.sum())
    S = float(w @ (innovation - off) ** 2 + R)
    across = (w * (off - innovation)) @ (points - state.mean[:2])
    # Gain: the velocity follows the position by their covariance
    K = state.covariance[:, :2] @ np.linalg.solve(state.covariance[:2, :2], across) / S
    covariance = state.covariance - S * np.outer(K, K)
    after = Gaussian(state.mean + K * off, symmetric(covariance))
    return after, log_normal(np.array([off]), np.array([[S]]))


def iekf(state: Gaussian, rows: LinearisedRows, world: MeasurementWorld, config: IekfConfig, starts: Floats) -> Updated:
    """Update a state by measurements linearised at the most probable position (iterated extended Kalman filter).

    The iterated filter is a Gauss-Newton search for the maximum a posteriori (Bell and Cathey 1993), here among
    positions that all sensors with a row can see; without a start among these rows are linearised at the prediction.
    Rows of a single sensor are processed by `polar_update` if the resulting position is visible.

    Args:
        state: the prediction.
        rows: R measurements of directions.
        world: the sensors.
        config: settings of the method.
        starts: (K, 2) further positions to search from.
    """
    alone = polar_update(state, rows, world) if len(np.unique(rows.sensor)) == 1 else None
    if alone is not None and (config.visibility_constraint == NONE or visible(alone.mean[None, :2], rows, world).all()):
        return Updated(alone, linear(state, state.mean[:2], rows, world).score)
    first = state.mean[None, :2]
    tried = np.vstack([first, starts]) if config.visibility_constraint == MULTISTART else first
    if config.visibility_constraint != NONE:
        tried = tried[visible(tried, rows, world).all(axis=1)]
        if not len(tried):
            return linear(state, first[0], rows, world)._replace(fallback=INFEASIBLE)
    found = [gauss_newton(position, state, rows, world, config) for position in tried]
    best = min(found, key=lambda one: one[1])
    return linear(state, best[0], rows, world)._replace(fallback=INFEASIBLE if best[2] else "")


def map_cost(positions: Floats, state: Gaussian, rows: LinearisedRows, world: MeasurementWorld) -> Floats:
    """Return (L,) values of minus the log of prior times likelihood at positions (L, 2), up to a constant.

    inf behind a camera.

    Args:
        positions: (L, 2) positions.
        state: prior.
        rows: measurements of directions.
        world: the sensors.
    """
    away = positions - state.mean[:2]
    cost = 0.5 * np.einsum("li,li->l", away, np.linalg.solve(state.covariance[:2, :2], away.T).T)
    expected, ahead = measured(positions, rows, world)
    variance = linearised(positions, rows, world)[1]
    terms = 0.5 * residuals(expected, rows) ** 2 / variance + 0.5 * np.log(variance)
    return np.asarray(np.where(ahead.all(axis=1), cost + np.where(ahead, terms, 0.0).sum(axis=1), np.inf))


def gauss_newton(
    start: Floats, state: Gaussian, rows: LinearisedRows, world: MeasurementWorld, config: IekfConfig
) -> tuple[Floats, float, bool]:
    """Search for the position of largest posterior density (least `map_cost`) by Gauss-Newton with halved steps.

    Args:
        start: (2,) first position.
        state: prior.
        rows: measurements of directions.
        world: the sensors.
        config: settings of method `iekf`.

    Returns:
        End position (2,), its cost, and whether the border of the visible region stopped the search.
    """
    at, cost = start, float(map_cost(start[None], state, rows, world)[0])
    whiten = np.linalg.inv(np.linalg.cholesky(state.covariance[:2, :2]))
    scale = STEP_SIGMA_TOLERANCE * math.sqrt(float(np.trace(state.covariance[:2, :2])))
    for _ in range(config.max_iterations):
        if not math.isfinite(cost):
            break
        expected, _ = measured(at[None], rows, world)
        H, R = linearised(at, rows, world)
        # Least squares in standard deviations: next to a sensor the normal equations are singular but for rounding
        weighted = np.vstack([whiten, H / np.sqrt(R)[:, None]])
        off = np.concatenate([whiten @ (state.mean[:2] - at), residuals(expected[0], rows) / np.sqrt(R)])
        step = np.linalg.lstsq(weighted, off, rcond=None)[0]
        # Line search: the longest of the halved steps that is feasible and lowers the cost
        ways = at + 0.5 ** np.arange(HALVINGS)[:, None] * step
        lower = map_cost(ways, state, rows, world)
        better = lower < cost
        allowed = better if config.visibility_constraint == NONE else better & visible(ways, rows, world).all(axis=1)
        if not allowed.any():
            return at, cost, bool(better.any()) and float(np.hypot(*step)) > scale
        k = int(np.argmax(allowed))
        at, cost, moved = ways[k], float(lower[k]), float(np.hypot(*(ways[k] - at)))
        if moved < scale:
            break
    return at, cost, False
