"""One frame of all trackers in images, but for how a method weighs their particles, [Qu] Alg. 1."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import Bools, Floats, Ints
from occlog.core.image.histogram_bins import update_bins
from occlog.track.images.interface import LEFT, LOST, Looks, Outlines
from occlog.track.images.kernels.motion import Motion, boxes_of, moved, resampled, spreads

from .appearance import log_appearance
from .colours import alike
from .loop_check import counterparts, looped
from .regions import Held, drawn, held, mask_outside, pull
from .state import LONGEST, State, Trackers, ages, chosen, gaps, seen


class Moment(NamedTuple):
    """What is known of all n trackers when their particles have moved."""

    here: Bools  # (n,) whether the view has a frame
    fresh: Bools  # (n,) whether the last frame is recent enough to help other views
    gap: Floats  # (n,) frames since the last one
    particles: Floats  # (n, N, 5)
    likeness: Floats  # (n, N) 1 where there is no frame
    log_local: Floats  # (n, N) 0 where there is no frame
    held: Held  # regions of a detector that are the trackers' own


class Weighed(NamedTuple):
    """What a method makes of it."""

    weights: Floats  # (n, N)
    estimate: Floats  # (n, 5)
    touching: Bools  # (n, n)
    helped: Bools  # (n, V)
    mode: Ints  # (n,)


Propose = Callable[[State, Floats, Floats, Generator], Floats]
"""State, particles (n, N, 5) moved, gap: the particles to be weighed."""
Weigh = Callable[[State, Moment, Generator], Weighed]
Learn = Callable[[State, Weighed, Floats, Bools], Trackers]
"""State, weighed, likeness of the estimates and `here`: trackers with colours brought up to date."""


class Scheme(NamedTuple):
    """What makes a method."""

    weigh: Weigh
    loop: bool  # whether it checks counterparts
    propose: Propose | None = None
    learn: Learn | None = None
    again: Callable[[State, Looks], State] | None = None  # starts trackers again


def advance(scheme: Scheme, state: State, looks: Looks, rng: Generator) -> tuple[State, Outlines]:
    """The next state and the estimates, see `occlog.track.images.interface.Visual.step`."""
    moment = moment_of(scheme, state, looks, rng)
    weighed = scheme.weigh(state, moment, rng)
    u = rng.random(len(moment.here))
    state = seen(state, looks)
    likeness = _alike(state, weighed.estimate[:, None], moment.here)[:, 0]
    after = _after(state.trackers, moment, weighed, likeness, u, state.config)
    state = state._replace(trackers=after)
    if scheme.loop:
        state = state._replace(trackers=looped(state, moment.here & moment.fresh))
    if scheme.learn is not None:
        state = state._replace(trackers=scheme.learn(state, weighed, likeness, moment.here))
    event = _events(scheme, state, moment.here)
    outlines = _outlines(scheme, state, moment, weighed, likeness, event)
    if scheme.again is not None:
        state = scheme.again(state, looks)
    return chosen(state, event == 0), outlines


def moment_of(scheme: Scheme, state: State, looks: Looks, rng: Generator) -> Moment:
    """The particles of all trackers moved into a frame, and what the images say of them."""
    t, config = state.trackers, state.config
    here = np.array([image is not None for image in looks.images])[t.view]
    age, gap = (since(state.clock, looks.t_ns)[t.view] for since in (ages, gaps))
    normals = rng.standard_normal(t.particles.shape)
    motion = Motion(
        config.sigma_px, config.keep_axes, config.sigma_axes_px, config.axes_limit, config.sigma_rho, config.keep_rho
    )
    particles = moved(t.particles, t.velocity, t.axes, gap, normals, motion)
    if scheme.propose is not None:
        particles = scheme.propose(state, particles, gap, rng)
    expected = t.estimate.copy()
    expected[:, :2] += gap[:, None] * t.velocity
    found = held(looks, t.view, expected, config.region_reach)
    particles = drawn(particles, found, normals, config.region_share, config.region_spread)
    if not here.all():
        waiting = t.particles.copy()
        waiting[..., :2] += (np.minimum(age, LONGEST)[:, None] * t.velocity)[:, None]
        particles = np.where(here[:, None, None], particles, waiting)
    boxes = boxes_of(particles)
    for v, image in enumerate(looks.images):
        if image is not None:
            update_bins(state.bins[v], image, boxes[t.view == v], config.pixel_step)
            mask_outside(state.bins[v], boxes[t.view == v], looks, v)
    likeness = _alike(state, particles, here)
    log_local = (likeness - 1.0) / (2.0 * config.sigma_colour**2)
    log_local += log_appearance(looks, particles, t.view, t.target, state.memories, config)
    log_local += pull(particles, found, config.region_pull)
    return Moment(here, here | (age < 1.5), gap, particles, likeness, log_local, found)


def _alike(state: State, ellipses: Floats, here: Bools) -> Floats:
    """(n, K) likeness of ellipses (n, K, 5) with their tracker's target; 1 where the view has no frame."""
    t = state.trackers
    out = np.ones(ellipses.shape[:2])
    starts = np.searchsorted(t.view, np.arange(len(state.views) + 1))
    for bins, first, last in zip(state.bins, starts[:-1], starts[1:], strict=True):
        if first < last and here[first]:
            flat = ellipses[first:last].reshape(-1, 5)
            owner = np.repeat(np.arange(last - first), ellipses.shape[1])
            rows = slice(first, last)
            found = alike(bins, flat, owner, t.colours[rows], t.split[rows], state.config.pixel_step)
            out[first:last] = found.reshape(last - first, -1)
    return out


def _after(t: Trackers, moment: Moment, weighed: Weighed, likeness: Floats, u: Floats, config: Any) -> Trackers:
    """Trackers after their frame; those whose view has none stay as they were."""
    step = (weighed.estimate[:, :2] - t.estimate[:, :2]) / moment.gap[:, None]
    keep = config.keep_velocity
    best = moment.likeness.max(axis=1)
    frozen = getattr(config, "frozen", 1.0)
    usual = t.path.mean(axis=1)
    entry = np.where(weighed.touching.any(axis=1, keepdims=True), usual + frozen * (step - usual), step)
    path = np.concatenate([t.path[:, 1:], entry[:, None]], axis=1)
    size = np.where(moment.held.has[:, None], moment.held.region[:, 2:], t.axes)
    after = t._replace(
        axes=t.axes + config.region_axes * (size - t.axes),
        particles=resampled(moment.particles, weighed.weights, u),
        estimate=weighed.estimate,
        velocity=keep * t.velocity + (1.0 - keep) * step,
        path=path,
        weak=np.where(best < config.lost_likeness, t.weak + 1, 0),
        likeness=likeness,
    )
    return after if moment.here.all() else _where(moment.here, after, t)


def _where(rows: Bools, one: Trackers, other: Trackers) -> Trackers:
    """Trackers of one set in these rows, and of another elsewhere."""
    pairs = zip(one, other, strict=True)
    return Trackers._make(np.where(rows.reshape(-1, *[1] * (a.ndim - 1)), a, b) for a, b in pairs)


def _events(scheme: Scheme, state: State, here: Bools) -> Ints:
    """(n,) `LEFT` for trackers whose target left the image, `LOST` for those that lost it; 0: go on."""
    t, config = state.trackers, state.config
    size = np.array([(view.width, view.height) for view in state.views], dtype=np.float64)[t.view]
    centre, reach = t.estimate[:, :2], t.estimate[:, 2:4].max(axis=1)[:, None]
    outside = ((centre < -0.5) | (centre > size - 0.5)).any(axis=1)
    over = ((centre < reach - 0.5) | (centre > size - 0.5 - reach)).any(axis=1)
    lost = (t.weak >= config.lost_after) & bool(config.lost_after)
    if scheme.loop:
        lost &= ~t.good.any(axis=1)
    return np.where(here & (outside | (lost & over)), LEFT, np.where(here & lost, LOST, 0))


def _outlines(
    scheme: Scheme, state: State, moment: Moment, weighed: Weighed, likeness: Floats, event: Ints
) -> Outlines:
    """Rows of the trackers whose views had a frame."""
    t, rows = state.trackers, np.flatnonzero(moment.here)
    covariance, ess = spreads(moment.particles, weighed.weights, weighed.estimate)
    checked = counterparts(t) if scheme.loop else np.zeros(len(t.view), dtype=np.int64)
    return Outlines(
        t.view[rows],
        t.target[rows],
        weighed.estimate[rows],
        covariance[rows],
        likeness[rows],
        ess[rows],
        weighed.mode[rows],
        checked[rows],
        weighed.touching[np.ix_(rows, rows)],
        weighed.helped[rows],
        event[rows],
    )
