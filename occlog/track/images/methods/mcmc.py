"""Method `mcmc`: one filter a view, whose samples hold all of its targets; the baseline of [Qu] Table 2.

Two samplers draw from the same joint posterior (see `occlog.track.images.kernels.joint_samples`):

    mcmc    Khan, Balch, Dellaert (ECCV 2004): a Markov chain that moves one target at a time, to
            where the motion takes it from a random sample of the frame before.  A sample costs
            one likelihood, whatever the number of targets.
    sir     importance sampling: all targets of a sample move at once, and the sample is weighed by
            the product of their likelihoods.  A sample costs a likelihood for each target, and
            its weight is good only if all of its targets are in good places.

Views are not connected.  The prediction of a chain is the product over the targets of their
own predictions.  A sample of a view is in the same column of `particles` for all trackers of
the view.  A detector's regions count in the likelihood only: no sample starts anew at one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import Bools, Bytes, Floats, Ints
from occlog.core.image.ellipse import touching
from occlog.core.image.histogram_bins import update_bins
from occlog.filtering.particles import effective_size, normalise, systematic_ancestors
from occlog.track.images.interface import MODES, FrameSet, Image, Outlines, Visual
from occlog.track.images.kernels.ellipse_colour import colour_likeness
from occlog.track.images.kernels.joint_samples import crowding_of_samples, distinct_size, run_chain
from occlog.track.images.kernels.motion import boxes_of, covariance_and_ess, moved, weights_and_means
from occlog.track.images.kernels.patch_pca import PatchModels

from .appearance import log_patches
from .config import McmcConfig
from .regions import OwnRegions, log_region_likelihood, mask_outside, own_regions
from .state import (
    Trackers,
    VisualState,
    add_trackers,
    advance_clock,
    end_trackers,
    gaps,
    initial_state,
    keys_of,
)
from .step import end_events, motion_of

MODE = MODES.index("mcmc")

McmcState = VisualState[McmcConfig]


class ViewFrame(NamedTuple):
    """A frame of one view with n targets, and their trackers before it."""

    frames: FrameSet
    view: int
    image: Image
    bins: Bytes  # (H, W) space for its bins
    trackers: Trackers  # the n rows of the view
    gap: float  # frames since the last one
    models: list[PatchModels]  # n of their patches; none for `model=colour`
    own: OwnRegions  # a detector's regions that belong to one tracker only
    config: McmcConfig


class JointSamples(NamedTuple):
    """N samples of the joint posterior of the n targets of a view."""

    particles: Floats  # (n, N, 5)
    log_weights: Floats  # (N,)
    ess: Floats  # (n,)
    best: Floats  # (n,) likeness of the best place that was tried


def step(state: McmcState, frames: FrameSet, rng: Generator) -> tuple[McmcState, Outlines]:
    """Take in the frames of one time, see `occlog.track.images.interface.Visual.step`."""
    t, gap = state.trackers, gaps(state.clock, frames.t_ns)
    starts, parts, outlines = np.searchsorted(t.view, np.arange(len(state.views) + 1)), [], []
    for v, image in enumerate(frames.images):
        own = Trackers._make(field[starts[v] : starts[v + 1]] for field in t)
        if image is not None and len(own.view):
            own, said = _followed(view_frame(state, frames, v, image, own, gap[v]), len(state.views), rng)
            outlines.append(said)
        parts.append(own)
    after = Trackers._make(np.concatenate(fields) for fields in zip(*parts, strict=True))
    joined = _joined(outlines, len(state.views))
    return _without_ended(advance_clock(state._replace(trackers=after), frames), joined), joined


def view_frame(state: McmcState, frames: FrameSet, v: int, image: Image, t: Trackers, gap: float) -> ViewFrame:
    """A frame of view v, for its trackers `t`, `gap` frames after the last one."""
    expected = t.estimate.copy()
    expected[:, :2] += gap * t.velocity
    return ViewFrame(
        frames=frames,
        view=v,
        image=image,
        bins=state.bins[v],
        trackers=t,
        gap=gap,
        models=[state.appearance[key] for key in keys_of(t)] if state.config.model == "pca" else [],
        own=own_regions(frames, t.view, expected, state.config.region_reach),
        config=state.config,
    )


def _followed(frame: ViewFrame, views: int, rng: Generator) -> tuple[Trackers, Outlines]:
    """The trackers of a view after its frame, and their outlines."""
    t, config, n = frame.trackers, frame.config, len(frame.trackers.view)
    # Propose and weigh the targets of the view together
    samples = (run_mcmc if config.sampler == "mcmc" else run_sir)(frame, rng)
    # Estimate
    log_weights = np.broadcast_to(samples.log_weights, samples.particles.shape[:2])
    weights, mean = weights_and_means(samples.particles, log_weights)
    covariance, _ = covariance_and_ess(samples.particles, weights, mean)
    likeness = _likeness(frame, mean, np.arange(n))
    # Resample, update the velocity, and follow the size of the own region
    pace = (mean[:, :2] - t.estimate[:, :2]) / frame.gap
    size = np.where(frame.own.has[:, None], frame.own.region[:, 2:], t.axes)
    after = t._replace(
        axes=t.axes + config.region_axes * (size - t.axes),
        particles=_resampled(samples, rng) if config.sampler == "sir" else samples.particles,
        estimate=mean,
        velocity=config.keep_velocity * t.velocity + (1.0 - config.keep_velocity) * pace,
        weak=np.where(samples.best < config.lost_likeness, t.weak + 1, 0),
        likeness=likeness,
    )
    # Decide whose target left the image or was lost
    height, width = frame.bins.shape
    outlines = Outlines(
        view=t.view,
        target_id=t.target,
        ellipse=mean,
        covariance=covariance,
        likeness=likeness,
        ess=samples.ess,
        mode=np.full(n, MODE),
        counterpart=np.zeros(n, dtype=np.int64),
        touching=touching(mean),
        helpers=np.zeros((n, views), dtype=np.bool_),
        event=end_events(after, np.tile([float(width), float(height)], (n, 1)), config),
    )
    return after, outlines


def run_mcmc(frame: ViewFrame, rng: Generator) -> JointSamples:
    """Draw samples by a Markov chain that starts from a moved sample of the frame before."""
    t, config, n = frame.trackers, frame.config, len(frame.trackers.view)
    burn = round(config.burn * config.particles)
    moves = burn + config.particles * config.thin
    # Propose: all moves at once, each from a random sample of the frame before
    whose, source = rng.integers(0, n, moves), rng.integers(0, config.particles, moves + 1)
    owner = np.concatenate([np.arange(n), whose])
    before = t.particles[owner, np.concatenate([np.full(n, source[0]), source[1:]])]
    pool = _moved(frame, before, owner, rng)
    # Weigh: the local likelihood of each move
    likeness, log_likelihood = _weighed(frame, pool, owner)
    # Accept or reject: Metropolis-Hastings
    log_u = np.log1p(-rng.random(moves))
    rows = run_chain(pool, whose, log_likelihood, log_u, config.overlap, burn, config.thin)
    best = np.full(n, -np.inf)
    np.maximum.at(best, owner, likeness)
    return JointSamples(np.ascontiguousarray(pool[rows.T]), np.zeros(len(rows)), distinct_size(rows), best)


def run_sir(frame: ViewFrame, rng: Generator) -> JointSamples:
    """Move all samples of the frame before as wholes, and weigh them."""
    t, config = frame.trackers, frame.config
    n, count = t.particles.shape[:2]
    # Propose: by the motion
    owner = np.repeat(np.arange(n), count)
    ellipses = _moved(frame, t.particles.reshape(-1, 5), owner, rng)
    # Weigh: the product of the targets' likelihoods, times the prior against overlap
    likeness, log_likelihood = _weighed(frame, ellipses, owner)
    particles = ellipses.reshape(n, count, 5)
    log_weights = log_likelihood.reshape(n, count).sum(axis=0)
    log_weights -= config.overlap * crowding_of_samples(np.ascontiguousarray(particles.transpose(1, 0, 2)))
    ess = np.full(n, effective_size(normalise(log_weights)[0]))
    return JointSamples(particles, log_weights, ess, likeness.reshape(n, count).max(axis=1))


def _resampled(samples: JointSamples, rng: Generator) -> Floats:
    """(n, N, 5) samples of equal weight, drawn as wholes by systematic resampling."""
    ancestors = systematic_ancestors(normalise(samples.log_weights)[0], len(samples.log_weights), rng.random())
    return np.ascontiguousarray(samples.particles[:, ancestors])


def _moved(frame: ViewFrame, ellipses: Floats, owner: Ints, rng: Generator) -> Floats:
    """(P, 5) ellipses after the motion from (P, 5), of the targets `owner` (P,)."""
    t = frame.trackers
    gap, normals = np.full(len(owner), frame.gap), rng.standard_normal((len(owner), 1, 5))
    after = moved(
        ellipses[:, None],
        velocity=t.velocity[owner],
        axes=t.axes[owner],
        gap=gap,
        normals=normals,
        motion=motion_of(frame.config),
    )
    return np.asarray(after[:, 0])


def _weighed(frame: ViewFrame, ellipses: Floats, owner: Ints) -> tuple[Floats, Floats]:
    """Weigh ellipses locally, after the map of bins is brought up to date where they are.

    Args:
        frame: of the view.
        ellipses: (P, 5).
        owner: (P,) target of each.

    Returns:
        (P,) likeness and (P,) log likelihood.
    """
    boxes = np.concatenate([boxes_of(ellipses[None, owner == i]) for i in range(len(frame.trackers.view))])
    update_bins(frame.bins, frame.image, boxes, frame.config.pixel_step)
    mask_outside(frame.bins, boxes, frame.frames, frame.view)
    likeness = _likeness(frame, ellipses, owner)
    # p_c = exp(-(1 - BC) / (2 sigma^2)) of the Bhattacharyya coefficient BC
    log_likelihood = (likeness - 1.0) / (2.0 * frame.config.sigma_colour**2)
    if frame.models:
        log_likelihood += log_patches(frame.image, ellipses, owner, frame.models, frame.config)
    own = OwnRegions(frame.own.has[owner], frame.own.region[owner])
    return likeness, log_likelihood + log_region_likelihood(ellipses[:, None], own, frame.config.region_pull)[:, 0]


def _likeness(frame: ViewFrame, ellipses: Floats, owner: Ints) -> Floats:
    """(P,) likeness of ellipses where the map of bins is up to date."""
    t = frame.trackers
    return colour_likeness(frame.bins, ellipses, owner, t.colours, t.split, frame.config.pixel_step)


def _without_ended(state: McmcState, outlines: Outlines) -> McmcState:
    """The state without the trackers that ended with these outlines."""
    over = outlines.event > 0
    return end_trackers(state, list(zip(outlines.view[over].tolist(), outlines.target_id[over].tolist(), strict=True)))


def _joined(parts: list[Outlines], views: int) -> Outlines:
    """The outlines of all views in one; trackers of different views do not touch."""
    whole, floats = np.zeros(0, dtype=np.int64), np.zeros(0)
    none = Outlines(
        view=whole,
        target_id=whole,
        ellipse=np.zeros((0, 5)),
        covariance=np.zeros((0, 3)),
        likeness=floats,
        ess=floats,
        mode=whole,
        counterpart=whole,
        touching=np.zeros((0, 0), dtype=np.bool_),
        helpers=np.zeros((0, views), dtype=np.bool_),
        event=whole,
    )
    touch: Bools = np.zeros((sum(len(p.view) for p in parts),) * 2, dtype=np.bool_)
    first = 0
    for p in parts:
        touch[first : first + len(p.view), first : first + len(p.view)] = p.touching
        first += len(p.view)
    blocks = [p._replace(touching=none.touching) for p in (none, *parts)]
    return Outlines._make(np.concatenate(columns) for columns in zip(*blocks, strict=True))._replace(touching=touch)


MCMC: Visual[McmcState, McmcConfig] = Visual(
    config=McmcConfig,
    init=initial_state,
    born=add_trackers,
    step=step,
    ended=end_trackers,
)
