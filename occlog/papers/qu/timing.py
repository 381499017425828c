"""CPU time of the parts of a frame of method `bmct`, as [Qu] Table 1 lists them."""

from __future__ import annotations

import copy
import time
from collections.abc import Callable

import numpy as np
from numpy.random import Generator

from occlog.array_types import Ints
from occlog.track.methods.images.interface import FrameSet
from occlog.track.methods.images.kernels.collaboration import Neighbours, reweighted
from occlog.track.methods.images.methods.config import BmctConfig
from occlog.track.methods.images.methods.state import VisualState
from occlog.track.methods.images.methods.weigh import LocalWeights, arrival_of, local_weights, weighing_model


def likelihood_seconds(
    state: VisualState, config: BmctConfig, frames: FrameSet, rng: Generator, repeats: int = 5
) -> tuple[float, float, float]:
    """CPU seconds of the local, the interaction and the collaboration likelihood for one frame of `bmct`.

    The local one includes the map of bins and the motion of the particles. The others are the additional time of
    weighing with neighbours, and with helpers.

    Args:
        state: state before the frame; it is not changed.
        config: settings of the method.
        frames: images of the frame.
        rng: random numbers of the particles; a copy is drawn from.
        repeats: number of times that each part is measured; the median counts.
    """

    def locally() -> LocalWeights:
        return local_weights(state, frames, arrival_of(state, frames), copy.deepcopy(rng))

    local, arrival = locally(), arrival_of(state, frames)
    model = weighing_model(state, arrival, local)
    order, sweeps = np.arange(len(state.views)), config.sweeps
    near = model.near
    separate = Neighbours(busy=np.zeros_like(near.busy), touching=np.zeros_like(near.touching), ratio=near.ratio)

    def weigh(close: Neighbours, helper: Ints) -> Callable[[], object]:
        trial = model._replace(near=close, cameras=model.cameras._replace(helper=helper))
        return lambda: reweighted(local.particles, local.log_local, arrival.here, trial, order, sweeps)

    no_helper = np.full_like(model.cameras.helper, -1)
    parts = [
        locally,
        weigh(separate, no_helper),
        weigh(near, no_helper),
        weigh(near, model.cameras.helper),
    ]
    whole, base, touching, helped = (_median_seconds(part, repeats) for part in parts)
    return whole, max(touching - base, 0.0), max(helped - touching, 0.0)


def _median_seconds(work: Callable[[], object], repeats: int) -> float:
    """Median CPU time of `repeats` calls of `work` in this thread [s]."""
    times = []
    for _ in range(repeats):
        start = time.thread_time()
        work()
        times.append(time.thread_time() - start)
    return float(np.median(times))
