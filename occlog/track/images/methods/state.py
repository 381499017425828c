"""State of the methods that track in images: one tracker for each target and view, [Qu] Sec. 2.2.

Trackers are rows of arrays, ordered by view and target.  This module makes the state,
adds and removes trackers, keeps the views' clocks, and pairs each tracker with its
counterparts: the trackers of the same target in the other views.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Bytes, Floats, Ints
from occlog.core.image.histogram_bins import update_bins
from occlog.measure.epipolar.views import Geometry, View
from occlog.track.images.interface import Birth, FrameSet, TrackerKey
from occlog.track.images.kernels.ellipse_colour import WIDTH, colours_in, level, upright
from occlog.track.images.kernels.motion import boxes_of

from .appearance import AppearanceModels, learn_appearance
from .config import IdmotConfig, MipfConfig
from .regions import is_masked, mask_outside

INTERVALS = 9
"""Last intervals between frames of a view from whose median its frame period is taken."""
LONGEST = 10.0
"""A gap [frames] longer than this counts as this one."""
LEAST = 1e-9
"""A histogram whose sum is below this is empty."""
NO_APPEARANCE: AppearanceModels = {}


class Trackers(NamedTuple):
    """n trackers, ordered by view and target."""

    view: Ints  # (n,)
    target: Ints  # (n,)
    particles: Floats  # (n, N, 5) of equal weight
    estimate: Floats  # (n, 5)
    velocity: Floats  # (n, 2) [px a frame]
    path: Floats  # (n, M, 2) the last M displacements, oldest first [px a frame]
    axes: Floats  # (n, 3) half axes [px] and angle [rad] at the start
    colours: Floats  # (n, WIDTH) see `colours`
    weak: Ints  # (n,) frames in a row in which no particle had the target's colours
    likeness: Floats  # (n,) of the last estimate
    counterpart: Ints  # (n, V) row of the tracker of the same target in each other view; -1: none
    good: Bools  # (n, V) whether the counterpart is good, [Qu] Sec. 3.4.2
    streak: Ints  # (n, V) loop checks in a row that contradict `good`
    checked: Bools  # (n, V) whether there was a loop check since the younger of both was born
    split: Bools  # (n,) whether the colours are those of the upper and the lower half


class Clock(NamedTuple):
    """Times of the last frames of V views."""

    t_ns: Ints  # (V,) of the last one; -1: none yet
    interval_ns: Floats  # (V, INTERVALS) between the last ones; NaN: not known


class VisualState(NamedTuple):
    """State of a method, see `occlog.track.images.interface`."""

    views: tuple[View, ...]
    geometry: Geometry
    config: MipfConfig
    clock: Clock
    bins: tuple[Bytes, ...]  # (V,) maps of bins (H, W); only what the latest frame's trackers look at is up to date
    trackers: Trackers
    appearance: AppearanceModels = NO_APPEARANCE  # models of the targets' patches; empty for `model=colour`


def initial_state(views: Sequence[View], geometry: Geometry, config: MipfConfig) -> VisualState:
    """Make a state without trackers.

    Args:
        views: V views.
        geometry: between them.
        config: settings of the method.
    """
    n = len(views)
    clock = Clock(t_ns=np.full(n, -1), interval_ns=np.full((n, INTERVALS), np.nan))
    bins = tuple(np.zeros((view.height, view.width), dtype=np.uint8) for view in views)
    none, ellipses = np.zeros(0, dtype=np.int64), np.zeros((0, 5))
    trackers = _at_rest(none, none, ellipses, np.zeros((0, WIDTH)), np.zeros(0, dtype=np.bool_), n, config)
    return VisualState(tuple(views), both_directions(geometry), config, clock, bins, trackers)


def both_directions(geometry: Geometry) -> Geometry:
    """Replace each unknown fundamental matrix by the transposed matrix of the other direction, F_ba = F_ab^T."""
    given = np.array(geometry.fundamental, dtype=np.float64)
    back = given.transpose(1, 0, 3, 2)
    return geometry._replace(fundamental=np.where(np.isnan(given).any(axis=(2, 3), keepdims=True), back, given))


def _at_rest(
    view: Ints, target: Ints, ellipse: Floats, colours: Floats, split: Bools, views: int, config: MipfConfig
) -> Trackers:
    """Trackers with all particles at the given ellipses (n, 5), at rest, without counterparts yet."""
    n, memory = len(view), config.memory if isinstance(config, IdmotConfig) else 1
    return Trackers(
        view=view,
        target=target,
        particles=np.repeat(ellipse[:, None], config.particles, axis=1),
        estimate=ellipse,
        velocity=np.zeros((n, 2)),
        path=np.zeros((n, memory, 2)),
        axes=ellipse[:, 2:].copy(),
        colours=colours,
        weak=np.zeros(n, dtype=np.int64),
        likeness=np.ones(n),
        counterpart=np.full((n, views), -1),
        good=np.zeros((n, views), dtype=np.bool_),
        streak=np.zeros((n, views), dtype=np.int64),
        checked=np.zeros((n, views), dtype=np.bool_),
        split=split,
    )


def add_trackers(state: VisualState, frames: FrameSet, births: Sequence[Birth]) -> VisualState:
    """Add trackers whose colours are those in the frames; one of the same view and target is replaced.

    Raises:
        ValueError: the view of a birth has no frame.
    """
    if not births:
        return state
    new = {(birth.view, birth.target_id) for birth in births}
    kept = keep_trackers(state, np.array([key not in new for key in keys_of(state.trackers)], dtype=np.bool_))
    parts = zip(kept.trackers, _newborn(state, frames, births), strict=True)
    joined = Trackers._make(np.concatenate(fields) for fields in parts)
    order = np.lexsort((joined.target, joined.view))
    trackers = _paired(Trackers._make(field[order] for field in joined), len(state.views))
    appearance = learn_appearance(state.appearance, keys_of(kept.trackers), frames, births, state.config)
    return advance_clock(state._replace(trackers=trackers, appearance=appearance), frames)


def keys_of(trackers: Trackers) -> list[TrackerKey]:
    """View and target of each tracker."""
    return list(zip(trackers.view.tolist(), trackers.target.tolist(), strict=True))


def _newborn(state: VisualState, frames: FrameSet, births: Sequence[Birth]) -> Trackers:
    """New trackers, with the colours in the frames."""
    config = state.config
    ellipse = level(np.array([birth.ellipse for birth in births], dtype=np.float64))
    split = upright(ellipse, config.halves)
    view = np.array([birth.view for birth in births], dtype=np.int64)
    target = np.array([birth.target_id for birth in births], dtype=np.int64)
    colours = np.empty((len(births), WIDTH))
    for v in np.unique(view).tolist():
        mine = view == v
        bins = update_map(state, frames, v, boxes_of(ellipse[mine][:, None]))
        found = colours_in(bins, ellipse[mine], split[mine], config.pixel_step)
        if is_masked(frames, v):
            # The masks leave a share s of the ellipse.  Colours that sum to 1/s give a likeness of 1 to an ellipse of
            # which as much is left, and of sqrt(r/s) to one of which a smaller share r is left.
            found /= np.maximum(found.sum(axis=1, keepdims=True), LEAST) ** 2
        colours[mine] = found
    return _at_rest(view, target, ellipse, colours, split, len(state.views), config)


def update_map(state: VisualState, frames: FrameSet, view: int, boxes: Ints) -> Bytes:
    """Bring a view's map of bins up to date inside boxes (n, 4), and return it.

    Raises:
        ValueError: the view has no frame.
    """
    image, bins = frames.images[view], state.bins[view]
    if image is None:
        raise ValueError(f"view {view} has no frame")
    update_bins(bins, image, boxes, state.config.pixel_step)
    mask_outside(bins, boxes, frames, view)
    return bins


def _paired(trackers: Trackers, views: int) -> Trackers:
    """Find the counterparts of all trackers; the loop check starts anew for a pair that has changed."""
    row = {key: i for i, key in enumerate(keys_of(trackers))}
    counterpart = np.full((len(trackers.view), views), -1)
    for (view, target), i in row.items():
        for v in range(views):
            if v != view:
                counterpart[i, v] = row.get((v, target), -1)
    both = (counterpart >= 0) & trackers.checked & trackers.checked[counterpart, trackers.view[:, None]]
    return trackers._replace(
        counterpart=counterpart,
        good=trackers.good & both,
        streak=np.where(both, trackers.streak, 0),
        checked=both,
    )


def keep_trackers(state: VisualState, keep: Bools) -> VisualState:
    """Remove the trackers for which `keep` (n,) is false."""
    if keep.all():
        return state
    trackers = _paired(Trackers._make(field[keep] for field in state.trackers), len(state.views))
    return state._replace(trackers=trackers)


def end_trackers(state: VisualState, keys: Sequence[TrackerKey]) -> VisualState:
    """Remove the trackers of these views and targets; keys without a tracker change nothing."""
    gone = set(keys)
    return keep_trackers(state, np.array([key not in gone for key in keys_of(state.trackers)], dtype=np.bool_))


def advance_clock(state: VisualState, frames: FrameSet) -> VisualState:
    """Put the time of the frames on the clocks of their views; the same frames a second time change nothing."""
    clock = state.clock
    have = np.array([image is not None for image in frames.images]) & (clock.t_ns != frames.t_ns)
    interval = np.where(clock.t_ns >= 0, frames.t_ns - clock.t_ns, np.nan)
    later = np.column_stack([clock.interval_ns[:, 1:], interval])
    return state._replace(
        clock=Clock(
            t_ns=np.where(have, frames.t_ns, clock.t_ns),
            interval_ns=np.where(have[:, None], later, clock.interval_ns),
        )
    )


def gaps(clock: Clock, t_ns: int) -> Floats:
    """(V,) frames of each view from its last one to one at a time: whole numbers, 1 to `LONGEST`."""
    return np.clip(np.round(ages(clock, t_ns)), 1.0, LONGEST)


def ages(clock: Clock, t_ns: int) -> Floats:
    """(V,) time since each view's last frame over the median of its last intervals; 1 where that is not known.

    Of an even number of intervals the upper one of the two in the middle counts.
    """
    out = np.ones(len(clock.t_ns))
    for v, (last, row) in enumerate(zip(clock.t_ns.tolist(), clock.interval_ns.tolist(), strict=True)):
        known = sorted(interval for interval in row if interval == interval)
        if known and last >= 0:
            out[v] = (t_ns - last) / known[len(known) // 2]
    return out


def with_geometry(state: VisualState, geometry: Geometry) -> VisualState:
    """Replace the geometry by one of the same views with fewer matrices.

    Counterparts in views whose matrices are gone in both directions are neither good nor checked any more.
    """
    known: Bools = np.asarray(np.isfinite(geometry.fundamental).all(axis=(2, 3)))
    t = state.trackers
    kept = (known | known.T)[t.view]
    trackers = t._replace(good=t.good & kept, streak=np.where(kept, t.streak, 0), checked=t.checked & kept)
    return state._replace(geometry=both_directions(geometry), trackers=trackers)
