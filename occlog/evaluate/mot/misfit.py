"""Search for mistakes that explain image tracks that fit no true boxes: frame numbers, image sizes, box formats."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.metrics.errors import intersection_over_union
from occlog.records.columns import rows_by_label
from occlog.records.tables import Boxes
from occlog.records.verdicts import Check, finding, outcome

FITS = "frame numbers, sizes and format of boxes"
"""Name of the check."""
MIN_MOTA = 0.2
"""MOTA below which another meaning of the boxes is looked for."""
MIN_IOU = 0.5
"""Intersection over union from which a track's box fits a true one."""
MIN_FIT, MIN_MORE = 0.5, 0.3
"""Share of boxes that fit with a change, and how much more that is than without it."""
SIMPLER = 0.05
"""Share by which a change must be better than one that is tried before it."""
MAX_ROWS = 20_000
"""Rows of each side, from the begin, that are compared."""
MAX_FRAMES = 200
"""Frames, evenly spread, in which boxes are compared."""
MAX_SHIFT = 300
"""Largest shift of frame numbers that is tried."""
REFLECTION_CELL_PX = 4.0
"""Size of the cells of the search for the size of images that are mirrored."""
SCALES = (0.5, 2.0, 2.0 / 3.0, 1.5, 0.75, 4.0 / 3.0, 1.0 / 3.0, 3.0, 0.25, 4.0)
"""Factors between sizes of images."""
MIN_ANNOTATED, MIN_BETWEEN = 10, 0.3
"""True frames with a common step from which other frames may have no annotation, and the share of the tracks' boxes in
these that is reported."""
RATES = (2.0, 0.5, 3.0, 5.0)
"""Factors between frame numbers of every n-th frame that are counted from 0."""


class SampledBoxes(NamedTuple):
    """Sample of the boxes of one side.

    Attributes:
        frame: (n,) number of the frame, or of the time step.
        view: (n,) number of the camera.
        target: (n,) identity.
        ltwh: (n, 4) left, top, width and height [px].
    """

    frame: Ints
    view: Ints
    target: Ints
    ltwh: Floats

    @classmethod
    def of(cls, rows: Boxes, views: Sequence[str], frame: Ints) -> SampledBoxes:
        """Return the rows that have a box in one of the cameras `views`, up to `MAX_ROWS`.

        `frame`: (n,) frame numbers of the n rows.
        """
        index = {name: n for n, name in enumerate(views)}
        view = np.array([index.get(name, -1) for name in rows.sensor.tolist()], dtype=np.int64)
        ltwh = np.column_stack([rows.left_px, rows.top_px, rows.width_px, rows.height_px])
        own = np.flatnonzero((view >= 0) & (ltwh[:, 2:] > 0.0).all(axis=1))[:MAX_ROWS]
        return cls(frame[own], view[own], rows.target_id[own].astype(np.int64), ltwh[own])

    @classmethod
    def merge(cls, parts: Sequence[SampledBoxes]) -> SampledBoxes:
        """Return the concatenated samples; without parts, empty ones."""
        none = np.zeros(0, np.int64)
        nothing = cls(none, none, none, np.zeros((0, 4)))
        return cls(*(np.concatenate(column) for column in zip(nothing, *parts, strict=True)))

    @property
    def key(self) -> Ints:
        """(n,) integer for each box, unique to its frame and camera."""
        return self.frame * 1024 + self.view


class BoxChange(NamedTuple):
    """A correction of the tracks' boxes that makes them fit the true boxes better.

    Attributes:
        words: description of the correction.
        fit: F1 score, 0 to 1, of the corrected boxes against the true ones.
    """

    words: str
    fit: float


def misfit(tracks: SampledBoxes, truth: SampledBoxes, metrics: Mapping[str, float]) -> tuple[Check, ...]:
    """Return the check of whether tracks fit the true boxes.

    If MOTA in `metrics` is low, a correction of frame numbers, sizes or box format is searched for and reported.
    """
    mota = metrics.get("mota", math.nan)
    return outcome(FITS, _found(tracks, truth) if mota < MIN_MOTA else (), mota=mota, allowed=MIN_MOTA)


def _found(tracks: SampledBoxes, truth: SampledBoxes) -> Iterator[Check]:
    if not (len(tracks.frame) and len(truth.frame)):
        return
    now, best = fit(tracks, truth), BoxChange("", 0.0)
    annotated = np.unique(truth.frame)
    between = 1.0 - np.isin(tracks.frame, annotated).mean()
    step = int(np.gcd.reduce(np.diff(annotated))) if len(annotated) >= MIN_ANNOTATED else 1
    if step > 1 and now >= MIN_FIT and between > MIN_BETWEEN:
        yield finding(FITS, "truth-frames-in-steps", step=step, share=between)
        return
    for words, changed in _changes(tracks, truth):
        share = fit(changed, truth)
        if share >= max(MIN_FIT, now + MIN_MORE) and share > best.fit + SIMPLER:
            best = BoxChange(words, share)
    if best.words:
        yield finding(FITS, "boxes-fit-if", fit=best.fit, now=now, change=best.words, iou=MIN_IOU)


def _changes(tracks: SampledBoxes, truth: SampledBoxes) -> Iterator[tuple[str, SampledBoxes]]:
    """Generate corrections of the tracks with their descriptions, simplest first.

    Other frame numbers, and each other meaning of the boxes, come with the shift of frame numbers that then fits best;
    a meaning of the boxes also alone.
    """
    numbers = {"frame numbers and identities exchanged": tracks.target}
    numbers |= {f"frame numbers multiplied by {rate:.3g}": np.rint(rate * tracks.frame).astype(int) for rate in RATES}
    for words, frame in numbers.items():
        renumbered = tracks._replace(frame=frame)
        yield words, renumbered._replace(frame=frame + _best_shift(renumbered, truth))
    for words, change in _of_boxes():
        ltwh = change(tracks.ltwh)
        there = (ltwh[:, 2:] > 0.0).all(axis=1)
        if np.count_nonzero(there) < MIN_FIT * len(ltwh):
            continue
        changed = SampledBoxes(tracks.frame[there], tracks.view[there], tracks.target[there], ltwh[there])
        if words:
            yield words, changed
        shift = _best_shift(changed, truth)
        if shift:
            moved = changed._replace(frame=changed.frame + shift)
            yield " and ".join([*([words] if words else []), f"frame numbers {shift:+d}"]), moved
    for axis, words in enumerate(("images mirrored", "y counted from below")):
        yield words, _reflected(tracks, truth, axis)


def _reflected(tracks: SampledBoxes, truth: SampledBoxes, axis: int) -> SampledBoxes:
    """Return the tracks with boxes reflected along an axis (0: x, 1: y), about the middle that fits the truth best.

    By a Hough transform: the sum of a true edge and of the opposite edge of a box of the tracks in the same frame is
    the size of the image for boxes of one target; the most frequent one counts.
    """
    ltwh = tracks.ltwh.copy()
    far = ltwh[:, axis] + ltwh[:, axis + 2]
    theirs = dict(rows_by_label(truth.key))
    sums = [truth.ltwh[theirs[key], axis] + far[row] for row, key in enumerate(tracks.key.tolist()) if key in theirs]
    if sums:
        cells, counts = np.unique((np.concatenate(sums) / REFLECTION_CELL_PX).round(), return_counts=True)
        ltwh[:, axis] = REFLECTION_CELL_PX * cells[counts.argmax()] - far
    return tracks._replace(ltwh=ltwh)


def _of_boxes() -> Iterator[tuple[str, Callable[[Floats], Floats]]]:
    """Generate other meanings of a box's four numbers (scaled, corners, centre, order), each with a description.

    With it comes a function from (n, 4) numbers to left, top, width and height; the first one is the identity.
    """
    yield "", np.array
    for scale in SCALES:
        yield f"boxes multiplied by {scale:.3g} (images of another size)", partial(np.multiply, scale)
    yield (
        "right and lower edges for width and height (xyxy for xywh)",
        lambda ltwh: np.column_stack([ltwh[:, :2], ltwh[:, 2:] - ltwh[:, :2]]),
    )
    yield (
        "the centre for the left upper corner",
        lambda ltwh: np.column_stack([ltwh[:, :2] - 0.5 * ltwh[:, 2:], ltwh[:, 2:]]),
    )
    yield "x and y exchanged", lambda ltwh: ltwh[:, [1, 0, 3, 2]]
    yield "width and height exchanged", lambda ltwh: ltwh[:, [0, 1, 3, 2]]


def fit(tracks: SampledBoxes, truth: SampledBoxes) -> float:
    """Return the F1 score, 0 to 1, of boxes that overlap a box of the other side in the same frame and camera.

    An overlap is an IoU of at least `MIN_IOU`; up to `MAX_FRAMES` common frames are compared, 0 without any.
    """
    common = np.intersect1d(tracks.key, truth.key)
    if not len(common):
        return 0.0
    chosen = common[np.unique(np.linspace(0, len(common) - 1, MAX_FRAMES).round().astype(np.int64))]
    ours, theirs = (dict(rows_by_label(np.where(np.isin(each.key, chosen), each.key, -1))) for each in (tracks, truth))
    met, total = np.zeros(2), np.zeros(2)
    for key in chosen.tolist():
        a, b = tracks.ltwh[ours[key]], truth.ltwh[theirs[key]]
        total += len(a), len(b)
        if len(a) and len(b):
            near = intersection_over_union(a, b) >= MIN_IOU
            met += near.any(axis=1).sum(), near.any(axis=0).sum()
    shares = met / np.maximum(total, 1)
    return float(2.0 * shares.prod() / max(shares.sum(), 1e-9))


def _best_shift(tracks: SampledBoxes, truth: SampledBoxes) -> int:
    """Return the shift to add to the tracks' frame numbers so that most boxes overlap a true one.

    By a Hough transform, for shifts up to `MAX_SHIFT`; 0 if no boxes overlap.
    """
    chosen = np.unique(np.linspace(0, len(tracks.frame) - 1, MAX_FRAMES).round().astype(np.int64))
    votes = np.zeros(2 * MAX_SHIFT + 1)
    for view in np.unique(tracks.view).tolist():
        theirs = np.flatnonzero(truth.view == view)
        own = chosen[tracks.view[chosen] == view]
        if not (len(theirs) and len(own)):
            continue
        near = np.concatenate(
            [intersection_over_union(tracks.ltwh[own], truth.ltwh[part]) for part in np.array_split(theirs, 8)], axis=1
        )
        row, column = np.nonzero(near >= MIN_IOU)
        apart = truth.frame[theirs[column]] - tracks.frame[own[row]]
        close = np.abs(apart) <= MAX_SHIFT
        # Of an object that stays where it is all frames agree: each votes once for a shift, by its overlap
        np.add.at(votes, apart[close] + MAX_SHIFT, near[row, column][close])
    return int(np.argmax(votes)) - MAX_SHIFT if votes.any() else 0
