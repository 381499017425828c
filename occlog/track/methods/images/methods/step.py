"""One frame of all trackers, [Qu] Alg. 1: the scheme of all methods, of which each has some parts.

    propose      motion; a share on epipolar lines; a share at regions of a detector
    weigh        local likelihood; interaction of trackers that touch; collaboration of the views
    estimate     mean of the particles, and resampling
    update       velocity, path, loop check of the views, colours
    end          targets that left the image or were lost; restart on an epipolar line

The class of a method's settings states which parts it has, see `occlog.track.methods.images.methods.config`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.random import Generator

from occlog.array_types import Bools, Floats, Ints
from occlog.track.methods.images.interface import LEFT, TERMINATED, Birth, FrameSet, TrackerOutlines

from .config import BmctConfig, CmctConfig, IdmotConfig, LoopCheckConfig, McmcConfig, MipfConfig
from .joint import joint_samples
from .restart import adapt_colours, check_loops, check_new_pairs, counterpart_status, restart_one
from .state import ImageTrackers, VisualState, add_trackers, advance_clock, keep_trackers
from .weigh import FrameContext, TrackerParticles, arrival_of, local_weights, similarity_of_estimates, weigh


def initiate_trackers(state: VisualState, frames: FrameSet, births: Sequence[Birth]) -> VisualState:
    """Return the state with a tracker for each birth; the view of each must have a frame (else ValueError).

    A method with the loop check makes the first check of the new pairs of counterparts at once.
    """
    state, config = add_trackers(state, frames, births), state.config
    if isinstance(config, LoopCheckConfig):
        state = state._replace(trackers=check_new_pairs(state, config))
    return state


def advance(state: VisualState, frames: FrameSet, rng: Generator) -> tuple[VisualState, TrackerOutlines]:
    """Update all trackers with the frames of one time step, which must be later than those of their births.

    Args:
        state: state before; its buffers belong to the next state afterwards, so do not use it again.
        frames: frames of the time step, at most one for each view.
        rng: generator of all random numbers drawn.

    Returns:
        The next state, without the trackers that ended, and the ellipses of all trackers with a frame in this time
        step.
    """
    config, arrival = state.config, arrival_of(state, frames)
    # Propose, weigh, estimate, resample
    if isinstance(config, McmcConfig):
        samples = joint_samples(state, config, frames, arrival, rng)
    else:
        samples = weigh(state, arrival, local_weights(state, frames, arrival, rng), rng)
    return advance_with(state, frames, arrival, samples)


def advance_with(
    state: VisualState, frames: FrameSet, arrival: FrameContext, samples: TrackerParticles
) -> tuple[VisualState, TrackerOutlines]:
    """Update all trackers with particles that were already proposed and weighted: the second half of `advance`.

    Args:
        state: state before; not to be used again.
        frames: frames of the time step.
        arrival: which trackers have a frame, and the time since their last one.
        samples: weighted and resampled particles of all trackers.

    Returns:
        The next state, without the trackers that ended, and the ellipses of all trackers with a frame in this time
        step.
    """
    config, here = state.config, arrival.here
    after = _updated(state.trackers, arrival, samples, config)
    state = advance_clock(state._replace(trackers=_where(here, after, state.trackers)), frames)
    similarities = np.where(here, similarity_of_estimates(state, here), state.trackers.similarities)
    state = state._replace(trackers=state.trackers._replace(similarities=similarities))
    # Check the loop of views ([Qu] Sec. 3.4.2)
    if isinstance(config, LoopCheckConfig):
        state = state._replace(trackers=check_loops(state, config, here))
    # Learn appearance
    if isinstance(config, CmctConfig):
        state = state._replace(trackers=adapt_colours(state, config, here))
    # Decide which targets left the image or were lost: target tracker killing ([Qu] Sec. 3.4.3)
    size = np.array([(view.width, view.height) for view in state.views], dtype=np.float64)[state.trackers.view]
    event = np.where(here, end_events(state.trackers, size, config), 0)
    outlines = _outlines(state, here, samples, event)
    # Restart where a counterpart shows that a tracker is wrong ([Qu] Sec. 3.4.2 leaves open how)
    if isinstance(config, BmctConfig):
        state = restart_one(state, config, frames)
    return keep_trackers(state, event == 0), outlines


def _updated(t: ImageTrackers, arrival: FrameContext, samples: TrackerParticles, config: MipfConfig) -> ImageTrackers:
    """Return the trackers with this frame's particles and estimates, and with updated velocity, path and size.

    The counter `weak` of frames in which no particle has the target's colours is updated, too.

    Args:
        t: trackers before the frame.
        arrival: frames since the last one of each tracker, and its own detected region.
        samples: weighted and resampled particles.
        config: settings of the method.
    """
    # Update the velocity: exponential mean of the displacements
    step = (samples.estimate[:, :2] - t.estimate[:, :2]) / arrival.gap[:, None]
    velocity = config.keep_velocity * t.velocity + (1.0 - config.keep_velocity) * step
    # Update the path of which v_ref is the mean; while trackers touch their displacements say little of the target
    frozen = config.frozen if isinstance(config, IdmotConfig) else 1.0
    usual = t.path.mean(axis=1)
    entry = np.where(samples.touching.any(axis=1, keepdims=True), usual + frozen * (step - usual), step)
    # Follow the size of the own region
    size = np.where(arrival.own.has[:, None], arrival.own.region[:, 2:], t.axes)
    return t._replace(
        particles=samples.resampled,
        axes=t.axes + config.region_axes * (size - t.axes),
        estimate=samples.estimate,
        velocity=velocity,
        path=np.concatenate([t.path[:, 1:], entry[:, None]], axis=1),
        # Count the frames in a row in which no particle has the target's colours
        weak=np.where(samples.best < config.lost_similarity, t.weak + 1, 0),
    )


def _where(rows: Bools, one: ImageTrackers, other: ImageTrackers) -> ImageTrackers:
    """Return trackers merged from two sets of n: those with `rows` (n,) true from `one`, the rest from `other`."""
    if rows.all():
        return one
    pairs = zip(one, other, strict=True)
    return ImageTrackers._make(np.where(rows.reshape(-1, *[1] * (a.ndim - 1)), a, b) for a, b in pairs)


def end_events(t: ImageTrackers, size: Floats, config: MipfConfig) -> Ints:
    """Return (n,) end events of the trackers, [Qu] Sec. 3.4.3: `LEFT`, `TERMINATED`, or 0 for those that go on.

    A target has left when the centre is outside the image, or when it was lost while the ellipse reaches over the edge.
    It was lost when no particle has had its colours for `max_lost_frames` frames in a row (0: never); but a tracker
    with a good counterpart in another view goes on.

    Args:
        t: n trackers after the frame.
        size: (n, 2) width and height of each tracker's image [px].
        config: settings of the method.
    """
    centre, reach = t.estimate[:, :2], t.estimate[:, 2:4].max(axis=1)[:, None]
    outside = ((centre < -0.5) | (centre > size - 0.5)).any(axis=1)
    over = ((centre < reach - 0.5) | (centre > size - 0.5 - reach)).any(axis=1)
    lost = (t.weak >= config.max_lost_frames) & (config.max_lost_frames > 0) & ~t.good.any(axis=1)
    return np.where(outside | (lost & over), LEFT, np.where(lost, TERMINATED, 0))


def _outlines(state: VisualState, here: Bools, samples: TrackerParticles, event: Ints) -> TrackerOutlines:
    """Return the output ellipses of the trackers `here` (n,), which have a frame of their view in this time step.

    Args:
        state: state after the frame, still with the trackers that end.
        here: (n,) whether the tracker's view has a frame.
        samples: estimates and particles of all trackers.
        event: (n,) end event of each tracker, 0: it goes on.
    """
    t, rows, checked = state.trackers, np.flatnonzero(here), isinstance(state.config, LoopCheckConfig)
    return TrackerOutlines(
        view=t.view[rows],
        target_id=t.target[rows],
        ellipse=samples.estimate[rows],
        covariance=samples.covariance[rows],
        similarity=t.similarities[rows],
        ess=samples.ess[rows],
        likelihood_mode=samples.mode[rows],
        counterpart=counterpart_status(t)[rows] if checked else np.zeros(len(rows), dtype=np.int64),
        touching=samples.touching[np.ix_(rows, rows)],
        assisting_views=samples.helped[rows],
        lifecycle=event[rows],
    )
