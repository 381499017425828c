"""One frame of all trackers, [Qu] Alg. 1: the steps that all methods but `mcmc` share.

A method differs in how it weighs particles, and in whether it draws them on epipolar lines,
checks the loop of views, learns colours and starts trackers again: see `Scheme`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import Bools, Floats, Ints
from occlog.core.image.histogram_bins import update_bins
from occlog.track.images.interface import LEFT, LOST, FrameSet, Outlines
from occlog.track.images.kernels.ellipse_colour import colour_likeness
from occlog.track.images.kernels.motion import EllipseMotion, boxes_of, covariance_and_ess, moved, resampled

from .appearance import log_appearance
from .config import MipfConfig
from .loop_check import counterpart_status
from .regions import OwnRegions, drawn_at_regions, log_region_likelihood, mask_outside, own_regions
from .state import LONGEST, C, Trackers, VisualState, advance_clock, ages, gaps, keep_trackers

FRESH = 1.5
"""Age [frame periods] below which the last estimate of a view without a frame still helps other views."""


class LocalWeights(NamedTuple):
    """Particles of n trackers after the proposal, and their local likelihoods."""

    here: Bools  # (n,) whether the view has a frame
    fresh: Bools  # (n,) whether the estimate is recent enough to help other views
    gap: Floats  # (n,) frames since the last one, 1 to `LONGEST`
    particles: Floats  # (n, N, 5)
    likeness: Floats  # (n, N) of the colours; 1 where there is no frame
    log_local: Floats  # (n, N) log p(z | x) of [Qu] Eq. 4 without its constant; 0 where there is no frame
    own: OwnRegions  # a detector's regions that belong to one tracker only


class Weighed(NamedTuple):
    """Weights of n trackers in one frame."""

    weights: Floats  # (n, N) w of [Qu] Eq. 4; each row sums to 1
    estimate: Floats  # (n, 5) weighted means
    touching: Bools  # (n, n)
    helped: Bools  # (n, V)
    mode: Ints  # (n,) place in `MODES`


class Scheme(NamedTuple, Generic[C]):
    """What a method does in each step; None: the method leaves the step out.

    Attributes:
        weigh: state before the frame, local weights and generator to weights.
        propose: state, particles (n, N, 5) after the motion, gap (n,) and generator to particles (n, N, 5).
        frozen: share of a displacement that enters the path while trackers touch.
        check_loops: state after the frame and (n,) which trackers have a frame, to trackers after a loop check.
        learn: state after the frame, weights, likeness (n,) of the estimates and (n,) which trackers have a
            frame, to trackers with other colours.
        restart: state after the frame and the frames, to a state with some trackers in new places.
    """

    weigh: Callable[[VisualState[C], LocalWeights, Generator], Weighed]
    propose: Callable[[VisualState[C], Floats, Floats, Generator], Floats] | None = None
    frozen: Callable[[C], float] | None = None
    check_loops: Callable[[VisualState[C], Bools], Trackers] | None = None
    learn: Callable[[VisualState[C], Weighed, Floats, Bools], Trackers] | None = None
    restart: Callable[[VisualState[C], FrameSet], VisualState[C]] | None = None


def advance(
    scheme: Scheme[C], state: VisualState[C], frames: FrameSet, rng: Generator
) -> tuple[VisualState[C], Outlines]:
    """Take in the frames of one time, see `occlog.track.images.interface.Visual.step`.

    Returns:
        The next state, without the trackers that ended, and the estimates of this time.
    """
    # Propose: draw from the state dynamics p(x_t | x_t-1), and weigh by the local likelihood p(z | x) ([Qu] Eq. 4)
    local = local_weights(scheme, state, frames, rng)
    # Weigh: interaction within views and collaboration between them ([Qu] Eqs. 4, 5 and 8); estimate the mean
    weighed = scheme.weigh(state, local, rng)
    # Resample: systematic ([Qu] Alg. 1)
    particles = resampled(local.particles, weighed.weights, rng.random(len(local.here)))
    # Update velocity and path, which [Qu] leaves to the state dynamics and the inertia model
    state = advance_clock(state, frames)
    likeness = _likeness(state, weighed.estimate[:, None], local.here)[:, 0]
    frozen = 1.0 if scheme.frozen is None else scheme.frozen(state.config)
    after = _updated(state.trackers, local, weighed, frozen, state.config)
    after = after._replace(particles=particles, likeness=likeness)
    state = state._replace(trackers=_where(local.here, after, state.trackers))
    # Check the loop of views ([Qu] Sec. 3.4.2)
    if scheme.check_loops is not None:
        state = state._replace(trackers=scheme.check_loops(state, local.here))
    # Learn appearance
    if scheme.learn is not None:
        state = state._replace(trackers=scheme.learn(state, weighed, likeness, local.here))
    # Decide whose target left the image or was lost: target tracker killing ([Qu] Sec. 3.4.3)
    size = np.array([(view.width, view.height) for view in state.views], dtype=np.float64)[state.trackers.view]
    event = np.where(local.here, end_events(state.trackers, size, state.config), 0)
    outlines = _outlines(state, local, weighed, likeness, event, checks=scheme.check_loops is not None)
    # Start again where a counterpart shows that a tracker is wrong ([Qu] Sec. 3.4.2 leaves open how)
    if scheme.restart is not None:
        state = scheme.restart(state, frames)
    return keep_trackers(state, event == 0), outlines


def local_weights(scheme: Scheme[C], state: VisualState[C], frames: FrameSet, rng: Generator) -> LocalWeights:
    """Move the particles of all trackers into the frames, and weigh them by the images alone."""
    t, config = state.trackers, state.config
    here = np.array([image is not None for image in frames.images])[t.view]
    age, gap = ages(state.clock, frames.t_ns)[t.view], gaps(state.clock, frames.t_ns)[t.view]
    # Propose: by the motion, p(x_t | x_t-1), over as many frames as are missing
    normals = rng.standard_normal(t.particles.shape)
    particles = moved(t.particles, velocity=t.velocity, axes=t.axes, gap=gap, normals=normals, motion=motion_of(config))
    if scheme.propose is not None:
        particles = scheme.propose(state, particles, gap, rng)
    # Propose: a share at the detector's region that belongs to the tracker alone
    expected = t.estimate.copy()
    expected[:, :2] += gap[:, None] * t.velocity
    own = own_regions(frames, t.view, expected, config.region_reach)
    particles = drawn_at_regions(particles, own, normals, config.region_share, config.region_spread)
    if not here.all():
        # Without a frame the particles of the last one go on at the tracker's velocity; they only help other views.
        waiting = t.particles.copy()
        waiting[..., :2] += (np.minimum(age, LONGEST)[:, None] * t.velocity)[:, None]
        particles = np.where(here[:, None, None], particles, waiting)
    # Weigh locally: p(z | x) = p_c p_p of colours and patches ([Qu] Sec. 3.3), times a pull to the own region
    boxes = boxes_of(particles)
    for v, image in enumerate(frames.images):
        if image is not None:
            update_bins(state.bins[v], image, boxes[t.view == v], config.pixel_step)
            mask_outside(state.bins[v], boxes[t.view == v], frames, v)
    likeness = _likeness(state, particles, here)
    # p_c = exp(-(1 - BC) / (2 sigma^2)) of the Bhattacharyya coefficient BC
    log_local = (likeness - 1.0) / (2.0 * config.sigma_colour**2)
    log_local += log_appearance(frames, particles, t.view, t.target, state.appearance, config)
    log_local += log_region_likelihood(particles, own, config.region_pull)
    return LocalWeights(here, here | (age < FRESH), gap, particles, likeness, log_local, own)


def motion_of(config: MipfConfig) -> EllipseMotion:
    """The motion model of the settings."""
    return EllipseMotion(
        sigma=config.sigma_px,
        keep=config.keep_axes,
        sigma_axes=config.sigma_axes_px,
        limit=config.axes_limit,
        sigma_rho=config.sigma_rho,
        keep_rho=config.keep_rho,
    )


def _likeness(state: VisualState[MipfConfig], ellipses: Floats, here: Bools) -> Floats:
    """(n, K) likeness of ellipses (n, K, 5) to their tracker's target; 1 where the view has no frame."""
    t = state.trackers
    out = np.ones(ellipses.shape[:2])
    starts = np.searchsorted(t.view, np.arange(len(state.views) + 1))
    for bins, first, last in zip(state.bins, starts[:-1], starts[1:], strict=True):
        if first < last and here[first]:
            flat = ellipses[first:last].reshape(-1, 5)
            owner = np.repeat(np.arange(last - first), ellipses.shape[1])
            rows = slice(first, last)
            found = colour_likeness(bins, flat, owner, t.colours[rows], t.split[rows], state.config.pixel_step)
            out[first:last] = found.reshape(last - first, -1)
    return out


def _updated(t: Trackers, local: LocalWeights, weighed: Weighed, frozen: float, config: MipfConfig) -> Trackers:
    """Trackers with the estimates of their frame, and with what follows from these.

    Args:
        t: n trackers before the frame.
        local: their particles.
        weighed: their weights and estimates.
        frozen: see `Scheme`.
        config: settings.
    """
    # Update the velocity: exponential mean of the displacements
    step = (weighed.estimate[:, :2] - t.estimate[:, :2]) / local.gap[:, None]
    velocity = config.keep_velocity * t.velocity + (1.0 - config.keep_velocity) * step
    # Update the path of which v_ref is the mean; while trackers touch their displacements say little of the target
    usual = t.path.mean(axis=1)
    entry = np.where(weighed.touching.any(axis=1, keepdims=True), usual + frozen * (step - usual), step)
    path = np.concatenate([t.path[:, 1:], entry[:, None]], axis=1)
    # Follow the size of the own region
    size = np.where(local.own.has[:, None], local.own.region[:, 2:], t.axes)
    axes = t.axes + config.region_axes * (size - t.axes)
    # Count the frames in a row in which no particle has the target's colours
    weak = np.where(local.likeness.max(axis=1) < config.lost_likeness, t.weak + 1, 0)
    return t._replace(axes=axes, estimate=weighed.estimate, velocity=velocity, path=path, weak=weak)


def _where(rows: Bools, one: Trackers, other: Trackers) -> Trackers:
    """Trackers of one set in the rows (n,), and of another elsewhere."""
    if rows.all():
        return one
    pairs = zip(one, other, strict=True)
    return Trackers._make(np.where(rows.reshape(-1, *[1] * (a.ndim - 1)), a, b) for a, b in pairs)


def end_events(t: Trackers, size: Floats, config: MipfConfig) -> Ints:
    """Which trackers end, [Qu] Sec. 3.4.3: `LEFT`, `LOST`, or 0 for those that go on.

    A target has left when the centre is outside the image, or when it was lost while the
    ellipse reaches over the edge.  It was lost when no particle has had its colours for
    `lost_after` frames in a row; but a tracker with a good counterpart goes on.

    Args:
        t: n trackers after the frame.
        size: (n, 2) width and height of each one's image [px].
        config: settings.
    """
    centre, reach = t.estimate[:, :2], t.estimate[:, 2:4].max(axis=1)[:, None]
    outside = ((centre < -0.5) | (centre > size - 0.5)).any(axis=1)
    over = ((centre < reach - 0.5) | (centre > size - 0.5 - reach)).any(axis=1)
    lost = (t.weak >= config.lost_after) & (config.lost_after > 0) & ~t.good.any(axis=1)
    return np.where(outside | (lost & over), LEFT, np.where(lost, LOST, 0))


def _outlines(
    state: VisualState[MipfConfig],
    local: LocalWeights,
    weighed: Weighed,
    likeness: Floats,
    event: Ints,
    checks: bool,
) -> Outlines:
    """Rows of the trackers whose views had a frame."""
    t, rows = state.trackers, np.flatnonzero(local.here)
    covariance, ess = covariance_and_ess(local.particles, weighed.weights, weighed.estimate)
    status = counterpart_status(t) if checks else np.zeros(len(t.view), dtype=np.int64)
    return Outlines(
        view=t.view[rows],
        target_id=t.target[rows],
        ellipse=weighed.estimate[rows],
        covariance=covariance[rows],
        likeness=likeness[rows],
        ess=ess[rows],
        mode=weighed.mode[rows],
        counterpart=status[rows],
        touching=weighed.touching[np.ix_(rows, rows)],
        helpers=weighed.helped[rows],
        event=event[rows],
    )
