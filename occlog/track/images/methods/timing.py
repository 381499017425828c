"""How long the parts of a frame of method `bmct` take, as [Qu] Table 1 has them."""

from __future__ import annotations

import copy
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.random import Generator

from occlog.track.images.interface import Looks
from occlog.track.images.kernels.sweeps import Near, settle

from .loop_check import helpers
from .state import State
from .step import Scheme, moment_of
from .weigh import setting, together


def likelihood_seconds(state: State, looks: Looks, rng: Generator, repeats: int = 5) -> tuple[float, float, float]:
    """CPU seconds of the local, the interaction and the collaboration likelihood of all particles in one frame.

    The local one holds the map of bins and the motion of the particles.  The others are the
    time that weighing takes longer with neighbours than without, and with helpers than without.

    Args:
        state: of method `bmct` before the frame; it is not changed.
        looks: the frame.
        rng: drawn from a copy of it.
        repeats: of each part, of which the median counts.
    """
    moment = moment_of(Scheme(together, True), state, looks, copy.deepcopy(rng))
    s = setting(state, moment, helpers(state.trackers, moment.fresh))
    order, sweeps = np.arange(len(state.views)), state.config.sweeps
    apart = Near(np.zeros_like(s.near.busy), np.zeros_like(s.near.touching), s.near.ratio)

    def weigh(near: Near, helper: Any) -> Callable[[], object]:
        rig = s.rig._replace(helper=helper)
        return lambda: settle(
            moment.particles, moment.log_local, near, s.past, rig, order, sweeps, s.model, moment.here
        )

    nobody = np.full_like(s.rig.helper, -1)
    parts = [
        lambda: moment_of(Scheme(together, True), state, looks, copy.deepcopy(rng)),
        weigh(apart, nobody),
        weigh(s.near, nobody),
        weigh(s.near, s.rig.helper),
    ]
    local, base, touching, helped = (_median_seconds(part, repeats) for part in parts)
    return local, max(touching - base, 0.0), max(helped - touching, 0.0)


def _median_seconds(work: Callable[[], object], repeats: int) -> float:
    times = []
    for _ in range(repeats):
        start = time.thread_time()
        work()
        times.append(time.thread_time() - start)
    return float(np.median(times))
