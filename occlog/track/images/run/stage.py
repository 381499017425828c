"""Tracking in the images of several views: moments in, tables of ellipses out, streaming."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.seeds import Stage, generator
from occlog.measure.epipolar.views import Geometry, View
from occlog.records.views import COUNTERPARTS, EVENTS, ViewTracks
from occlog.track.images.births.births import Key, Nursery, attend, nursery
from occlog.track.images.births.config import ViewsConfig
from occlog.track.images.births.regions import Feed
from occlog.track.images.interface import LEFT, LOST, MODES, START, Birth, Looks, Outlines, Visual

from .frames_in_step import Moment, there
from .loop_checks import Checks, Tried, check_births, check_outlines, gather, no_checks, trusted

MOMENTS = 64
"""Moments in a part."""
START_VARIANCE = 1.0
"""Of a centre that was given or detected [px^2]."""
RECENT = 1.5
"""Frame periods for which a tracker's ellipse is where its target is, for one that starts in another view."""


class Start(NamedTuple):
    """A tracker to begin in the first frame from `frame` on that can be used."""

    view: int
    frame: int
    target_id: int
    ellipse: Floats  # (5,)


@dataclass(frozen=True)
class Setup:
    """What tracks, where, and from what.

    Attributes:
        views: V views.
        geometry: between them.
        method: a tracking method.
        config: its settings.
        stage: settings around it.
        starts: trackers to begin.
        next_id: number of the first target that detections begin.
        helped: the method uses other views.  The trackers of one that does not may be on different targets in
            two views, which is no fault of the geometry.
        period_ns: of the frames of each view; 0 or none: not known.
        doubted: the method's state with fewer matrices, from one with more; None: it has no use for matrices.
    """

    views: tuple[View, ...]
    geometry: Geometry
    method: Visual
    config: Any
    stage: ViewsConfig = field(default_factory=ViewsConfig)
    starts: tuple[Start, ...] = ()
    next_id: int = 0
    helped: bool = True
    period_ns: tuple[int, ...] = ()
    doubted: Callable[[Any, Geometry], Any] | None = None

    @property
    def bottom(self) -> bool:
        """Whether the lowest points of ellipses are compared with epipolar lines; else their centres."""
        return getattr(self.config, "anchor", "centre") == "bottom"


class ViewsPart(NamedTuple):
    """What came out of some moments."""

    tracks: ViewTracks
    frames: Ints  # (V,) frames that could be used
    last_ns: Ints  # (V,) time of the latest one of the part, -1: none
    lost: tuple[tuple[int, int, str], ...]  # (view, frame, why) of the others
    checks: Checks  # loop checks of targets that stand free
    start_checks: Checks  # the same of what trackers started with
    dropped: tuple[tuple[int, int], ...]  # pairs of views whose fundamental matrix is not used any more


@dataclass(frozen=True)
class _Run:
    """State between moments."""

    state: Any  # of the method; None until the first birth
    geometry: Geometry
    nursery: Nursery
    last_ns: Ints  # (V,) time of each view's latest frame; -1: none yet
    tried: Tried  # starts that told of matrices
    waiting: tuple[Start, ...]
    trackers: Mapping[Key, Floats]  # ellipses of the trackers there are, by view and target


class _Step(NamedTuple):
    """What one moment gave."""

    moment: Moment
    outlines: Outlines | None
    births: tuple[Birth, ...]
    ended: tuple[Key, ...]
    checks: Checks
    start_checks: Checks
    dropped: tuple[tuple[int, int], ...]


def track_views(moments: Iterable[Moment], setup: Setup, seed: int, feed: Feed | None = None) -> Iterator[ViewsPart]:
    """View tracks in the order of time, with what happened.

    A tracker's first row is its birth, with the ellipse that was given.  Where most of the
    first targets that two views share contradict their fundamental matrix it is not used, so
    that they are tracked without each other's help.

    Args:
        moments: frames of the views.
        setup: what tracks.
        seed: of all random numbers.
        feed: regions of a detector, from which trackers begin too and by which they are ended.
    """
    rng = generator(seed, Stage.TRACK)
    unseen = np.full(len(setup.views), -1, dtype=np.int64)
    run = _Run(None, setup.geometry, nursery(len(setup.views), setup.next_id), unseen, {}, setup.starts, {})
    steps: list[_Step] = []
    for moment in moments:
        run, step = _advance(run, moment, setup, rng, feed)
        steps.append(step)
        if len(steps) == MOMENTS:
            yield _part(steps, setup.views)
            steps = []
    if steps:
        yield _part(steps, setup.views)


def _advance(
    run: _Run, moment: Moment, setup: Setup, rng: np.random.Generator, feed: Feed | None
) -> tuple[_Run, _Step]:
    outlines, checks, gone = None, no_checks(), frozenset[Key]()
    found: tuple[Floats | None, ...] = ()
    if feed is not None:
        found = tuple(feed.at([view.name for view in setup.views], moment.t_ns))
        moment = moment._replace(looks=moment.looks._replace(regions=found))
    run = replace(run, last_ns=np.where(there(moment), moment.t_ns, run.last_ns))
    if run.trackers and there(moment).any():
        state, outlines = setup.method.step(run.state, moment.looks, rng)
        outlines = outlines._replace(event=np.where(outlines.event == START, 0, outlines.event))
        survivors = _survivors(run.trackers, outlines)
        gone = frozenset(run.trackers) - frozenset(survivors)
        run = replace(run, state=state, trackers=survivors)
        checks = check_outlines(outlines, setup.geometry, setup.bottom) if setup.helped else checks
    run, births = _due(run, moment.looks, gone)
    ended: tuple[Key, ...] = ()
    if feed is not None:
        trackers = {**run.trackers, **{(b.view, b.target_id): b.ellipse for b in births}}
        kept, born, ended = attend(
            run.nursery, found, trackers, setup.views, run.geometry, setup.stage, setup.bottom, gone
        )
        births, run = (*births, *born), replace(run, nursery=kept)
        # Without `ended` a method's trackers end on their own
        ended = () if setup.method.ended is None else tuple(key for key in ended if key in run.trackers)
    start_checks = check_births(births, setup.geometry, _recent(run, moment, setup), setup.bottom)
    run, dropped = _doubt(run, start_checks, setup)
    run = _begin(run, moment.looks, births, ended, setup, rng)
    return run, _Step(moment, outlines, births, ended, checks, start_checks, dropped)


def _survivors(trackers: Mapping[Key, Floats], outlines: Outlines) -> dict[Key, Floats]:
    """The trackers after a step, with their latest ellipses."""
    out = dict(trackers)
    rows = zip(
        outlines.view.tolist(), outlines.target_id.tolist(), outlines.ellipse, outlines.event.tolist(), strict=True
    )
    for view, target, ellipse, event in rows:
        if event in (LEFT, LOST):
            out.pop((view, target), None)
        else:
            out[view, target] = ellipse
    return out


def _due(run: _Run, looks: Looks, gone: frozenset[Key]) -> tuple[_Run, tuple[Birth, ...]]:
    """Births that were asked for and whose frame is here, or was lost; none where a tracker of the target is there.

    Where one has ended in this frame they wait for the next, as a frame has one row of a target.
    """
    here = [s for s in run.waiting if looks.images[s.view] is not None and looks.frame[s.view] >= s.frame]
    due = [s for s in here if (s.view, s.target_id) not in gone]
    if not due:
        return run, ()
    births = tuple(Birth(s.view, s.target_id, s.ellipse) for s in due if (s.view, s.target_id) not in run.trackers)
    return replace(run, waiting=tuple(s for s in run.waiting if s not in due)), births


def _recent(run: _Run, moment: Moment, setup: Setup) -> dict[Key, Floats]:
    """Ellipses of trackers that births of other views may be compared with; none where no view helps another."""
    if not setup.helped:
        return {}
    period = np.array(setup.period_ns or (0,) * len(setup.views))
    age = moment.t_ns.max() - run.last_ns
    fresh = there(moment) | ((run.last_ns >= 0) & (age <= RECENT * period))
    return {(view, target): ellipse for (view, target), ellipse in run.trackers.items() if fresh[view]}


def _doubt(run: _Run, checks: Checks, setup: Setup) -> tuple[_Run, tuple[tuple[int, int], ...]]:
    """The run without matrices that starts contradict, and the pairs of views that lost theirs."""
    geometry, tried, dropped = trusted(run.geometry, checks, run.tried)
    state = run.state
    if dropped and state is not None and setup.doubted is not None:
        state = setup.doubted(state, geometry)
    return replace(run, state=state, geometry=geometry, tried=tried), dropped


def _begin(
    run: _Run,
    looks: Looks,
    births: tuple[Birth, ...],
    ended: tuple[Key, ...],
    setup: Setup,
    rng: np.random.Generator,
) -> _Run:
    """The run with trackers that begin and without those that end."""
    state = run.state
    if births and state is None:
        state = setup.method.init(setup.views, run.geometry, setup.config, rng)
    if ended and setup.method.ended is not None:
        state = setup.method.ended(state, ended)
    if births:
        state = setup.method.born(state, looks, births)
    trackers = {key: ellipse for key, ellipse in run.trackers.items() if key not in ended}
    trackers |= {(b.view, b.target_id): b.ellipse for b in births}
    return replace(run, state=state, trackers=trackers)


def _part(steps: Sequence[_Step], views: Sequence[View]) -> ViewsPart:
    seen = np.array([there(step.moment) for step in steps])
    times = np.array([step.moment.t_ns for step in steps])
    return ViewsPart(
        ViewTracks.concat([_table(step, views) for step in steps]),
        seen.sum(axis=0),
        times.max(axis=0),
        tuple(lost for step in steps for lost in step.moment.lost),
        gather([step.checks for step in steps]),
        gather([step.start_checks for step in steps]),
        tuple(pair for step in steps for pair in step.dropped),
    )


def _table(step: _Step, views: Sequence[View]) -> ViewTracks:
    """Rows of one moment: births, and what the trackers there were have done."""
    parts = [] if step.outlines is None else [_tracked(step.outlines, step.moment, views, step.ended)]
    if step.births:
        parts.append(_born(step.births, step.moment, views))
    return ViewTracks.merge(parts)


def _born(births: Sequence[Birth], moment: Moment, views: Sequence[View]) -> ViewTracks:
    n = len(births)
    view = np.array([birth.view for birth in births])
    ellipse = np.array([birth.ellipse for birth in births])
    nothing = np.full(n, "")
    return ViewTracks.of(
        **_places(view, np.array([birth.target_id for birth in births]), ellipse, moment, views),
        cov_xx_px=np.full(n, START_VARIANCE),
        cov_xy_px=np.zeros(n),
        cov_yy_px=np.full(n, START_VARIANCE),
        likeness=np.ones(n),
        ess=np.full(n, np.nan),
        mode=nothing,
        counterpart=nothing,
        neighbours=nothing,
        helpers=nothing,
        event=np.full(n, EVENTS[START]),
    ).sorted()


def _tracked(o: Outlines, moment: Moment, views: Sequence[View], ended: Sequence[Key]) -> ViewTracks:
    keys = list(zip(o.view.tolist(), o.target_id.tolist(), strict=True))
    event = np.where(np.array([key in ended for key in keys], dtype=np.bool_), LOST, o.event)
    names = np.array([view.name for view in views])
    return ViewTracks.of(
        **_places(o.view, o.target_id, o.ellipse, moment, views),
        cov_xx_px=o.covariance[:, 0],
        cov_xy_px=o.covariance[:, 1],
        cov_yy_px=o.covariance[:, 2],
        likeness=o.likeness,
        ess=o.ess,
        mode=np.array(MODES)[o.mode],
        counterpart=np.array(COUNTERPARTS)[o.counterpart],
        neighbours=_listed(o.touching, o.target_id.astype(str)),
        helpers=_listed(o.helpers, names),
        event=np.array(EVENTS)[event],
    ).sorted()


def _places(view: Ints, target: Ints, ellipse: Floats, moment: Moment, views: Sequence[View]) -> dict[str, Any]:
    """Columns that say where."""
    rho = (ellipse[:, 4] + 0.5 * np.pi) % np.pi - 0.5 * np.pi
    return {
        "t_ns": moment.t_ns[view],
        "sensor": np.array([v.name for v in views])[view],
        "frame": moment.looks.frame[view],
        "target_id": target.astype(np.int32),
        "x_px": ellipse[:, 0],
        "y_px": ellipse[:, 1],
        "a_px": ellipse[:, 2],
        "b_px": ellipse[:, 3],
        "rho": np.where(rho >= 0.5 * np.pi, -0.5 * np.pi, rho),
    }


def _listed(marks: Bools, names: Any) -> list[str]:
    """For each row the names of its marks, with commas."""
    return [",".join(names[row].tolist()) for row in marks]
