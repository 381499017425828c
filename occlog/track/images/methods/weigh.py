"""Weights of the particles of all trackers in one frame, [Qu] Sec. 3 and Alg. 1.

Every method weighs by the local likelihood.  `idmot` adds the interaction of trackers that
touch, `bmct` also the collaboration with good counterparts in other views.  A tracker of `bmct`
without a helper does what `idmot` does, and one that touches no other what `mipf` does: the
triangle transition of [Qu] Sec. 3.4.2.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import Bools, Floats, Ints
from occlog.track.images.interface import MODES
from occlog.track.images.kernels.collaboration import (
    CameraCollaboration,
    PastMotion,
    WeighingModel,
    neighbours,
    reweighted,
)
from occlog.track.images.kernels.motion import covariance_and_ess, resampled, weights_and_means
from occlog.track.images.kernels.repulsion import Interaction

from .config import BmctConfig, CmctConfig, IdmotConfig
from .local import Arrival, LocalWeights
from .loop_check import affine_maps, helpers
from .state import VisualState

MIPF, IDMOT, BMCT, CMCT = (MODES.index(name) for name in ("mipf", "idmot", "bmct", "cmct"))
NEVER = -1.0
"""Distance at which no trackers touch, and none are close."""


class Samples(NamedTuple):
    """Weighted particles of n trackers in one frame, and what follows from them."""

    weights: Floats  # (n, N) w of [Qu] Eq. 4; each row sums to 1
    estimate: Floats  # (n, 5) weighted means
    touching: Bools  # (n, n)
    helped: Bools  # (n, V)
    mode: Ints  # (n,) place in `MODES`
    covariance: Floats  # (n, 3) of the centre: xx, xy, yy [px^2]
    ess: Floats  # (n,) effective sample size
    best: Floats  # (n,) likeness of the particle that is most like the target
    resampled: Floats  # (n, N, 5) particles of equal weight


def weigh(state: VisualState, arrival: Arrival, local: LocalWeights, rng: Generator) -> Samples:
    """Weigh by the local likelihood, the interaction of trackers that touch and the other views; resample.

    A target that is close to others in all views is worked out in the views in turn, in random order ([Qu] Sec. 3.2).

    Args:
        state: before the frame.
        arrival: of the frame.
        local: weights by the images alone.
        rng: generator.
    """
    c, order, sweeps = state.config, np.arange(len(state.views)), 1
    if isinstance(c, BmctConfig):
        order, sweeps = rng.permutation(len(state.views)), c.sweeps
    model = weighing_model(state, arrival, local)
    weights, estimate, helped = reweighted(local.particles, local.log_local, arrival.here, model, order, sweeps)
    touching = model.near.touching
    alone = CMCT if isinstance(c, CmctConfig) else MIPF
    mode = np.where(helped.any(axis=1), BMCT, np.where(touching.any(axis=1), IDMOT, alone))
    covariance, ess = covariance_and_ess(local.particles, weights, estimate)
    return Samples(
        weights=weights,
        estimate=estimate,
        touching=touching,
        helped=helped,
        mode=mode,
        covariance=covariance,
        ess=ess,
        best=local.likeness.max(axis=1),
        # Resample: systematic ([Qu] Alg. 1)
        resampled=resampled(local.particles, weights, rng.random(len(weights))),
    )


def weighing_model(state: VisualState, arrival: Arrival, local: LocalWeights) -> WeighingModel:
    """What besides the local likelihood counts, by the temporary estimates of [Qu] Alg. 1.

    Args:
        state: before the frame.
        arrival: of the frame.
        local: weights by the images alone.
    """
    t, c = state.trackers, state.config
    first = weights_and_means(local.particles, local.log_local)[1]
    # Interaction within views
    touch, interaction = NEVER, Interaction(alpha=1.0, sigma=1.0, iterations=0, inertia=0.0, angle=1.0, speed=1.0)
    if isinstance(c, IdmotConfig):
        touch, interaction = (
            c.touch,
            Interaction(
                alpha=c.alpha,
                sigma=c.repulsion,
                iterations=c.iterations,
                inertia=c.inertia,
                angle=c.inertia_angle,
                speed=c.inertia_speed,
            ),
        )
    # Collaboration between views
    close, cameras = (
        touch,
        CameraCollaboration(
            camera=t.view,
            helper=np.full(t.counterpart.shape, -1),
            fundamental=state.geometry.fundamental,
            affine=np.zeros((len(t.view), 2, 3)),
            bottom=False,
            band=1.0,
            clear=0.0,
        ),
    )
    if isinstance(c, BmctConfig):
        close, cameras = (
            c.close,
            cameras._replace(
                helper=helpers(t, arrival.fresh),
                affine=affine_maps(state, first),
                bottom=c.bottom,
                band=c.band,
                clear=c.clear,
            ),
        )
    return WeighingModel(
        near=neighbours(first, t.view, touch, close),
        past=PastMotion(centre=t.estimate[:, :2].copy(), step=t.path.mean(axis=1) * arrival.gap[:, None]),
        cameras=cameras,
        interaction=interaction,
    )
