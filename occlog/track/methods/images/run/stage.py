"""Tracking in the images of several views as a stream: time steps in, tables of ellipses out.

Around the method's step stand the births and ends of trackers, from a file or from a
detector's regions, and the checks whether the fundamental matrices fit what is tracked.

Check of the fundamental matrices against what is tracked: the loop check of [Qu] Sec. 3.4.2 on free targets.

Only targets that touch no other in both views count: the tracker of a hidden target may be
off it, which is no fault of the geometry.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from occlog.array_types import Bools, Floats, Ints, Strings
from occlog.core.image import touching
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.measure.epipolar.views import TrackedView, ViewGeometry
from occlog.records.declared.views import COUNTERPARTS, EVENTS, ViewTracks
from occlog.track.methods.images.initiation.births import (
    BirthCandidates,
    empty_candidates,
    initiate_and_terminate,
    loop_distances,
    radius,
)
from occlog.track.methods.images.initiation.config import ViewsConfig
from occlog.track.methods.images.initiation.regions import RegionStream
from occlog.track.methods.images.interface import (
    LEFT,
    MODES,
    START,
    TERMINATED,
    Birth,
    FrameSet,
    TrackerKey,
    TrackerOutlines,
)
from occlog.track.methods.images.methods.config import LoopCheckConfig, MipfConfig
from occlog.track.methods.images.methods.state import VisualState, end_trackers, initial_state, with_geometry
from occlog.track.methods.images.methods.step import advance, initiate_trackers

from .frame_synchronisation import FrameSetImages, there

NO_TRACKERS: Mapping[TrackerKey, Floats] = MappingProxyType({})
FEWEST = 3
"""Checked starts of targets below which they say nothing about a fundamental matrix."""

StartCounts = Mapping[tuple[int, int], tuple[int, int]]
"""For pairs of views the number of checked starts of targets, and how many of these failed."""


class Checks(NamedTuple):
    """N loop checks, each of a target in two views: its distances from epipolar lines, [Qu] Sec. 3.4.2.

    A check fails where `radii`, the larger of the two distances in radii of the ellipse, exceeds 1.
    """

    first: Floats  # (N,) the lower view of the two, a whole number
    second: Floats  # (N,) the higher view
    radii: Floats  # (N,) larger one of the two distances from a line, in radii of the target in that view
    px: Floats  # (N,) the same in pixels, by the mean of the two radii


def no_checks() -> Checks:
    """Return an empty set of loop checks."""
    return Checks(*(np.zeros(0) for _ in range(4)))


def gather(parts: Sequence[Checks]) -> Checks:
    """Return several sets of loop checks as one, in order; an empty set for none."""
    return Checks(*(np.concatenate(columns) for columns in zip(*parts, strict=True))) if parts else no_checks()


def check_outlines(outlines: TrackerOutlines, geometry: ViewGeometry, bottom: bool = False) -> Checks:
    """Return the loop checks of the targets that touch no other in either view, for all pairs of views.

    Args:
        outlines: ellipses of the trackers at one time step.
        geometry: fundamental matrices between the views; a pair without one has no checks.
        bottom: compare the lowest points of ellipses with epipolar lines; else their centres.
    """
    return _checks(_free(outlines.view, outlines.target_id, outlines.ellipse), geometry, bottom)


def check_births(
    births: Sequence[Birth],
    geometry: ViewGeometry,
    trackers: Mapping[TrackerKey, Floats] = NO_TRACKERS,
    bottom: bool = False,
) -> Checks:
    """Return the loop checks of starting ellipses, among themselves and against trackers of other views.

    Ellipses that touch another one of their view are omitted.

    Args:
        births: starting ellipses of one time step.
        geometry: fundamental matrices between the views.
        trackers: ellipses (5,) of existing trackers at the same time, by (view, target).
        bottom: compare the lowest points of ellipses with epipolar lines; else their centres.
    """
    if not births:
        return no_checks()
    rows = {**trackers, **{(b.view, b.target_id): b.ellipse for b in births}}
    view, target = (np.array(numbers) for numbers in zip(*rows, strict=True))
    return _checks(
        _free(view, target, np.array(list(rows.values()))), geometry, bottom, {(b.view, b.target_id) for b in births}
    )


def _free(view: Ints, target: Ints, ellipses: Floats) -> dict[TrackerKey, Floats]:
    """Return the ellipses that touch no other of their view, by (view, target).

    `view` and `target` (n,) belong to `ellipses` (n, 5).
    """
    rows = {}
    for v in np.unique(view).tolist():
        mine = np.flatnonzero(view == v)
        alone = mine[~touching(ellipses[mine]).any(axis=1)]
        rows.update({(v, t): e for t, e in zip(target[alone].tolist(), ellipses[alone], strict=True)})
    return rows


def _checks(
    rows: Mapping[TrackerKey, Floats],
    geometry: ViewGeometry,
    bottom: bool,
    initiated: Collection[TrackerKey] | None = None,
) -> Checks:
    """Return the loop checks of each target in each pair of views with a known fundamental matrix.

    Args:
        rows: ellipses (5,) by view and target.
        geometry: fundamental matrices between the views.
        bottom: compare the lowest points of ellipses with epipolar lines; else their centres.
        initiated: starting trackers; only checks that involve one of them count. None: all checks.
    """
    parts = []
    known = np.isfinite(geometry.fundamental).all(axis=(2, 3))
    for a, b in zip(*(indices.tolist() for indices in np.nonzero(np.triu(known, 1))), strict=True):
        shared = [t for v, t in rows if v == a and (b, t) in rows]
        if initiated is not None:
            shared = [t for t in shared if (a, t) in initiated or (b, t) in initiated]
        if shared:
            of_a, of_b = (np.array([rows[v, t] for t in shared]) for v in (a, b))
            radii = loop_distances(geometry, a, b, of_a, of_b, bottom)
            n = len(shared)
            size = 0.5 * (radius(of_a) + radius(of_b))
            parts.append(Checks(np.full(n, float(a)), np.full(n, float(b)), radii, radii * size))
    return gather(parts)


def drop_contradicted(
    geometry: ViewGeometry, checks: Checks, counts: StartCounts
) -> tuple[ViewGeometry, StartCounts, tuple[tuple[int, int], ...]]:
    """Drop the fundamental matrices of pairs of views that more than half of the first targets contradict.

    The first `FEWEST` checked starts of a pair decide, with others of the same time step; later ones change nothing.

    Args:
        geometry: fundamental matrices in use.
        checks: loop checks of the births of one time step.
        counts: numbers of checked and failed starts by pair of views, from the time steps before.

    Returns:
        The geometry, with NaN for dropped matrices; the counts with the checks added; the pairs of views dropped now.
    """
    matrices, after, dropped = geometry.fundamental.copy(), dict(counts), []
    for a, b in sorted(set(zip(checks.first.astype(int).tolist(), checks.second.astype(int).tolist(), strict=True))):
        n, failed = counts.get((a, b), (0, 0))
        if n >= FEWEST:
            continue
        mine = checks.radii[(checks.first == a) & (checks.second == b)]
        n, failed = after[a, b] = n + len(mine), failed + int((mine > 1.0).sum())
        if n >= FEWEST and 2 * failed > n:
            matrices[a, b] = matrices[b, a] = np.nan
            dropped.append((a, b))
    return geometry._replace(fundamental=matrices) if dropped else geometry, after, tuple(dropped)


STEPS_PER_PART = 64
"""Time steps in a part."""
START_VARIANCE = 1.0
"""Variance of a centre that was given or detected [px^2], each axis."""
MAX_COMPARISON_AGE_PERIODS = 1.5
"""Age [frame periods] to which a tracker's ellipse is compared with that of a tracker initiated in another view."""


class TrackerStart(NamedTuple):
    """A tracker to start in the first usable frame from number `frame`."""

    view: int
    frame: int
    target_id: int
    ellipse: Floats  # (5,)


@dataclass(frozen=True)
class TrackingSetup:
    """Method, settings, views and starts of trackers of a run.

    Attributes:
        views: V views.
        geometry: fundamental matrices between the views.
        config: settings of the method; their class selects it.
        stage: settings of births and ends.
        starts: trackers to begin.
        next_id: number of the first target that detections begin.
        period_ns: frame period of each view [ns], 0 if not known; empty: none is known.
    """

    views: tuple[TrackedView, ...]
    geometry: ViewGeometry
    config: MipfConfig
    stage: ViewsConfig = field(default_factory=ViewsConfig)
    starts: tuple[TrackerStart, ...] = ()
    next_id: int = 0
    period_ns: tuple[int, ...] = ()

    @property
    def bottom(self) -> bool:
        """Return whether epipolar distances use the lowest points of ellipses; otherwise their centres."""
        return isinstance(self.config, LoopCheckConfig) and self.config.bottom

    @property
    def views_help(self) -> bool:
        """Return whether the method uses the collaboration of views."""
        return isinstance(self.config, LoopCheckConfig)


class ViewsPart(NamedTuple):
    """Output rows of some time steps with V views, and counts for the summary."""

    tracks: ViewTracks
    frames: Ints  # (V,) frames that could be used
    last_ns: Ints  # (V,) time of the latest one of the part, -1: none
    lost: tuple[tuple[int, int, str], ...]  # (view, frame, why) of the others
    checks: Checks  # loop checks of targets that touch no other
    start_checks: Checks  # the same of the ellipses that trackers started with
    dropped: tuple[tuple[int, int], ...]  # pairs of views with a fundamental matrix that is not used any more


@dataclass(frozen=True)
class _RunState:
    """State of a run between time steps: the method's state, and what births, ends and checks need."""

    state: VisualState | None  # of the method; None until the first birth
    geometry: ViewGeometry  # without the matrices that were dropped
    candidates: BirthCandidates
    last_ns: Ints  # (V,) time of each view's latest frame; -1: none yet
    start_counts: StartCounts
    waiting: tuple[TrackerStart, ...]  # starts with a frame still to come
    trackers: Mapping[TrackerKey, Floats]  # latest ellipse of each tracker


class _MomentResult(NamedTuple):
    """Results of one time step: frames, outlines of the trackers, births, ends and loop checks.

    `outlines` is None if the method made no step, without trackers or frames. `checks` are of tracked ellipses,
    `start_checks` of those that trackers started with. `dropped` are pairs of views that lost their fundamental matrix.
    """

    frame_set: FrameSetImages
    outlines: TrackerOutlines | None
    births: tuple[Birth, ...]
    ended: tuple[TrackerKey, ...]
    checks: Checks
    start_checks: Checks
    dropped: tuple[tuple[int, int], ...]


def track_views(
    frame_sets: Iterable[FrameSetImages], setup: TrackingSetup, seed: int, stream: RegionStream | None = None
) -> Iterator[ViewsPart]:
    """Generate tracks in images in time order, in parts of some time steps, with the checks of each part.

    A tracker's first row is its birth, with the ellipse that was given. Where most of the first targets that two views
    share contradict their fundamental matrix, the matrix is not used any more.

    Args:
        frame_sets: frames of the views, time step by time step.
        setup: method, views and starts.
        seed: seed of all random numbers.
        stream: regions of a detector, which start and end trackers; None: no detector.
    """
    rng = generator(seed, RandomStream.TRACK)
    run = _RunState(
        state=None,
        geometry=setup.geometry,
        candidates=empty_candidates(len(setup.views), setup.next_id),
        last_ns=np.full(len(setup.views), -1, dtype=np.int64),
        start_counts={},
        waiting=setup.starts,
        trackers={},
    )
    results: list[_MomentResult] = []
    for frame_set in frame_sets:
        run, result = _advance(run, frame_set, setup, rng, stream)
        results.append(result)
        if len(results) == STEPS_PER_PART:
            yield _part(results, setup.views)
            results = []
    if results:
        yield _part(results, setup.views)


def _advance(
    run: _RunState,
    frame_set: FrameSetImages,
    setup: TrackingSetup,
    rng: np.random.Generator,
    stream: RegionStream | None,
) -> tuple[_RunState, _MomentResult]:
    """Return the run after the frames of one time step, and the results of the step.

    Args:
        run: state before the time step.
        frame_set: frames of the views.
        setup: method, views and settings.
        rng: generator of the random numbers drawn.
        stream: regions of a detector, which start and end trackers; None: no detector.
    """
    outlines, checks, gone = None, no_checks(), frozenset[TrackerKey]()
    found: tuple[Floats | None, ...] = ()
    if stream is not None:
        found = tuple(stream.at([view.name for view in setup.views], frame_set.t_ns))
        frame_set = frame_set._replace(frames=frame_set.frames._replace(regions=found))
    run = replace(run, last_ns=np.where(there(frame_set), frame_set.t_ns, run.last_ns))
    # Step of the method
    if run.state is not None and run.trackers and there(frame_set).any():
        state, outlines = advance(run.state, frame_set.frames, rng)
        survivors = _survivors(run.trackers, outlines)
        gone = frozenset(run.trackers) - frozenset(survivors)
        run = replace(run, state=state, trackers=survivors)
        if setup.views_help:
            checks = check_outlines(outlines, setup.geometry, setup.bottom)
    # Births that were given, and births and ends by regions
    run, births = _due(run, frame_set.frames, gone)
    ended: tuple[TrackerKey, ...] = ()
    if stream is not None:
        trackers = {**run.trackers, **{(b.view, b.target_id): b.ellipse for b in births}}
        candidates, initiated, ended = initiate_and_terminate(
            run.candidates,
            found,
            trackers,
            views=setup.views,
            geometry=run.geometry,
            config=setup.stage,
            bottom=setup.bottom,
            gone=gone,
        )
        births, run = (*births, *initiated), replace(run, candidates=candidates)
        ended = tuple(key for key in ended if key in run.trackers)
    # Drop matrices that births contradict, then begin and end
    start_checks = check_births(births, setup.geometry, _recent(run, frame_set, setup), setup.bottom)
    run, dropped = _without_contradicted(run, start_checks, setup)
    run = _begun(run, frame_set.frames, births, ended, setup)
    return run, _MomentResult(frame_set, outlines, births, ended, checks, start_checks, dropped)


def _survivors(trackers: Mapping[TrackerKey, Floats], outlines: TrackerOutlines) -> dict[TrackerKey, Floats]:
    """Return the latest ellipses (5,) of the trackers after a step by (view, target), without those that ended in it.

    Args:
        trackers: latest ellipses before the step; a tracker without a frame keeps its ellipse.
        outlines: ellipses and end events of the step.
    """
    out = dict(trackers)
    rows = zip(
        outlines.view.tolist(), outlines.target_id.tolist(), outlines.ellipse, outlines.lifecycle.tolist(), strict=True
    )
    for view, target, ellipse, event in rows:
        if event in (LEFT, TERMINATED):
            out.pop((view, target), None)
        else:
            out[view, target] = ellipse
    return out


def _due(run: _RunState, frames: FrameSet, gone: frozenset[TrackerKey]) -> tuple[_RunState, tuple[Birth, ...]]:
    """Return the run without the starts that are due in this time step, and these as births.

    A start is due when a frame of its view with its number or a later one is there; it gives no birth if the target is
    tracked in that view already. A start with a tracker that ended in this frame (`gone`) waits for the next frame, as
    a frame has one row per target.
    """
    here = [s for s in run.waiting if frames.images[s.view] is not None and frames.number[s.view] >= s.frame]
    due = [s for s in here if (s.view, s.target_id) not in gone]
    if not due:
        return run, ()
    births = tuple(Birth(s.view, s.target_id, s.ellipse) for s in due if (s.view, s.target_id) not in run.trackers)
    return replace(run, waiting=tuple(s for s in run.waiting if s not in due)), births


def _recent(run: _RunState, frame_set: FrameSetImages, setup: TrackingSetup) -> dict[TrackerKey, Floats]:
    """Return the ellipses of trackers with which births in other views are compared, by (view, target).

    These are the latest ones of views with a frame in this time step or one at most 1.5 frame periods old; none if the
    method does not use several views, as the trackers of two views may then be on different targets.
    """
    if not setup.views_help:
        return {}
    period = np.array(setup.period_ns or (0,) * len(setup.views))
    age = frame_set.t_ns.max() - run.last_ns
    fresh = there(frame_set) | ((run.last_ns >= 0) & (age <= MAX_COMPARISON_AGE_PERIODS * period))
    return {(view, target): ellipse for (view, target), ellipse in run.trackers.items() if fresh[view]}


def _without_contradicted(
    run: _RunState, checks: Checks, setup: TrackingSetup
) -> tuple[_RunState, tuple[tuple[int, int], ...]]:
    """Return the run without the fundamental matrices contradicted by births, and the pairs of views dropped now.

    `checks` are the loop checks of this time step's births.
    """
    geometry, counts, dropped = drop_contradicted(run.geometry, checks, run.start_counts)
    state = run.state
    if dropped and state is not None and setup.views_help:
        state = with_geometry(state, geometry)
    return replace(run, state=state, geometry=geometry, start_counts=counts), dropped


def _begun(
    run: _RunState,
    frames: FrameSet,
    births: tuple[Birth, ...],
    ended: tuple[TrackerKey, ...],
    setup: TrackingSetup,
) -> _RunState:
    """Return the run with trackers added for `births`, and without the trackers `ended`, keys (view, target).

    Args:
        run: state before.
        frames: frames of the time step; the views of the births have one.
        births: trackers to start.
        ended: trackers to end.
        setup: views and settings of the method, to make its state at the first birth.
    """
    state = run.state
    if births and state is None:
        state = initial_state(setup.views, run.geometry, setup.config)
    if ended and state is not None:
        state = end_trackers(state, ended)
    if births and state is not None:
        state = initiate_trackers(state, frames, births)
    trackers = {key: ellipse for key, ellipse in run.trackers.items() if key not in ended}
    trackers |= {(b.view, b.target_id): b.ellipse for b in births}
    return replace(run, state=state, trackers=trackers)


def _part(results: Sequence[_MomentResult], views: Sequence[TrackedView]) -> ViewsPart:
    """Return the output of several time steps, concatenated."""
    seen = np.array([there(result.frame_set) for result in results])
    times = np.array([result.frame_set.t_ns for result in results])
    return ViewsPart(
        tracks=ViewTracks.concat([_table(result, views) for result in results]),
        frames=seen.sum(axis=0),
        last_ns=times.max(axis=0),
        lost=tuple(lost for result in results for lost in result.frame_set.lost),
        checks=gather([result.checks for result in results]),
        start_checks=gather([result.start_checks for result in results]),
        dropped=tuple(pair for result in results for pair in result.dropped),
    )


def _table(result: _MomentResult, views: Sequence[TrackedView]) -> ViewTracks:
    """Return the rows of one time step, sorted: births and tracked ellipses."""
    parts = [] if result.outlines is None else [_tracked(result.outlines, result.frame_set, views, result.ended)]
    if result.births:
        parts.append(_initiated(result.births, result.frame_set, views))
    return ViewTracks.merge(parts)


def _initiated(births: Sequence[Birth], frame_set: FrameSetImages, views: Sequence[TrackedView]) -> ViewTracks:
    """Return the rows of births, with the ellipse they start from and a variance of `START_VARIANCE`."""
    n = len(births)
    view = np.array([birth.view for birth in births])
    ellipse = np.array([birth.ellipse for birth in births])
    nothing = np.full(n, "")
    return ViewTracks.of(
        **_places(view, np.array([birth.target_id for birth in births]), ellipse, frame_set, views),
        cov_xx_px=np.full(n, START_VARIANCE),
        cov_xy_px=np.zeros(n),
        cov_yy_px=np.full(n, START_VARIANCE),
        similarity=np.ones(n),
        ess=np.full(n, np.nan),
        likelihood_mode=nothing,
        counterpart=nothing,
        neighbours=nothing,
        assisting_views=nothing,
        lifecycle=np.full(n, EVENTS[START]),
    ).sorted()


def _tracked(
    o: TrackerOutlines, frame_set: FrameSetImages, views: Sequence[TrackedView], ended: Sequence[TrackerKey]
) -> ViewTracks:
    """Return the output rows of tracked ellipses, in the table's order.

    Args:
        o: ellipses of the trackers after the step.
        frame_set: frames of the step, for times and frame numbers.
        views: V views, for their names.
        ended: (view, target) of trackers ended for lack of regions; they are marked as terminated.
    """
    keys = list(zip(o.view.tolist(), o.target_id.tolist(), strict=True))
    event = np.where(np.array([key in ended for key in keys], dtype=np.bool_), TERMINATED, o.lifecycle)
    names = np.array([view.name for view in views])
    return ViewTracks.of(
        **_places(o.view, o.target_id, o.ellipse, frame_set, views),
        cov_xx_px=o.covariance[:, 0],
        cov_xy_px=o.covariance[:, 1],
        cov_yy_px=o.covariance[:, 2],
        similarity=o.similarity,
        ess=o.ess,
        likelihood_mode=np.array(MODES)[o.likelihood_mode],
        counterpart=np.array(COUNTERPARTS)[o.counterpart],
        neighbours=_listed(o.touching, o.target_id.astype(str)),
        assisting_views=_listed(o.assisting_views, names),
        lifecycle=np.array(EVENTS)[event],
    ).sorted()


def _places(
    view: Ints, target: Ints, ellipse: Floats, frame_set: FrameSetImages, views: Sequence[TrackedView]
) -> dict[str, NDArray[np.generic]]:
    """Return the columns time, camera, frame, target and ellipse of the output rows of n trackers.

    Angles are wrapped to [-pi/2, pi/2).

    Args:
        view: (n,) number of each tracker's view.
        target: (n,) identities.
        ellipse: (n, 5) centre and half axes [px], angle of the first axis [rad].
        frame_set: frames of the step, for times and frame numbers.
        views: V views, for their names.
    """
    rho = (ellipse[:, 4] + 0.5 * np.pi) % np.pi - 0.5 * np.pi
    return {
        "t_ns": frame_set.t_ns[view],
        "sensor": np.array([v.name for v in views])[view],
        "frame": frame_set.frames.number[view],
        "target_id": target.astype(np.int32),
        "x_px": ellipse[:, 0],
        "y_px": ellipse[:, 1],
        "a_px": ellipse[:, 2],
        "b_px": ellipse[:, 3],
        "rho": np.where(rho >= 0.5 * np.pi, -0.5 * np.pi, rho),
    }


def _listed(marks: Bools, names: Strings) -> list[str]:
    """Return for each row of `marks` (n, K) the marked ones of `names` (K,), comma-separated."""
    return [",".join(names[row].tolist()) for row in marks]
