"""Expected errors of a filter at the end of paths, for many targets.

The filter models people who walk straight and turn now and then, with the turn rate, speed and position noise of the
walk (`occlog.plan.walks`). Between turns it assumes as much process noise as occlog's trackers by default, even if the
walk has less. Unlike the posterior bound of `occlog evaluate`, it does not know where the target is going.

Between turns the velocity is constant except for noise; at a turn it is redrawn from N(0, fresh I). The filter
estimates the times of turns by hypotheses, each a Kalman filter of (x, y, vx, vy) with a probability: at every step one
is added, for a turn at this step. If there are more than `MAX_HYPOTHESES`, the two most similar neighbours in the order
of start are merged. In a gap the first two moments over all hypotheses are exactly those of the walk. Each hypothesis
has two covariances: the one assumed by the filter, which determines gains and probabilities, and that of the actual
errors with these gains.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.core.numerics.jit import kernel

MAX_HYPOTHESES = 4
"""Hypotheses after a step; with 20 expected errors are the same to 1 %."""
MIN_HYPOTHESIS_PROBABILITY = 1e-6
"""Probability below which a hypothesis is dropped."""

PROBABILITY, STATE, FILTER_COVARIANCE, TRUE_COVARIANCE, WIDTH = 0, 1, 5, 15, 25
"""Columns of the hypotheses: probability, state, and the triangles of the two covariances."""
TRIANGLE = np.array([[0, 1, 2, 3], [1, 4, 5, 6], [2, 5, 7, 8], [3, 6, 8, 9]])
"""Index of an element of a covariance in its triangle."""


class StepNoise(NamedTuple):
    """Process noise of a step without a turn, per axis: variances of position and velocity, and covariance `both`.

    `fresh` is the variance of each velocity component after a turn.
    """

    position: float
    both: float  # of position and velocity
    velocity: float
    fresh: float  # variance of a new velocity


@kernel
def run_filter(
    ways: Floats,
    information: Floats,
    noise: Floats,
    start: Floats,
    prior: Floats,
    turn: float,
    assumed: StepNoise,
    true: StepNoise,
    dt: float,
    keep: int,
) -> tuple[Floats, Floats]:
    """Compute the position estimates of a filter and their error covariances at the last steps of N paths of T steps.

    Args:
        ways: (N, T, 2) true positions of targets.
        information: (3, N, T) xx, xy, yy of the Fisher information I of each step's measurements about the position.
        noise: (2, N, T) measurement noise: a step measures I x + noise for a position x; its covariance is I.
        start: (2,) prior mean of the position.
        prior: (2, 2) prior covariance of the position.
        turn: probability that the target turns in a step.
        assumed: process noise that the filter assumes.
        true: process noise of the walk.
        dt: time between steps [s].
        keep: number of the last steps that are returned.

    Returns:
        (N, keep, 2) estimated positions, and (N, keep, 3) xx, xy, yy of the covariance of their errors.
    """
    steps = ways.shape[1]
    positions, spread = np.empty((ways.shape[0], keep, 2)), np.empty((ways.shape[0], keep, 3))
    rows, packed, work = np.empty((MAX_HYPOTHESES + 1, WIDTH)), np.empty(7), np.empty((4, 8))
    for i in range(ways.shape[0]):
        rows[0] = 0.0
        rows[0, PROBABILITY] = 1.0
        rows[0, STATE], rows[0, STATE + 1] = start[0], start[1]
        for first in (FILTER_COVARIANCE, TRUE_COVARIANCE):
            rows[0, first], rows[0, first + 1], rows[0, first + 4] = prior[0, 0], prior[0, 1], prior[1, 1]
            rows[0, first + 7] = rows[0, first + 9] = assumed.fresh
        n = 1
        for t in range(steps):
            if t:
                _turn_into(rows, n, turn, assumed.fresh)
                n += 1
                for h in range(n):
                    _move_into(rows, h, dt, assumed, true)
            packed[0], packed[1], packed[2] = information[0, i, t], information[1, i, t], information[2, i, t]
            if packed[0] + packed[2] > 0.0:
                packed[3], packed[4], packed[5], packed[6] = (
                    ways[i, t, 0],
                    ways[i, t, 1],
                    noise[0, i, t],
                    noise[1, i, t],
                )
                n = _weigh_into(rows, n, packed, work)
            if n > MAX_HYPOTHESES:
                _merge_into(rows, n)
                n -= 1
            if t >= steps - keep:
                _moments_into(rows, n, TRUE_COVARIANCE, positions[i, t - steps + keep], spread[i, t - steps + keep])
    return positions, spread


@kernel
def _moments_into(rows: Floats, n: int, first: int, position: Floats, spread: Floats) -> None:
    """Write mean and covariance of the position over all hypotheses to `position` and `spread`.

    Args:
        rows: (> n, `WIDTH`) hypotheses: probability, state, triangles of the assumed and the true covariance.
        n: number of rows in use.
        first: column of the covariance: `FILTER_COVARIANCE` or `TRUE_COVARIANCE`.
        position: (2,) filled: mean.
        spread: (3,) filled: xx, xy, yy of the covariance.
    """
    x, y = 0.0, 0.0
    for h in range(n):
        x += rows[h, PROBABILITY] * rows[h, STATE]
        y += rows[h, PROBABILITY] * rows[h, STATE + 1]
    xx, xy, yy = 0.0, 0.0, 0.0
    for h in range(n):
        dx, dy = rows[h, STATE] - x, rows[h, STATE + 1] - y
        xx += rows[h, PROBABILITY] * (rows[h, first] + dx * dx)
        xy += rows[h, PROBABILITY] * (rows[h, first + 1] + dx * dy)
        yy += rows[h, PROBABILITY] * (rows[h, first + 4] + dy * dy)
    position[0], position[1] = x, y
    spread[0], spread[1], spread[2] = xx, xy, yy


@kernel
def _turn_into(rows: Floats, n: int, turn: float, fresh: float) -> None:
    """Add hypothesis n that the target turns now, in place; the probabilities of the others are multiplied by 1 - turn.

    Its position has the moments over all others, its velocity is 0 with the variance `fresh`.

    Args:
        rows: (> n, `WIDTH`) hypotheses: probability, state, triangles of the assumed and the true covariance.
        n: number of hypotheses before.
        turn: probability of a turn in this step.
        fresh: variance of each component of the velocity after a turn.
    """
    initiated = rows[n]
    initiated[:] = 0.0
    _moments_into(
        rows, n, FILTER_COVARIANCE, initiated[STATE : STATE + 2], initiated[TRUE_COVARIANCE : TRUE_COVARIANCE + 3]
    )
    initiated[FILTER_COVARIANCE], initiated[FILTER_COVARIANCE + 1], initiated[FILTER_COVARIANCE + 4] = (
        initiated[TRUE_COVARIANCE],
        initiated[TRUE_COVARIANCE + 1],
        initiated[TRUE_COVARIANCE + 2],
    )
    _moments_into(
        rows, n, TRUE_COVARIANCE, initiated[STATE : STATE + 2], initiated[TRUE_COVARIANCE : TRUE_COVARIANCE + 3]
    )
    initiated[TRUE_COVARIANCE + 4] = initiated[TRUE_COVARIANCE + 2]
    initiated[TRUE_COVARIANCE + 2] = 0.0
    initiated[FILTER_COVARIANCE + 7] = initiated[FILTER_COVARIANCE + 9] = initiated[TRUE_COVARIANCE + 7] = initiated[
        TRUE_COVARIANCE + 9
    ] = fresh
    for h in range(n):
        rows[h, PROBABILITY] *= 1.0 - turn
    initiated[PROBABILITY] = turn


@kernel
def _move_into(rows: Floats, h: int, dt: float, assumed: StepNoise, true: StepNoise) -> None:
    """Predict hypothesis h by a step of constant velocity, in place.

    Args:
        rows: (n, `WIDTH`) hypotheses: probability, state, triangles of the assumed and the true covariance.
        h: row of the hypothesis.
        dt: length of the step [s].
        assumed: noise added to the covariance that the filter assumes.
        true: noise added to the covariance of the actual errors.
    """
    rows[h, STATE] += dt * rows[h, STATE + 2]
    rows[h, STATE + 1] += dt * rows[h, STATE + 3]
    _spread_into(rows[h, FILTER_COVARIANCE:TRUE_COVARIANCE], dt, assumed)
    _spread_into(rows[h, TRUE_COVARIANCE:], dt, true)


@kernel
def _spread_into(P: Floats, dt: float, noise: StepNoise) -> None:
    """Predict the covariance of (x, y, vx, vy), given as its upper triangle P (10,), by `dt` [s], in place.

    `noise` is the process noise that is added.
    """
    P[0] += dt * (2.0 * P[2] + dt * P[7]) + noise.position
    P[1] += dt * (P[3] + P[5] + dt * P[8])
    P[4] += dt * (2.0 * P[6] + dt * P[9]) + noise.position
    P[2] += dt * P[7] + noise.both
    P[3] += dt * P[8]
    P[5] += dt * P[8]
    P[6] += dt * P[9] + noise.both
    P[7] += noise.velocity
    P[9] += noise.velocity


@kernel
def _weigh_into(rows: Floats, n: int, information: Floats, work: Floats) -> int:
    """Update all hypotheses by the measurement of a step, in place; return the number kept (at the front).

    Those less probable than `MIN_HYPOTHESIS_PROBABILITY` are dropped.

    Args:
        rows: (>= n, `WIDTH`) hypotheses: probability, state, triangles of the assumed and the true covariance.
        n: number of hypotheses.
        information: (7,) xx, xy, yy of the Fisher information; true position x, y; measurement noise x, y.
        work: (4, 8) buffer.
    """
    best = -math.inf
    for h in range(n):
        log_chance = math.log(rows[h, PROBABILITY]) + _update_into(rows[h], information, work)
        rows[h, PROBABILITY] = log_chance
        best = max(best, log_chance)
    total = 0.0
    for h in range(n):
        rows[h, PROBABILITY] = math.exp(rows[h, PROBABILITY] - best)
        total += rows[h, PROBABILITY]
    left, kept = 0, 0.0
    for h in range(n):
        if rows[h, PROBABILITY] >= MIN_HYPOTHESIS_PROBABILITY * total:
            kept += rows[h, PROBABILITY]
            if left < h:
                rows[left] = rows[h]
            left += 1
    for h in range(left):
        rows[h, PROBABILITY] /= kept
    return left


@kernel
def _update_into(row: Floats, information: Floats, work: Floats) -> float:
    """Update a hypothesis by a measurement, in place; return its log-likelihood up to a constant common to all.

    The measurement is I x + noise. With M = 1 + I P_xx: gain W = P_x M^-1 for it minus I x, G = W I for the
    position; the filter covariance becomes P - G P_x^T, that of the actual errors (1 - G H) R (1 - G H)^T + W I
    W^T.

    Args:
        row: (`WIDTH`,) hypothesis: probability, state, triangles of the assumed and the true covariance.
        information: (7,) xx, xy, yy of the Fisher information I; true position x, y; measurement noise x, y.
        work: (4, 8) buffer for gains.
    """
    xx, xy, yy = information[0], information[1], information[2]
    p, q, r = row[FILTER_COVARIANCE], row[FILTER_COVARIANCE + 1], row[FILTER_COVARIANCE + 4]
    a, b, c, d = 1.0 + xx * p + xy * q, xx * q + xy * r, xy * p + yy * q, 1.0 + xy * q + yy * r
    det = a * d - b * c
    off_x, off_y = information[3] - row[STATE], information[4] - row[STATE + 1]
    new_x, new_y = xx * off_x + xy * off_y + information[5], xy * off_x + yy * off_y + information[6]
    gone_x, gone_y = (d * new_x - b * new_y) / det, (a * new_y - c * new_x) / det
    log: float = -0.5 * math.log(det) - 0.5 * (off_x * (new_x + information[5]) + off_y * (new_y + information[6]))
    log += 0.5 * (new_x * (p * gone_x + q * gone_y) + new_y * (q * gone_x + r * gone_y))
    r_xx, r_xy, r_yy = row[TRUE_COVARIANCE], row[TRUE_COVARIANCE + 1], row[TRUE_COVARIANCE + 4]
    for k in range(4):
        px, py = row[FILTER_COVARIANCE + TRIANGLE[k, 0]], row[FILTER_COVARIANCE + TRIANGLE[k, 1]]
        wx, wy = (px * d - py * c) / det, (py * a - px * b) / det
        work[k, 0], work[k, 1], work[k, 2], work[k, 3] = px, py, wx, wy
        work[k, 4], work[k, 5] = wx * xx + wy * xy, wx * xy + wy * yy
        work[k, 6], work[k, 7] = row[TRUE_COVARIANCE + TRIANGLE[k, 0]], row[TRUE_COVARIANCE + TRIANGLE[k, 1]]
        row[STATE + k] += wx * new_x + wy * new_y
    for k in range(4):
        gx, gy = work[k, 4], work[k, 5]
        # R G^T is P_x of the true covariance times gains; what the gains make of it and of the noise
        ux, uy = gx * r_xx + gy * r_xy - work[k, 6], gx * r_xy + gy * r_yy - work[k, 7]
        for m in range(k, 4):
            at = TRIANGLE[k, m]
            row[FILTER_COVARIANCE + at] -= gx * work[m, 0] + gy * work[m, 1]
            row[TRUE_COVARIANCE + at] += ux * work[m, 4] + uy * work[m, 5] - gx * work[m, 6] - gy * work[m, 7]
            row[TRUE_COVARIANCE + at] += gx * work[m, 2] + gy * work[m, 3]
    return log


@kernel
def _merge_into(rows: Floats, n: int) -> None:
    """Merge those two neighbours of n hypotheses with the least loss, in place; n - 1 rows remain.

    The loss is their distance (Mahalanobis, and of the log velocity variances) times p1 p2 / (p1 + p2). `rows` are
    probability, state, and triangles of the assumed and the true covariance.
    """
    at, least = 0, math.inf
    for h in range(n - 1):
        one, two = rows[h, PROBABILITY], rows[h + 1, PROBABILITY]
        off = 0.0
        for k in range(4):
            v = rows[h, FILTER_COVARIANCE + TRIANGLE[k, k]] + rows[h + 1, FILTER_COVARIANCE + TRIANGLE[k, k]]
            off += (rows[h, STATE + k] - rows[h + 1, STATE + k]) ** 2 / v
        for k in (7, 9):
            off += abs(math.log(rows[h, FILTER_COVARIANCE + k] / rows[h + 1, FILTER_COVARIANCE + k]))
        loss = off * one * two / (one + two)
        if loss < least:
            at, least = h, loss
    total = rows[at, PROBABILITY] + rows[at + 1, PROBABILITY]
    one = rows[at, PROBABILITY] / total
    two = 1.0 - one
    for k in range(4):
        for m in range(k, 4):
            spread = one * two
            spread *= (rows[at, STATE + k] - rows[at + 1, STATE + k]) * (rows[at, STATE + m] - rows[at + 1, STATE + m])
            for first in (FILTER_COVARIANCE + TRIANGLE[k, m], TRUE_COVARIANCE + TRIANGLE[k, m]):
                rows[at, first] = one * rows[at, first] + two * rows[at + 1, first] + spread
    for k in range(4):
        rows[at, STATE + k] = one * rows[at, STATE + k] + two * rows[at + 1, STATE + k]
    rows[at, PROBABILITY] = total
    for h in range(at + 1, n - 1):
        rows[h] = rows[h + 1]


BLOCK = 1_000_000
"""Positions times cells that are summed at a time."""
MIN_VELOCITY_VARIANCE = 1e-18
"""Least variance of a velocity after a turn, so that logarithms stay finite without motion."""


class Motion(NamedTuple):
    """Parameters of a random walk fitted to its second moments: speed, turn rate and position noise.

    `speed`: root mean square velocity [length/s]; `turns`: rate at which the velocity is redrawn [1/s]; `sigma`:
    position noise per axis, accumulated over 1 s [length].
    """

    speed: float  # root mean square of the velocity, per second
    turns: float  # how often a second the velocity is forgotten
    sigma: float  # noise of the position per axis, accumulated over 1 s


class FilterNoise(NamedTuple):
    """Process noise that a filter assumes between turns, per axis, accumulated over 1 s.

    `sigma_v` of the position [length], at least that of the walk in use; `sigma_a` of the velocity [length/s].
    """

    sigma_v: float  # of the position
    sigma_a: float  # of the velocity


class Reports(NamedTuple):
    """Simulated measurements of N targets at T steps: Fisher information I of each step, and noise.

    A step measures I x + noise for the position x; the covariance of the noise is I.
    """

    information: Floats  # (3, N, T) xx, xy, yy of the Fisher information I of each step about the position
    noise: Floats  # (2, N, T) the error of the measurement, in units of I times a position; its covariance is I


class ExpectedPosteriors(NamedTuple):
    """Position estimates of a filter for N targets at K steps (N, K, 2), with error covariances (N, K, 2, 2)."""

    position: Floats  # (N, K, 2)
    covariance: Floats  # (N, K, 2, 2)


def noise_of(information: Floats, chance: Floats) -> Floats:
    """Noise (2, N, T) of a measurement in information form: the information matrix times the error of a position.

    The covariance of this noise is the information matrix itself.

    Args:
        information: (3, N, T) entries xx, xy, yy of the information matrix of N targets at T steps.
        chance: (2, N, T) standard normal numbers, which the Cholesky factor of the matrix multiplies.
    """
    xx, xy, yy = information
    root = np.sqrt(xx)
    across = np.divide(xy, root, out=np.zeros_like(xy), where=root > 0.0)
    left = np.sqrt(np.maximum(yy - across**2, 0.0))
    return np.stack([root * chance[0], across * chance[0] + left * chance[1]])


def errors_along(
    ways: Floats,
    reports: Reports,
    start: tuple[Floats, Floats],
    motion: Motion,
    belief: FilterNoise,
    dt: float,
    keep: int = 1,
) -> ExpectedPosteriors:
    """Return position estimates and error covariances of a filter for N targets along their paths, at the last steps.

    Args:
        ways: (N, T, 2) true positions.
        reports: simulated measurements.
        start: (2,) mean and (2, 2) covariance of the position before any measurement.
        motion: parameters of the targets' walk.
        belief: process noise that the filter assumes.
        dt: time between steps [s].
        keep: number of last steps, 1 to T.
    """
    fresh = max(0.5 * motion.speed**2, MIN_VELOCITY_VARIANCE)
    position, spread = run_filter(
        np.ascontiguousarray(ways),
        np.ascontiguousarray(reports.information),
        np.ascontiguousarray(reports.noise),
        np.ascontiguousarray(start[0]),
        np.ascontiguousarray(start[1]),
        -math.expm1(-motion.turns * dt),
        step_noise(max(belief.sigma_v, motion.sigma), belief.sigma_a, fresh, dt),
        step_noise(motion.sigma, 0.0, fresh, dt),
        dt,
        keep,
    )
    return ExpectedPosteriors(position, spread[..., [[0, 1], [1, 2]]])


def step_noise(sigma: float, sigma_a: float, fresh: float, dt: float) -> StepNoise:
    """Process noise of a step without a turn.

    Args:
        sigma: random walk of the position, per axis [length/s^0.5].
        sigma_a: white acceleration, per axis [length/s^1.5].
        fresh: variance of each component of the velocity after a turn.
        dt: length of the step [s].
    """
    q = sigma_a**2
    return StepNoise(sigma**2 * dt + q * dt**3 / 3.0, q * dt**2 / 2.0, q * dt, fresh)


def square_error_in_room(covariance: Floats, at: Floats, floor: Floats, size: Floats) -> Floats:
    """Mean square errors (N,) of normal distributions truncated to the floor, never above the trace of the covariance.

    Computed by summation over cells of the floor; a normal narrower than a cell is unchanged.

    Args:
        covariance: (N, 2, 2) of positions, positive definite.
        at: (N, 2) their means.
        floor: (C, 2) centres of the cells of the floor.
        size: (2,) sides of a cell.
    """
    out = np.trace(covariance, axis1=1, axis2=2).copy()
    wide = np.flatnonzero(out > float(size @ size) / 4.0)
    grain = np.diag(size**2 / 12.0)  # so that a normal that is thin across the cells is not lost between them
    for rows in np.array_split(wide, max(1, len(wide) * len(floor) // BLOCK)):
        off = floor - at[rows, None]
        exponent = -0.5 * np.einsum("nci,nij,ncj->nc", off, np.linalg.inv(covariance[rows] + grain), off)
        weight = np.exp(exponent - exponent.max(axis=1, keepdims=True))
        weight /= weight.sum(axis=1, keepdims=True)
        mean = np.einsum("nc,nci->ni", weight, off)
        cut = np.einsum("nc,nci,nci->n", weight, off, off) - np.sum(mean**2, axis=1)
        out[rows] = np.minimum(out[rows], cut)
    return np.asarray(out)
