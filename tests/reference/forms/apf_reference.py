"""Steps of the auxiliary particle filter, written plainly with vectorised NumPy and SciPy.

It shares no code with occlog.  `step` follows [Ercan] Sec. 4 line by line, with the
departures that `occlog.track.methods.apf.filter` states; `scan_step` points at the scan first, as
`occlog.track.methods.apf.proposal` describes, with normal equations in place of rotations.  Tests
compare the fast filter with it; the benchmark `track` takes it as the baseline.  Random numbers are handed in, so that
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
    reference_step_s: float = 1.0
    process_noise_position: float = 0.33
    process_noise_velocity: float = 0.0
    process_noise_waiting: float = 0.0
    process_noise_creep: float = 0.0
    mean_wait_s: float = 0.0
    velocity_memory: float = 0.03
    change_time: str = "beginning"
    beta1: float = 0.88
    lambda1: float = 0.1
    beta2: float = 0.05
    lambda2: float = 0.9
    defensive_fraction: float = 0.05
    hit: float = 1.0
    miss: float = 1.0
    false_alarm_probability: float = 1e-4
    out_of_view_likelihood: float = 1e-2


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
    """(L, N) factors of cameras that no one hides, (N,) of those that somebody does, (L, N) which could be hidden.

    `hit`, `miss` and `false` of the config may be (N,).
    """
    N = len(scene.cameras)
    a, b, assigned = np.ones((len(xy), N)), np.ones(N), np.zeros((len(xy), N), dtype=bool)
    hit, miss, false = (
        np.broadcast_to(value, N) for value in (config.hit, config.miss, config.false_alarm_probability)
    )
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
        a[:, i] = np.where(
            seen, hit[i] * normal + miss[i] * b[i], config.out_of_view_likelihood * hit[i] * normal + b[i]
        )
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
    reach = particles.speed * config.reference_step_s
    return (distance < reach) | (distance == 0) | ~on_floor(particles.xy + reach[:, None] * e, scene)


def expected(particles, there, dt, config):
    n = dt / config.reference_step_s
    e, _ = direction(particles)
    beta = np.where(there, config.beta2, config.beta1)
    going = n * beta + (1 - n) * (particles.regime != W)
    return particles.xy + (going * particles.speed * dt)[:, None] * e


def move(particles, there, dt, config, draws):
    n, T = dt / config.reference_step_s, config.reference_step_s
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
    v = config.process_noise_position * np.sqrt(dt) * draws.noise
    s = particles.speed[:, None]
    moves = regime != W
    new.xy = np.where(moves[:, None], particles.xy + s * e * dt + v, particles.xy)
    step = s * T * e + v
    new.speed = np.where(
        moves,
        (1 - config.velocity_memory) * s[:, 0] + config.velocity_memory * np.hypot(step[:, 0], step[:, 1]) / T,
        s[:, 0],
    )
    return new


def systematic(weights, u, n=None):
    n = len(weights) if n is None else n
    points = (np.arange(n) + u) / n
    return np.minimum(np.searchsorted(np.cumsum(weights), points, side="right"), len(weights) - 1)


def step(particles, z, sigma_read, scene, config, dt, draws, priors=None):
    """Alg. 1 for a step up to the reference step; new particles with weights, and the scan's log-likelihood."""
    there = arrived(particles, scene, config)
    kappa = expected(particles, there, dt, config)
    log_first = np.log(particles.weights) + log_likelihood(kappa, z, sigma_read, scene, config, priors)
    first = particles.weights
    if np.isfinite(logsumexp(log_first)):
        first = np.exp(log_first - logsumexp(log_first))
    first = (1 - config.defensive_fraction) * first + config.defensive_fraction * particles.weights
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


@dataclass
class ScanDraws:
    """Random numbers of one step that points at the scan, in the order in which the filter uses them."""

    destinations: np.ndarray  # (L, 2)
    before: np.ndarray  # (L,) share of the step before a change of the destination
    resample: float
    which: np.ndarray  # (n,) uniform: defensive or not
    noise: np.ndarray  # (n, 2) of the place
    velocity: np.ndarray  # (n, 2) of the velocity given the place


@dataclass
class Approximation:
    """Gaussian approximations of n posteriors."""

    mode: np.ndarray  # (n, 2)
    covariance: np.ndarray  # (n, 2, 2)
    log_volume: np.ndarray  # (n,)
    log_factors: np.ndarray  # (n,)


def laplace(mean, p0, z, sigma_read, scene, config, most=8, anneal=1e-2, open_below=1e-2, settled_below=1e-2):
    """Modes and curvatures of N(x; mean, p0 I) times the factors of the cameras that report a value.

    Gauss-Newton on the expected log-posterior: a camera counts by the probability that its value is the
    target's, judged with a variance that begins with what the motion leaves open.
    """
    n, seeing = len(mean), np.flatnonzero(~np.isnan(z))
    x, information = mean.copy(), np.empty((n, 2, 2))
    share, last, done = np.ones(n), np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    for round_ in range(most):
        last |= round_ == most - 1
        A = np.eye(2) / p0[:, None, None]
        b = (mean - x) / p0[:, None]
        open_still = np.zeros(n, dtype=bool)
        for i in seeing:
            r, H, v = residual(x, z[i], sigma_read[i], scene.cameras[i])
            front = v > 0
            wide = share * p0 * (H**2).sum(axis=1)
            open_still |= front & (wide > open_below * v)
            normal = normal_density(r, np.where(front, v + wide, 1.0)) * front
            g = config.hit * normal / (config.hit * normal + rival(scene.cameras[i], config))
            g = np.where(last, g > 0.5, g) * (g >= 1e-6)
            scaled = np.where(front, g / np.where(front, v, 1.0), 0.0)
            A += scaled[:, None, None] * H[:, :, None] * H[:, None, :]
            b += (scaled * r)[:, None] * H
        step_ = np.linalg.solve(A, b[:, :, None])[:, :, 0]
        x = np.where(done[:, None], x, x + step_)
        information = np.where(done[:, None, None], information, A)
        done |= last
        if done.all():
            break
        last = ~open_still & ((b * step_).sum(axis=1) < settled_below)
        share = np.where(open_still, share * anneal, 0.0)
    log_volume = -np.log(p0) - 0.5 * np.log(np.linalg.det(information)) - 0.5 * ((x - mean) ** 2).sum(axis=1) / p0
    log_factors = np.zeros(n)
    for i in seeing:
        r, _, v = residual(x, z[i], sigma_read[i], scene.cameras[i])
        normal = normal_density(r, np.where(v > 0, v, 1.0)) * (v > 0)
        log_factors += np.log(config.hit * normal + rival(scene.cameras[i], config))
    return Approximation(x, np.linalg.inv(information), log_volume, log_factors)


def residual(xy, value, sigma, camera):
    """(n,) residuals of Eq. 1, (n, 2) derivatives of the reading by the place, (n,) variances of Eq. 2 (-1: behind)."""
    theta = camera.yaw + np.pi
    h, d = offsets(xy, camera)
    front = d > 1e-9 * np.abs(h)
    h, d = np.where(front, h, 0.0), np.where(front, d, 1.0)
    f = camera.focal
    by_h, by_d = f / d, -f * h / d**2
    H = np.column_stack([by_h * np.sin(theta) - by_d * np.cos(theta), -by_h * np.cos(theta) - by_d * np.sin(theta)])
    variance = (
        f**2 * (1 + h**2 / d**2) ** 2 * camera.sigma_yaw**2
        + f**2 * (h**2 + d**2) / d**4 * camera.sigma_position**2
        + sigma**2
    )
    return np.where(front, value - f * h / d, 0.0), H * front[:, None], np.where(front, variance, -1.0)


def normal_density(r, v):
    return np.exp(-0.5 * r**2 / v) / np.sqrt(2 * np.pi * v)


def rival(camera, config):
    """Density of a value that is not the target's."""
    return max(config.miss * config.false_alarm_probability / (2 * camera.focal * np.tan(camera.fov / 2)), 1e-30)


def collected(dt, config):
    """Variance of the place, gain of the velocity and variance left of it, after white noise of place and velocity."""
    place = config.process_noise_position**2 * dt + config.process_noise_velocity**2 * dt**3 / 3
    if config.process_noise_velocity == 0:
        return place, config.velocity_memory / config.reference_step_s, 0.0
    gain = config.process_noise_velocity**2 * dt**2 / 2 / place
    return place, gain, config.process_noise_velocity**2 * dt - gain**2 * place


def standing(dt, stood, config):
    """(n,) variances of the place, gains of the velocity and variances left of it, of targets that wait."""
    q = config.process_noise_creep**2
    place = config.process_noise_waiting**2 * dt + np.where(stood, q * dt**3 / 3, q * dt**2)
    both = np.where(stood, q * dt**2 / 2, q * dt)
    gain = both / np.where(both > 0, place, 1.0)
    return place, gain, np.where(stood, q * dt, q) - gain * both


def scan_step(particles, z, sigma_read, scene, config, dt, draws):
    """Alg. 1 with hypotheses and their approximations; new particles with weights, and the scan's log-likelihood."""
    L, n = len(particles.weights), len(draws.which)
    there = arrived(particles, scene, config)
    share = dt / config.reference_step_s
    towards = share * np.where(there, config.beta2, config.beta1)
    change = share * np.where(there, config.lambda2, config.lambda1)
    goes_on = np.where(particles.regime == W, W, MTD)
    chances = np.array([towards, change, share - towards - change])
    chances[goes_on, np.arange(L)] += 1 - share
    stood = (particles.regime == W) & (config.mean_wait_s > 0)
    if config.mean_wait_s > 0:
        leave = dt / config.mean_wait_s
        chances[:, stood] = np.array([0.0, leave, 1 - leave])[:, None]
    old, _ = direction(particles)
    new, _ = direction(RefParticles(particles.xy, draws.destinations, None, None, None))
    way = (particles.speed * dt)[:, None]
    creep = stood[:, None] * (particles.destination - particles.xy) / 10.0
    # A change is at the beginning of the step, or after a share of it
    share = draws.before[:, None] if config.change_time == "uniform" else 0.0
    held = share * np.where((particles.regime == W)[:, None], dt * creep, way * old) + (1 - share) * way * new
    mean = np.concatenate([particles.xy + way * old, particles.xy + held, particles.xy + dt * creep])
    place, _gain, _left = collected(dt, config)
    p0 = np.maximum(np.concatenate([np.full(2 * L, place), standing(dt, stood, config)[0]]), 1e-18)
    prior = (chances * particles.weights).ravel()
    near = laplace(mean, p0, z, sigma_read, scene, config)
    with np.errstate(divide="ignore"):
        log_first = (np.log(prior) + near.log_volume + near.log_factors).reshape(3, L)
    best = np.argmax(log_first, axis=0) * L + np.arange(L)
    a, _, _ = factors(near.mode[best], z, sigma_read, scene, config)
    log_first += np.log(a).sum(axis=1) - near.log_factors[best]
    first = np.exp(log_first - logsumexp(log_first)).ravel()
    first = (1 - config.defensive_fraction) * first + config.defensive_fraction * prior
    if np.isnan(z).all():  # no one sees the target: a fifth goes to all that is possible alike
        possible = chances > 0
        first = 0.8 * first + 0.2 * (possible * particles.weights / possible.sum(axis=0)).ravel()
    chosen = systematic(first, draws.resample, n)
    parents, regime = chosen % L, chosen // L
    # An upper triangular root of the covariance, as the filter's: the same noise makes the same place
    P = near.covariance[chosen]
    r2 = np.sqrt(P[:, 1, 1])
    r1 = P[:, 0, 1] / r2
    r0 = np.sqrt(P[:, 0, 0] - r1**2)
    step_ = np.column_stack([r0 * draws.noise[:, 0] + r1 * draws.noise[:, 1], r2 * draws.noise[:, 1]])
    blunt = np.sqrt(p0[chosen])[:, None] * draws.noise
    xy = np.where((draws.which < config.defensive_fraction)[:, None], mean[chosen] + blunt, near.mode[chosen] + step_)
    log_prior = -0.5 * ((xy - mean[chosen]) ** 2).sum(axis=1) / p0[chosen] - np.log(p0[chosen])
    away = xy - near.mode[chosen]
    square = (away * np.linalg.solve(P, away[:, :, None])[:, :, 0]).sum(axis=1)
    with np.errstate(divide="ignore"):
        log_q = np.logaddexp(
            np.log1p(-config.defensive_fraction) - 0.5 * square - np.log(r0 * r2),
            np.log(config.defensive_fraction) + log_prior,
        )
        log_weights = log_prior - log_q + np.log(prior[chosen]) - np.log(first[chosen] * n)
    moved = come(particles, parents, regime, draws, mean[chosen], xy, dt, config)
    log_weights += log_likelihood(xy, z, sigma_read, scene, config)
    log_sum = logsumexp(log_weights)
    moved.weights = np.exp(log_weights - log_sum)
    return moved, float(log_sum)


def come(particles, parents, regime, draws, mean, xy, dt, config):
    """Particles that have come to given places: destinations, and speeds (Eq. 5, or by white acceleration)."""
    _, gain, left = collected(dt, config)
    T, phi = config.reference_step_s, config.velocity_memory
    destination = np.where((regime == CD)[:, None], draws.destinations[parents], particles.destination[parents])
    e, _ = direction(RefParticles(particles.xy[parents], destination, None, None, None))
    s, v, moves = particles.speed[parents], xy - mean, regime != W
    step_ = s[:, None] * T * e + v
    speed = np.where(moves, (1 - phi) * s + phi * np.hypot(step_[:, 0], step_[:, 1]) / T, s)
    if config.process_noise_velocity > 0:
        velocity = speed[:, None] * e + gain * v + np.sqrt(left) * draws.velocity
        turned = np.hypot(velocity[:, 0], velocity[:, 1])
        away = destination - xy
        ahead = xy + np.hypot(away[:, 0], away[:, 1])[:, None] * velocity / turned[:, None]
        speed = np.where(moves, turned, speed)
        destination = np.where(moves[:, None], ahead, destination)
    if config.mean_wait_s > 0:
        stood = particles.regime[parents] == W
        _, pull, rest = standing(dt, stood, config)
        creep = stood[:, None] * (particles.destination[parents] - particles.xy[parents]) / 10.0
        creep = creep + pull[:, None] * v + np.sqrt(rest)[:, None] * draws.velocity
        destination = np.where(moves[:, None], destination, xy + 10.0 * creep)
    return RefParticles(xy, destination, speed, regime, None)
