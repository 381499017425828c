"""How people walk along their true paths: where they face and where they are in their gait."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from occlog.array_types import Floats
from occlog.core.numerics.time_grid import Grid

from .body import FULL_SWING, Poses

STRIDE = 1.45
"""Way of two steps [m]."""
WALKING = 1.2
"""Speed at which the legs swing fully [m/s]."""
LAG_S = 0.35
"""Time constant with which a body turns and changes its gait."""


def walking(grids: Iterable[Grid], metre: float) -> Iterator[Grid]:
    """The grids with, instead of z, columns vx, vy (smoothed velocity in m/s) and phase of the gait [rad].

    A body faces its velocity, smoothed with a time constant of 0.35 s, so that the noise
    of its path does not make it shake; it starts in the direction of its first step.
    """
    last: Grid | None = None
    for grid in grids:
        out = np.concatenate([grid.xyz[..., :2], np.zeros((*grid.xyz.shape[:2], 3))], axis=-1)
        place, velocity, phase = _start(last, grid, metre)
        before = int(grid.t_ns[0]) if last is None else int(last.t_ns[-1])
        for k, t in enumerate(grid.t_ns.tolist()):
            dt = (t - before) * 1e-9
            if dt > 0:
                seen = (out[k, :, :2] - place) / (metre * dt)
                velocity = velocity - np.expm1(-dt / LAG_S) * np.nan_to_num(seen - velocity)
                phase = phase + 2 * np.pi * dt * np.hypot(*velocity.T) / STRIDE
            place, before = out[k, :, :2], t
            out[k, :, 2:4], out[k, :, 4] = velocity, phase
        last = grid._replace(xyz=out)
        yield last


def _start(last: Grid | None, grid: Grid, metre: float) -> tuple[Floats, Floats, Floats]:
    """Place, velocity and phase of each object before the first time of a chunk."""
    place = grid.xyz[0, :, :2].copy()
    velocity = np.zeros_like(place)
    velocity[:, 0] = 1e-6
    if len(grid.t_ns) > 1:
        dt = (int(grid.t_ns[1]) - int(grid.t_ns[0])) * 1e-9
        velocity += np.nan_to_num(grid.xyz[1, :, :2] - place) / (metre * dt)
    phase: Floats = 2.4 * np.arange(len(grid.ids), dtype=np.float64)  # not in step
    if last is not None:
        _, old, new = np.intersect1d(last.ids, grid.ids, return_indices=True)
        place[new], velocity[new], phase[new] = last.xyz[-1, old, :2], last.xyz[-1, old, 2:4], last.xyz[-1, old, 4]
    return place, velocity, phase


def poses(rows: Floats) -> Poses:
    """Poses of n bodies from (n, 5) x, y, vx, vy, phase."""
    speed = np.hypot(rows[:, 2], rows[:, 3])
    heading = rows[:, 2:4] / np.maximum(speed, 1e-12)[:, None]
    heading[speed < 1e-9] = (1.0, 0.0)
    swing = FULL_SWING * np.minimum(1.0, speed / WALKING)
    return Poses(rows[:, :2], heading, rows[:, 4], swing)
