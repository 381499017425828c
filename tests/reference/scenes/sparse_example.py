"""The synthetic example of [Rahimi] Sec. 6: cameras around a square room whose views hardly meet, reflected walks."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d
from trajectory_reference import make_steps

from occlog.track.methods.map.kernels.gauss_markov import GaussMarkov, constant_velocity
from occlog.track.methods.map.kernels.problem import BearingLinesByStep, HalfPlanes, TrajectoryProblem

SIDE, HALF_VIEW, RANGE, SPEED, STEP_S, SIGMA = 5.0, np.radians(20.0), 3.5, 0.5, 0.5, 0.01
CAMERAS = [(-5, -5, 45), (0, -5, 90), (5, -5, 135), (5, 0, 180), (5, 5, 225), (0, 5, 270), (-5, 5, 315), (-5, 0, 0)]
WALKER = constant_velocity(0.06, 1e-3, STEP_S)


def walk(T: int, rng):
    """(T, 2) straight on at constant speed, reflected by the walls, then smoothed."""
    at, angle = rng.uniform(-4.5, 4.5, 2), rng.uniform(0.0, 2.0 * np.pi)
    way = at + np.arange(T)[:, None] * SPEED * STEP_S * np.array([np.cos(angle), np.sin(angle)])
    period = 4.0 * SIDE
    folded = SIDE - np.abs((way + SIDE) % period - 2.0 * SIDE)  # a wave between the walls
    return gaussian_filter1d(folded, 2.5, axis=0, mode="nearest")


def views(place, axis, xy, noise):
    """Which of (T, 2) places a camera sees, and f h / d with f = 1 there."""
    away = xy - place
    d, h = away @ axis, away @ np.array([-axis[1], axis[0]])
    seen = (d > 0) & (np.abs(np.arctan2(h, d)) < HALF_VIEW) & (np.hypot(d, h) < RANGE)
    return seen, (h / np.where(d == 0, 1.0, d) + noise)[seen]


def example(seed: int, T: int = 200, model: GaussMarkov = WALKER, near: float = 1e-3):
    """Problem, start and true positions (T, 2)."""
    rng = np.random.default_rng(seed)
    xy = walk(T, rng)
    rows = []
    for x, y, yaw in CAMERAS:
        place, axis = np.array([x, y], float), np.array([np.cos(np.radians(yaw)), np.sin(np.radians(yaw))])
        seen, z = views(place, axis, xy, SIGMA * rng.standard_normal(T))
        rows += [(t, *place, *axis, z_t) for t, z_t in zip(np.flatnonzero(seen), z, strict=True)]
    table = np.array(sorted(rows)).reshape(-1, 6)
    n, place, axis = len(table), table[:, 1:3].copy(), table[:, 3:5].copy()
    lines = BearingLinesByStep(
        table[:, 0].astype(np.int64),
        place,
        axis,
        np.ones(n),
        table[:, 5].copy(),
        np.full(n, SIGMA**2),
        np.zeros(n),
        np.zeros(n, np.bool_),
        np.zeros(n),
        np.zeros(n),
    )
    planes = HalfPlanes(lines.step, axis, np.einsum("ni,ni->n", axis, place) + near)
    steps = make_steps(model, np.arange(T) * STEP_S, np.zeros(4), np.diag([25.0, 1.0, 25.0, 1.0]))
    X = np.zeros((T, 4))
    X[lines.step, ::2] = place + axis  # one metre along the axis
    return TrajectoryProblem(steps, lines, planes, 0, 1.0), X, xy
