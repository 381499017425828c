"""What is kept of trackers in images from frame to frame: one tracker for each target and view, [Qu] Sec. 2.2.

What is left of a tracking state when matrices between its views turn out to be wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import Bools, Floats, Ints
from occlog.core.image.histogram_bins import update_bins
from occlog.measure.epipolar.views import Geometry, View
from occlog.track.images.interface import Birth, Looks
from occlog.track.images.kernels.motion import boxes_of

from .appearance import Memories, remembered
from .colours import WIDTH, colours_in, level, upright
from .regions import mask_outside, masked

INTERVALS = 9
"""Frames whose distance in time tells how often a view delivers one."""
LONGEST = 10.0
"""A longer gap [frames] counts as this one."""
LEAST = 1e-9
"""A histogram of less than this is empty."""
NOTHING: Memories = {}


class Trackers(NamedTuple):
    """n trackers, by view and target."""

    view: Ints  # (n,)
    target: Ints  # (n,)
    particles: Floats  # (n, N, 5) of equal weight
    estimate: Floats  # (n, 5)
    velocity: Floats  # (n, 2) [px a frame]
    path: Floats  # (n, M, 2) the last displacements [px]
    axes: Floats  # (n, 3) half axes and angle at the start
    colours: Floats  # (n, WIDTH) see `views_colours`
    weak: Ints  # (n,) frames in a row in which no particle looked like the target
    likeness: Floats  # (n,) of the last estimate
    twin: Ints  # (n, V) row of the tracker of the same target in each other view; -1: none
    good: Bools  # (n, V) counterparts that pass the loop check
    run: Ints  # (n, V) loop checks in a row that said otherwise
    checked: Bools  # (n, V) whether there was a loop check since the younger of both was born
    split: Bools  # (n,) whether the colours are of halves


class Clock(NamedTuple):
    """When each view's last frames were."""

    t_ns: Ints  # (V,) -1: none yet
    interval_ns: Floats  # (V, INTERVALS) NaN: not known


class State(NamedTuple):
    """The state of a method: see `occlog.track.images.interface`."""

    views: tuple[View, ...]
    geometry: Geometry
    config: Any
    clock: Clock
    bins: tuple[Any, ...]  # (V,) maps of bins, (H, W); only what the latest frame's trackers look at is up to date
    trackers: Trackers
    memories: Memories = NOTHING  # what is known of targets besides colours; empty for `model=colour`


def empty(views: Sequence[View], geometry: Geometry, config: Any, rng: Generator) -> State:
    """The state without trackers."""
    del rng
    n = len(views)
    clock = Clock(np.full(n, -1), np.full((n, INTERVALS), np.nan))
    bins = tuple(np.zeros((view.height, view.width), dtype=np.uint8) for view in views)
    return State(tuple(views), completed(geometry), config, clock, bins, _none(n, config))


def completed(geometry: Geometry) -> Geometry:
    """The geometry with each unknown matrix replaced by the transposed one of the other direction."""
    given = np.array(geometry.fundamental, dtype=np.float64)
    back = given.transpose(1, 0, 3, 2)
    return geometry._replace(fundamental=np.where(np.isnan(given).any(axis=(2, 3), keepdims=True), back, given))


def _none(views: int, config: Any) -> Trackers:
    z, memory = np.zeros, getattr(config, "memory", 1)
    whole, flags = np.int64, np.bool_
    return Trackers(
        z(0, whole),
        z(0, whole),
        z((0, config.particles, 5)),
        z((0, 5)),
        z((0, 2)),
        z((0, memory, 2)),
        z((0, 3)),
        z((0, WIDTH)),
        z(0, whole),
        z(0),
        z((0, views), whole),
        z((0, views), flags),
        z((0, views), whole),
        z((0, views), flags),
        z(0, flags),
    )


def born(state: State, looks: Looks, births: Sequence[Birth]) -> State:
    """The state with new trackers; one that replaces a tracker of its target and view ends that."""
    if not births:
        return state
    new = {(birth.view, birth.target_id) for birth in births}
    old = state.trackers
    pairs = zip(old.view.tolist(), old.target.tolist(), strict=True)
    kept = chosen(state, np.array([pair not in new for pair in pairs], dtype=np.bool_))
    fresh = _newborn(state, looks, births)
    joined = Trackers._make(np.concatenate(parts) for parts in zip(kept.trackers, fresh, strict=True))
    order = np.lexsort((joined.target, joined.view))
    trackers = _paired(Trackers._make(field[order] for field in joined), len(state.views))
    known = remembered(state.memories, _pairs(kept.trackers), looks, births, state.config)
    return seen(state._replace(trackers=trackers, memories=known), looks)


def _pairs(trackers: Trackers) -> list[tuple[int, int]]:
    return list(zip(trackers.view.tolist(), trackers.target.tolist(), strict=True))


def _newborn(state: State, looks: Looks, births: Sequence[Birth]) -> Trackers:
    n, views, config = len(births), len(state.views), state.config
    ellipse = level(np.array([birth.ellipse for birth in births], dtype=np.float64))
    split = upright(ellipse, config.halves)
    view = np.array([birth.view for birth in births], dtype=np.int64)
    colours = np.empty((n, WIDTH))
    for v in np.unique(view).tolist():
        image, mine = looks.images[v], view == v
        if image is None:
            raise ValueError(f"a tracker is born in view {v}, which has no frame")
        boxes = boxes_of(ellipse[mine][:, None])
        update_bins(state.bins[v], image, boxes, config.pixel_step)
        mask_outside(state.bins[v], boxes, looks, v)
        found = colours_in(state.bins[v], ellipse[mine], split[mine], config.pixel_step)
        if masked(looks, v):  # of full likeness is what fills as much of the ellipse, not what fills it wholly
            found /= np.maximum(found.sum(axis=1, keepdims=True), LEAST) ** 2
        colours[mine] = found
    blank = _none(views, config)
    return Trackers(
        view,
        np.array([birth.target_id for birth in births], dtype=np.int64),
        np.repeat(ellipse[:, None], config.particles, axis=1),
        ellipse,
        np.zeros((n, 2)),
        np.zeros((n, *blank.path.shape[1:])),
        ellipse[:, 2:].copy(),
        colours,
        np.zeros(n, dtype=np.int64),
        np.ones(n),
        np.full((n, views), -1),
        np.zeros((n, views), dtype=np.bool_),
        np.zeros((n, views), dtype=np.int64),
        np.zeros((n, views), dtype=np.bool_),
        split,
    )


def _paired(trackers: Trackers, views: int) -> Trackers:
    """The trackers with each other's places; where a counterpart came or went the loop check starts anew."""
    row = {pair: i for i, pair in enumerate(zip(trackers.view.tolist(), trackers.target.tolist(), strict=True))}
    twin = np.full((len(trackers.view), views), -1)
    for (view, target), i in row.items():
        for v in range(views):
            if v != view:
                twin[i, v] = row.get((v, target), -1)
    both = (twin >= 0) & trackers.checked & trackers.checked[twin, trackers.view[:, None]]
    return trackers._replace(twin=twin, good=trackers.good & both, run=np.where(both, trackers.run, 0), checked=both)


def chosen(state: State, keep: Bools) -> State:
    """The state with some of its trackers only."""
    if keep.all():
        return state
    trackers = _paired(Trackers._make(field[keep] for field in state.trackers), len(state.views))
    return state._replace(trackers=trackers)


def ended(state: State, pairs: Sequence[tuple[int, int]]) -> State:
    """The state without the trackers of these views and targets."""
    gone, t = set(pairs), state.trackers
    have = zip(t.view.tolist(), t.target.tolist(), strict=True)
    return chosen(state, np.array([pair not in gone for pair in have], dtype=np.bool_))


def seen(state: State, looks: Looks) -> State:
    """The state whose clock knows of the frames; the same frames a second time change nothing."""
    clock = state.clock
    have = np.array([image is not None for image in looks.images]) & (clock.t_ns != looks.t_ns)
    gap = np.where(clock.t_ns >= 0, looks.t_ns - clock.t_ns, np.nan)
    later = np.column_stack([clock.interval_ns[:, 1:], gap])
    return state._replace(
        clock=Clock(np.where(have, looks.t_ns, clock.t_ns), np.where(have[:, None], later, clock.interval_ns))
    )


def gaps(clock: Clock, t_ns: int) -> Floats:
    """(V,) frames of each view from its last one to one at a time: whole numbers, 1 to `LONGEST`."""
    return np.clip(np.round(ages(clock, t_ns)), 1.0, LONGEST)


def ages(clock: Clock, t_ns: int) -> Floats:
    """(V,) time since each view's last frame over the median of its last intervals; 1 where that is not known."""
    out = np.ones(len(clock.t_ns))
    for v, (last, row) in enumerate(zip(clock.t_ns.tolist(), clock.interval_ns.tolist(), strict=True)):
        known = sorted(interval for interval in row if interval == interval)
        if known and last >= 0:
            out[v] = (t_ns - last) / known[len(known) // 2]
    return out


def doubted(state: State, geometry: Geometry) -> State:
    """The state with another geometry; counterparts in views whose matrix is gone are neither good nor checked.

    Args:
        state: of any method that has trackers of its own.
        geometry: the same views, with fewer matrices.
    """
    known: Bools = np.asarray(np.isfinite(geometry.fundamental).all(axis=(2, 3)))
    t = state.trackers
    kept = (known | known.T)[t.view]
    trackers = t._replace(good=t.good & kept, run=np.where(kept, t.run, 0), checked=t.checked & kept)
    return state._replace(geometry=completed(geometry), trackers=trackers)
