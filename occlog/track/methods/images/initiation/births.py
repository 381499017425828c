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
    """Return (N, 2) reference points of ellipses (N, 5) [px]: their centres, or their lowest points if `bottom`.

    Args:
        ellipses: (N, 5) x, y, two semi-axes [px] and angle [rad], see `occlog.core.image`.
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
    """Return (N,) larger of the two distances of ellipses from each other's epipolar lines, in radii.

    They are inf where unknown.

    Args:
        geometry: fundamental matrices between the views.
        a: number of a view.
        b: number of another view.
        of_a: (N, 5) ellipses of targets in view a.
        of_b: (N, 5) of the same targets in view b.
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
    """(N,) radii [px] of the circles of the same area as ellipses (N, 5)."""
    return np.asarray(np.sqrt(ellipses[:, 2] * ellipses[:, 3]))


Trail = tuple[tuple[int, Floats], ...]
"""Number of the time step and ellipse, for each of the latest frames."""

EDGE_PX = 1.0
"""The edge of the image cuts a region that comes nearer to it than this."""
MAX_MISFIT_RATIO = 0.5
"""The best fit is clear when its misfit is at most this share of the second one's."""


@dataclass(frozen=True)
class Candidate:
    """A detected region without a tracker, followed from frame to frame as a possible birth."""

    trail: Trail
    count: int  # frames in a row

    @property
    def ellipse(self) -> Floats:
        """Return the ellipse (5,) of the latest frame."""
        return self.trail[-1][1]


@dataclass(frozen=True)
class BirthCandidates:
    """Candidates for births, and trails and unsupported frame counts of trackers, carried between time steps."""

    next_id: int
    candidates: tuple[tuple[Candidate, ...], ...]  # of each view
    trails: Mapping[TrackerKey, Trail] = field(default_factory=dict)  # of trackers
    unsupported: Mapping[TrackerKey, int] = field(default_factory=dict)  # frames in a row without a region at a tracker
    step: int = 0


def empty_candidates(n_views: int, next_id: int = 0) -> BirthCandidates:
    """State before the first time step; new targets are numbered from `next_id`."""
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
    """Decide which regions of a time step start trackers and which trackers end.

    Args:
        state: candidates after the time step before.
        regions: (K, 5) of each view; None: frame not processed by the detector.
        trackers: ellipses of all trackers after this time step's frames, of all views.
        views: V views.
        geometry: fundamental matrices between the views.
        config: settings of births and terminations.
        bottom: the lowest points of ellipses are compared with epipolar lines; else their centres.
        gone: trackers that ended in this time step; their targets do not restart in that view before the next one.
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
    """Return a trail with ellipse (5,) of time step `now` appended, cut to its last `keep` entries."""
    return (*trail, (now, ellipse))[-keep:]


def _birth_sized(regions: Floats, view: TrackedView, config: ViewsConfig) -> Floats:
    """Return those of the regions (K, 5) that are large enough for a birth: half axes of at least `birth_min_size_px`.

    Without `birth_allow_truncated` those that the image edge cuts are omitted, too.
    """
    low, high = regions[:, :2] - regions[:, 2:4], regions[:, :2] + regions[:, 2:4]
    good = (regions[:, 2:4] >= config.birth_min_size_px).all(axis=1)
    if not config.birth_allow_truncated:
        corner = np.array([view.width, view.height]) - 0.5 - EDGE_PX
        good &= (low >= EDGE_PX - 0.5).all(axis=1) & (high <= corner).all(axis=1)
    return np.asarray(regions[good])


def _unexplained(regions: Floats, trackers: Sequence[Floats], separation: float) -> Floats:
    """Return those of the regions (K, 5) that are farther than `separation` sums of radii from every tracker (5,)."""
    if not trackers or not len(regions):
        return regions
    near = nearness(np.vstack([regions, *trackers]))[: len(regions), len(regions) :]
    return np.asarray(regions[near.min(axis=1) > separation])


def _followed(before: Sequence[Candidate], regions: Floats, now: int, keep: int) -> tuple[Candidate, ...]:
    """Return this frame's candidates, one for each region (K, 5).

    A region continues a touching candidate of the last frame (`before`), nearest pairs first, or starts one; other
    candidates are dropped. `now` is the time step; trails keep their last `keep` entries.
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
    """Count frames without a supporting region, and end the trackers that have had none for long.

    Return the state with the counts, and the trackers ended after `max_coasting_frames` such frames in a row.
    `regions` are (K, 5) of each view (None: frame not processed, which counts as no frame), `trackers` ellipses (5,).
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
    """Return the trackers of `mine` (those of one view) that a touching region supports, one region each.

    Of several trackers at a region, the one supported last gets it. `trackers` are ellipses (5,), `regions` (K, 5),
    `before` the frames in a row without support.
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
    """Return the state after the births in all views, and the births, view by view.

    Args:
        state: candidates, updated with this frame.
        geometry: fundamental matrices between the views.
        config: settings of births and terminations.
        bottom: compare the lowest points of ellipses with epipolar lines; else their centres.
        gone: trackers that ended in this time step; their targets do not restart in that view now.
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
    """Return the state after the births in view `v`, without their candidates, and these births.

    The other arguments are those of `_births`.
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
    """Return the candidates, without those within `separation` sums of radii of a candidate with more frames."""
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
    """Return the mean loop distance between a candidate's trail in view `v` and a target's trackers, in radii.

    Of several trackers the largest counts. It is inf where no fundamental matrix is known, no frame is shared, or the
    distance exceeds 1. `bottom`: compare the lowest points of ellipses; else their centres.
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
    """Decide which target a candidate belongs to.

    Args:
        misfit: (candidates, targets) from `_misfit`, at most 1 where they fit.
        c: row of the candidate.
        candidate: the candidate.
        config: settings of births and terminations.

    Returns:
        Column of the target; -1: a new one; None: wait.
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
