"""Weights of the particles of `mipf`, `idmot` and `bmct`, [Qu] Sec. 3 and Alg. 1.

All three weigh by the local likelihood.  `idmot` adds the interaction of trackers that touch,
`bmct` also the collaboration with good counterparts in other views.  A tracker of `bmct`
without a helper does what `idmot` does, and one that touches no other what `mipf` does: the
triangle transition of [Qu] Sec. 3.4.2.
"""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from occlog.array_types import Floats, Ints
from occlog.track.images.interface import MODES
from occlog.track.images.kernels.collaboration import (
    CameraCollaboration,
    PastMotion,
    WeighingModel,
    neighbours,
    reweighted,
)
from occlog.track.images.kernels.motion import weights_and_means
from occlog.track.images.kernels.repulsion import Interaction

from .config import BmctConfig, IdmotConfig, MipfConfig
from .loop_check import affine_maps, at_bottom, helpers
from .state import VisualState
from .step import LocalWeights, Weighed

MIPF, IDMOT, BMCT = MODES.index("mipf"), MODES.index("idmot"), MODES.index("bmct")


def weigh_mipf(state: VisualState[MipfConfig], local: LocalWeights, rng: Generator) -> Weighed:
    """Weigh by the local likelihood only."""
    del rng
    weights, estimate = weights_and_means(local.particles, local.log_local)
    n = len(weights)
    return Weighed(
        weights=weights,
        estimate=estimate,
        touching=np.zeros((n, n), dtype=np.bool_),
        helped=np.zeros(state.trackers.counterpart.shape, dtype=np.bool_),
        mode=np.full(n, MIPF),
    )


def weigh_idmot(state: VisualState[IdmotConfig], local: LocalWeights, rng: Generator) -> Weighed:
    """Weigh by the local likelihood, and by the interaction of trackers that touch ([Qu] Eq. 8) and their inertia."""
    del rng
    return _reweighted(local, interaction_of(state, local), order=np.arange(len(state.views)), sweeps=1)


def weigh_bmct(state: VisualState[BmctConfig], local: LocalWeights, rng: Generator) -> Weighed:
    """Weigh as `weigh_idmot`, and by the bands of good counterparts for trackers close to others ([Qu] Eq. 5).

    A target that is close to others in all views is worked out in the views in turn, in random order ([Qu] Sec. 3.2).
    """
    order = rng.permutation(len(state.views))
    return _reweighted(local, collaboration_of(state, local), order, state.config.sweeps)


def interaction_of(state: VisualState[IdmotConfig], local: LocalWeights) -> WeighingModel:
    """Interaction within views, without help between them.

    Args:
        state: before the frame.
        local: of the frame.
    """
    n, views = state.trackers.counterpart.shape
    nobody = CameraCollaboration(
        camera=state.trackers.view,
        helper=np.full((n, views), -1),
        fundamental=state.geometry.fundamental,
        affine=np.zeros((n, 2, 3)),
        bottom=False,
        band=1.0,
        clear=0.0,
    )
    first = weights_and_means(local.particles, local.log_local)[1]
    return _model(state, local, first, state.config.touch, nobody)


def collaboration_of(state: VisualState[BmctConfig], local: LocalWeights) -> WeighingModel:
    """Interaction within views, and collaboration with good counterparts that are fresh.

    Args:
        state: before the frame.
        local: of the frame.
    """
    t, c = state.trackers, state.config
    first = weights_and_means(local.particles, local.log_local)[1]
    cameras = CameraCollaboration(
        camera=t.view,
        helper=helpers(t, local.fresh),
        fundamental=state.geometry.fundamental,
        affine=affine_maps(state, first),
        bottom=at_bottom(c),
        band=c.band,
        clear=c.clear,
    )
    return _model(state, local, first, c.close, cameras)


def _model(
    state: VisualState[IdmotConfig],
    local: LocalWeights,
    first: Floats,
    close: float,
    cameras: CameraCollaboration,
) -> WeighingModel:
    """The model for neighbours by the temporary estimates `first` (n, 5) of [Qu] Alg. 1."""
    t, c = state.trackers, state.config
    return WeighingModel(
        near=neighbours(first, t.view, c.touch, close),
        past=PastMotion(centre=t.estimate[:, :2].copy(), step=t.path.mean(axis=1) * local.gap[:, None]),
        cameras=cameras,
        interaction=Interaction(
            alpha=c.alpha,
            sigma=c.repulsion,
            iterations=c.iterations,
            inertia=c.inertia,
            angle=c.inertia_angle,
            speed=c.inertia_speed,
        ),
    )


def _reweighted(local: LocalWeights, model: WeighingModel, order: Ints, sweeps: int) -> Weighed:
    """Weights of all trackers; the mode of each says which likelihoods counted."""
    weights, estimate, helped = reweighted(local.particles, local.log_local, local.here, model, order, sweeps)
    touching = model.near.touching
    mode = np.where(helped.any(axis=1), BMCT, np.where(touching.any(axis=1), IDMOT, MIPF))
    return Weighed(weights, estimate, touching, helped, mode)
