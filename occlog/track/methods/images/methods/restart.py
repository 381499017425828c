"""Restart of trackers on an epipolar line, after which a bad counterpart may be good again, [Qu] Sec. 3.4.2.

[Qu] lets the status of a counterpart change back "after reinitialization" and leaves open when
and how.  Here a tracker restarts when all of its counterparts that were checked are bad, when
its estimate is on another tracker or on something of other colours, and when one of its
counterparts is clear of others and consistent with its target: then it is this tracker that is wrong.  It
moves to the position on the epipolar line with the highest similarity to its target, unless another tracker
is there or no position is similar.

Loop check of the trackers of one target in several views, [Qu] Sec. 3.4.2, and its outcome from frame to frame.

Parts of method `cmct`: particles on epipolar lines, and colours that adapt.

The method is a simple form of Nummiaro's colour-based multicamera tracker, as [Qu] Sec. 4.2 compares
with it: an estimate in every view, the first colours of the target in that view as its model,
and no interaction between targets.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.random import Generator

from occlog.array_types import Bools, Floats, Ints
from occlog.core.image import nearness, nearness_between
from occlog.track.methods.images.interface import BAD, GOOD, NONE, FrameSet
from occlog.track.methods.images.kernels.appearance import colour_similarity, colours_in
from occlog.track.methods.images.kernels.epipolar_lines import (
    TOGETHER,
    UNKNOWN,
    anchor,
    drawn_on_lines,
    hysteresis,
    line_of,
    loop_check,
)

from .config import BmctConfig, CmctConfig, LoopCheckConfig
from .state import LEAST, ImageTrackers, VisualState, update_map

IDENTITY = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
SAME_TARGET_RADII = 0.5
"""Nearer than this many times the sum of their radii, two trackers are on the same target."""


def affine_maps(state: VisualState, estimate: Floats) -> Floats:
    """Return (n, 2, 3) affine transformations from recorded to undistorted pixels, linearised at n ellipse centres.

    Args:
        state: trackers and lenses; tracker i is in view `state.trackers.view[i]`.
        estimate: (n, 5) ellipse of each tracker; its transformation is exact at the centre.
    """
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


def check_loops(state: VisualState, config: LoopCheckConfig, fresh: Bools) -> ImageTrackers:
    """Return the trackers after the loop check of all counterparts, with their good or bad status, [Qu] Sec. 3.4.2.

    The first check of a pair decides at once. After that a good counterpart becomes bad when `bad_after` checks in a
    row fail, and a bad one good when `good_after` in a row pass.

    Args:
        state: trackers after the frame.
        config: settings of the method.
        fresh: (n,) trackers with an estimate new enough to be compared.
    """
    t = state.trackers
    check = _check(state, config, fresh)
    good, streak = hysteresis(check, t.good, t.streak, config.bad_after, config.good_after)
    good, streak, checked = _first(t, check, good, streak)
    return t._replace(good=good, streak=streak, checked=checked)


def check_new_pairs(state: VisualState, config: LoopCheckConfig) -> ImageTrackers:
    """Return the trackers after a first loop check of the pairs of counterparts that have never been checked.

    This check decides at once whether the pair is good; other pairs keep their status.
    """
    t = state.trackers
    good, streak, checked = _first(t, _check(state, config, np.ones(len(t.view), dtype=np.bool_)), t.good, t.streak)
    return t._replace(good=good, streak=streak, checked=checked)


def _check(state: VisualState, config: LoopCheckConfig, fresh: Bools) -> Ints:
    """Return (n, V) outcomes of the loop check of each tracker with its counterpart in each view.

    They are `TOGETHER`, `APART` or `UNKNOWN`; `UNKNOWN` too where one of the two estimates is not `fresh` (n,).
    """
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


def _first(t: ImageTrackers, check: Ints, good: Bools, streak: Ints) -> tuple[Bools, Ints, Bools]:
    """Return `good`, `streak` and `checked` (n, V), where the first check of a pair decides its status at once.

    Args:
        t: n trackers before the check.
        check: (n, V) outcomes of the loop check.
        good: (n, V) status after the check by the rule for pairs that were checked before.
        streak: (n, V) checks in a row that contradict the status, by that rule.
    """
    first = ~t.checked & (check != UNKNOWN)
    return np.where(first, check == TOGETHER, good), np.where(first, 0, streak), t.checked | first


def counterpart_status(t: ImageTrackers) -> Ints:
    """Return (n,) status of each tracker's counterparts in other views.

    `GOOD` with a good one, `BAD` with checked ones that are all bad, `NONE` without a checked one.
    """
    return np.where(t.good.any(axis=1), GOOD, np.where(t.checked.any(axis=1), BAD, NONE))


def assisting_views(t: ImageTrackers, fresh: Bools) -> Ints:
    """Return (n, V) rows of the trackers that may help each tracker from each view; -1: none.

    A counterpart may help if it is good by the loop check and its estimate is `fresh` (n,).
    """
    return np.where(t.good & (t.counterpart >= 0) & fresh[t.counterpart], t.counterpart, -1)


def nearest(t: ImageTrackers) -> Floats:
    """Return (n,) distances of trackers to the nearest tracker of the same view; inf if there is none.

    The unit is the sum of the two radii along the line between the centres.
    """
    return np.asarray(
        np.where(t.view[:, None] == t.view[None, :], nearness(t.estimate), np.inf).min(axis=1, initial=np.inf)
    )


OCCLUSION_RADII = 0.75
"""Farther than this many times the sum of their radii, one target hardly hides another."""
STEP_PX = 2.0
"""Distance of the positions on a line that are tried."""
EVERY = 5
"""Positions are tried in every n-th frame: mostly none is good, and the next frame is similar."""


def restart_one(state: VisualState, config: BmctConfig, frames: FrameSet) -> VisualState:
    """Return the state after the restart of the first tracker that is wrong and for which a position is found.

    A tracker is wrong if all its checked counterparts are bad, and it is at another tracker or unlike its target. It
    moves to the most similar position on the epipolar line of a counterpart that is clear of others. Without such a
    tracker the result is `state`.

    Args:
        state: trackers after the frame.
        config: settings of the method.
        frames: frames of this time step, at most one for each view.
    """
    t = state.trackers
    bad = t.checked.any(axis=1) & ~t.good.any(axis=1)
    if not (config.restart and bad.any()):
        return state
    ratio = nearest(t)
    wrong = bad & ((ratio < SAME_TARGET_RADII) | (t.similarities < config.restart_similarity))
    clear = (ratio > OCCLUSION_RADII) & (t.similarities >= config.restart_similarity)
    for i in np.flatnonzero(wrong).tolist():
        guides = [j for j in t.counterpart[i].tolist() if j >= 0 and clear[j] and _views_agree(t, i, j)]
        if not guides or frames.number[t.view[i]] % EVERY:
            continue
        position = _best_place(state, config, i, guides[0], frames)
        if position is not None:
            return state._replace(trackers=_moved_to(t, i, position))
    return state


def _views_agree(t: ImageTrackers, i: int, j: int) -> bool:
    """Return whether at least half of the checked pairs of trackers between the views of trackers `i` and `j` are good.

    The fundamental matrix between the two views then seems right. `i` and `j` are rows of `t`.
    """
    pairs = (t.view == t.view[i]) & t.checked[:, t.view[j]]
    return bool(2 * (pairs & t.good[:, t.view[j]]).sum() >= pairs.sum())


def _best_place(state: VisualState, config: BmctConfig, i: int, guide: int, frames: FrameSet) -> Floats | None:
    """Return the ellipse (5,) on an epipolar line that is most similar in colours to the target of tracker `i`.

    None if the similarity is below `restart_similarity`, or without a frame. Positions outside the image or at other
    trackers do not count.

    Args:
        state: trackers after the frame; the view's map of colour bins is updated in place.
        config: settings of the method.
        i: row of the tracker.
        guide: row of its counterpart in another view, the source of the line.
        frames: frames of this time step.
    """
    t, v = state.trackers, int(state.trackers.view[i])
    view = state.views[v]
    if frames.images[v] is None:
        return None
    # Try positions all along the line, those inside the image at which there is no other tracker
    tried = _places_on_line(state, config, i, guide)
    tried = tried[((tried[:, :2] >= 0) & (tried[:, :2] < [view.width, view.height])).all(axis=1)]
    others = np.flatnonzero((t.view == t.view[i]) & (np.arange(len(t.view)) != i))
    tried = tried[(nearness_between(t.estimate[others], tried) >= SAME_TARGET_RADII).all(axis=0)]
    # Weigh them by the colours
    bins = update_map(state, frames, v, np.array([[0, 0, view.width, view.height]]))
    found = colour_similarity(bins, tried, np.full(len(tried), i), t.colours, t.split, config.pixel_step)
    if not len(tried) or found.max() < config.restart_similarity:
        return None
    return np.asarray(tried[int(np.argmax(found))])


def _places_on_line(state: VisualState, config: BmctConfig, i: int, guide: int) -> Floats:
    """Return (K, 5) ellipses `STEP_PX` apart along the epipolar line of counterpart `guide` in tracker i's view.

    They have the half axes and angle of tracker i at its start, and reach both ways from its estimate as far as the
    image diagonal. `i` and `guide` are rows of the trackers.
    """
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


def _moved_to(t: ImageTrackers, i: int, position: Floats) -> ImageTrackers:
    """Return a copy of the trackers with tracker `i` (row) moved to ellipse `position` (5,) at zero velocity.

    Its pairs with counterparts become bad, and stay so until checks pass in a row.
    """
    out = ImageTrackers._make(field.copy() for field in t)
    out.particles[i], out.estimate[i] = position, position
    out.velocity[i], out.path[i], out.weak[i] = 0.0, 0.0, 0
    others = t.counterpart[i][t.counterpart[i] >= 0]
    for field in (out.good, out.streak):
        field[i] = 0
        field[others, t.view[i]] = 0
    return out


def propose_on_lines(state: VisualState, c: CmctConfig, particles: Floats, gap: Floats, rng: Generator) -> Floats:
    """Return particles with a share of them, or all after a loss, moved to the epipolar lines of other views.

    A target counts as lost when the colour similarity of its estimate is below `max_similarity_to_search`, or when its
    estimate is nearer than `SAME_TARGET_RADII` to another tracker while a counterpart is bad: of two targets of similar
    appearance the tracker then has the wrong one. Only counterparts that had a frame in the last frame period give a
    line.

    Args:
        state: trackers before the frame.
        c: settings.
        particles: (n, N, 5) ellipses after the motion.
        gap: (n,) frames since the last one.
        rng: generator of the random numbers drawn.

    Returns:
        (n, N, 5) ellipses; a tracker without a line keeps its particles.
    """
    t = state.trackers
    expected = t.estimate.copy()
    expected[:, :2] += gap[:, None] * t.velocity
    many = particles.shape[1]
    bad = ((t.counterpart >= 0) & t.checked & ~t.good).any(axis=1)
    lost = (t.similarities < c.max_similarity_to_search) | (bad & (nearest(t) < SAME_TARGET_RADII))
    return drawn_on_lines(
        particles,
        estimate=expected,
        affine=affine_maps(state, expected),
        view=t.view,
        counterpart=np.where((t.counterpart >= 0) & (gap <= 1.0)[t.counterpart], t.counterpart, -1),
        fundamental=state.geometry.fundamental,
        bottom=c.bottom,
        count=np.where(lost, many, round(c.epipolar_fraction * many)),
        along=c.sigma_along_line_px,
        across=c.sigma_across_line,
        normals=rng.standard_normal((*particles.shape[:2], 2)),
    )


def adapt_colours(state: VisualState, c: CmctConfig, here: Bools) -> ImageTrackers:
    """Return the trackers with colour histograms moved towards those in their estimates.

    The new histogram is (1 - r) old + r found, r the setting `appearance_learning_rate`, where the estimate's
    similarity is at least `min_similarity_to_adapt`.

    Args:
        state: trackers after the frame, and colour maps of the views.
        c: settings.
        here: (n,) trackers with a frame of their view; the others keep their colours.
    """
    t = state.trackers
    colours = t.colours.copy()
    for v, bins in enumerate(state.bins):
        rows = np.flatnonzero((t.view == v) & here & (t.similarities >= c.min_similarity_to_adapt))
        found = colours_in(bins, t.estimate[rows], t.split[rows], c.pixel_step)
        # Where the edge of the image or a mask hides a part, the colours of the rest represent all.
        found *= colours[rows].sum(axis=1, keepdims=True) / np.maximum(found.sum(axis=1, keepdims=True), LEAST)
        colours[rows] = (1.0 - c.appearance_learning_rate) * colours[rows] + c.appearance_learning_rate * found
    return t._replace(colours=colours)
