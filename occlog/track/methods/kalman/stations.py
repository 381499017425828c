"""How `ekf` and `ukf` take measurements of stations: ranges and whatever else has a measurement model.

The noise of measurements is independent given the state, so that they are taken in after the readings and bearings of
their scan.  A measurement is used if its innovation is within the gate; late and false ones are omitted by it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.filtering.gaussian import Gaussian, updated
from occlog.filtering.likelihood.distances import RangeMeasurements, linearise, residuals
from occlog.filtering.likelihood.measurement_model import LinearisedRows, MeasurementWorld
from occlog.filtering.likelihood.measurement_model import linearised as of_directions
from occlog.filtering.likelihood.measurement_model import measured as expected_of
from occlog.filtering.likelihood.measurement_model import residuals as off_directions

from .updates import WEIGHTS, by_sigma_points, sigma_points

GRID = 32
"""Number of grid positions per side, over the floor, for the search of the initial position."""
MAX_ITERATIONS, HALVINGS, STEP_CHI2_TOLERANCE = 30, 12, 1e-9
"""Gauss-Newton search: maximum steps, maximum halvings of a step, squared length of the last one in variances."""

StationUpdate = Callable[[Gaussian, RangeMeasurements], tuple[Gaussian, float]]
"""State and log-likelihood after measurements of stations that are within the gate."""


def innovation_gating(state: Gaussian, rows: RangeMeasurements, gate: float) -> Bools:
    """Return (m,) booleans: the innovation of a measurement of distances is within `gate` standard deviations.

    `state` is the prediction, `rows` are the m measurements.
    """
    found = linearise(rows, state.mean[None, :2])
    H, off = found.gradient[0], found.residual[0]
    return np.asarray(off**2 <= gate**2 * (np.einsum("mi,ij,mj->m", H, state.covariance[:2, :2], H) + 1.0))


def extended(state: Gaussian, rows: RangeMeasurements) -> tuple[Gaussian, float]:
    """Return the state after m measurements of distances, linearised at the mean (EKF), and their log-likelihood."""
    found = linearise(rows, state.mean[None, :2])
    after, score = updated(state, _whole(found.gradient[0]), found.residual[0], np.ones(len(rows.kind)))
    return after, score - float(np.log(rows.sigma).sum())


def unscented(state: Gaussian, rows: RangeMeasurements) -> tuple[Gaussian, float]:
    """Return the state after m measurements of distances, by sigma points one after another (UKF).

    The second value is their log-likelihood.
    """
    score = -float(np.log(rows.sigma).sum())
    for m in range(len(rows.kind)):
        points = sigma_points(state)
        innovation = residuals(rows.take(slice(m, m + 1)), points)[:, 0]
        state, log_p = by_sigma_points(state, points, WEIGHTS, innovation, 1.0)
        score += log_p
    return state, score


def first_position(
    anywhere: Gaussian, rows: LinearisedRows, distances: RangeMeasurements, world: MeasurementWorld, gate: float
) -> tuple[Gaussian, Ints]:
    """Return the most probable state from a single scan's measurements, and the sensors of the bearings used.

    The best position of a grid over the floor decides which measurements agree; a Gauss-Newton search for the maximum a
    posteriori continues from there with these.

    Args:
        anywhere: prior of the target.
        rows: measurements of directions.
        distances: measurements of distances.
        world: sensors and floor.
        gate: largest deviation of a measurement that agrees [standard deviations].
    """

    def deviations(at: Floats) -> tuple[Floats, Floats]:
        """Return (L, n) normalised residuals and (L, n, 2) gradients of all measurements at (L, 2) positions."""
        found = linearise(distances, at)
        expected, ahead = expected_of(at, rows, world)
        H, R = of_directions(at, rows, world)
        off = np.where(ahead, off_directions(expected, rows) / np.sqrt(R), np.inf)
        gradient = np.concatenate([found.gradient, H / np.sqrt(R)[..., None]], axis=1)
        return np.concatenate([found.residual, off], axis=1), gradient

    def cost(at: Floats, off: Floats) -> float:
        away = at - anywhere.mean[:2]
        return 0.5 * float(away @ np.linalg.solve(anywhere.covariance[:2, :2], away) + off @ off)

    # Grid: half a cell widens every deviation
    low, high = world.floor.room.min(axis=0), world.floor.room.max(axis=0)
    share = (np.arange(GRID) + 0.5) / GRID
    grid = low + (high - low) * np.stack(np.meshgrid(share, share), axis=-1).reshape(-1, 2)
    cell2 = float(np.max(0.5 * (high - low) / GRID) ** 2)
    every_off, every_H = deviations(grid)
    wide = every_off**2 / (1.0 + cell2 * (every_H**2).sum(axis=-1))
    best = int(np.argmin(np.minimum(wide, gate**2).sum(axis=1)))
    at, use, off, H = grid[best], wide[best] <= gate**2, every_off[best], every_H[best]
    state = anywhere
    for _ in range(MAX_ITERATIONS if use.any() else 0):
        # Posterior of the measurements linearised at the position
        innovation = off[use] - H[use] @ (anywhere.mean[:2] - at)
        state, _ = updated(anywhere, _whole(H[use]), innovation, np.ones(len(innovation)))
        step = state.mean[:2] - at
        if float(step @ np.linalg.solve(state.covariance[:2, :2], step)) < STEP_CHI2_TOLERANCE:
            break
        # Line search: the longest of the halved steps that lowers the cost
        tried = at + 0.5 ** np.arange(HALVINGS)[:, None] * step
        every_off, every_H = deviations(tried)
        lower = [cost(tried[k], every_off[k, use]) < cost(at, off[use]) for k in range(HALVINGS)]
        if not any(lower):
            break
        k = lower.index(True)
        at, off, H = tried[k], every_off[k], every_H[k]
    return state, rows.sensor[use[len(distances.kind) :]]


def _whole(H: Floats) -> Floats:
    """Return (m, 4) derivatives by (x, y, vx, vy) from `H` (m, 2) by the position; those by the velocity are 0."""
    return np.hstack([H, np.zeros_like(H)])
