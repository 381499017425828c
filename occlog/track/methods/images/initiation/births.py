"""Births and ends of trackers from a detector's regions, and the target that a new tracker belongs to.

A region that no tracker of its view explains in several frames in a row becomes a tracker.
It belongs to a target of another view when the two have agreed with the epipolar geometry in
those frames (the loop check of [Qu] Sec. 3.4.2) and nothing else fits.  Where several targets
fit, it waits, and then takes the one that fits clearly best, or becomes a new target.  A
tracker that no region has touched for long ends.

Distances of the loop check of [Qu] Sec. 3.4.2, for ellipses of one target in two views.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from occlog.array_types import Floats
from occlog.core.geometry.fundamental import epipolar_distances
from occlog.core.image import nearness
from occlog.measure.epipolar.views import TrackedView, ViewGeometry
from occlog.track.methods.images.interface import Birth, TrackerKey

from .config import ViewsConfig


def anchors(ellipses: Floats, bottom: bool) -> Floats:
    """Return (N, 2) reference points of ellipses in an image [px]: their centres, or their lowest points.

    Args:
        ellipses: (N, 5) centre x, y and half axes a, b [px], angle [rad] of axis a from +x (right) to +y (down).
        bottom: the lowest point, where people stand; else the centre.
    """
    if not bottom:
        return np.asarray(ellipses[:, :2])
    # Where the tangent is horizontal
    a, b, rho = ellipses[:, 2:].T
    down = np.hypot(a * np.sin(rho), b * np.cos(rho))
    aside = (a * a - b * b) * np.sin(rho) * np.cos(rho) / down
    return np.asarray(ellipses[:, :2] + np.column_stack([aside, down]))


def loop_distances(geometry: ViewGeometry, a: int, b: int, of_a: Floats, of_b: Floats, bottom: bool = False) -> Floats:
    """Return (N,) loop distances of ellipse pairs in two views: distances from each other's epipolar lines, in radii.

    Of the two distances, each divided by the radius of its ellipse, the larger one counts ([Qu] Sec. 3.4.2). inf where
    the fundamental matrix or the line is unknown.

    Args:
        geometry: fundamental matrices between the views, and undistortion of each.
        a: number of a view.
        b: number of another view.
        of_a: (N, 5) ellipses of N targets in view a: centre, half axes [px] and angle [rad].
        of_b: (N, 5) ellipses of the same targets in view b.
        bottom: compare the lowest points of ellipses with epipolar lines; else their centres.
    """
    points = []
    for view, ellipses in ((a, of_a), (b, of_b)):
        recorded, ideal = anchors(ellipses, bottom), geometry.ideal[view]
        points.append(recorded if ideal is None else ideal(recorded))
    radii = np.column_stack([radius(of_a), radius(of_b)])
    distances = epipolar_distances(geometry.fundamental[a, b], *points) / radii
    return np.asarray(np.where(np.isfinite(distances), distances, np.inf).max(axis=1))


def radius(ellipses: Floats) -> Floats:
    """Return (N,) radii sqrt(a b) [px] of the circles with the areas of ellipses (N, 5), a and b their half axes."""
    return np.asarray(np.sqrt(ellipses[:, 2] * ellipses[:, 3]))


Trail = tuple[tuple[int, Floats], ...]
"""Number of the time step and ellipse, for each of the latest frames."""

EDGE_PX = 1.0
"""The edge of the image cuts a region that comes nearer to it than this."""
MAX_MISFIT_RATIO = 0.5
"""The best fit is clear when its misfit is at most this share of the second one's."""


@dataclass(frozen=True)
class Candidate:
    """A detected region without a tracker, followed from frame to frame, from which a tracker may be started.

    `trail` has the time step and ellipse (5,) of its latest frames, oldest first; `count` is the number of frames in a
    row in which it was found.
    """

    trail: Trail
    count: int  # frames in a row

    @property
    def ellipse(self) -> Floats:
        """Return the ellipse (5,) of the latest frame: centre and half axes [px], angle [rad]."""
        return self.trail[-1][1]


@dataclass(frozen=True)
class BirthCandidates:
    """State of track initiation and termination between time steps, for V views.

    The identity of the next new target; the candidates of each view; the latest ellipses (trails) of all trackers; for
    each tracker the number of frames in a row without a supporting region; and the number of the next time step.
    """

    next_id: int
    candidates: tuple[tuple[Candidate, ...], ...]  # of each view
    trails: Mapping[TrackerKey, Trail] = field(default_factory=dict)  # of trackers
    unsupported: Mapping[TrackerKey, int] = field(default_factory=dict)  # frames in a row without a region at a tracker
    step: int = 0


def empty_candidates(n_views: int, next_id: int = 0) -> BirthCandidates:
    """Return the state of track initiation before the first time step; new targets are numbered from `next_id`."""
    return BirthCandidates(next_id, ((),) * n_views)


def initiate_and_terminate(
    state: BirthCandidates,
    regions: Sequence[Floats | None],
    trackers: Mapping[TrackerKey, Floats],
    views: Sequence[TrackedView],
    geometry: ViewGeometry,
    config: ViewsConfig,
    bottom: bool = False,
    gone: Collection[TrackerKey] = (),
) -> tuple[BirthCandidates, tuple[Birth, ...], tuple[TrackerKey, ...]]:
    """Decide which regions of a time step start trackers, and which trackers end.

    Args:
        state: candidates after the time step before; not changed.
        regions: detected ellipses (K, 5) of each view; None: frame not processed by the detector.
        trackers: ellipses (5,) of all trackers of all views after this time step, by (view, target).
        views: V views.
        geometry: fundamental matrices between the views.
        config: settings of births and terminations.
        bottom: the lowest points of ellipses are compared with epipolar lines; else their centres.
        gone: trackers that ended in this time step; their targets do not restart in that view before the next one.

    Returns:
        The state after the time step, the trackers to start, and the (view, target) of those to end for lack of
        regions.
    """
    # Lengthen the trails of trackers
    now = state.step
    keep = max(config.confirmation_frames, 1)
    trails = {key: _extended(state.trails.get(key, ()), now, ellipse, keep) for key, ellipse in trackers.items()}
    state = replace(state, trails=trails, step=now + 1)
    # Follow the regions that no tracker explains as candidates
    waiting = []
    for v, found in enumerate(regions):
        mine = [ellipse for (view, _), ellipse in trackers.items() if view == v]
        if found is None:  # candidates wait for the next frame that the detector processes
            waiting.append(state.candidates[v])
            continue
        free = _unexplained(_birth_sized(found, views[v], config), mine, config.birth_min_distance)
        waiting.append(_followed(state.candidates[v], free, now, keep))
    state = replace(state, candidates=tuple(waiting))
    # End trackers without support
    state, ended = _ends(state, regions, trackers, config)
    alive = {key: trail for key, trail in state.trails.items() if key not in ended}
    state = replace(state, trails=alive)
    # Begin trackers from candidates that were seen often enough
    if config.confirmation_frames == 0:
        return replace(state, candidates=empty_candidates(len(views)).candidates), (), ended
    state, births = _births(state, geometry, config, bottom, {*gone, *ended})
    return state, births, ended


def _extended(trail: Trail, now: int, ellipse: Floats, keep: int) -> Trail:
    """Return a trail with `ellipse` (5,) at time step `now` appended, cut to its last `keep` entries."""
    return (*trail, (now, ellipse))[-keep:]


def _birth_sized(regions: Floats, view: TrackedView, config: ViewsConfig) -> Floats:
    """Return the regions large enough for a birth: both half axes are at least `birth_min_size_px`.

    Without `birth_allow_truncated` the regions that the image edge cuts are omitted, too.

    Args:
        regions: (K, 5) upright ellipses: centre, half width and half height [px], angle 0.
        view: the view, with its image size.
        config: settings of births.
    """
    low, high = regions[:, :2] - regions[:, 2:4], regions[:, :2] + regions[:, 2:4]
    good = (regions[:, 2:4] >= config.birth_min_size_px).all(axis=1)
    if not config.birth_allow_truncated:
        corner = np.array([view.width, view.height]) - 0.5 - EDGE_PX
        good &= (low >= EDGE_PX - 0.5).all(axis=1) & (high <= corner).all(axis=1)
    return np.asarray(regions[good])


def _unexplained(regions: Floats, trackers: Sequence[Floats], separation: float) -> Floats:
    """Return the regions (K, 5) that no tracker explains: farther than `separation` sums of radii from each.

    `trackers` are ellipses (5,) of the same view. Distances are between centres, radii along the line between them.
    """
    if not trackers or not len(regions):
        return regions
    near = nearness(np.vstack([regions, *trackers]))[: len(regions), len(regions) :]
    return np.asarray(regions[near.min(axis=1) > separation])


def _followed(before: Sequence[Candidate], regions: Floats, now: int, keep: int) -> tuple[Candidate, ...]:
    """Return this frame's candidates of a view, one for each region that no tracker explains.

    A region continues the nearest touching candidate of the frame before, nearest pairs first, or starts a candidate;
    candidates without a region are dropped.

    Args:
        before: candidates of the view in the last frame processed.
        regions: (K, 5) ellipses of the regions.
        now: number of the time step.
        keep: number of frames kept in a trail.
    """
    n = len(regions)
    earlier = dict.fromkeys(range(n), Candidate((), 0))
    if before and n:
        near = nearness(np.vstack([regions, *(c.ellipse for c in before)]))[:n, n:]
        assigned: dict[int, int] = {}
        for flat in np.argsort(near, axis=None, kind="stable").tolist():
            r, c = divmod(flat, len(before))
            if near[r, c] <= 1.0 and r not in assigned and c not in assigned.values():
                assigned[r] = c
        earlier |= {r: before[c] for r, c in assigned.items()}
    return tuple(Candidate(_extended(earlier[r].trail, now, regions[r], keep), earlier[r].count + 1) for r in range(n))


def _ends(
    state: BirthCandidates, regions: Sequence[Floats | None], trackers: Mapping[TrackerKey, Floats], config: ViewsConfig
) -> tuple[BirthCandidates, tuple[TrackerKey, ...]]:
    """Count the frames without a supporting region of each tracker, and end those at `max_coasting_frames` in a row.

    Args:
        state: state of births and ends, with the counts before.
        regions: ellipses (K, 5) of each view; None: frame not processed by the detector, which leaves the counts as
            they are.
        trackers: ellipses (5,) by (view, target).
        config: `max_coasting_frames`; 0: no tracker ends.

    Returns:
        The state with the counts of the trackers that go on, and the (view, target) of those that end.
    """
    before = {key: state.unsupported.get(key, 0) for key in trackers}
    unsupported: dict[TrackerKey, int] = {}
    for v, found in enumerate(regions):
        mine = [key for key in trackers if key[0] == v]
        supported = [] if found is None else _supported(mine, trackers, found, before)
        for key in mine:
            if found is None:
                unsupported[key] = before[key]
            else:
                unsupported[key] = 0 if key in supported else before[key] + 1
    ended = tuple(key for key, count in unsupported.items() if 0 < config.max_coasting_frames <= count)
    return replace(state, unsupported={key: n for key, n in unsupported.items() if key not in ended}), ended


def _supported(
    mine: Sequence[TrackerKey], trackers: Mapping[TrackerKey, Floats], regions: Floats, before: Mapping[TrackerKey, int]
) -> list[TrackerKey]:
    """Return the trackers of one view that a touching region supports; a region supports one tracker.

    Pairs of tracker and region are assigned greedily: trackers with fewer frames without support first, then nearer
    pairs.

    Args:
        mine: (view, target) of the view's trackers.
        trackers: ellipses (5,) of these and others, by (view, target).
        regions: (K, 5) ellipses of the view's regions.
        before: frames in a row without support of each tracker.
    """
    if not mine or not len(regions):
        return []
    near = nearness(np.vstack([*(trackers[key] for key in mine), regions]))[: len(mine), len(mine) :]
    pairs = [(before[mine[i]], near[i, r], i, r) for i, r in zip(*np.nonzero(near <= 1.0), strict=True)]
    taken: dict[int, int] = {}
    for _, _, i, r in sorted(pairs):
        if i not in taken and r not in taken.values():
            taken[i] = r
    return [mine[i] for i in taken]


def _births(
    state: BirthCandidates, geometry: ViewGeometry, config: ViewsConfig, bottom: bool, gone: Collection[TrackerKey]
) -> tuple[BirthCandidates, tuple[Birth, ...]]:
    """Start trackers from the candidates of all views that have been followed for long enough.

    Args:
        state: candidates, updated with this frame.
        geometry: fundamental matrices between the views.
        config: settings of births and terminations.
        bottom: compare the lowest points of ellipses with epipolar lines; else their centres.
        gone: trackers that ended in this time step; their targets do not restart in that view now.

    Returns:
        The state without the candidates that became trackers, and the births, view by view.
    """
    births: list[Birth] = []
    for v in range(len(state.candidates)):
        state, initiated = _births_in(state, v, geometry, config, bottom, gone)
        births += initiated
    return state, tuple(births)


def _births_in(
    state: BirthCandidates,
    v: int,
    geometry: ViewGeometry,
    config: ViewsConfig,
    bottom: bool,
    gone: Collection[TrackerKey],
) -> tuple[BirthCandidates, list[Birth]]:
    """Start trackers in view `v` from its candidates, each for a target of other views or for a new target.

    Args:
        state: candidates of all views, and trails of the trackers.
        v: number of the view.
        geometry: fundamental matrices between the views.
        config: settings of births and terminations.
        bottom: compare the lowest points of ellipses with epipolar lines; else their centres.
        gone: (view, target) of trackers that ended in this time step; their targets do not restart in that view now.

    Returns:
        The state without the candidates that became trackers, with trails of these, and the births.
    """
    candidates = _without_doubles(state.candidates[v], config.birth_min_distance)
    free = _free_targets(state.trails, v)
    misfit = np.array([[_misfit(c.trail, v, t, state.trails, geometry, bottom) for t in free] for c in candidates])
    misfit = misfit.reshape(len(candidates), len(free))
    births, left, trails, next_id = [], [], dict(state.trails), state.next_id
    for c, candidate in enumerate(candidates):
        target = _decide(misfit, c, candidate, config) if candidate.count >= config.confirmation_frames else None
        if target is None or (target >= 0 and (v, free[target]) in gone):
            left.append(candidate)
            continue
        if target < 0:
            target_id, next_id = next_id, next_id + 1
        else:
            target_id = free[target]
            misfit[:, target] = np.inf  # the target now has a tracker in this view
        births.append(Birth(v, target_id, candidate.ellipse))
        trails[v, target_id] = candidate.trail
    rest = (*state.candidates[:v], tuple(left), *state.candidates[v + 1 :])
    return replace(state, candidates=rest, trails=trails, next_id=next_id), births


def _without_doubles(candidates: Sequence[Candidate], separation: float) -> tuple[Candidate, ...]:
    """Return the candidates, without those near one that has been followed for at least as many frames.

    Near means at most `separation` times the sum of the two radii along the line between the centres.
    """
    order = sorted(range(len(candidates)), key=lambda c: -candidates[c].count)
    if len(order) < 2:
        return tuple(candidates)
    near = nearness(np.array([c.ellipse for c in candidates]))
    kept: list[int] = []
    for c in order:
        if all(near[c, k] > separation for k in kept):
            kept.append(c)
    return tuple(candidates[c] for c in sorted(kept))


def _free_targets(trails: Mapping[TrackerKey, Trail], v: int) -> list[int]:
    """Return the sorted identities of targets with a tracker (a key of `trails`) in other views but not in view `v`."""
    mine = {target for view, target in trails if view == v}
    return sorted({target for _, target in trails} - mine)


def _misfit(
    trail: Trail, v: int, target: int, trails: Mapping[TrackerKey, Trail], geometry: ViewGeometry, bottom: bool
) -> float:
    """Return how badly a candidate in view `v` fits a target: the mean loop distance over common time steps, in radii.

    The loop distance is that of [Qu] Sec. 3.4.2 (`loop_distances`). Of the target's trackers in other views the worst
    counts. inf without a fundamental matrix, without a common time step, or if the mean exceeds 1.

    Args:
        trail: time steps and ellipses of the candidate.
        v: view of the candidate.
        target: identity of the target.
        trails: time steps and ellipses of all trackers, by (view, target).
        geometry: fundamental matrices between the views.
        bottom: compare the lowest points of ellipses; else their centres.
    """
    worst = -np.inf
    for (w, other), theirs in trails.items():
        matrix = geometry.fundamental[w, v]
        if other != target or not np.isfinite(matrix).all():
            continue
        past = dict(theirs)
        both = [(past[k], ellipse) for k, ellipse in trail if k in past]
        if both:
            a, b = (np.array(rows) for rows in zip(*both, strict=True))
            worst = max(worst, float(loop_distances(geometry, w, v, a, b, bottom).mean()))
    return worst if 0.0 <= worst <= 1.0 else np.inf


def _decide(misfit: Floats, c: int, candidate: Candidate, config: ViewsConfig) -> int | None:
    """Decide which target of other views a candidate belongs to, if any.

    Where none fits it starts a new target. It takes the only target that fits if no other candidate fits that one.
    Otherwise it waits for `confirmation_wait_frames`, and then takes the best fit if its misfit is at most half that of
    every rival fit, else it starts a new target.

    Args:
        misfit: (candidates, targets) mean loop distances in radii, from `_misfit`; inf where they do not fit.
        c: row of the candidate.
        candidate: the candidate.
        config: settings of births and terminations.

    Returns:
        Column of the target; -1: a new target; None: wait.
    """
    # A new target where none fits, and the only one that fits where it fits no other candidate
    fits = np.flatnonzero(misfit[c] <= 1.0)
    if not len(fits):
        return -1
    rivals = (misfit[:, fits] <= 1.0).sum(axis=0) > 1
    if len(fits) == 1 and not rivals[0]:
        return int(fits[0])
    # Wait for the rivals to part, then take the best where it is clearly so
    if candidate.count < config.confirmation_frames + config.confirmation_wait_frames:
        return None
    best = int(fits[np.argmin(misfit[c, fits])])
    others = np.concatenate([np.delete(misfit[c], best), np.delete(misfit[:, best], c)])
    return best if not (others <= 1.0).any() or misfit[c, best] <= MAX_MISFIT_RATIO * float(others.min()) else -1
