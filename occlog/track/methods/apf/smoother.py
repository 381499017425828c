"""Backward simulation smoother of method `apf`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel
from occlog.filtering.motion import waypoint
from occlog.filtering.motion.waypoint import WaypointModel, WaypointParticles
from occlog.filtering.particles import systematic_ancestors
from occlog.track.interface import SmoothedState

from .config import ApfConfig
from .kernels.backward_simulation import parents_of
from .model import ApfModel

CANDIDATES = 500
"""Particles of the step before among which each trajectory chooses, also its own parent."""

MIN_EFFECTIVE_SAMPLE_SIZE = 1.5
"""Fewer positions count as this number, so that a single one does not count as certain."""


class ParticleRecord(NamedTuple):
    """Particles after one step of the filter, as backward simulation needs them.

    `states` (L, 5): x, y, velocity towards the destination, and speed. `arrived` (L,): the destination is reached.
    `parents` (L,): indices in the record before, None: each its own.
    """

    states: Floats  # (L, 5) from `waypoint.headings`
    regime: Ints  # (L,)
    arrived: Bools  # (L,)
    weights: Floats  # (L,)
    parents: Ints | None  # (L,) among those of the link before; None: each its own
    dt: float  # since the link before [s]; 0 without parents: nothing before counts, the particles were resampled
    sharpness: float  # mean variance per axis of the densities that the positions were drawn from; 0: not known


Trace = tuple[ParticleRecord, ...]
"""What a scan leaves for the way back: its link, after those of the steps that led there without a scan."""


def record_particles(
    particles: WaypointParticles,
    weights: Floats,
    parents: Ints | None,
    dt: float,
    model: ApfModel,
    sharpness: float = 0.0,
) -> ParticleRecord:
    """Return the record of a filter step that backward simulation needs: particles as states, with their parents.

    Args:
        particles: L particles after the step.
        weights: (L,) weights of the particles, sum 1.
        parents: (L,) indices among those of the step before; None: each its own.
        dt: length of the step [s]; 0 without parents: the particles were drawn without regard to earlier ones.
        model: motion and floor.
        sharpness: mean variance per axis of the densities that positions were drawn from; 0: unknown.
    """
    arrived = waypoint.reached(particles, model.motion, model.floor)
    return ParticleRecord(
        waypoint.headings(particles, model.motion), particles.regime, arrived, weights, parents, dt, sharpness
    )


def smooth(traces: Sequence[Trace], config: ApfConfig, motion: WaypointModel, rng: Generator) -> list[SmoothedState]:
    """Return a smoothed state for each scan, by backward simulation of `smoothing_trajectories` trajectories.

    Args:
        traces: records of the filter's steps up to each scan, in the order of time; at least one.
        config: settings of the method.
        motion: the motion model.
        rng: generator of the random numbers drawn.
    """
    M = config.smoothing_trajectories
    found: list[SmoothedState] = []
    later: ParticleRecord | None = None
    chosen = np.empty(0, dtype=np.int64)
    for trace in reversed(traces):
        for step in range(len(trace) - 1, -1, -1):
            now = trace[step]
            if later is None or (later.parents is None and later.dt <= 0.0):
                # The end of the record, or of what the filter knew before it was resampled
                chosen = rng.permutation(systematic_ancestors(now.weights, M, rng.random()))
            else:
                chosen = _parents(now, later, chosen, motion, rng)
            if step == len(trace) - 1:
                found.append(_state(now, chosen))
            later = now
    return found[::-1]


def _parents(now: ParticleRecord, later: ParticleRecord, chosen: Ints, motion: WaypointModel, rng: Generator) -> Ints:
    """Return for each of M trajectories the particle through which it passes at an earlier step, drawn at random.

    Args:
        now: L particles of the earlier step.
        later: particles of the step after it.
        chosen: (M,) indices of the trajectories' particles in `later`.
        motion: the motion model.
        rng: source of random numbers.

    Returns:
        (M,) indices in `now`.
    """
    count = min(CANDIDATES, len(now.weights))
    own = chosen if later.parents is None else later.parents[chosen]
    if later.dt <= 0.0:  # two scans at one time: nothing has moved between them
        return own
    return parents_of(
        later.states[chosen],
        later.regime[chosen],
        own,
        now.states,
        now.regime,
        waypoint.regime_probabilities(now.regime, now.arrived, later.dt, motion),
        systematic_ancestors(now.weights, count, rng.random()),
        later.dt,
        motion,
        kernel_variance(now.states, now.weights),
        rng.random(len(chosen)),
    )


@kernel
def kernel_variance(states: Floats, weights: Floats) -> tuple[float, float]:
    """Return the squared kernel bandwidths of position and velocity per axis, optimal for a 4-D Gaussian (Silverman).

    Args:
        states: (L, 5) x, y, velocity x and y, and speed, from `waypoint.headings`.
        weights: (L,) weights of the particles, sum 1.
    """
    mean, second, square = np.zeros(4), np.zeros(4), 0.0
    for i in range(weights.shape[0]):
        for k in range(4):
            mean[k] += weights[i] * states[i, k]
            second[k] += weights[i] * states[i, k] ** 2
        square += weights[i] * weights[i]
    variance = np.maximum(second - mean * mean, 0.0)
    share = (2.0 / 3.0 * square) ** 0.25
    return 0.5 * (variance[0] + variance[1]) * share, 0.5 * (variance[2] + variance[3]) * share


def _state(now: ParticleRecord, chosen: Ints) -> SmoothedState:
    """Return mean position, covariance and mean velocity of the particles that trajectories pass through at a step.

    Where trajectories share particles there are fewer positions than trajectories, n effective ones. Their spread is
    then too small by n / (n - 1), and their mean is uncertain by an n-th of the variance that a position was drawn
    with; both are corrected.

    Args:
        now: particles after the step.
        chosen: (M,) index of each trajectory's particle.
    """
    states = now.states[chosen]
    going = now.regime[chosen] != waypoint.WAIT
    xy = states[:, :2].mean(axis=0)
    centred = states[:, :2] - xy
    M = len(chosen)
    counts = np.unique(chosen, return_counts=True)[1]
    n = max(M * M / float(counts @ counts), MIN_EFFECTIVE_SAMPLE_SIZE)
    covariance = centred.T @ centred / M * (n / (n - 1.0)) + now.sharpness / n * np.eye(2)
    return SmoothedState(xy=xy, velocity=(states[:, 2:4] * going[:, None]).mean(axis=0), covariance=covariance)
