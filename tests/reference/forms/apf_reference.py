"""One step of the auxiliary particle filter, written plainly with vectorised NumPy and SciPy.

It shares no code with occlog and follows [Ercan] Sec. 4 line by line, with the
departures that `occlog.track.apf.filter` states.  Tests compare the fast filter with it;
the benchmark `track` takes it as the baseline.  Random numbers are handed in, so that
both can be given the same.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import occlusion_reference as occlusion
from scipy.special import logsumexp

MTD, CD, W = 0, 1, 2


@dataclass(frozen=True)
class RefCamera:
    xy: np.ndarray
    yaw: float
    focal: float
    fov: float
    reach: float
    sigma_position: float
    sigma_yaw: float


@dataclass(frozen=True)
class RefScene:
    room: np.ndarray
    occluders: list[np.ndarray]
    cameras: list[RefCamera]


@dataclass(frozen=True)
class RefConfig:
    reference_s: float = 1.0
    sigma_v: float = 0.33
    phi: float = 0.03
    beta1: float = 0.88
    lambda1: float = 0.1
    beta2: float = 0.05
    lambda2: float = 0.9
    defensive: float = 0.05
    hit: float = 1.0
    miss: float = 1.0
    false: float = 1e-4
    soften: float = 1e-2


@dataclass
class RefParticles:
    xy: np.ndarray
    destination: np.ndarray
    speed: np.ndarray
    regime: np.ndarray
    weights: np.ndarray


@dataclass
class Draws:
    """Random numbers of one step, in the order in which the filter uses them."""

    resample: float
    regime: np.ndarray
    noise: np.ndarray
    destinations: np.ndarray  # as many as there are particles that change theirs, at least
    used: int = field(default=0)


def inside(xy, polygon):
    """Even-odd rule."""
    x, y = xy[:, :1], xy[:, 1:]
    x1, y1 = polygon.T
    x2, y2 = np.roll(polygon, 1, axis=0).T
    with np.errstate(divide="ignore", invalid="ignore"):
        crosses = ((y1 > y) != (y2 > y)) & (x < (x2 - x1) * (y - y1) / (y2 - y1) + x1)
    return crosses.sum(axis=1) % 2 == 1


def blocked(origin, xy, polygon):
    """Whether the segment from the origin crosses an edge of the polygon."""
    a, b = polygon, np.roll(polygon, -1, axis=0)
    p, r = origin, (xy - origin)[:, None, :]
    s = (b - a)[None]
    cross = r[..., 0] * s[..., 1] - r[..., 1] * s[..., 0]
    q = (a - p)[None]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (q[..., 0] * s[..., 1] - q[..., 1] * s[..., 0]) / cross
        u = (q[..., 0] * r[..., 1] - q[..., 1] * r[..., 0]) / cross
    return np.any((t > 0) & (t < 1) & (u > 0) & (u < 1), axis=1) | inside(xy, polygon)


def on_floor(xy, scene):
    ok = inside(xy, scene.room)
    for polygon in scene.occluders:
        ok &= ~inside(xy, polygon)
    return ok


def log_likelihood(xy, z, sigma_read, scene, config, priors=None):
    """z: one value a camera, NaN where it does not see the target; absent cameras are not in `scene.cameras`.

    With priors (`occlusion_reference.RefPriors`) of the people who walk about, cameras count by
    the form of the priors: independent of each other, or by the recursion.
    """
    a, b, assigned = factors(xy, z, sigma_read, scene, config)
    with np.errstate(divide="ignore"):
        if priors is None:
            total = np.log(a).sum(axis=1)
        else:
            total = np.log(occlusion.among(xy, [c.xy for c in scene.cameras], a, b, assigned, priors))
    return np.where(on_floor(xy, scene), total, -np.inf)


def factors(xy, z, sigma_read, scene, config):
    """(L, N) factors of cameras that nobody hides, (N,) of those that somebody does, (L, N) which could be hidden.

    `hit`, `miss` and `false` of the config may be (N,).
    """
    N = len(scene.cameras)
    a, b, assigned = np.ones((len(xy), N)), np.ones(N), np.zeros((len(xy), N), dtype=bool)
    hit, miss, false = (np.broadcast_to(value, N) for value in (config.hit, config.miss, config.false))
    for i, camera in enumerate(scene.cameras):
        h, d = offsets(xy, camera)
        seen = (d > 0) & (np.abs(np.arctan2(h, d)) <= camera.fov / 2) & (np.hypot(h, d) <= camera.reach)
        for polygon in scene.occluders:
            seen &= ~blocked(camera.xy, xy, polygon)
        assigned[:, i] = seen
        if np.isnan(z[i]):
            a[:, i] = np.where(seen, miss[i], 1.0)
            continue
        normal = density(h, d, z[i], sigma_read[i], camera)
        b[i] = false[i] / (2 * camera.focal * np.tan(camera.fov / 2))
        a[:, i] = np.where(seen, hit[i] * normal + miss[i] * b[i], config.soften * hit[i] * normal + b[i])
    return a, b, assigned


def offsets(xy, camera):
    """h and d of Eq. 1."""
    theta = camera.yaw + np.pi
    dx, dy = xy[:, 0] - camera.xy[0], xy[:, 1] - camera.xy[1]
    return np.sin(theta) * dx - np.cos(theta) * dy, -np.cos(theta) * dx - np.sin(theta) * dy


def density(h, d, value, sigma, camera):
    """(L,) densities of a reading, with the variance of Eq. 2; 0 behind the camera."""
    front = d > 1e-9 * np.abs(h)
    h, d = np.where(front, h, 0.0), np.where(front, d, 1.0)
    variance = (
        camera.focal**2 * (1 + h**2 / d**2) ** 2 * camera.sigma_yaw**2
        + camera.focal**2 * (h**2 + d**2) / d**4 * camera.sigma_position**2
        + sigma**2
    )
    normal = np.exp(-0.5 * (value - camera.focal * h / d) ** 2 / variance) / np.sqrt(2 * np.pi * variance)
    return np.where(front, normal, 0.0)


def direction(particles):
    to = particles.destination - particles.xy
    distance = np.hypot(to[:, 0], to[:, 1])
    return to / np.where(distance > 0, distance, 1.0)[:, None], distance


def arrived(particles, scene, config):
    e, distance = direction(particles)
    reach = particles.speed * config.reference_s
    return (distance < reach) | (distance == 0) | ~on_floor(particles.xy + reach[:, None] * e, scene)


def expected(particles, there, dt, config):
    n = dt / config.reference_s
    e, _ = direction(particles)
    beta = np.where(there, config.beta2, config.beta1)
    going = n * beta + (1 - n) * (particles.regime != W)
    return particles.xy + (going * particles.speed * dt)[:, None] * e


def move(particles, there, dt, config, draws):
    n, T = dt / config.reference_s, config.reference_s
    towards = n * np.where(there, config.beta2, config.beta1)
    change = n * np.where(there, config.lambda2, config.lambda1)
    u = draws.regime
    kept = np.where(particles.regime == W, W, MTD)
    regime = np.where(u < towards, MTD, np.where(u < towards + change, CD, np.where(u < n, W, kept)))
    destination = particles.destination.copy()
    draws.used = int(np.sum(regime == CD))
    destination[regime == CD] = draws.destinations[: draws.used]
    new = RefParticles(particles.xy, destination, particles.speed, regime, particles.weights)
    e, _ = direction(new)
    v = config.sigma_v * np.sqrt(dt) * draws.noise
    s = particles.speed[:, None]
    moves = regime != W
    new.xy = np.where(moves[:, None], particles.xy + s * e * dt + v, particles.xy)
    step = s * T * e + v
    new.speed = np.where(moves, (1 - config.phi) * s[:, 0] + config.phi * np.hypot(step[:, 0], step[:, 1]) / T, s[:, 0])
    return new


def systematic(weights, u):
    points = (np.arange(len(weights)) + u) / len(weights)
    return np.minimum(np.searchsorted(np.cumsum(weights), points, side="right"), len(weights) - 1)


def step(particles, z, sigma_read, scene, config, dt, draws, priors=None):
    """Alg. 1 for a step up to the reference step; new particles with weights, and the scan's log-likelihood."""
    there = arrived(particles, scene, config)
    kappa = expected(particles, there, dt, config)
    log_first = np.log(particles.weights) + log_likelihood(kappa, z, sigma_read, scene, config, priors)
    first = particles.weights
    if np.isfinite(logsumexp(log_first)):
        first = np.exp(log_first - logsumexp(log_first))
    first = (1 - config.defensive) * first + config.defensive * particles.weights
    parents = systematic(first, draws.resample)
    ratio = particles.weights[parents] / first[parents] / len(parents)
    chosen = RefParticles(
        particles.xy[parents],
        particles.destination[parents],
        particles.speed[parents],
        particles.regime[parents],
        ratio,
    )
    moved = move(chosen, there[parents], dt, config, draws)
    log_weights = np.log(ratio) + log_likelihood(moved.xy, z, sigma_read, scene, config, priors)
    log_sum = logsumexp(log_weights)
    moved.weights = np.exp(log_weights - log_sum)
    return moved, float(log_sum)
