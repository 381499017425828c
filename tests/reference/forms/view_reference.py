"""One frame of `bmct` in plain NumPy, written from [Qu] Alg. 1 and the project's notes alone.

Trackers are rows of arrays, as in `occlog.track.methods.images.methods.state.ImageTrackers`; all random numbers are
given.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

Array = np.ndarray


class RefFrame(NamedTuple):
    """What a frame makes of the trackers."""

    particles: Array
    weights: Array
    estimate: Array
    helped: Array
    touching: Array
    velocity: Array
    path: Array
    resampled: Array


def bins_of(image: Array) -> Array:
    """Bin numbers by the formulas of OpenCV's HSV, all in whole numbers."""
    b, g, r = (image[..., k].astype(np.int64) for k in range(3))
    high, low = image.max(axis=2).astype(np.int64), image.min(axis=2).astype(np.int64)
    spread = high - low
    part = np.select(
        [high == r, high == g], [(g - b) % np.maximum(6 * spread, 1), 2 * spread + b - r], 4 * spread + r - g
    )
    hue = np.minimum(4 * part // np.maximum(3 * spread, 1), 7)
    saturation = np.minimum(8 * spread // np.maximum(high, 1), 7)
    grey = (10 * spread <= high) | (5 * high <= 255)
    return np.where(grey, 64 + high * 8 // 256, 8 * hue + saturation).astype(np.uint8)


def ellipse_distance(ellipses: Array, x: Array, y: Array) -> Array:
    """(N, K) squared distances, 1 on the ellipse, of points (K,) from ellipses (N, 5)."""
    cx, cy, a, b, rho = (ellipses[:, k : k + 1] for k in range(5))
    dx, dy, c, s = x - cx, y - cy, np.cos(rho), np.sin(rho)
    return ((c * dx + s * dy) / a) ** 2 + ((c * dy - s * dx) / b) ** 2


def likeness_of(bins: Array, ellipses: Array, model: Array, step: int) -> Array:
    """(N,) Bhattacharyya coefficients of kernel histograms on the grid of pixels that count."""
    reach = ellipses[:, 2:4].max()
    low = np.floor((ellipses[:, :2].min(axis=0) - reach) / step).astype(int)
    high = np.ceil((ellipses[:, :2].max(axis=0) + reach) / step).astype(int)
    x, y = (
        g.ravel() for g in np.meshgrid(step * np.arange(low[0], high[0] + 1), step * np.arange(low[1], high[1] + 1))
    )
    weight = np.maximum(1.0 - ellipse_distance(ellipses, x, y), 0.0)
    mass = weight.sum(axis=1)
    on = (x >= 0) & (y >= 0) & (x < bins.shape[1]) & (y < bins.shape[0])
    number = len(model) * np.arange(len(ellipses))[:, None] + bins[y[on], x[on]]
    sums = np.bincount(number.ravel(), weight[:, on].ravel(), len(model) * len(ellipses)).reshape(len(ellipses), -1)
    return np.minimum(np.sqrt(sums * model).sum(axis=1) / np.sqrt(np.where(mass > 0, mass, np.inf)), 1.0)


def mean_of(particles: Array, weights: Array) -> Array:
    """Mean ellipse, the angle as half of that of the mean of exp(2 i rho)."""
    angle = 0.5 * np.angle((weights * np.exp(2j * particles[:, 4])).sum())
    return np.append(weights @ particles[:, :4], np.mod(angle + np.pi / 2, np.pi) - np.pi / 2)


def weights_of(log_weights: Array) -> Array:
    w = np.exp(log_weights - log_weights.max())
    return w / w.sum()


def reach(e: Array, theta: Array | float) -> Any:
    """Associations radius of ellipses (..., 5)."""
    return np.hypot(e[..., 2] * np.cos(theta - e[..., 4]), e[..., 3] * np.sin(theta - e[..., 4]))


def ratios(estimate: Array, view: Array) -> Array:
    """(n, n) distances over the sum of radii; inf between views and on the diagonal."""
    d = estimate[None, :, :2] - estimate[:, None, :2]
    theta = np.arctan2(d[..., 1], d[..., 0])
    out = np.hypot(d[..., 0], d[..., 1]) / (reach(estimate[:, None], theta) + reach(estimate[None], theta))
    return np.where((view[:, None] == view[None]) & ~np.eye(len(view), dtype=bool), out, np.inf)


def inertia(particles: Array, previous: Array, before: Array, c: Any) -> Array:
    """Weight gained by moving as before."""
    v = particles[:, :2] - previous
    speed, usual = np.linalg.norm(v, axis=1), np.linalg.norm(before)
    turn = np.abs((np.arctan2(v[:, 1], v[:, 0]) - np.arctan2(before[1], before[0]) + np.pi) % (2 * np.pi) - np.pi)
    turn = np.where(np.minimum(speed, usual) > 0.5, turn, 0.0)
    return 1 + c.inertia * np.exp(-((turn / c.inertia_angle) ** 2)) * np.exp(
        -(((speed - usual) / c.inertia_speed) ** 2)
    )


def repulsion(particles: Array, i: int, estimate: Array, touching: Array, c: Any) -> Array:
    """[Qu] Eq. 8, multiplied over the neighbours."""
    out = np.ones(len(particles))
    for j in np.flatnonzero(touching[i]):
        theta = np.arctan2(*(estimate[j, 1::-1] - estimate[i, 1::-1]))
        sigma = c.repulsion * (reach(estimate[i], theta) + reach(estimate[j], theta)) / 2
        l2 = ((particles[:, :2] - estimate[j, :2]) ** 2).sum(axis=1)
        out *= 1 - np.exp(-l2 / sigma**2) / c.alpha
    return out


def band(particles: Array, line: Array, mine: Array, c: Any) -> Array:
    """[Qu] Eq. 5 without its constant."""
    line = line / np.hypot(line[0], line[1])
    d = particles[:, :2] @ line[:2] + line[2]
    return np.exp(-(d**2) / (2 * (c.epipolar_band * reach(mine, np.arctan2(line[1], line[0]))) ** 2))


def moved(t: Any, c: Any, normals: Array) -> Array:
    """Particles of the next frame."""
    out = t.particles.copy()
    out[..., :2] += t.velocity[:, None] + c.sigma_px * normals[..., :2]
    first, rho = t.axes[:, None, :2], t.axes[:, None, 2]
    out[..., 2:4] = first + c.keep_axes * (out[..., 2:4] - first) + c.sigma_axes_px * normals[..., 2:4]
    out[..., 2:4] = np.clip(out[..., 2:4], (1 - c.axes_limit) * first, (1 + c.axes_limit) * first)
    turn = np.mod(out[..., 4] - rho + np.pi / 2, np.pi) - np.pi / 2
    out[..., 4] = rho + c.keep_rho * turn + c.sigma_rho * normals[..., 4]
    out[..., 4] = np.mod(out[..., 4] + np.pi / 2, np.pi) - np.pi / 2
    return out


def helping(t: Any, i: int, ready: Array, ratio: Array, c: Any) -> list[int]:
    """Counterparts that help a tracker: good, ready and clear; those alone in their view before others."""
    nearest = ratio.min(axis=1)
    found = [j for v, j in enumerate(t.counterpart[i]) if j >= 0 and t.good[i, v] and ready[j]]
    alone = [j for j in found if nearest[j] > c.collaboration_distance]
    return [j for j in alone or found if nearest[j] >= min(c.clear_distance, nearest[i])]


def frame(t: Any, c: Any, fundamental: Array, bins: list[Array], normals: Array, order: Array, u: Array) -> RefFrame:
    """A frame in which all views have an image.

    Args:
        t: the trackers before it.
        c: settings of bmct, `anchor` the centre.
        fundamental: (V, V, 3, 3).
        bins: of each view's image.
        normals: (n, N, 5).
        order: (V,) in which views are worked out.
        u: (n,) for resampling.
    """
    x, n = moved(t, c, normals), len(t.view)
    similar = [likeness_of(bins[t.view[i]], x[i], t.colours[i, :72], c.pixel_step) for i in range(n)]
    log_local = [(a - 1) / (2 * c.sigma_colour**2) for a in similar]
    ratio = ratios(np.array([mean_of(x[i], weights_of(log_local[i])) for i in range(n)]), t.view)
    touching, busy = ratio <= c.interaction_distance, (ratio <= c.collaboration_distance).any(axis=1)
    usual = t.path.mean(axis=1)
    own = [
        log_local[i] + (np.log(inertia(x[i], t.estimate[i, :2], usual[i], c)) if touching[i].any() else 0.0)
        for i in range(n)
    ]
    weights = np.array([weights_of(log_w) for log_w in own])
    estimate = np.array([mean_of(x[i], weights[i]) for i in range(n)])
    ready, helped = ~busy, np.zeros((n, len(bins)), dtype=bool)
    for v in np.tile(order, c.sweeps):
        rows = np.flatnonzero(busy & (t.view == v))
        for i in rows:
            helped[i], w = False, weights_of(own[i])
            for j in helping(t, i, ready, ratio, c):
                line = fundamental[t.view[j], v] @ np.append(estimate[j, :2], 1.0)
                helped[i, t.view[j]], w = True, w * band(x[i], line, estimate[i], c)
            weights[i] = w / w.sum()
        for i in rows:
            estimate[i] = mean_of(x[i], weights[i])
        base = weights.copy()
        for _ in range(c.iterations):
            before = estimate.copy()
            for i in rows:
                w = base[i] * repulsion(x[i], i, before, touching, c)
                weights[i] = w / w.sum()
                estimate[i] = mean_of(x[i], weights[i])
        ready[rows] = True
    step = estimate[:, :2] - t.estimate[:, :2]
    share = np.where(touching.any(axis=1), c.frozen, 1.0)[:, None]
    path = np.concatenate([t.path[:, 1:], (usual + share * (step - usual))[:, None]], axis=1)
    again = np.array(
        [x[i][np.searchsorted(np.cumsum(weights[i]), (np.arange(x.shape[1]) + u[i]) / x.shape[1])] for i in range(n)]
    )
    return RefFrame(
        x, weights, estimate, helped, touching, c.keep_velocity * t.velocity + (1 - c.keep_velocity) * step, path, again
    )
