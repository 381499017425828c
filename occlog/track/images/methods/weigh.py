"""How the methods weigh particles: alone, with their neighbours, and with the other views, [Qu] Sec. 3."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import Ints
from occlog.track.images.interface import MODES
from occlog.track.images.kernels.motion import summed
from occlog.track.images.kernels.repulsion import Interaction
from occlog.track.images.kernels.sweeps import Near, Past, Rig, nearby, settle

from .loop_check import affine_maps, helpers
from .state import State
from .step import Moment, Weighed

MIPF, IDMOT, BMCT = MODES.index("mipf"), MODES.index("idmot"), MODES.index("bmct")


def alone(state: State, moment: Moment, rng: Generator) -> Weighed:
    """Weights of the colours only."""
    del rng
    weights, estimate = summed(moment.particles, moment.log_local)
    n = len(weights)
    nobody = np.zeros((n, n), dtype=np.bool_)
    return Weighed(weights, estimate, nobody, np.zeros(state.trackers.twin.shape, dtype=np.bool_), np.full(n, MIPF))


def among(state: State, moment: Moment, rng: Generator) -> Weighed:
    """Weights with repulsion and inertia of trackers that touch."""
    del rng
    n, views = state.trackers.twin.shape
    helper = np.full((n, views), -1)
    return _settled(state, moment, helper, np.arange(views), 1)


def together(state: State, moment: Moment, rng: Generator) -> Weighed:
    """Weights with those and with the bands of good counterparts in other views."""
    order = rng.permutation(len(state.views))
    return _settled(state, moment, helpers(state.trackers, moment.fresh), order, state.config.sweeps)


class Setting(NamedTuple):
    """What `settle` is told besides the particles and their local weights."""

    near: Near
    past: Past
    rig: Rig
    model: Interaction


def _settled(state: State, moment: Moment, helper: Ints, order: Ints, sweeps: int) -> Weighed:
    s = setting(state, moment, helper)
    weights, estimate, helped = settle(moment.particles, moment.log_local, *s[:3], order, sweeps, s.model, moment.here)
    touching = s.near.touching
    mode = np.where(helped.any(axis=1), BMCT, np.where(touching.any(axis=1), IDMOT, MIPF))
    return Weighed(weights, estimate, touching, helped, mode)


def setting(state: State, moment: Moment, helper: Ints) -> Setting:
    """Neighbours by the local weights, the past and the rig.

    Args:
        state: before the frame.
        moment: of the frame.
        helper: (n, V) trackers of the same target in other views that may help; -1: none.
    """
    t, c = state.trackers, state.config
    first = summed(moment.particles, moment.log_local)[1]
    near = nearby(first, t.view, c.touch, getattr(c, "close", c.touch))
    past = Past(t.estimate[:, :2].copy(), t.path.mean(axis=1) * moment.gap[:, None])
    bottom, band = getattr(c, "anchor", "centre") == "bottom", getattr(c, "band", 1.0)
    maps, clear = affine_maps(state, first), getattr(c, "clear", 0.0)
    rig = Rig(t.view, helper, state.geometry.fundamental, maps, bottom, band, clear)
    model = Interaction(c.alpha, c.repulsion, c.iterations, c.inertia, c.inertia_angle, c.inertia_speed)
    return Setting(near, past, rig, model)
