"""Everybody with a lag: the same over a window that moves, in bounded memory and in time linear in the moments.

A window holds moments that were reported (they tell the identities), moments that are to be reported, and at least the
lag after them.  When so much has come, all of it is smoothed, the middle is reported, and the window moves on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from occlog.array_types import Ints

from ..filter import State
from ..interface import NOBODY, Event, Look, Moment
from .smooth import smooth

MOST_MOMENTS = 4096
"""So many moments are reported at a time at most, and as many wait after them."""
LEAST_MOMENTS = 8
"""So many moments are reported at a time at least, so that a short lag does not cost much more than a long one."""
SAME_PERSON = 1.0
"""The person of a window is the one of the window before who is this near at the last moment that both have [m]."""


@dataclass(frozen=True)
class Window:
    """Moments that wait, after some that were reported."""

    lag_ns: int | None  # what must have come after a moment at least; None: everything
    generator: np.random.Generator
    looks: tuple[Sequence[Look], ...] = ()
    moments: tuple[Moment, ...] = ()
    reported: int = 0  # so many of the moments were
    last: Moment | None = None  # the last one that was reported
    next_id: int = 0


def add(window: Window, state: State, looks: Sequence[Look], moment: Moment) -> tuple[Window, list[Moment]]:
    """Take in what the filter said of a moment, and give the moments that have waited long enough.

    Args:
        window: before.
        state: of the filter after the moment.
        looks: of the moment, as they were given to the filter.
        moment: what the filter said.
    """
    window = replace(window, looks=(*window.looks, looks), moments=(*window.moments, moment))
    waiting = len(window.moments) - window.reported
    if waiting >= 2 * MOST_MOMENTS:
        return _report(window, state, window.reported + MOST_MOMENTS)
    if window.lag_ns is None:
        return window, []
    # Ready: what has the lag after it
    t_ns = np.array([m.t_ns for m in window.moments])
    ready = int(np.searchsorted(t_ns, moment.t_ns - window.lag_ns, side="right"))
    if ready - window.reported < max(LEAST_MOMENTS, waiting - (ready - window.reported)):
        return window, []
    return _report(window, state, ready)


def finish(window: Window, state: State) -> list[Moment]:
    """The moments that still wait, when nothing comes any more."""
    return _report(window, state, len(window.moments))[1]


def _report(window: Window, state: State, stop: int) -> tuple[Window, list[Moment]]:
    """Smooth the window, give the moments before `stop` that were not given yet, and move on."""
    if stop <= window.reported:
        return window, []
    smoothed = smooth(state, window.looks, window.moments, window.generator)
    coming = smoothed[window.reported : stop]
    number, next_id = _identities(window, coming, smoothed[max(window.reported - 1, 0)], state.metre)
    out = [_renamed(m, number) for m in coming]
    out[0] = _first(out[0], window.last)
    # As much as waits stays before it, so that tracks do not begin at the window's edge
    keep = max(2 * stop - len(window.moments), 0) if stop < len(window.moments) else stop
    keep = min(max(keep, stop - MOST_MOMENTS), max(stop - LEAST_MOMENTS, 0))
    window = replace(
        window,
        looks=window.looks[keep:],
        moments=window.moments[keep:],
        reported=stop - keep,
        last=out[-1],
        next_id=next_id,
    )
    return window, out


def _identities(window: Window, coming: Sequence[Moment], joint: Moment, metre: float) -> tuple[dict[int, int], int]:
    """What the identities of this window are called: as before, where they were; and the next free one."""
    number: dict[int, int] = {}
    if window.last is not None and len(window.last.ids) and len(joint.ids):
        apart = np.hypot(*(joint.mean[:, None, :2] - window.last.mean[None, :, :2]).transpose(2, 0, 1))
        rows, columns = linear_sum_assignment(np.minimum(apart, SAME_PERSON * metre))
        for a, b in zip(rows, columns, strict=True):
            if apart[a, b] < SAME_PERSON * metre:
                number[int(joint.ids[a])] = int(window.last.ids[b])
    next_id = window.next_id
    for moment in coming:
        for each in moment.ids.tolist():
            if each not in number:
                number[each] = next_id
                next_id += 1
    return number, next_id


def _renamed(moment: Moment, number: dict[int, int]) -> Moment:
    """The moment with other identities, rising."""
    ids: Ints = np.array([number[k] for k in moment.ids.tolist()], dtype=np.int64)
    order = np.argsort(ids, kind="stable")
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    events = tuple(
        Event(e.kind, number[e.id], e.other if e.other == NOBODY else number[e.other], e.probability)
        for e in moment.events
        if e.id in number and (e.other == NOBODY or e.other in number)
    )
    return moment._replace(
        ids=ids[order],
        mean=moment.mean[order],
        covariance=moment.covariance[order],
        existence=moment.existence[order],
        visibility=moment.visibility[order],
        support=moment.support._replace(person=place[moment.support.person]),
        events=events,
    )


def _first(moment: Moment, last: Moment | None) -> Moment:
    """The first moment of a part, with births and deaths against the last one that was reported."""
    before = {} if last is None else dict(zip(last.ids.tolist(), last.existence.tolist(), strict=True))
    now = dict(zip(moment.ids.tolist(), moment.existence.tolist(), strict=True))
    events = [Event("birth", k, NOBODY, p) for k, p in now.items() if k not in before]
    events += [Event("death", k, NOBODY, p) for k, p in before.items() if k not in now]
    return moment._replace(events=(*events, *(e for e in moment.events if e.kind == "doubt")))
