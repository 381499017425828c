"""Weights of the particles of all trackers in one frame, [Qu] Sec. 3 and Alg. 1.

Every method weighs by the local likelihood.  `idmot` adds the interaction of trackers that
touch, `bmct` also the collaboration with good counterparts in other views.  A tracker of `bmct`
without a helper does what `idmot` does, and one that touches no other what `mipf` does: the
triangle transition of [Qu] Sec. 3.4.2.

Proposal and local likelihood of the particles of all trackers in one frame, [Qu] Sec. 3 and Eq. 4.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import Bools, Floats, Ints
from occlog.track.methods.images.interface import MODES, FrameSet
from occlog.track.methods.images.kernels.appearance import colour_similarity
from occlog.track.methods.images.kernels.collaboration import (
    CameraCollaboration,
    Interaction,
    PastMotion,
    WeighingModel,
    neighbours,
    reweighted,
)
from occlog.track.methods.images.kernels.motion import (
    EllipseMotion,
    boxes_of,
    covariance_and_ess,
    moved,
    resampled,
    weights_and_means,
)

from .config import BmctConfig, CmctConfig, IdmotConfig, MipfConfig
from .restart import affine_maps, assisting_views, propose_on_lines
from .state import (
    LONGEST,
    OwnRegions,
    VisualState,
    ages,
    drawn_at_regions,
    gaps,
    log_patches,
    log_region_likelihood,
    own_regions,
    update_map,
)

MAX_ESTIMATE_AGE_PERIODS = 1.5
"""Age [frame periods] below which the last estimate of a view without a frame still helps other views."""


class FrameContext(NamedTuple):
    """What n trackers need to know of a time step: which have a frame, the time since the last one, and own regions."""

    here: Bools  # (n,) whether the view has a frame
    age: Floats  # (n,) time since the view's last frame [frame periods]
    gap: Floats  # (n,) frames since the last one, 1 to `LONGEST`
    own: OwnRegions  # a detector's regions that belong to one tracker only

    @property
    def fresh(self) -> Bools:
        """Return (n,) booleans: whether the estimate is recent enough to help other views.

        It has a frame in this time step, or the last one is less than 1.5 frame periods old.
        """
        return self.here | (self.age < MAX_ESTIMATE_AGE_PERIODS)


class LocalWeights(NamedTuple):
    """Proposed particles (n, N, 5) of n trackers, with their colour similarities and local log likelihoods (n, N)."""

    particles: Floats  # (n, N, 5)
    similarities: Floats  # (n, N) of the colours; 1 where there is no frame
    log_local: Floats  # (n, N) log p(z | x) of [Qu] Eq. 4 without its constant; 0 where there is no frame


def arrival_of(state: VisualState, frames: FrameSet) -> FrameContext:
    """Return which of the n trackers have a frame in this time step, how old their last one is, and own regions.

    Own regions are detected regions near the ellipse expected in this frame that belong to one tracker only.
    """
    t = state.trackers
    here = np.array([image is not None for image in frames.images])[t.view]
    age, gap = ages(state.clock, frames.t_ns)[t.view], gaps(state.clock, frames.t_ns)[t.view]
    expected = t.estimate.copy()
    expected[:, :2] += gap[:, None] * t.velocity
    return FrameContext(here, age, gap, own_regions(frames, t.view, expected, state.config.region_reach))


def local_weights(state: VisualState, frames: FrameSet, arrival: FrameContext, rng: Generator) -> LocalWeights:
    """Propose particles of all trackers for this time step's frames, and weigh them by the images alone.

    Particles of trackers without a frame only move on at the tracker's velocity.

    Args:
        state: trackers before the frames; its colour maps are updated in place.
        frames: frames of the time step.
        arrival: which trackers have a frame, from `arrival_of`.
        rng: generator of the random numbers drawn.
    """
    t, c = state.trackers, state.config
    # Propose: by the motion, p(x_t | x_t-1), over as many frames as are missing
    normals = rng.standard_normal(t.particles.shape)
    motion = motion_of(c)
    particles = moved(t.particles, t.velocity, axes=t.axes, gap=arrival.gap, normals=normals, motion=motion)
    # Propose: a share on the epipolar lines of the other views
    if isinstance(c, CmctConfig):
        particles = propose_on_lines(state, c, particles, arrival.gap, rng)
    # Propose: a share at the detector's region that belongs to the tracker alone
    particles = drawn_at_regions(particles, arrival.own, normals, c.region_share, c.region_spread)
    if not arrival.here.all():
        # Without a frame the particles of the last one go on at the tracker's velocity; they only help other views.
        waiting = t.particles.copy()
        waiting[..., :2] += (np.minimum(arrival.age, LONGEST)[:, None] * t.velocity)[:, None]
        particles = np.where(arrival.here[:, None, None], particles, waiting)
    # Weigh locally
    count = particles.shape[1]
    similarities, log_local = np.ones(particles.shape[:2]), np.zeros(particles.shape[:2])
    boxes = boxes_of(particles)
    for v, image in enumerate(frames.images):
        rows = np.flatnonzero(t.view == v)
        if image is not None and len(rows):
            flat, owner = particles[rows].reshape(-1, 5), np.repeat(rows, count)
            found = local_likelihood(state, frames, arrival.own, boxes[rows], flat, owner)
            similarities[rows], log_local[rows] = (each.reshape(-1, count) for each in found)
    return LocalWeights(particles, similarities, log_local)


def motion_of(config: MipfConfig) -> EllipseMotion:
    """Return the ellipse motion model of the settings."""
    return EllipseMotion(
        sigma=config.sigma_px,
        keep=config.keep_axes,
        sigma_axes=config.sigma_axes_px,
        limit=config.axes_limit,
        sigma_rho=config.sigma_rho,
        keep_rho=config.keep_rho,
    )


def local_likelihood(
    state: VisualState, frames: FrameSet, own: OwnRegions, boxes: Ints, ellipses: Floats, owner: Ints
) -> tuple[Floats, Floats]:
    """Return (P,) colour similarities of ellipses in one view's frame, and (P,) their local log likelihoods.

    The likelihood is that of colours and grey patches, p_c p_p of [Qu] Sec. 3.3, times a pull towards the tracker's own
    detected region, without its constant. Similarities are Bhattacharyya coefficients, 0 to 1.

    Args:
        state: trackers before the frame; the view's colour map is updated in place.
        frames: frames of one time step; the view of the ellipses has one.
        own: detected regions of the n trackers.
        boxes: (K, 4) left, top, right, bottom [px] of boxes that hold all pixels of the ellipses.
        ellipses: (P, 5) in one view, P > 0: centre and half axes [px], angle of the first axis [rad].
        owner: (P,) row of each ellipse's tracker, 0 to n - 1.
    """
    t, c, v = state.trackers, state.config, int(state.trackers.view[owner[0]])
    bins = update_map(state, frames, v, boxes)
    similarities = colour_similarity(bins, ellipses, owner, t.colours, t.split, c.pixel_step)
    # p_c = exp(-(1 - BC) / (2 sigma^2)) of the Bhattacharyya coefficient BC
    log_likelihood = (similarities - 1.0) / (2.0 * c.sigma_colour**2)
    image = frames.images[v]
    if c.model == "pca" and image is not None:
        rows = np.flatnonzero(t.view == v)
        models = [state.appearance[v, target] for target in t.target[rows].tolist()]
        log_likelihood += log_patches(image, ellipses, owner - rows[0], models, c)
    return similarities, log_likelihood + log_region_likelihood(ellipses, own, owner, c.region_pull)


def similarity_of_estimates(state: VisualState, here: Bools) -> Floats:
    """Return (n,) colour similarities, 0 to 1, of the estimates of trackers `here` (n,); 1 for the others."""
    t = state.trackers
    out = np.ones(len(t.view))
    for v, bins in enumerate(state.bins):
        rows = np.flatnonzero((t.view == v) & here)
        out[rows] = colour_similarity(bins, t.estimate[rows], rows, t.colours, t.split, state.config.pixel_step)
    return out


MIPF, IDMOT, BMCT, CMCT = (MODES.index(name) for name in ("mipf", "idmot", "bmct", "cmct"))
NEVER = -1.0
"""Distance at which no trackers touch, and none are close."""


class TrackerParticles(NamedTuple):
    """Weighted particles (n, N, 5) of n trackers in one frame, their mean ellipses, and the views that helped.

    `weights` are those of the particles before resampling, `resampled` are particles of equal weight.
    """

    weights: Floats  # (n, N) w of [Qu] Eq. 4; each row sums to 1
    estimate: Floats  # (n, 5) weighted means
    touching: Bools  # (n, n)
    helped: Bools  # (n, V)
    mode: Ints  # (n,) index in `MODES`
    covariance: Floats  # (n, 3) of the centre: xx, xy, yy [px^2]
    ess: Floats  # (n,) effective sample size
    best: Floats  # (n,) similarity of the particle that is most like the target
    resampled: Floats  # (n, N, 5) particles of equal weight


def weigh(state: VisualState, arrival: FrameContext, local: LocalWeights, rng: Generator) -> TrackerParticles:
    """Weigh proposed particles by images, touching trackers and other views, and resample them, [Qu] Alg. 1.

    Which of these parts apply depends on the class of the method's settings. Targets close to others in all views are
    worked out in several sweeps over the views, in random order ([Qu] Sec. 3.2).

    Args:
        state: trackers before the frame.
        arrival: which of the n trackers have a frame.
        local: proposed particles and their weights by the images alone.
        rng: generator of the random order and of the resampling.
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
    return TrackerParticles(
        weights=weights,
        estimate=estimate,
        touching=touching,
        helped=helped,
        mode=mode,
        covariance=covariance,
        ess=ess,
        best=local.similarities.max(axis=1),
        # Resample: systematic ([Qu] Alg. 1)
        resampled=resampled(local.particles, weights, rng.random(len(weights))),
    )


def weighing_model(state: VisualState, arrival: FrameContext, local: LocalWeights) -> WeighingModel:
    """Return the parameters of interaction and collaboration for a frame, from the temporary estimates of [Qu] Alg. 1.

    The temporary estimates are the means by the local likelihood. Parts that a method does not have are switched off.

    Args:
        state: trackers before the frame.
        arrival: which of the n trackers have a frame, and how old their last is.
        local: proposed particles and their weights by the images alone.
    """
    t, c = state.trackers, state.config
    first = weights_and_means(local.particles, local.log_local)[1]
    # Interaction within views
    touch, interaction = NEVER, Interaction(alpha=1.0, sigma=1.0, iterations=0, inertia=0.0, angle=1.0, speed=1.0)
    if isinstance(c, IdmotConfig):
        touch, interaction = (
            c.interaction_distance,
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
            c.collaboration_distance,
            cameras._replace(
                helper=assisting_views(t, arrival.fresh),
                affine=affine_maps(state, first),
                bottom=c.bottom,
                band=c.epipolar_band,
                clear=c.clear_distance,
            ),
        )
    return WeighingModel(
        near=neighbours(first, t.view, touch, close),
        past=PastMotion(centre=t.estimate[:, :2].copy(), step=t.path.mean(axis=1) * arrival.gap[:, None]),
        cameras=cameras,
        interaction=interaction,
    )
