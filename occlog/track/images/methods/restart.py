"""Trackers that start again on an epipolar line, after which a bad counterpart may be good, [Qu] Sec. 3.4.2.

[Qu] leaves open when and how.  Here a tracker starts again when the loop check has said that
its counterparts are bad, it sits on another tracker or on nothing, and a counterpart is in
the clear on something that looks right: then it is this one that is wrong.  It goes to the
place on the line that looks most like its target, unless others are there or nothing does.
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats
from occlog.core.image.ellipse import nearness, nearness_between
from occlog.core.image.histogram_bins import update_bins
from occlog.track.images.interface import Looks
from occlog.track.images.kernels.bands import anchor, line_of

from .colours import alike
from .loop_check import affine_maps
from .regions import mask_outside
from .state import State, Trackers

APART = 0.5
"""Nearer than this many times the sum of their radii, two trackers are on the same target."""
CLEAR = 0.75
"""Farther than this, a tracker hardly hides another one."""
STEP_PX = 2.0
"""Between the places on a line that are tried."""
TRIED = 5
"""Places are tried in frames whose number is a multiple of this: most often none is good, and the next is no better."""


def restarted(state: State, looks: Looks) -> State:
    """The state after the frame, with some trackers in new places."""
    t, config = state.trackers, state.config
    bad = t.checked.any(axis=1) & ~t.good.any(axis=1)
    if not (config.restart and bad.any()):
        return state
    ratio = nearest(t)
    wrong = bad & ((ratio < APART) | (t.likeness < config.restart_likeness))
    clear = (ratio > CLEAR) & (t.likeness >= config.restart_likeness)
    for i in np.flatnonzero(wrong).tolist():
        guides = [j for j in t.twin[i].tolist() if j >= 0 and clear[j] and _agreed(t, i, j)]
        if not guides or looks.frame[t.view[i]] % TRIED:
            continue
        place = _place(state, i, guides[0], looks)
        if place is not None:
            return state._replace(trackers=_moved(t, i, place))
    return state


def nearest(t: Trackers) -> Floats:
    """(n,) distance to the nearest tracker of the same view, in sums of radii; inf for none."""
    return np.asarray(
        np.where(t.view[:, None] == t.view[None, :], nearness(t.estimate), np.inf).min(axis=1, initial=np.inf)
    )


def _agreed(t: Trackers, i: int, j: int) -> bool:
    """Whether at least half of the targets of two views agree, so that it is not their geometry that is wrong."""
    pairs = (t.view == t.view[i]) & t.checked[:, t.view[j]]
    return bool(2 * (pairs & t.good[:, t.view[j]]).sum() >= pairs.sum())


def _place(state: State, i: int, guide: int, looks: Looks) -> Floats | None:
    """(5,) where tracker i should start again on the line of its counterpart; None: nowhere."""
    t, config, number = state.trackers, state.config, int(state.trackers.view[i])
    view, image, bins = state.views[number], looks.images[number], state.bins[number]
    if image is None:
        return None
    tried = _tried(state, i, guide)
    others = np.flatnonzero((t.view == t.view[i]) & (np.arange(len(t.view)) != i))
    inside = ((tried[:, :2] >= 0) & (tried[:, :2] < [view.width, view.height])).all(axis=1)
    tried = tried[inside]
    tried = tried[(nearness_between(t.estimate[others], tried) >= APART).all(axis=0)]
    whole = np.array([[0, 0, view.width, view.height]])
    update_bins(bins, image, whole, config.pixel_step)
    mask_outside(bins, whole, looks, number)
    owner, one = np.zeros(len(tried), dtype=np.int64), slice(i, i + 1)
    found = alike(bins, tried, owner, t.colours[one], t.split[one], config.pixel_step)
    if not len(tried) or found.max() < config.restart_likeness:
        return None
    return np.asarray(tried[int(np.argmax(found))])


def _tried(state: State, i: int, guide: int) -> Floats:
    """(K, 5) ellipses of tracker i along the line of its counterpart, through the whole image."""
    t, bottom = state.trackers, state.config.anchor == "bottom"
    maps, view = affine_maps(state, t.estimate), state.views[int(t.view[i])]
    x, y = anchor(t.estimate[guide], maps[guide], bottom)
    line = line_of(state.geometry.fundamental[t.view[guide], t.view[i]], x, y)
    x, y = anchor(t.estimate[i], maps[i], bottom)
    off, reach = line[0] * x + line[1] * y + line[2], math.hypot(view.width, view.height)
    along = np.arange(-reach, reach + STEP_PX, STEP_PX)
    shift = np.column_stack([-off * line[0] - along * line[1], -off * line[1] + along * line[0]])
    out = np.repeat(t.estimate[i][None], len(along), axis=0)
    out[:, :2] += np.linalg.solve(maps[i][:, :2], shift.T).T
    out[:, 2:] = t.axes[i]
    return out


def _moved(t: Trackers, i: int, place: Floats) -> Trackers:
    """The trackers with one in a new place, at rest; its counterparts are bad until checks in a row say otherwise."""
    out = Trackers._make(field.copy() for field in t)
    out.particles[i], out.estimate[i] = place, place
    out.velocity[i], out.path[i], out.weak[i] = 0.0, 0.0, 0
    others = t.twin[i][t.twin[i] >= 0]
    for field in (out.good, out.run):
        field[i] = 0
        field[others, t.view[i]] = 0
    return out
