"""State of the methods that track in images: one tracker for each target and view, [Qu] Sec. 2.2.

Trackers are rows of arrays, ordered by view and target.  This module makes the state,
adds and removes trackers, keeps the views' clocks, and pairs each tracker with its
counterparts: the trackers of the same target in the other views.

Appearance of targets also colours, `model=pca`: densities of grey patches, [Qu] Sec. 3.3.

The local likelihood is then p = p_c p_p, with p_p from the density of the grey patch inside the
ellipse (`occlog.track.methods.images.kernels.appearance`).  The pixels of a patch are far from independent, so
that p_p is the density's geometric mean over the pixels, to the power of the setting `pca_power`.
A target's patches are learned from the frame it starts in, from ellipses that are off by a
little, so that a target that turns, or on which the light changes, becomes unlikely.

Influence of a detector's regions on the trackers of a frame, also births and ends.

Without regions nothing here has an effect.  Colours count inside regions only, as [Qu]
Sec. 4.2 uses background subtraction.  Where a tracker and a region have only each other
within reach, the tracker is drawn to the region and takes its size.  Where people merge into
one region nothing draws their trackers: the method has to keep them apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Bytes, Floats, Ints
from occlog.core.image import nearness_between, update_bins
from occlog.measure.epipolar.views import TrackedView, ViewGeometry
from occlog.track.methods.images.interface import Birth, FrameSet, Image, TrackerKey
from occlog.track.methods.images.kernels.appearance import (
    WIDTH,
    PatchModels,
    colours_in,
    disc_points,
    learn_target,
    level,
    patch_log_likelihood,
    stack_models,
    upright,
)
from occlog.track.methods.images.kernels.motion import boxes_of

from .config import IdmotConfig, MipfConfig

AppearanceModels = Mapping[TrackerKey, PatchModels]
"""Model of each tracker's patches, M = 1."""

COMPONENTS = 12
"""Principal components of a model."""
PATCHES = 40
"""Patches from which the components are learned, also that of the given ellipse."""


def learn_appearance(
    appearance: AppearanceModels,
    kept: Sequence[TrackerKey],
    frames: FrameSet,
    births: Sequence[Birth],
    config: MipfConfig,
) -> AppearanceModels:
    """Return the patch models of the trackers kept and of the new ones; for `model=colour` those given, unchanged.

    Args:
        appearance: models so far, by (view, target).
        kept: trackers that go on.
        frames: frames of the time step, in which the targets of the births are.
        births: new trackers; one without a frame of its view gets no model.
        config: settings of the method.
    """
    if config.model != "pca":
        return appearance
    jitter = np.random.default_rng(0).standard_normal((PATCHES, 5))
    out = {key: appearance[key] for key in kept if key in appearance}
    for birth in births:
        image = frames.images[birth.view]
        if image is not None:
            ellipse = level(np.asarray(birth.ellipse, dtype=np.float64)[None])[0]  # axes in the order of the tracker's
            out[birth.view, birth.target_id] = learn_target(image, ellipse, jitter, COMPONENTS)
    return out


def log_patches(
    image: Image, ellipses: Floats, owner: Ints, models: Sequence[PatchModels], config: MipfConfig
) -> Floats:
    """Return (P,) log likelihoods p_p of the grey patches inside ellipses in one view's frame, [Qu] Sec. 3.3.

    The log density of a patch is multiplied by `pca_power` / pixels, as neighbouring pixels are not independent.

    Args:
        image: the frame.
        ellipses: (P, 5) centre and half axes [px], angle of the first axis [rad].
        owner: (P,) index in `models` of each ellipse's target.
        models: patch density of each target.
        config: settings of the method.
    """
    power = config.pca_power / len(disc_points())
    return np.asarray(power * patch_log_likelihood(image, ellipses, owner, stack_models(models)))


OUTSIDE = 255
"""Bin of pixels that belong to no target."""


class OwnRegions(NamedTuple):
    """Detected regions of n trackers: a tracker has one where both have only each other within reach.

    `has` (n,): whether the tracker has a region; `region` (n, 5): its ellipse, NaN where it has none.
    """

    has: Bools  # (n,) whether the tracker has one
    region: Floats  # (n, 5) NaN: none


def mask_outside(bins: Bytes, boxes: Ints, frames: FrameSet, view: int) -> None:
    """Set the bins of a view's colour map that belong to no target to `OUTSIDE`, in place.

    These are the pixels that the view's foreground mask calls background, and those in no detected region's box.

    Args:
        bins: (H, W) colour bin of each pixel; changed inside the boxes only.
        boxes: (n, 4) left, top, right, bottom [px], half-open.
        frames: frames of the time step, with their masks and regions.
        view: number of the view.
    """
    regions = frames.regions[view] if frames.regions else None
    mask = frames.masks[view] if frames.masks else None
    if mask is not None:
        _clear(bins, boxes, mask > 0)
    if regions is None:
        return
    height, width = bins.shape
    inside = np.zeros((height, width), dtype=np.bool_)
    for x, y, a, b, _ in regions.tolist():
        rows = slice(max(int(np.ceil(y - b)), 0), max(int(np.floor(y + b)) + 1, 0))
        inside[rows, max(int(np.ceil(x - a)), 0) : max(int(np.floor(x + a)) + 1, 0)] = True
    _clear(bins, boxes, inside)


def is_masked(frames: FrameSet, view: int) -> bool:
    """Return whether a view's frame has a foreground mask or detected regions, which limit where colours count."""
    regions = bool(frames.regions) and frames.regions[view] is not None
    return regions or (bool(frames.masks) and frames.masks[view] is not None)


def _clear(bins: Bytes, boxes: Ints, inside: Bools) -> None:
    """Set the bins (H, W) that lie in a box but not `inside` (H, W) to `OUTSIDE`, in place.

    `boxes` (n, 4) are left, top, right and bottom [px], half-open.
    """
    for left, top, right, bottom in boxes.tolist():
        part = slice(max(top, 0), max(bottom, 0)), slice(max(left, 0), max(right, 0))
        bins[part][~inside[part]] = OUTSIDE


def own_regions(frames: FrameSet, view: Ints, expected: Floats, reach: float) -> OwnRegions:
    """Assign detected regions to the trackers with which they have only each other within reach.

    Args:
        frames: frames of the time step, with their regions.
        view: (n,) view of each tracker.
        expected: (n, 5) ellipses of the trackers expected in these frames.
        reach: largest distance of the centres, in sums of the two radii along the line between them.
    """
    out = np.full((len(view), 5), np.nan)
    for v, regions in enumerate(frames.regions):
        mine = np.flatnonzero(view == v)
        if regions is None or not len(regions) or not len(mine):
            continue
        near = nearness_between(expected[mine], regions) <= reach
        only = near & (near.sum(axis=1) == 1)[:, None] & (near.sum(axis=0) == 1)[None, :]
        row, column = np.nonzero(only)
        out[mine[row]] = regions[column]
    return OwnRegions(np.isfinite(out[:, 0]), out)


def drawn_at_regions(particles: Floats, own: OwnRegions, normals: Floats, share: float, spread: float) -> Floats:
    """Return particles with a share of each tracker's redrawn at its own region, with the region's size and angle.

    Args:
        particles: (n, N, 5) ellipses, N particles of each tracker; not changed.
        own: detected regions of the trackers; a tracker without one keeps its particles.
        normals: (n, N, 5) standard normal numbers.
        share: share of the particles that are redrawn, 0 to 1.
        spread: standard deviation of their centres, as a multiple of the region's radius.
    """
    count = round(share * particles.shape[1])
    if not own.has.any():
        return particles
    out, rows = particles.copy(), own.has
    radius = np.sqrt(own.region[rows, 2] * own.region[rows, 3])[:, None, None]
    fresh = np.repeat(own.region[rows][:, None], count, axis=1)
    fresh[..., :2] += spread * radius * normals[rows, :count, :2]
    out[rows, :count] = fresh
    return out


def log_region_likelihood(ellipses: Floats, own: OwnRegions, owner: Ints, spread: float) -> Floats:
    """Return (P,) log likelihoods, up to a constant, of the distances of ellipses from their tracker's own region.

    The distance is normal with the standard deviation `spread` times the region's radius sqrt(a b) in each direction.

    Args:
        ellipses: (P, 5) the ellipses.
        own: detected regions of n trackers; the result is 0 for a tracker without one.
        owner: (P,) index of each ellipse's tracker.
        spread: standard deviation over the region's radius.
    """
    if not own.has.any():
        return np.zeros(len(ellipses))
    region = own.region[owner]
    away = (ellipses[:, :2] - region[:, :2]) / np.sqrt(region[:, 2] * region[:, 3])[:, None]
    return np.asarray(np.where(own.has[owner], -0.5 * (away**2).sum(axis=-1) / spread**2, 0.0))


INTERVALS = 9
"""Last intervals between frames of a view; their median is its frame period."""
LONGEST = 10.0
"""A gap [frames] longer than this counts as this one."""
LEAST = 1e-9
"""A histogram with a sum below this is empty."""
NO_APPEARANCE: AppearanceModels = {}


class ImageTrackers(NamedTuple):
    """State of n trackers, one for each target in each view that shows it, in the order of view and target.

    An ellipse is (cx, cy, a, b, rho): centre and half axes [px], angle rho [rad] of axis a. A counterpart is the
    tracker of the same target in another view; the loop check ([Qu] Sec. 3.4.2) decides whether it is good.
    """

    view: Ints  # (n,)
    target: Ints  # (n,)
    particles: Floats  # (n, N, 5) of equal weight
    estimate: Floats  # (n, 5)
    velocity: Floats  # (n, 2) [px a frame]
    path: Floats  # (n, M, 2) the last M displacements, oldest first [px a frame]
    axes: Floats  # (n, 3) half axes [px] and angle [rad] at the start
    colours: Floats  # (n, WIDTH) see `colours`
    weak: Ints  # (n,) frames in a row in which no particle had the target's colours
    similarities: Floats  # (n,) of the last estimate
    counterpart: Ints  # (n, V) row of the tracker of the same target in each other view; -1: none
    good: Bools  # (n, V) whether the counterpart is good, [Qu] Sec. 3.4.2
    streak: Ints  # (n, V) loop checks in a row that contradict `good`
    checked: Bools  # (n, V) whether there was a loop check since the younger of both was initiated
    split: Bools  # (n,) whether the colours are those of the upper and the lower half


class FrameClock(NamedTuple):
    """Times of the latest frames of V views and intervals between them, from which frame periods are estimated."""

    t_ns: Ints  # (V,) of the last one; -1: none yet
    interval_ns: Floats  # (V, INTERVALS) between the last ones; NaN: not known


class VisualState(NamedTuple):
    """State of all trackers of all V views between time steps.

    `advance` makes the next one and reuses buffers, so that the state before must not be used again.
    """

    views: tuple[TrackedView, ...]
    geometry: ViewGeometry
    config: MipfConfig
    clock: FrameClock
    bins: tuple[Bytes, ...]  # (V,) maps of bins (H, W); up to date where the latest frame's trackers use it
    trackers: ImageTrackers
    appearance: AppearanceModels = NO_APPEARANCE  # models of the targets' patches; empty for `model=colour`


def initial_state(views: Sequence[TrackedView], geometry: ViewGeometry, config: MipfConfig) -> VisualState:
    """Return the state of tracking in V views before the first frame: no trackers, and empty colour maps.

    Args:
        views: V views.
        geometry: fundamental matrices between the views; missing directions are filled in by transposing.
        config: settings of the method.
    """
    n = len(views)
    clock = FrameClock(t_ns=np.full(n, -1), interval_ns=np.full((n, INTERVALS), np.nan))
    bins = tuple(np.zeros((view.height, view.width), dtype=np.uint8) for view in views)
    none, ellipses = np.zeros(0, dtype=np.int64), np.zeros((0, 5))
    trackers = _at_rest(none, none, ellipses, np.zeros((0, WIDTH)), np.zeros(0, dtype=np.bool_), n, config)
    return VisualState(tuple(views), both_directions(geometry), config, clock, bins, trackers)


def both_directions(geometry: ViewGeometry) -> ViewGeometry:
    """Return the geometry with each unknown fundamental matrix replaced by the opposite direction's, F_ba = F_ab^T."""
    given = np.array(geometry.fundamental, dtype=np.float64)
    back = given.transpose(1, 0, 3, 2)
    return geometry._replace(fundamental=np.where(np.isnan(given).any(axis=(2, 3), keepdims=True), back, given))


def _at_rest(
    view: Ints, target: Ints, ellipse: Floats, colours: Floats, split: Bools, views: int, config: MipfConfig
) -> ImageTrackers:
    """Return n new trackers with all particles at their ellipses, zero velocity and no counterparts.

    Args:
        view: (n,) index of each tracker's view.
        target: (n,) identities.
        ellipse: (n, 5) ellipses: centre and half axes [px], angle [rad].
        colours: (n, WIDTH) colour histograms: of upper and lower half (`split`), or of the whole ellipse, then zeros.
        split: (n,) whether the colours are those of the halves.
        views: V, the number of views.
        config: settings of the method.
    """
    n, memory = len(view), config.memory if isinstance(config, IdmotConfig) else 1
    return ImageTrackers(
        view=view,
        target=target,
        particles=np.repeat(ellipse[:, None], config.particles, axis=1),
        estimate=ellipse,
        velocity=np.zeros((n, 2)),
        path=np.zeros((n, memory, 2)),
        axes=ellipse[:, 2:].copy(),
        colours=colours,
        weak=np.zeros(n, dtype=np.int64),
        similarities=np.ones(n),
        counterpart=np.full((n, views), -1),
        good=np.zeros((n, views), dtype=np.bool_),
        streak=np.zeros((n, views), dtype=np.int64),
        checked=np.zeros((n, views), dtype=np.bool_),
        split=split,
    )


def add_trackers(state: VisualState, frames: FrameSet, births: Sequence[Birth]) -> VisualState:
    """Return the state with a tracker for each birth, with the colours in the frames, and updated frame times.

    A tracker of the same view and target is replaced.

    Raises:
        ValueError: the view of a birth has no frame.
    """
    if not births:
        return state
    new = {(birth.view, birth.target_id) for birth in births}
    kept = keep_trackers(state, np.array([key not in new for key in keys_of(state.trackers)], dtype=np.bool_))
    parts = zip(kept.trackers, _initiated(state, frames, births), strict=True)
    joined = ImageTrackers._make(np.concatenate(fields) for fields in parts)
    order = np.lexsort((joined.target, joined.view))
    trackers = _paired(ImageTrackers._make(field[order] for field in joined), len(state.views))
    appearance = learn_appearance(state.appearance, keys_of(kept.trackers), frames, births, state.config)
    return advance_clock(state._replace(trackers=trackers, appearance=appearance), frames)


def keys_of(trackers: ImageTrackers) -> list[TrackerKey]:
    """Return the (view, target) of each tracker, in order."""
    return list(zip(trackers.view.tolist(), trackers.target.tolist(), strict=True))


def _initiated(state: VisualState, frames: FrameSet, births: Sequence[Birth]) -> ImageTrackers:
    """Return new trackers at the ellipses of the n births, with the colours there in the frames.

    The views' maps of colour bins are updated in place. ValueError if the view of a birth has no frame.
    """
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
            # The masks leave a share s of the ellipse.  Colours that sum to 1/s give a similarity of 1 to an ellipse of
            # which as much is left, and of sqrt(r/s) to one of which a smaller share r is left.
            found /= np.maximum(found.sum(axis=1, keepdims=True), LEAST) ** 2
        colours[mine] = found
    return _at_rest(view, target, ellipse, colours, split, len(state.views), config)


def update_map(state: VisualState, frames: FrameSet, view: int, boxes: Ints) -> Bytes:
    """Update a view's map of colour bins from its frame inside `boxes`, in place, and return it (H, W).

    Pixels outside detected regions or the foreground mask get the bin `OUTSIDE`. `boxes` (n, 4) are left, top, right
    and bottom [px], half-open.

    Raises:
        ValueError: the view has no frame.
    """
    image, bins = frames.images[view], state.bins[view]
    if image is None:
        raise ValueError(f"view {view} has no frame")
    update_bins(bins, image, boxes, state.config.pixel_step)
    mask_outside(bins, boxes, frames, view)
    return bins


def _paired(trackers: ImageTrackers, views: int) -> ImageTrackers:
    """Return the trackers with their counterparts in all `views` (V) views paired again.

    Pairs that changed count as never checked.
    """
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
    """Return the state without the trackers for which `keep` (n,) is false; `state` itself if all are kept."""
    if keep.all():
        return state
    trackers = _paired(ImageTrackers._make(field[keep] for field in state.trackers), len(state.views))
    return state._replace(trackers=trackers)


def end_trackers(state: VisualState, keys: Sequence[TrackerKey]) -> VisualState:
    """Return the state without the trackers with these (view, target) keys; keys without a tracker change nothing."""
    gone = set(keys)
    return keep_trackers(state, np.array([key not in gone for key in keys_of(state.trackers)], dtype=np.bool_))


def advance_clock(state: VisualState, frames: FrameSet) -> VisualState:
    """Return the state with the times of this time step's frames as the latest ones of their views.

    Frames at a view's latest time, and views without a frame, change nothing.
    """
    clock = state.clock
    have = np.array([image is not None for image in frames.images]) & (clock.t_ns != frames.t_ns)
    interval = np.where(clock.t_ns >= 0, frames.t_ns - clock.t_ns, np.nan)
    later = np.column_stack([clock.interval_ns[:, 1:], interval])
    return state._replace(
        clock=FrameClock(
            t_ns=np.where(have, frames.t_ns, clock.t_ns),
            interval_ns=np.where(have[:, None], later, clock.interval_ns),
        )
    )


def gaps(clock: FrameClock, t_ns: int) -> Floats:
    """Return (V,) numbers of frames from each view's latest frame to time `t_ns`: whole, 1 to `LONGEST`, as floats."""
    return np.clip(np.round(ages(clock, t_ns)), 1.0, LONGEST)


def ages(clock: FrameClock, t_ns: int) -> Floats:
    """Return (V,) times from each view's latest frame to time `t_ns`, in frame periods of the view; 1 where unknown.

    The frame period is the median of the last intervals, the upper of the middle two for an even number.
    """
    out = np.ones(len(clock.t_ns))
    for v, (last, row) in enumerate(zip(clock.t_ns.tolist(), clock.interval_ns.tolist(), strict=True)):
        known = sorted(interval for interval in row if interval == interval)
        if known and last >= 0:
            out[v] = (t_ns - last) / known[len(known) // 2]
    return out


def with_geometry(state: VisualState, geometry: ViewGeometry) -> VisualState:
    """Return the state with another geometry of the same views, with fewer fundamental matrices.

    Counterparts in views between which no matrix is left in either direction are neither good nor checked any more.
    """
    known: Bools = np.asarray(np.isfinite(geometry.fundamental).all(axis=(2, 3)))
    t = state.trackers
    kept = (known | known.T)[t.view]
    trackers = t._replace(good=t.good & kept, streak=np.where(kept, t.streak, 0), checked=t.checked & kept)
    return state._replace(geometry=both_directions(geometry), trackers=trackers)
