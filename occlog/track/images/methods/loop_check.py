"""Loop check of the trackers of one target in several views, [Qu] Sec. 3.4.2, and its outcome from frame to frame."""

from __future__ import annotations

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.image.ellipse import nearness
from occlog.track.images.interface import BAD, GOOD, NONE
from occlog.track.images.kernels.epipolar_lines import TOGETHER, UNKNOWN, hysteresis, loop_check

from .config import LoopCheckConfig
from .state import Trackers, VisualState

IDENTITY = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
APART = 0.5
"""Nearer than this many times the sum of their radii, two trackers are on the same target."""


def affine_maps(state: VisualState, estimate: Floats) -> Floats:
    """(n, 2, 3) maps from recorded pixels to those without distortion, linearised at the estimates (n, 5)."""
    t = state.trackers
    out = np.repeat(IDENTITY[None], len(t.view), axis=0)
    for v, ideal in enumerate(state.geometry.ideal):
        rows = np.flatnonzero(t.view == v)
        if ideal is None or not len(rows):
            continue
        # Differences over one pixel to the right and one down are the columns of the linear part.
        centre = estimate[rows, :2]
        around = centre + np.array([[[0.0, 0.0]], [[1.0, 0.0]], [[0.0, 1.0]]])
        p, right, down = ideal(around.reshape(-1, 2)).reshape(3, -1, 2)
        linear = np.stack([right - p, down - p], axis=-1)
        out[rows] = np.concatenate([linear, (p - np.einsum("nij,nj->ni", linear, centre))[..., None]], axis=-1)
    return out


def check_loops(state: VisualState, config: LoopCheckConfig, fresh: Bools) -> Trackers:
    """Check the estimates of all counterparts against each other, and say which counterparts are good.

    The first check of a pair decides at once.  After that a good counterpart becomes bad when
    `bad_after` checks in a row fail, and a bad one good when `good_after` in a row hold.

    Args:
        state: after the frame.
        config: settings.
        fresh: (n,) trackers whose estimate is new enough to be compared.
    """
    t = state.trackers
    check = _check(state, config, fresh)
    good, streak = hysteresis(check, t.good, t.streak, config.bad_after, config.good_after)
    good, streak, checked = _first(t, check, good, streak)
    return t._replace(good=good, streak=streak, checked=checked)


def check_new_pairs(state: VisualState, config: LoopCheckConfig) -> Trackers:
    """Check for the first time the pairs that have never been checked; the others stay as they are."""
    t = state.trackers
    good, streak, checked = _first(t, _check(state, config, np.ones(len(t.view), dtype=np.bool_)), t.good, t.streak)
    return t._replace(good=good, streak=streak, checked=checked)


def _check(state: VisualState, config: LoopCheckConfig, fresh: Bools) -> Ints:
    """(n, V) outcomes of `loop_check`; unknown where an estimate is old."""
    t = state.trackers
    found = loop_check(
        t.estimate,
        affine=affine_maps(state, t.estimate),
        view=t.view,
        counterpart=t.counterpart,
        fundamental=state.geometry.fundamental,
        bottom=config.bottom,
    )
    return np.where(fresh[:, None] & fresh[t.counterpart], found, UNKNOWN)


def _first(t: Trackers, check: Ints, good: Bools, streak: Ints) -> tuple[Bools, Ints, Bools]:
    """`good`, `streak` and `checked` where the first check of a pair decides at once."""
    first = ~t.checked & (check != UNKNOWN)
    return np.where(first, check == TOGETHER, good), np.where(first, 0, streak), t.checked | first


def counterpart_status(t: Trackers) -> Ints:
    """(n,) `GOOD` with a good counterpart, `BAD` with bad ones only, `NONE` without one that can be checked."""
    return np.where(t.good.any(axis=1), GOOD, np.where(t.checked.any(axis=1), BAD, NONE))


def helpers(t: Trackers, fresh: Bools) -> Ints:
    """(n, V) rows of the trackers that may help: good counterparts whose estimates are fresh (n,); -1: none."""
    return np.where(t.good & (t.counterpart >= 0) & fresh[t.counterpart], t.counterpart, -1)


def nearest(t: Trackers) -> Floats:
    """(n,) distance to the nearest tracker of the same view, in sums of radii; inf for none."""
    return np.asarray(
        np.where(t.view[:, None] == t.view[None, :], nearness(t.estimate), np.inf).min(axis=1, initial=np.inf)
    )
