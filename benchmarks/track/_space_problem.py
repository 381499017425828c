"""The filter in space and that of one plane in two plain forms, vectorised NumPy and one loop in numba.

They draw the same numbers in the same order as occlog's, so that all three give the same estimates.
Arrays are upright, which spares them the rotations that ours does.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from occlog.array_types import Floats
from occlog.core.bounds.in_space import accelerated_path
from occlog.records.scene import MicrophoneArray, Scene
from occlog.scans.grouping import Scan

PLACES = np.array([[0.0, 0.0, 1.0], [8.0, 0.0, 2.5], [4.0, 6.0, 0.5]])
START = np.array([2.0, 1.0, 1.4, 0.6, 0.3, 0.05])
SPREAD = np.array([0.3, 0.3, 0.3, 0.1, 0.1, 0.1])
ACCELERATION = np.array([0.0, 0.05, 0.01])
SIGMA, STEP_S, DENSITY, SEED = math.radians(3.0), 0.1, 0.1, 5
RESAMPLE_BELOW = 0.5


class Recording(NamedTuple):
    """A target and what three arrays say of it."""

    truth: Floats  # (T, 6)
    theta: Floats  # (T, S)
    phi: Floats  # (T, S)
    start: Floats  # (6,) mean of the prior


def recording(steps: int) -> Recording:
    """A target that all arrays hear at every step."""
    rng = np.random.default_rng(SEED)
    dt = np.full(steps, STEP_S)
    dt[0] = 0.0
    truth = accelerated_path(START, np.tile(ACCELERATION, (steps, 1)), dt)
    to = truth[:, None, :3] - PLACES
    theta = np.arctan2(to[..., 1], to[..., 0]) + SIGMA * rng.standard_normal((steps, len(PLACES)))
    flat = np.hypot(to[..., 0], to[..., 1])
    phi = np.arctan2(flat, to[..., 2]) + SIGMA * rng.standard_normal((steps, len(PLACES)))
    return Recording(truth, theta, phi, START + SPREAD * rng.standard_normal(6))


def scene() -> Scene:
    """The arrays, in no room."""
    return Scene(arrays=tuple(MicrophoneArray(f"a{i}", p, sigma=SIGMA) for i, p in enumerate(PLACES)))


def scan_of(r: Recording, k: int) -> Scan:
    """Return the scan of step k."""
    n = len(PLACES)
    sigma = np.full(n, SIGMA)
    return Scan.of(
        round(k * STEP_S * 1e9),
        np.arange(n),
        target_id=np.zeros(n, dtype=np.int32),
        bearing=r.theta[k],
        sigma=sigma,
        elevation=0.5 * math.pi - r.phi[k],
        sigma_elevation=sigma,
    )


def noise_root(dt: float) -> Floats:
    """(2, 2) root of the noise of position and velocity of one axis."""
    s = math.sqrt(DENSITY * dt)
    return np.array([[s * dt / math.sqrt(3.0), 0.0], [s * math.sqrt(0.75), 0.5 * s]])


def both_signs(half: Floats) -> Floats:
    """Draws that serve two particles each."""
    return np.concatenate([half, -half], axis=1)


class Plain(NamedTuple):
    """Particles (2d, L) and their weights."""

    x: Floats
    w: Floats


def numpy_step(
    p: Plain, dt: float, a: Floats, angles: Floats, rng: np.random.Generator, h: float
) -> tuple[Plain, Floats]:
    """One step of the filter of 2d states; `angles` (S, 1) of a plane or (S, 2) in space."""
    d, L = len(p.x) // 2, p.x.shape[1]
    x = p.x
    if dt > 0.0:
        n, B = both_signs(rng.standard_normal((2 * d, L // 2))), noise_root(dt)
        position = x[:d] + dt * x[d:] + 0.5 * dt * dt * a[:, None] + B[0, 0] * n[:d]
        x = np.concatenate([position, x[d:] + dt * a[:, None] + B[1, 0] * n[:d] + B[1, 1] * n[d:]])
    log_w = np.log(p.w)
    for place, z in zip(PLACES[:, :d], angles, strict=True):
        to = x[:d] - place[:, None]
        off = (np.arctan2(to[1], to[0]) - z[0] + np.pi) % (2.0 * np.pi) - np.pi
        log_w = log_w - 0.5 * (off / SIGMA) ** 2
        if d == 3:
            up = np.arctan2(np.hypot(to[0], to[1]), to[2]) - z[1]
            log_w = log_w - 0.5 * (up / SIGMA) ** 2
    w = np.exp(log_w - log_w.max())
    w /= w.sum()
    mean = x @ w
    centred = x - mean[:, None]
    covariance = (centred * w) @ centred.T
    if 1.0 / np.dot(w, w) < RESAMPLE_BELOW * L:
        x = x[:, np.searchsorted(np.cumsum(w), (np.arange(L) + rng.random()) / L).clip(max=L - 1)]
        values, vectors = np.linalg.eigh(covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        c = math.sqrt(1.0 - h * h)
        x = c * x + (1.0 - c) * mean[:, None] + h * root @ both_signs(rng.standard_normal((2 * d, L // 2)))
        w = np.full(L, 1.0 / L)
    return Plain(x, w), mean


def numba_step(
    p: Plain, dt: float, a: Floats, angles: Floats, rng: np.random.Generator, h: float
) -> tuple[Plain, Floats]:
    """The same by loops over the particles."""
    d, L = len(p.x) // 2, p.x.shape[1]
    n = both_signs(rng.standard_normal((2 * d, L // 2))) if dt > 0.0 else np.zeros((2 * d, L))
    x, w, mean, covariance, size = _loop(p.x, p.w, dt, a, noise_root(dt), n, PLACES, angles, SIGMA)
    if size < RESAMPLE_BELOW * L:
        values, vectors = np.linalg.eigh(covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        u = rng.random()
        x = _draw(x, w, mean, h * root, math.sqrt(1.0 - h * h), u, both_signs(rng.standard_normal((2 * d, L // 2))))
        w = np.full(L, 1.0 / L)
    return Plain(x, w), mean


@numba.njit(cache=True)
def _loop(x0, w0, dt, a, B, n, places, angles, sigma):  # type: ignore[no-untyped-def]
    d, L = x0.shape[0] // 2, x0.shape[1]
    x, log_w = np.empty_like(x0), np.empty(L)
    top = -np.inf
    for i in range(L):
        for k in range(d):
            x[k, i] = x0[k, i] + dt * x0[d + k, i] + 0.5 * dt * dt * a[k] + B[0, 0] * n[k, i]
            x[d + k, i] = x0[d + k, i] + dt * a[k] + B[1, 0] * n[k, i] + B[1, 1] * n[d + k, i]
        value = math.log(w0[i])
        for s in range(places.shape[0]):
            u, v = x[0, i] - places[s, 0], x[1, i] - places[s, 1]
            off = (math.atan2(v, u) - angles[s, 0] + math.pi) % (2.0 * math.pi) - math.pi
            value -= 0.5 * (off / sigma) ** 2
            if d == 3:
                up = math.atan2(math.sqrt(u * u + v * v), x[2, i] - places[s, 2]) - angles[s, 1]
                value -= 0.5 * (up / sigma) ** 2
        log_w[i] = value
        top = max(top, value)
    w, total = np.empty(L), 0.0
    for i in range(L):
        w[i] = math.exp(log_w[i] - top)
        total += w[i]
    mean, covariance, square = np.zeros(2 * d), np.zeros((2 * d, 2 * d)), 0.0
    for i in range(L):
        w[i] /= total
        square += w[i] * w[i]
        for k in range(2 * d):
            mean[k] += w[i] * x[k, i]
    for i in range(L):
        for k in range(2 * d):
            for m in range(k + 1):
                covariance[k, m] += w[i] * (x[k, i] - mean[k]) * (x[m, i] - mean[m])
    for k in range(2 * d):
        for m in range(k):
            covariance[m, k] = covariance[k, m]
    return x, w, mean, covariance, 1.0 / square


@numba.njit(cache=True)
def _draw(x, w, mean, root, c, u, n):  # type: ignore[no-untyped-def]
    size, L = x.shape
    out = np.empty_like(x)
    j, total = 0, w[0]
    for i in range(L):
        while total <= (i + u) / L and j < L - 1:
            j += 1
            total += w[j]
        for k in range(size):
            value = c * x[k, j] + (1.0 - c) * mean[k]
            for m in range(size):
                value += root[k, m] * n[m, i]
            out[k, i] = value
    return out
