"""Labelled objects of two sides, truth and tracks, laid against each other frame by frame.

All figures of merit for many targets (`mot_clear`, `mot_identity`, `mot_hota`, `mot_gospa`)
start from the same table of pairs.  Several views, or several recordings, are put in as
`view`: a label of one view is another object than the same label of another view, so that the
figures are those of all views pooled.

Two objects are compared by a distance and by a similarity in [0, 1]:

    boxes     distance 1 - IoU; similarity IoU (intersection over union)
    points    distance Euclidean; similarity max(0, 1 - distance / (2 limit)), which is 0.5 at
              the limit, as an IoU of 0.5 is the usual limit of boxes, and 0 from twice the limit on
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .metrics import Bools, Floats, Ints

EPS = float(np.finfo(np.float64).eps)
"""A similarity that is lower than a threshold by rounding only still reaches it."""


class Objects(NamedTuple):
    """What is where: a row for each object and frame, in any order.

    Attributes:
        frame: (n,) number of the frame.
        label: (n,) identity; no two rows of a frame and view have the same.
        place: (n, 4) box left, top, width, height with sizes above 0, or (n, d) point.
        view: (n,) number of the view; None: there is one view.
    """

    frame: Ints
    label: Ints
    place: Floats
    view: Ints | None = None


class Frames(NamedTuple):
    """Truth and tracks by frame, with all pairs of each frame; `Frame` here is a frame of one view.

    Rows are sorted by view, frame, label.  T frames that have a row on either side, N true rows
    of G targets, M rows of K tracks, P pairs.

    Attributes:
        frame: (T,) number of each frame.
        view: (T,) its view.
        truth: (N,) number of each row's target, 0 to G - 1.
        track: (M,) number of each row's track, 0 to K - 1.
        truth_start: (T + 1,) first row of each frame in `truth`.
        track_start: (T + 1,) first row of each frame in `track`.
        pair_start: (T + 1,) first pair of each frame; its pairs are a matrix, true rows by track rows.
        pair_truth: (P,) true row of each pair.
        pair_track: (P,) track row of each pair.
        distance: (P,) >= 0.
        similarity: (P,) in [0, 1].
        truth_key: (G, 2) view and label of each target.
        track_key: (K, 2) view and label of each track.
        truth_row: (N,) place of each true row in the input.
        track_row: (M,) place of each track row in the input.
    """

    frame: Ints
    view: Ints
    truth: Ints
    track: Ints
    truth_start: Ints
    track_start: Ints
    pair_start: Ints
    pair_truth: Ints
    pair_track: Ints
    distance: Floats
    similarity: Floats
    truth_key: Ints
    track_key: Ints
    truth_row: Ints
    track_row: Ints

    def block(self, t: int, values: Floats) -> Floats:
        """(n, m) values of frame t's pairs, true rows by track rows."""
        n = int(self.truth_start[t + 1] - self.truth_start[t])
        return values[self.pair_start[t] : self.pair_start[t + 1]].reshape(n, -1)

    def meeting(self) -> list[int]:
        """Frames that have rows on both sides."""
        return [int(t) for t in np.flatnonzero(np.diff(self.pair_start))]


def of_boxes(truth: Objects, tracks: Objects) -> Frames:
    """Frames of boxes (n, 4): left, top, width, height.

    Raises:
        ValueError: a place is not finite or no box, or a label comes twice in a frame of a view.
    """
    for side in (truth, tracks):
        if side.place.shape[1:] != (4,) or not (side.place[:, 2:] > 0).all():
            raise ValueError("boxes must be (n, 4): left, top, width, height with sizes above 0")
    frames = _frames(truth, tracks)
    a, b = truth.place[frames.truth_row[frames.pair_truth]], tracks.place[frames.track_row[frames.pair_track]]
    low, high = np.maximum(a[:, :2], b[:, :2]), np.minimum(a[:, :2] + a[:, 2:], b[:, :2] + b[:, 2:])
    shared = np.prod(np.maximum(high - low, 0.0), axis=1)
    similarity = shared / (np.prod(a[:, 2:], axis=1) + np.prod(b[:, 2:], axis=1) - shared)
    return frames._replace(distance=1.0 - similarity, similarity=similarity)


def of_points(truth: Objects, tracks: Objects, limit: float) -> Frames:
    """Frames of points (n, d), on the ground, in space or in the image.

    Args:
        truth: the targets.
        tracks: the estimates.
        limit: distance at which the similarity is 0.5, > 0, unit of the places.

    Raises:
        ValueError: a place is not finite, or a label comes twice in a frame of a view.
    """
    if not 0 < limit < np.inf:
        raise ValueError(f"limit {limit:g} must be above 0")
    frames = _frames(truth, tracks)
    apart = truth.place[frames.truth_row[frames.pair_truth]] - tracks.place[frames.track_row[frames.pair_track]]
    distance = np.sqrt(np.sum(apart**2, axis=1))
    return frames._replace(distance=distance, similarity=np.maximum(0.0, 1.0 - distance / (2.0 * limit)))


def reaches(similarity: Floats, threshold: float) -> Bools:
    """Whether similarities reach a threshold, up to rounding; 0 never does."""
    return np.asarray((similarity >= threshold - EPS) & (similarity > EPS))


def _frames(truth: Objects, tracks: Objects) -> Frames:
    """Frames with all pairs, distances and similarities still empty."""
    n = len(truth.frame)
    both_views = np.concatenate([_views(truth), _views(tracks)])
    both_frames = np.concatenate([truth.frame, tracks.frame]).astype(np.int64)
    key, cell = _numbered(both_views, both_frames)
    truth_key, target = _numbered(both_views[:n], truth.label)
    track_key, track = _numbered(both_views[n:], tracks.label)
    truth_row, truth_start = _sorted(truth, cell[:n], target, len(key))
    track_row, track_start = _sorted(tracks, cell[n:], track, len(key))
    counts, width = np.diff(truth_start) * np.diff(track_start), np.diff(track_start)
    pair_start = np.concatenate([[0], np.cumsum(counts)])
    at = np.repeat(np.arange(len(key)), counts)
    place = np.arange(pair_start[-1]) - pair_start[at]
    pair_truth, pair_track = truth_start[at] + place // width[at], track_start[at] + place % width[at]
    return Frames(
        key[:, 1], key[:, 0], target[truth_row], track[track_row], truth_start, track_start, pair_start,
        pair_truth, pair_track, np.empty(0), np.empty(0), truth_key, track_key, truth_row, track_row,
    )  # fmt: skip


def _views(side: Objects) -> Ints:
    if not np.isfinite(side.place).all():
        raise ValueError("places must be finite; leave out objects without one")
    return np.zeros(len(side.frame), dtype=np.int64) if side.view is None else side.view.astype(np.int64)


def _numbered(first: Ints, second: Ints) -> tuple[Ints, Ints]:
    """Distinct pairs (n, 2) of two columns in rising order, and the number of each row's pair."""
    a, at_a = np.unique(first, return_inverse=True)
    b, at_b = np.unique(second, return_inverse=True)
    codes, number = np.unique(at_a * max(len(b), 1) + at_b, return_inverse=True)
    pairs = np.column_stack([a[codes // max(len(b), 1)], b[codes % max(len(b), 1)]])
    return pairs.astype(np.int64), number.astype(np.int64)


def _sorted(side: Objects, cell: Ints, number: Ints, cells: int) -> tuple[Ints, Ints]:
    """Rows of one side in order of frame and label, and where each frame starts."""
    order = np.lexsort((number, cell))
    same = (np.diff(cell[order]) == 0) & (np.diff(number[order]) == 0)
    if same.any():
        row = order[int(np.flatnonzero(same)[0])]
        raise ValueError(f"label {side.label[row]} comes twice in frame {side.frame[row]}")
    return order.astype(np.int64), np.searchsorted(cell[order], np.arange(cells + 1)).astype(np.int64)
