"""Smoothing of targets with several motion models: trajectories drawn back through the filter's particles.

A particle after a step has the model under which it moved there.  On the way back that model moves it back, and the
model before it is drawn along with its state: of two particles that are as likely to have led to a state that one
counts more whose model changes seldom into the later one (`hold_s`).  See `occlog.filtering.backward_simulation`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import NS, Floats, Ints
from occlog.filtering.backward_simulation import Knot, knot, last_states, spread_of, states_before
from occlog.filtering.motion.coordinated_turn import acceleration_root, move, three_models
from occlog.track.interface import Past

from .config import ImmConfig
from .tracks import Track, switching


class TrackTrace(NamedTuple):
    """A target's particles after a scan, for the way back."""

    t_ns: int
    knot: Knot  # rows x, vx, y, vy; kinds are motion models


def trace_of(track: Track, t_ns: int) -> TrackTrace:
    """What a step leaves of a target for the way back."""
    states, models = track.cloud
    return TrackTrace(t_ns, knot(np.ascontiguousarray(states.T), np.full(len(states), 1.0 / len(states)), models))


def back(traces: Sequence[TrackTrace], config: ImmConfig, rng: Generator) -> list[Past]:
    """Past states of a target from trajectories that are drawn back from the last trace to the first."""
    models, out = three_models(config.alpha), []
    states, kinds = last_states(traces[-1].knot, config.trajectories, rng)
    out.append(_past(states))
    for k in range(len(traces) - 2, -1, -1):
        dt = (traces[k + 1].t_ns - traces[k].t_ns) / NS
        chances = switching(len(models), dt, config.hold_s)
        moved = moved_back(states, kinds, models, dt)
        noise = noise_back(config.sigma_v**2, dt)
        states, kinds = states_before(traces[k].knot, moved, noise, kinds, chances, rng=rng)
        out.append(_past(states))
    return out[::-1]


def moved_back(states: Floats, kinds: Ints, models: Floats, dt: float) -> Floats:
    """(4, M) states dt >= 0 seconds before, without noise, each under the one of (J, 3) models that (M,) kinds say.

    It is the inverse of a step of `occlog.filtering.motion.coordinated_turn.move`, as a turn leaves the speed as it is.
    """
    out = np.empty_like(states)
    for kind, model in enumerate(models):
        own: Ints = np.flatnonzero(kinds == kind)
        still = np.zeros((len(own), 4))
        out[:, own] = move(np.ascontiguousarray(states[:, own].T), model, -dt, np.zeros((2, 2)), still).T
    return out


def noise_back(density: float, dt: float) -> Floats:
    """(4, 4) covariance of a step's noise moved back by the step; that of a turn counts as that of the straight way."""
    root = acceleration_root(density, dt)
    block = root @ root.T
    block[0, 1] = block[1, 0] = -block[0, 1]
    out = np.zeros((4, 4))
    out[:2, :2] = out[2:, 2:] = block
    return out


def _past(states: Floats) -> Past:
    mean, covariance = spread_of(states)
    return Past(mean[::2], mean[1::2], np.ascontiguousarray(covariance[::2, ::2]))
