"""Whether trackers of one target in several views agree: the loop check of [Qu] Sec. 3.4.2 from frame to frame."""

from __future__ import annotations

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.track.images.interface import BAD, GOOD, NONE
from occlog.track.images.kernels.bands import TOGETHER, UNKNOWN, hysteresis, loop_check

from .state import State, Trackers

_SAME = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def affine_maps(state: State, estimate: Floats) -> Floats:
    """(n, 2, 3) maps from recorded pixels to those without distortion, good near the estimates (n, 5)."""
    t = state.trackers
    out = np.repeat(_SAME[None], len(t.view), axis=0)
    for v, ideal in enumerate(state.geometry.ideal):
        rows = np.flatnonzero(t.view == v)
        if ideal is None or not len(rows):
            continue
        centre = estimate[rows, :2]
        around = centre + np.array([[[0.0, 0.0]], [[1.0, 0.0]], [[0.0, 1.0]]])
        p, right, down = ideal(around.reshape(-1, 2)).reshape(3, -1, 2)
        turn = np.stack([right - p, down - p], axis=-1)
        out[rows] = np.concatenate([turn, (p - np.einsum("nij,nj->ni", turn, centre))[..., None]], axis=-1)
    return out


def looped(state: State, fresh: Bools) -> Trackers:
    """The trackers after a loop check of their estimates.

    Args:
        state: after the frame.
        fresh: (n,) trackers whose estimate is new enough to be compared.
    """
    t, config = state.trackers, state.config
    check = _check(state, fresh)
    good, run = hysteresis(check, t.good, t.run, config.bad_after, config.good_after)
    good, run, checked = _first(t, check, good, run)
    return t._replace(good=good, run=run, checked=checked)


def paired_anew(state: State) -> Trackers:
    """The trackers, those with new counterparts checked for the first time."""
    t = state.trackers
    good, run, checked = _first(t, _check(state, np.ones(len(t.view), dtype=np.bool_)), t.good, t.run)
    return t._replace(good=good, run=run, checked=checked)


def _check(state: State, fresh: Bools) -> Ints:
    t = state.trackers
    maps = affine_maps(state, t.estimate)
    found = loop_check(t.estimate, maps, t.view, t.twin, state.geometry.fundamental, state.config.anchor == "bottom")
    return np.where(fresh[:, None] & fresh[t.twin], found, UNKNOWN)


def _first(t: Trackers, check: Ints, good: Bools, run: Ints) -> tuple[Bools, Ints, Bools]:
    """The first check of a pair decides at once."""
    first = ~t.checked & (check != UNKNOWN)
    return np.where(first, check == TOGETHER, good), np.where(first, 0, run), t.checked | first


def counterparts(t: Trackers) -> Ints:
    """(n,) whether a tracker has a good counterpart, only bad ones, or none that can be checked."""
    return np.where(t.good.any(axis=1), GOOD, np.where(t.checked.any(axis=1), BAD, NONE))


def helpers(t: Trackers, fresh: Bools) -> Ints:
    """(n, V) trackers that may help: good counterparts whose estimates are not old; -1: none."""
    return np.where(t.good & (t.twin >= 0) & fresh[t.twin], t.twin, -1)
