"""Smoothing of tracks in space: what was seen afterwards tells of a state as well.

`direct3d` draws trajectories back through the kernel densities of its particles
(`occlog.filtering.backward_simulation`), the same densities from which its particles were drawn.
`pps` has no density in space; its combined estimates are smoothed as Gaussians (Rauch, Tung and Striebel 1965).
A filter that began anew forgot what it knew before: states before such a time are smoothed with what follows up to it
alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import NS, Floats
from occlog.filtering.backward_simulation import Knot, last_states, spread_of, states_before
from occlog.filtering.motion.white_acceleration import AccelerationModel, moved, moved_back
from occlog.track.interface import Height, Past

from .config import SpaceConfig
from .importance_step import drift_matrix, process_noise
from .start import motion_of


class CloudTrace(NamedTuple):
    """Particles after a scan, for the way back."""

    t_ns: int
    knot: Knot
    begun: bool  # anew: they do not come from the particles before


class GaussianTrace(NamedTuple):
    """A combined estimate after a scan, for the way back."""

    t_ns: int
    mean: Floats  # (6,)
    covariance: Floats  # (6, 6)
    begun: bool


def through_clouds(traces: Sequence[CloudTrace], config: SpaceConfig, rng: Generator) -> list[Past]:
    """Past states from trajectories that are drawn back from the last trace to the first."""
    motion, out, states = motion_of(config), [], np.empty((6, 0))
    for k in range(len(traces) - 1, -1, -1):
        if k == len(traces) - 1 or traces[k + 1].begun:
            states, _ = last_states(traces[k].knot, config.trajectories, rng)
        else:
            dt = (traces[k + 1].t_ns - traces[k].t_ns) / NS
            back = moved_back(states, motion, dt)
            states, _ = states_before(traces[k].knot, back, process_noise(motion, -dt), rng=rng)
        out.append(past_of(*spread_of(states)))
    return out[::-1]


def through_gaussians(traces: Sequence[GaussianTrace], config: SpaceConfig, rng: Generator) -> list[Past]:
    """Past states by the recursion of Rauch, Tung and Striebel."""
    motion, out = motion_of(config), []
    mean, covariance = np.empty(6), np.empty((6, 6))
    for k in range(len(traces) - 1, -1, -1):
        m, P = traces[k].mean, traces[k].covariance
        if k == len(traces) - 1 or traces[k + 1].begun:
            mean, covariance = m, P
        else:
            dt = (traces[k + 1].t_ns - traces[k].t_ns) / NS
            mean, covariance = _before(m, P, mean, covariance, motion, dt, rng)
        out.append(past_of(mean, covariance))
    return out[::-1]


def _before(
    m: Floats, P: Floats, later: Floats, later_covariance: Floats, motion: AccelerationModel, dt: float, rng: Generator
) -> tuple[Floats, Floats]:
    """Mean and covariance a time dt before a smoothed state, where the filter had (m, P)."""
    F = drift_matrix(3, dt)
    ahead = moved(m[:, None], motion._replace(density=np.zeros(3)), dt, rng)[:, 0]
    predicted = F @ P @ F.T + process_noise(motion, dt)
    G = P @ F.T @ np.linalg.pinv(predicted, rcond=1e-13, hermitian=True)
    covariance = P + G @ (later_covariance - predicted) @ G.T
    return m + G @ (later - ahead), 0.5 * (covariance + covariance.T)


def past_of(mean: Floats, covariance: Floats) -> Past:
    """A state in space as a past one."""
    height = Height(float(mean[2]), float(mean[5]), np.array([covariance[0, 2], covariance[1, 2], covariance[2, 2]]))
    return Past(mean[:2], mean[3:5], np.ascontiguousarray(covariance[:2, :2]), height)
