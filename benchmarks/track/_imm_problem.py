"""The filter of several motion models in two plain forms, and a recording for them and for Stone Soup."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np

from occlog.array_types import Floats

SEED, STEPS, PARTICLES, STEP_S = 7, 100, 5000, 0.2
ALPHA, SIGMA_V, SIGMA = 0.3, 0.2, math.radians(2.0)
PLACE = np.array([0.0, 0.0])
START, SPREAD = np.array([8.0, -0.5, 6.0, 0.3]), np.array([0.5, 0.1, 0.5, 0.1])
OTHERS = np.array([[-6.0, 7.0], [-5.0, -8.0]])
"""Two more sources, which stand still; their bearings have no labels either."""


class Recording(NamedTuple):
    """A target's way and what one array hears of it and of the others, unlabelled."""

    truth: Floats  # (T, 2)
    angle: Floats  # (T, 3) [rad], rising
    own: Floats  # (T,) the target's


def recording() -> Recording:
    """The target goes round in a circle of radius 1."""
    rng = np.random.default_rng(SEED)
    truth, angle, own = [], [], []
    for k in range(STEPS):
        turn = 0.06 * k * STEP_S
        xy = START[::2] + np.array([math.sin(turn), 1.0 - math.cos(turn)])
        positions = np.vstack([xy, OTHERS])
        heard = np.arctan2(positions[:, 1], positions[:, 0]) + SIGMA * rng.standard_normal(3)
        truth.append(xy)
        angle.append(np.sort(heard))
        own.append(heard[0])
    return Recording(np.array(truth), np.array(angle), np.array(own))


def root(dt: float) -> Floats:
    """Noise of a step; see `occlog.filtering.motion.coordinated_turn.acceleration_root`."""
    s = math.sqrt(SIGMA_V**2 * dt)
    return np.array([[s * dt / math.sqrt(3.0), 0.0], [s * math.sqrt(0.75), 0.5 * s]])


def numpy_step(states: Floats, dt: float, angle: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """[Lee] Eqs. 3.3-3.6 with whole arrays: states (L, 4) after a step, and the mean (4,)."""
    L, normals, B = len(states), rng.standard_normal((3, len(states), 4)), root(dt)
    x, vx, y, vy = states.T
    rate = np.array([0.0, -ALPHA, ALPHA])[:, None] / np.maximum(np.hypot(vx, vy), 1e-300)
    a = rate * dt
    small = np.abs(a) < 1e-8
    safe = np.where(small, 1.0, a)
    along, aside = np.where(small, 1.0, np.sin(safe) / safe), np.where(small, 0.0, (1.0 - np.cos(safe)) / safe)
    c, s = np.cos(a), np.sin(a)
    predicted = np.stack(
        [x + dt * (along * vx - aside * vy), c * vx - s * vy, y + dt * (aside * vx + along * vy), s * vx + c * vy], -1
    )
    predicted[..., :2] += normals[..., :2] @ B.T
    predicted[..., 2:] += normals[..., 2:] @ B.T
    at = np.arctan2(predicted[..., 2] - PLACE[1], predicted[..., 0] - PLACE[0])
    off = (angle[:, None, None] - at + math.pi) % (2.0 * math.pi) - math.pi
    w = np.exp(-0.5 * (off / SIGMA) ** 2).sum(axis=0)
    w /= w.sum()
    mean = np.einsum("ml,mla->a", w, predicted)
    off4 = (predicted - mean).reshape(-1, 4)
    _covariance = (w.reshape(-1, 1) * off4).T @ off4
    flat = np.searchsorted(np.cumsum(w.ravel()), (np.arange(L) + rng.random()) / L)
    return predicted.reshape(-1, 4)[np.minimum(flat, 3 * L - 1)], mean


def numba_step(states: Floats, dt: float, angle: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """The same as a loop over particles; normals are drawn by NumPy, which is faster than drawing them in the loop."""
    return _loop(states, dt, angle, root(dt), rng.standard_normal((3, len(states), 4)), rng.random())  # type: ignore[no-any-return]


@numba.njit(cache=True)
def _loop(states: Floats, dt: float, angle: Floats, B: Floats, normals: Floats, u: float) -> Any:
    L = states.shape[0]
    predicted, w = np.empty((3, L, 4)), np.empty((3, L))
    total = 0.0
    for m in range(3):
        alpha = (0.0, -ALPHA, ALPHA)[m]
        for k in range(L):
            x, vx, y, vy = states[k]
            a = alpha / max(math.hypot(vx, vy), 1e-300) * dt
            along, aside = (1.0, 0.0) if abs(a) < 1e-8 else (math.sin(a) / a, (1.0 - math.cos(a)) / a)
            c, s, n = math.cos(a), math.sin(a), normals[m, k]
            px = x + dt * (along * vx - aside * vy) + B[0, 0] * n[0] + B[0, 1] * n[1]
            py = y + dt * (aside * vx + along * vy) + B[0, 0] * n[2] + B[0, 1] * n[3]
            predicted[m, k, 0], predicted[m, k, 2] = px, py
            predicted[m, k, 1] = c * vx - s * vy + B[1, 0] * n[0] + B[1, 1] * n[1]
            predicted[m, k, 3] = s * vx + c * vy + B[1, 0] * n[2] + B[1, 1] * n[3]
            at, weight = math.atan2(py - PLACE[1], px - PLACE[0]), 0.0
            for i in range(angle.shape[0]):
                off = abs(angle[i] - at)
                off = min(off, 2.0 * math.pi - off) / SIGMA
                weight += math.exp(-0.5 * off * off)
            w[m, k] = weight
            total += weight
    mean, covariance = np.zeros(4), np.zeros((4, 4))
    for m in range(3):
        for k in range(L):
            w[m, k] /= total
            for a in range(4):
                mean[a] += w[m, k] * predicted[m, k, a]
    for m in range(3):
        for k in range(L):
            for a in range(4):
                for b in range(4):
                    covariance[a, b] += w[m, k] * (predicted[m, k, a] - mean[a]) * (predicted[m, k, b] - mean[b])
    out, at_row, cumulated = np.empty((L, 4)), 0, w[0, 0]
    for k in range(L):
        while cumulated < (k + u) / L and at_row < 3 * L - 1:
            at_row += 1
            cumulated += w[at_row // L, at_row % L]
        out[k] = predicted[at_row // L, at_row % L]
    return out, mean
