"""`mcmc`: one filter a view whose samples hold all of its targets, the baseline of [Qu] Table 2.

Two samplers of the same joint posterior (see `occlog.track.images.kernels.joint_samples`):

    mcmc    Khan, Balch, Dellaert (ECCV 2004): a Markov chain that moves one target at a time, to
            where the motion takes it from a sample of the frame before drawn at random.  A sample
            costs one likelihood, whatever the number of targets.
    sir     importance sampling: all targets of a sample move at once, and it is weighed by the
            product of their likelihoods.  A sample costs a likelihood for each target, and its
            weight is good only if all of its targets are in good places.

Views are not connected.  The prediction of a chain is the product over the targets of their
own predictions.  A sample of a view is in the same column of `particles` for all trackers of
the view.  Regions of a detector count in the likelihood only: no sample starts anew at one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import Bools, Floats, Ints
from occlog.core.filter.log_weights import effective_size, normalise
from occlog.core.filter.resampling import systematic_ancestors
from occlog.core.image.ellipse import touching
from occlog.core.image.histogram_bins import update_bins
from occlog.track.images.interface import LEFT, LOST, MODES, Image, Looks, Outlines, Visual
from occlog.track.images.kernels.joint_samples import crowding_of_samples, distinct_size, run_chain
from occlog.track.images.kernels.motion import Motion, boxes_of, moved, spreads, summed
from occlog.track.images.kernels.patch_pca import PatchModels

from .appearance import log_patches
from .colours import alike
from .config import McmcConfig
from .regions import Held, held, mask_outside, pull
from .state import State, Trackers, born, empty, ended, gaps, seen

MODE = MODES.index("mcmc")


class Panel(NamedTuple):
    """A frame of one view with n targets, and the samples before it."""

    looks: Looks
    view: int
    image: Image
    bins: Image  # (H, W) space for its bins
    trackers: Trackers  # the n rows of the view
    gap: float  # frames since the last one
    models: list[PatchModels]  # n of their patches; none for `model=colour`
    held: Held  # regions of a detector that are the trackers' own
    config: McmcConfig


class Cloud(NamedTuple):
    """What a sampler makes of it."""

    particles: Floats  # (n, N, 5)
    log_weights: Floats  # (N,)
    ess: Floats  # (n,)
    best: Floats  # (n,) likeness of the best place that was tried


def step(state: State, looks: Looks, rng: Generator) -> tuple[State, Outlines]:
    """The state after the frames of one time, and what it says."""
    t, gap = state.trackers, gaps(state.clock, looks.t_ns)
    starts, parts, outlines = np.searchsorted(t.view, np.arange(len(state.views) + 1)), [], []
    for v, image in enumerate(looks.images):
        own = Trackers._make(field[starts[v] : starts[v + 1]] for field in t)
        if image is not None and len(own.view):
            own, said = _followed(panel_of(state, looks, v, image, own, gap[v]), len(state.views), rng)
            outlines.append(said)
        parts.append(own)
    after = Trackers._make(np.concatenate(fields) for fields in zip(*parts, strict=True))
    joined = _joined(outlines, len(state.views))
    return _without_ended(seen(state._replace(trackers=after), looks), joined), joined


def panel_of(state: State, looks: Looks, v: int, image: Image, t: Trackers, gap: float) -> Panel:
    """A frame of one view, for its trackers `t`, `gap` frames after the last one."""
    expected = t.estimate.copy()
    expected[:, :2] += gap * t.velocity
    found = held(looks, t.view, expected, state.config.region_reach)
    return Panel(looks, v, image, state.bins[v], t, gap, _models(state, t), found, state.config)


def _followed(panel: Panel, views: int, rng: Generator) -> tuple[Trackers, Outlines]:
    """The trackers of a view after its frame, and what they say."""
    t, config, n = panel.trackers, panel.config, len(panel.trackers.view)
    cloud = (run_mcmc if config.sampler == "mcmc" else run_sir)(panel, rng)
    weights, mean = summed(cloud.particles, np.broadcast_to(cloud.log_weights, cloud.particles.shape[:2]))
    covariance, _ = spreads(cloud.particles, weights, mean)
    likeness = _likeness(panel, mean, np.arange(n))
    pace = (mean[:, :2] - t.estimate[:, :2]) / panel.gap
    size = np.where(panel.held.has[:, None], panel.held.region[:, 2:], t.axes)
    after = t._replace(
        axes=t.axes + config.region_axes * (size - t.axes),
        particles=_equal(cloud, rng) if config.sampler == "sir" else cloud.particles,
        estimate=mean,
        velocity=config.keep_velocity * t.velocity + (1.0 - config.keep_velocity) * pace,
        weak=np.where(cloud.best < config.lost_likeness, t.weak + 1, 0),
        likeness=likeness,
    )
    none = np.zeros(n, dtype=np.int64)
    helpers = np.zeros((n, views), dtype=np.bool_)
    event = _events(after, panel)
    said = Outlines(
        t.view, t.target, mean, covariance, likeness, cloud.ess, none + MODE, none, touching(mean), helpers, event
    )
    return after, said


def run_mcmc(panel: Panel, rng: Generator) -> Cloud:
    """A Markov chain that starts from a sample of the frame before, moved."""
    t, config, n = panel.trackers, panel.config, len(panel.trackers.view)
    burn = round(config.burn * config.particles)
    moves = burn + config.particles * config.thin
    whose, source = rng.integers(0, n, moves), rng.integers(0, config.particles, moves + 1)
    owner = np.concatenate([np.arange(n), whose])
    before = t.particles[owner, np.concatenate([np.full(n, source[0]), source[1:]])]
    pool = _moved(panel, before, owner, rng)
    likeness, log_likelihood = _weighed(panel, pool, owner)
    log_u = np.log1p(-rng.random(moves))
    rows = run_chain(pool, whose, log_likelihood, log_u, config.overlap, burn, config.thin)
    best = np.full(n, -np.inf)
    np.maximum.at(best, owner, likeness)
    return Cloud(np.ascontiguousarray(pool[rows.T]), np.zeros(len(rows)), distinct_size(rows), best)


def run_sir(panel: Panel, rng: Generator) -> Cloud:
    """All samples of the frame before moved as a whole, and weighed."""
    t, config = panel.trackers, panel.config
    n, count = t.particles.shape[:2]
    owner = np.repeat(np.arange(n), count)
    ellipses = _moved(panel, t.particles.reshape(-1, 5), owner, rng)
    likeness, log_likelihood = _weighed(panel, ellipses, owner)
    particles = ellipses.reshape(n, count, 5)
    log_weights = log_likelihood.reshape(n, count).sum(axis=0)
    log_weights -= config.overlap * crowding_of_samples(np.ascontiguousarray(particles.transpose(1, 0, 2)))
    ess = np.full(n, effective_size(normalise(log_weights)[0]))
    return Cloud(particles, log_weights, ess, likeness.reshape(n, count).max(axis=1))


def _equal(cloud: Cloud, rng: Generator) -> Floats:
    """(n, N, 5) samples of equal weight, drawn as wholes."""
    ancestors = systematic_ancestors(normalise(cloud.log_weights)[0], len(cloud.log_weights), rng.random())
    return np.ascontiguousarray(cloud.particles[:, ancestors])


def _moved(panel: Panel, ellipses: Floats, owner: Ints, rng: Generator) -> Floats:
    """(P, 5) where the motion takes ellipses of the targets."""
    c, t = panel.config, panel.trackers
    motion = Motion(c.sigma_px, c.keep_axes, c.sigma_axes_px, c.axes_limit, c.sigma_rho, c.keep_rho)
    gap, normals = np.full(len(owner), panel.gap), rng.standard_normal((len(owner), 1, 5))
    return np.asarray(moved(ellipses[:, None], t.velocity[owner], t.axes[owner], gap, normals, motion)[:, 0])


def _weighed(panel: Panel, ellipses: Floats, owner: Ints) -> tuple[Floats, Floats]:
    """(P,) likeness and log likelihood of ellipses of the targets; the map is brought up to date where they are."""
    boxes = [boxes_of(ellipses[None, owner == i]) for i in range(len(panel.trackers.view))]
    update_bins(panel.bins, panel.image, np.concatenate(boxes), panel.config.pixel_step)
    mask_outside(panel.bins, np.concatenate(boxes), panel.looks, panel.view)
    likeness = _likeness(panel, ellipses, owner)
    log_likelihood = (likeness - 1.0) / (2.0 * panel.config.sigma_colour**2)
    if panel.models:
        log_likelihood += log_patches(panel.image, ellipses, owner, panel.models, panel.config)
    mine = Held(panel.held.has[owner], panel.held.region[owner])
    return likeness, log_likelihood + pull(ellipses[:, None], mine, panel.config.region_pull)[:, 0]


def _models(state: State, t: Trackers) -> list[PatchModels]:
    """Of the patches of trackers."""
    pairs = zip(t.view.tolist(), t.target.tolist(), strict=True)
    return [state.memories[pair] for pair in pairs] if state.config.model == "pca" else []


def _likeness(panel: Panel, ellipses: Floats, owner: Ints) -> Floats:
    """(P,) of ellipses among those that the map was brought up to date for."""
    return alike(panel.bins, ellipses, owner, panel.trackers.colours, panel.trackers.split, panel.config.pixel_step)


def _events(t: Trackers, panel: Panel) -> Ints:
    """(n,) `LEFT` for targets out of the image, or half out of it and not seen; `LOST` for those not seen inside."""
    height, width = panel.bins.shape
    size = np.array([width, height], dtype=np.float64)
    centre, reach = t.estimate[:, :2], t.estimate[:, 2:4].max(axis=1)[:, None]
    outside = ((centre < -0.5) | (centre > size - 0.5)).any(axis=1)
    over = ((centre < reach - 0.5) | (centre > size - 0.5 - reach)).any(axis=1)
    lost = (t.weak >= panel.config.lost_after) & (panel.config.lost_after > 0)
    return np.where(outside | (lost & over), LEFT, np.where(lost, LOST, 0))


def _without_ended(state: State, said: Outlines) -> State:
    """The state without the trackers that ended."""
    if not said.event.any():
        return state
    over = said.event > 0
    return ended(state, list(zip(said.view[over].tolist(), said.target_id[over].tolist(), strict=True)))


def _joined(parts: list[Outlines], views: int) -> Outlines:
    """The outlines of all views; trackers of different views do not touch."""
    whole, flags, floats = np.zeros(0, dtype=np.int64), np.zeros((0, views), dtype=np.bool_), np.zeros(0)
    none = Outlines(
        whole, whole, np.zeros((0, 5)), np.zeros((0, 3)), floats, floats, whole, whole, flags[:, :0], flags, whole
    )
    touch: Bools = np.zeros((sum(len(p.view) for p in parts),) * 2, dtype=np.bool_)
    first = 0
    for p in parts:
        touch[first : first + len(p.view), first : first + len(p.view)] = p.touching
        first += len(p.view)
    joined = none._replace(touching=touch)
    for name in Outlines._fields:
        if name != "touching":
            joined = joined._replace(
                **{name: np.concatenate([getattr(none, name), *(getattr(p, name) for p in parts)])}
            )
    return joined


MCMC = Visual("a joint filter of all targets of a view, by a Markov chain", McmcConfig, empty, born, step, ended)
