"""Restart of trackers on an epipolar line, after which a bad counterpart may be good again, [Qu] Sec. 3.4.2.

[Qu] lets the status of a counterpart change back "after reinitialization" and leaves open when
and how.  Here a tracker restarts when all of its counterparts that were checked are bad, when
its estimate is on another tracker or on something of other colours, and when one of its
counterparts is clear of others and looks right: then it is this tracker that is wrong.  It
moves to the place on the epipolar line that looks most like its target, unless another tracker
is there or no place looks like it.
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats
from occlog.core.image.ellipse import nearness_between
from occlog.track.images.interface import FrameSet
from occlog.track.images.kernels.ellipse_colour import colour_likeness
from occlog.track.images.kernels.epipolar_lines import anchor, line_of

from .config import BmctConfig
from .loop_check import APART, affine_maps, nearest
from .state import Trackers, VisualState, update_map

CLEAR = 0.75
"""Farther than this many times the sum of their radii, one target hardly hides another."""
STEP_PX = 2.0
"""Distance of the places on a line that are tried."""
EVERY = 5
"""Places are tried in frames whose number is a multiple of this: mostly none is good, and the next frame is alike."""


def restart_one(state: VisualState, config: BmctConfig, frames: FrameSet) -> VisualState:
    """Restart the first tracker that is wrong and for which there is a place.

    Args:
        state: after the frame.
        config: settings.
        frames: of this time.
    """
    t = state.trackers
    bad = t.checked.any(axis=1) & ~t.good.any(axis=1)
    if not (config.restart and bad.any()):
        return state
    ratio = nearest(t)
    wrong = bad & ((ratio < APART) | (t.likeness < config.restart_likeness))
    clear = (ratio > CLEAR) & (t.likeness >= config.restart_likeness)
    for i in np.flatnonzero(wrong).tolist():
        guides = [j for j in t.counterpart[i].tolist() if j >= 0 and clear[j] and _views_agree(t, i, j)]
        if not guides or frames.number[t.view[i]] % EVERY:
            continue
        place = _best_place(state, config, i, guides[0], frames)
        if place is not None:
            return state._replace(trackers=_moved_to(t, i, place))
    return state


def _views_agree(t: Trackers, i: int, j: int) -> bool:
    """Whether at least half of the pairs of the two trackers' views are good, so that their geometry is not wrong."""
    pairs = (t.view == t.view[i]) & t.checked[:, t.view[j]]
    return bool(2 * (pairs & t.good[:, t.view[j]]).sum() >= pairs.sum())


def _best_place(state: VisualState, config: BmctConfig, i: int, guide: int, frames: FrameSet) -> Floats | None:
    """(5,) ellipse on the line of counterpart `guide` that is most like the target of tracker i; None: no good one."""
    t, v = state.trackers, int(state.trackers.view[i])
    view = state.views[v]
    if frames.images[v] is None:
        return None
    # Try places all along the line, those inside the image at which there is no other tracker
    tried = _places_on_line(state, config, i, guide)
    tried = tried[((tried[:, :2] >= 0) & (tried[:, :2] < [view.width, view.height])).all(axis=1)]
    others = np.flatnonzero((t.view == t.view[i]) & (np.arange(len(t.view)) != i))
    tried = tried[(nearness_between(t.estimate[others], tried) >= APART).all(axis=0)]
    # Weigh them by the colours
    bins = update_map(state, frames, v, np.array([[0, 0, view.width, view.height]]))
    found = colour_likeness(bins, tried, np.full(len(tried), i), t.colours, t.split, config.pixel_step)
    if not len(tried) or found.max() < config.restart_likeness:
        return None
    return np.asarray(tried[int(np.argmax(found))])


def _places_on_line(state: VisualState, config: BmctConfig, i: int, guide: int) -> Floats:
    """(K, 5) ellipses of tracker i, as large as at its start, along the epipolar line of its counterpart."""
    t, bottom = state.trackers, config.bottom
    maps, view = affine_maps(state, t.estimate), state.views[int(t.view[i])]
    x, y = anchor(t.estimate[guide], maps[guide], bottom)
    line = line_of(state.geometry.fundamental[t.view[guide], t.view[i]], x, y)
    # From the point of the line nearest to the estimate in both directions, as far as the image is wide and high
    x, y = anchor(t.estimate[i], maps[i], bottom)
    off, reach = line[0] * x + line[1] * y + line[2], math.hypot(view.width, view.height)
    along = np.arange(-reach, reach + STEP_PX, STEP_PX)
    shift = np.column_stack([-off * line[0] - along * line[1], -off * line[1] + along * line[0]])
    out = np.repeat(t.estimate[i][None], len(along), axis=0)
    out[:, :2] += np.linalg.solve(maps[i][:, :2], shift.T).T
    out[:, 2:] = t.axes[i]
    return out


def _moved_to(t: Trackers, i: int, place: Floats) -> Trackers:
    """Put tracker i in another place, at rest; its counterparts stay bad until checks in a row say otherwise."""
    out = Trackers._make(field.copy() for field in t)
    out.particles[i], out.estimate[i] = place, place
    out.velocity[i], out.path[i], out.weak[i] = 0.0, 0.0, 0
    others = t.counterpart[i][t.counterpart[i] >= 0]
    for field in (out.good, out.streak):
        field[i] = 0
        field[others, t.view[i]] = 0
    return out
