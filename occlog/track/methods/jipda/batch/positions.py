"""Fixed-interval smoother of each track, with the time-correlated position error that all cameras share.

Given the boxes of each track, its motion state s (6,) and the common error b (2,), a first-order Gauss-Markov process,
are smoothed together (Rauch, Tung and Striebel 1965). Boxes observe the position x + e + b, with e the gait
displacement of the body, independent at each time step. The reported position is x + e.
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats

from ..interface import STATE_SIZE
from ..target_set import BODY, CONSTANT_VELOCITY, ERROR, FULL_SIZE, without_gait_variance
from .gaussian_messages import noise_of_walk
from .mcmc_association import NO_NODE
from .states import States
from .tracks import ChainTracks, WindowSpan

DIFFUSE_SIGMA_M = 100.0
"""Prior standard deviation of the position of a track [m]."""


def smoothed_positions(
    walk: States,
    tracks: ChainTracks,
    span: WindowSpan,
    own: Floats,
    square: float,
    common: tuple[float, float],
    wide: float,
) -> tuple[Floats, Floats]:
    """Return smoothed states of people with their gait displacement: means (K, 6) and covariances (K, 6, 6).

    Args:
        walk: K rows of tracks at time steps, in the order of time steps.
        tracks: n nodes of the tracks, with their measurement factors.
        span: the time steps.
        own: (n,) gait variance of each node's position about the smooth track, per axis.
        square: gait variance where a track has no node.
        common: variance per axis and correlation time [s] of the position error common to all cameras.
        wide: inflation factor of the variances of smooth tracks, at least 1.
    """
    has = walk.node != NO_NODE
    spread = np.full(len(walk.track), square)
    spread[has] = own[walk.node[has]]
    J, h = np.zeros((len(spread), STATE_SIZE, STATE_SIZE)), np.zeros((len(spread), STATE_SIZE))
    J[has], h[has] = tracks.J[walk.node[has]], tracks.h[walk.node[has]]
    mean, covariance = _smoothed(walk, tracks, span, *without_gait_variance(J, h, spread), common)
    covariance *= wide
    # Displacement about the walk, given the state: e = a - B s + N(0, C)
    C = np.linalg.inv(J[:, :2, :2] + np.eye(2) / spread[:, None, None])
    out = np.repeat(np.eye(STATE_SIZE, FULL_SIZE)[None], len(spread), axis=0)
    out[:, :2] -= C @ J[:, :2] @ BODY
    mean = np.einsum("kij,kj->ki", out, mean)
    mean[:, :2] += np.einsum("kij,kj->ki", C, h[:, :2])
    covariance = out @ covariance @ out.swapaxes(1, 2)
    covariance[:, :2, :2] += C
    return mean, 0.5 * (covariance + covariance.swapaxes(1, 2))


def _smoothed(
    walk: States, tracks: ChainTracks, span: WindowSpan, J: Floats, h: Floats, common: tuple[float, float]
) -> tuple[Floats, Floats]:
    """Rauch-Tung-Striebel smoother of the state with the common position error: means (K, 8), covariances (K, 8, 8).

    The first six entries are x, y, vx, vy, height, width, the last two the error in x and y.

    Args:
        walk: K rows of tracks at time steps, in the order of time steps.
        tracks: nodes of the tracks, with their motion models.
        span: the time steps.
        J: (K, 6, 6) information matrix of the boxes of each row; 0 without boxes.
        h: (K, 6) information vector of these boxes.
        common: variance per axis and correlation time [s] of the common error.
    """
    K = len(walk.track)
    bounds = np.searchsorted(walk.step, np.arange(len(span.time) + 1))
    information, vector = BODY.T @ J @ BODY, h @ BODY
    mean, covariance = np.zeros((K, FULL_SIZE)), np.zeros((K, FULL_SIZE, FULL_SIZE))
    predicted, spread, F = np.zeros_like(mean), np.zeros_like(covariance), np.zeros_like(covariance)
    before = np.full(K, NO_NODE)
    last = np.full(int(walk.track.max(initial=-1)) + 1, NO_NODE)
    first_mean, first_covariance = _prior(tracks, span, common)
    for t in range(len(span.time)):
        rows = np.arange(bounds[t], bounds[t + 1])
        if not len(rows):
            continue
        before[rows] = last[walk.track[rows]]
        last[walk.track[rows]] = rows
        new, old = rows[before[rows] == NO_NODE], rows[before[rows] != NO_NODE]
        predicted[new], spread[new] = first_mean, first_covariance
        predicted[new, :2] = tracks.nodes.at[walk.head[new]]
        if len(old):
            ahead = before[old]
            node = walk.last[old]
            model = np.where(node != NO_NODE, tracks.chain.model[node], CONSTANT_VELOCITY)
            dt = span.time[t] - span.time[walk.step[ahead]]
            kinds, kind = np.unique(np.column_stack([dt, model]), axis=0, return_inverse=True)
            steps = [_transition(float(dt), tracks.walk.drift[int(model)], common) for dt, model in kinds]
            kind = kind.reshape(-1)
            F[old], Q = np.stack([s[0] for s in steps])[kind], np.stack([s[1] for s in steps])[kind]
            predicted[old] = np.einsum("kij,kj->ki", F[old], mean[ahead])
            spread[old] = F[old] @ covariance[ahead] @ F[old].swapaxes(1, 2) + Q
        prior = np.linalg.inv(spread[rows])
        P = np.linalg.inv(prior + information[rows])
        mean[rows] = np.einsum("kij,kj->ki", P, np.einsum("kij,kj->ki", prior, predicted[rows]) + vector[rows])
        covariance[rows] = 0.5 * (P + P.swapaxes(1, 2))
    for t in range(len(span.time) - 1, -1, -1):
        rows = np.arange(bounds[t], bounds[t + 1])
        rows = rows[before[rows] != NO_NODE]
        if not len(rows):
            continue
        ahead = before[rows]
        gain = covariance[ahead] @ F[rows].swapaxes(1, 2) @ np.linalg.inv(spread[rows])
        mean[ahead] += np.einsum("kij,kj->ki", gain, mean[rows] - predicted[rows])
        P = covariance[ahead] + gain @ (covariance[rows] - spread[rows]) @ gain.swapaxes(1, 2)
        covariance[ahead] = 0.5 * (P + P.swapaxes(1, 2))
    return mean, covariance


def _prior(tracks: ChainTracks, span: WindowSpan, common: tuple[float, float]) -> tuple[Floats, Floats]:
    """Return the prior mean (8,) and covariance (8, 8) of a new track: a person's state, and the common error.

    The mean position is 0, with the standard deviation `DIFFUSE_SIGMA_M`; velocity and body size are those of the
    tracks' motion model. `common` is the variance per axis and the correlation time [s] of the position error in x and
    y.
    """
    mean, variance = np.zeros(FULL_SIZE), np.empty(FULL_SIZE)
    mean[2:STATE_SIZE] = tracks.walk.mean[2:]
    variance[:2], variance[2:STATE_SIZE] = (DIFFUSE_SIGMA_M * span.metre) ** 2, 1.0 / tracks.walk.prior[2:]
    variance[list(ERROR)] = common[0]
    return mean, np.diag(variance)


def _transition(dt: float, drift: Floats, common: tuple[float, float]) -> tuple[Floats, Floats]:
    """Return the transition matrix F and process noise Q, both (8, 8), of a step of `dt` [s].

    The state is x, y, vx, vy, height, width and the common position error in x and y. `drift` (3,) are the densities of
    acceleration, height and width noise, `common` the error's variance per axis and correlation time [s].
    """
    F, Q = np.eye(FULL_SIZE), np.zeros((FULL_SIZE, FULL_SIZE))
    F[0, 2] = F[1, 3] = dt
    noise_of_walk(dt, drift, Q[:STATE_SIZE, :STATE_SIZE])
    square, time = common
    rho = math.exp(-dt / time)
    for e in ERROR:
        F[e, e], Q[e, e] = rho, square * (1.0 - rho * rho)
    return F, Q
