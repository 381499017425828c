"""Samples that hold all targets of a view, of method `mcmc`; the baseline of [Qu] Table 2.

Two samplers draw from the same joint posterior (see `occlog.track.methods.images.kernels.joint_samples`):

    mcmc    Khan, Balch, Dellaert (ECCV 2004): a Markov chain that moves one target at a time, to
            where the motion takes it from a random sample of the frame before.  A sample costs
            one likelihood, whatever the number of targets.
    sir     importance sampling: all targets of a sample move at once, and the sample is weighed by
            the product of their likelihoods.  A sample costs a likelihood for each target, and
            its weight is good only if all of its targets are in good positions.

Views are not connected.  The prediction of a chain is the product over the targets of their
own predictions.  A sample of a view is in the same column of `particles` for all trackers of
the view.  A detector's regions count in the likelihood only: no sample restarts at one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import Floats, Ints
from occlog.core.image import touching
from occlog.filtering.particles import effective_sample_size, normalise_log_weights, systematic_ancestors
from occlog.track.methods.images.interface import MODES, FrameSet
from occlog.track.methods.images.kernels.joint_samples import crowding_of_samples, distinct_size, run_chain
from occlog.track.methods.images.kernels.motion import boxes_of, covariance_and_ess, moved, weights_and_means

from .config import McmcConfig
from .state import VisualState
from .weigh import FrameContext, TrackerParticles, local_likelihood, motion_of

MCMC = MODES.index("mcmc")


class ViewFrame(NamedTuple):
    """A frame of one view, and the n targets of that view before it: the input of a joint sampler.

    `state` and `arrival` are of all trackers of all views; `rows` (n,) are those of this view.
    """

    state: VisualState
    config: McmcConfig
    frames: FrameSet
    arrival: FrameContext
    rows: Ints  # (n,) rows of the view's trackers


class ViewSamples(NamedTuple):
    """N samples of the joint posterior of the n targets of a view, with weights common to all targets.

    `particles` (n, N, 5): ellipses; column k is joint sample k. `log_weights` (N,): unnormalised. `ess` (n,): effective
    sample sizes. `best` (n,): colour similarity of the best position tried for each target.
    """

    particles: Floats  # (n, N, 5)
    log_weights: Floats  # (N,)
    ess: Floats  # (n,)
    best: Floats  # (n,) similarity of the best position that was tried


def joint_samples(
    state: VisualState, config: McmcConfig, frames: FrameSet, arrival: FrameContext, rng: Generator
) -> TrackerParticles:
    """Return particles and estimates of all trackers after a frame, sampling the targets of each view jointly.

    The sampler is a Markov chain (`config.sampler` "mcmc"), or sampling, weighting and resampling ("sir").

    Args:
        state: trackers before the frame; its colour maps are updated in place.
        config: settings of the method.
        frames: frames of one time step, at most one for each view.
        arrival: which of the n trackers have a frame; the particles and estimates of the others stay.
        rng: generator of the random numbers drawn.
    """
    t = state.trackers
    n, count = t.particles.shape[:2]
    out = TrackerParticles(
        weights=np.full((n, count), 1.0 / count),
        estimate=t.estimate.copy(),
        touching=np.zeros((n, n), dtype=np.bool_),
        helped=np.zeros(t.counterpart.shape, dtype=np.bool_),
        mode=np.full(n, MCMC),
        covariance=np.zeros((n, 3)),
        ess=np.full(n, float(count)),
        best=np.ones(n),
        resampled=t.particles.copy(),
    )
    for v in range(len(state.views)):
        rows = np.flatnonzero((t.view == v) & arrival.here)
        if not len(rows):
            continue
        frame = ViewFrame(state, config, frames, arrival, rows)
        drawn = (run_mcmc if config.sampler == "mcmc" else run_sir)(frame, rng)
        log_weights = np.broadcast_to(drawn.log_weights, drawn.particles.shape[:2])
        out.weights[rows], mean = weights_and_means(drawn.particles, log_weights)
        out.estimate[rows], out.ess[rows], out.best[rows] = mean, drawn.ess, drawn.best
        out.covariance[rows], _ = covariance_and_ess(drawn.particles, out.weights[rows], mean)
        out.touching[np.ix_(rows, rows)] = touching(mean)
        out.resampled[rows] = _resampled(drawn, rng) if config.sampler == "sir" else drawn.particles
    return out


def run_mcmc(frame: ViewFrame, rng: Generator) -> ViewSamples:
    """Return samples of a Markov chain over the joint positions of the view's targets, started from a predicted sample.

    The log weights are 0, as all samples of a chain weigh the same.
    """
    config, n = frame.config, len(frame.rows)
    burn = round(config.burn_in * config.particles)
    moves = burn + config.particles * config.thin
    # Propose: all moves at once, each from a random sample of the frame before
    changed, source = rng.integers(0, n, moves), rng.integers(0, config.particles, moves + 1)
    owner = np.concatenate([np.arange(n), changed])
    sample = np.concatenate([np.full(n, source[0]), source[1:]])
    pool = _moved(frame, frame.state.trackers.particles[frame.rows[owner], sample], owner, rng)
    # Weigh: the local likelihood of each move
    similarities, log_likelihood = _weighed(frame, pool, owner)
    # Accept or reject: Metropolis-Hastings
    log_u = np.log1p(-rng.random(moves))
    rows = run_chain(pool, changed, log_likelihood, log_u, config.overlap_penalty, burn, config.thin)
    best = np.full(n, -np.inf)
    np.maximum.at(best, owner, similarities)
    return ViewSamples(np.ascontiguousarray(pool[rows.T]), np.zeros(len(rows)), distinct_size(rows), best)


def run_sir(frame: ViewFrame, rng: Generator) -> ViewSamples:
    """Return the joint samples of the frame before, predicted to this one and weighted by their likelihoods.

    This is sequential importance resampling without the resampling.
    """
    before = frame.state.trackers.particles[frame.rows]
    n, count = before.shape[:2]
    # Propose: by the motion
    owner = np.repeat(np.arange(n), count)
    ellipses = _moved(frame, before.reshape(-1, 5), owner, rng)
    # Weigh: the product of the targets' likelihoods, times the prior against overlap
    similarities, log_likelihood = _weighed(frame, ellipses, owner)
    particles = ellipses.reshape(n, count, 5)
    log_weights = log_likelihood.reshape(n, count).sum(axis=0)
    log_weights -= frame.config.overlap_penalty * crowding_of_samples(
        np.ascontiguousarray(particles.transpose(1, 0, 2))
    )
    ess = np.full(n, effective_sample_size(normalise_log_weights(log_weights)[0]))
    return ViewSamples(particles, log_weights, ess, similarities.reshape(n, count).max(axis=1))


def _resampled(samples: ViewSamples, rng: Generator) -> Floats:
    """Return (n, N, 5) joint samples of equal weight, resampled systematically by their weights."""
    ancestors = systematic_ancestors(
        normalise_log_weights(samples.log_weights)[0], len(samples.log_weights), rng.random()
    )
    return np.ascontiguousarray(samples.particles[:, ancestors])


def _moved(frame: ViewFrame, ellipses: Floats, owner: Ints, rng: Generator) -> Floats:
    """Return (P, 5) ellipses drawn from the motion model for this frame, starting at `ellipses` (P, 5).

    Ellipse p is of the view's target `owner[p]`, 0 to n - 1, and moves at the velocity of its tracker.
    """
    t, rows = frame.state.trackers, frame.rows[owner]
    after = moved(
        ellipses[:, None],
        velocity=t.velocity[rows],
        axes=t.axes[rows],
        gap=frame.arrival.gap[rows],
        normals=rng.standard_normal((len(owner), 1, 5)),
        motion=motion_of(frame.config),
    )
    return np.asarray(after[:, 0])


def _weighed(frame: ViewFrame, ellipses: Floats, owner: Ints) -> tuple[Floats, Floats]:
    """Return (P,) colour similarities, 0 to 1, and (P,) local log likelihoods of `ellipses` (P, 5) in the view's frame.

    Ellipse p is of the view's target `owner[p]`, 0 to n - 1.
    """
    boxes = np.concatenate([boxes_of(ellipses[None, owner == i]) for i in range(len(frame.rows))])
    return local_likelihood(frame.state, frame.frames, frame.arrival.own, boxes, ellipses, frame.rows[owner])
