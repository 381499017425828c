"""Truth and tracks, matched by frame for all multi-target metrics.

`clear_mot`, `idf1`, `hota`, `gospa` and `failure_rates` start from the same table of pairs. Several views, or
recordings, are distinguished by `view`: equal labels in different views are different objects, so that metrics are
pooled over the views. Two objects are compared by a distance and a similarity in [0, 1]:

boxes: distance 1 - IoU; similarity IoU (intersection over union)

points: Euclidean distance; similarity max(0, 1 - distance / (2 limit)), which is 0.5 at the limit (as an IoU of 0.5 is
the usual limit of boxes) and 0 from twice the limit

Also sums for couples of target and track over a stream of frames.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel

EPS = float(np.finfo(np.float64).eps)
"""A similarity that is lower than a threshold by rounding only still reaches it."""


class Objects(NamedTuple):
    """Labelled objects of one side (truth or tracks): a row per object and frame, in any order.

    Attributes:
        frame: (n,) number of the frame.
        label: (n,) identity; no two rows of a frame and view have the same.
        position: (n, 4) box left, top, width, height with sizes above 0, or (n, d) point.
        view: (n,) number of the view; None: there is one view.
    """

    frame: Ints
    label: Ints
    position: Floats
    view: Ints | None = None


class MatchedFrames(NamedTuple):
    """Truth and tracks by frame; frames of different views are separate.

    Rows are sorted by view, frame, label. T frames that have a row on either side, N true rows of G targets, M rows of
    K tracks. Pairs are compared frame by frame on request, so that memory does not grow with their number.

    Attributes:
        frame: (T,) number of each frame.
        view: (T,) its view.
        truth: (N,) number of each row's target, 0 to G - 1.
        track: (M,) number of each row's track, 0 to K - 1.
        truth_start: (T + 1,) first row of each frame in `truth`.
        track_start: (T + 1,) first row of each frame in `track`.
        truth_position: (N, d) positions.
        track_position: (M, d) positions.
        truth_key: (G, 2) view and label of each target.
        track_key: (K, 2) view and label of each track.
        truth_row: (N,) position of each true row in the input.
        track_row: (M,) position of each track row in the input.
        limit: distance of points at which their similarity is 0.5; NaN: the positions are boxes.
    """

    frame: Ints
    view: Ints
    truth: Ints
    track: Ints
    truth_start: Ints
    track_start: Ints
    truth_position: Floats
    track_position: Floats
    truth_key: Ints
    track_key: Ints
    truth_row: Ints
    track_row: Ints
    limit: float

    def meeting(self) -> list[int]:
        """Return the indices of the frames with rows on both sides, truth and tracks."""
        return [int(t) for t in np.flatnonzero(np.diff(self.truth_start) * np.diff(self.track_start))]

    def rows(self, t: int) -> tuple[slice, slice]:
        """Return the true rows and the track rows of frame t, as slices."""
        return (
            slice(int(self.truth_start[t]), int(self.truth_start[t + 1])),
            slice(int(self.track_start[t]), int(self.track_start[t + 1])),
        )

    def compare(self, t: int) -> tuple[Floats, Floats]:
        """Return distances (n, m) >= 0 and similarities (n, m) in [0, 1] of all pairs of target and track in frame t.

        Boxes: 1 - IoU and IoU. Points: Euclidean distance and max(0, 1 - distance / (2 limit)).
        """
        left, right = self.rows(t)
        a, b = self.truth_position[left], self.track_position[right]
        if np.isnan(self.limit):
            similarity = _overlaps(a, b)
            return 1.0 - similarity, similarity
        distance = _without_rounding(_distances(a, b), a, b)
        return distance, np.maximum(0.0, 1.0 - distance / (2.0 * self.limit))


def _without_rounding(distance: Floats, a: Floats, b: Floats) -> Floats:
    """Return distances rounded to the precision of the positions.

    Distances of 0.3 to 0.8 and of 1000.3 to 1000.8 differ in the last bits, but must be on the same side of a limit.

    Args:
        distance: (n, m) distances.
        a: (n, d) positions from which they were computed.
        b: (m, d) the other positions.
    """
    largest = max(np.abs(a).max(initial=0.0), np.abs(b).max(initial=0.0))
    if not largest:
        return distance
    return np.round(distance, min(math.floor(-math.log10(8.0 * EPS * largest)), 300))


def numbered(part: MatchedFrames, truth_key: Ints, track_key: Ints) -> MatchedFrames:
    """Return frames of a part of a recording, with target and track numbers of the whole recording.

    Args:
        part: frames with numbers of the targets and tracks of the part only.
        truth_key: (G, 2) view and label of all targets of the recording, in increasing order.
        track_key: (K, 2) view and label of all tracks of the recording, in increasing order.

    Raises:
        KeyError: a target or a track of the part is none of the recording.
    """
    found = []
    for own, every in ((part.truth_key, truth_key), (part.track_key, track_key)):
        index_of = {key: n for n, key in enumerate(map(tuple, every.tolist()))}
        found.append(np.array([index_of[key] for key in map(tuple, own.tolist())], dtype=np.int64))
    return part._replace(
        truth=found[0][part.truth], track=found[1][part.track], truth_key=truth_key, track_key=track_key
    )


def of_boxes(truth: Objects, tracks: Objects) -> MatchedFrames:
    """Return the truth and tracks of boxes, arranged by frame; boxes are left, top, width, height.

    Raises:
        ValueError: a position is not finite or not a box, a label comes twice in a frame of a view, or only one side
            has views.
    """
    for side in (truth, tracks):
        if side.position.shape[1:] != (4,) or not (side.position[:, 2:] > 0).all():
            raise ValueError("boxes must be (n, 4): left, top, width, height with sizes above 0")
    return _frames(truth, tracks, np.nan)


def of_points(truth: Objects, tracks: Objects, limit: float) -> MatchedFrames:
    """Return the truth and tracks of points (n, d), arranged by frame; on the ground, in space or in the image.

    Args:
        truth: the targets.
        tracks: the estimates.
        limit: distance at which the similarity is 0.5, > 0, unit of the positions.

    Raises:
        ValueError: a position is not finite or has other columns than those of the other side, a label comes twice in a
            frame of a view, or only one side has views.
    """
    if not 0 < limit < np.inf:
        raise ValueError(f"limit {limit:g} must be above 0")
    return _frames(truth, tracks, limit)


def reaches(similarity: Floats, threshold: float) -> Bools:
    """Return whether similarities (any shape) are at least a threshold, up to rounding; False for a similarity of 0."""
    return np.asarray((similarity >= threshold - EPS) & (similarity > EPS))


def _frames(truth: Objects, tracks: Objects, limit: float) -> MatchedFrames:
    """Return truth and tracks arranged by frame.

    Args:
        truth: the targets.
        tracks: the estimates.
        limit: distance of points at which their similarity is 0.5; NaN for boxes.

    Raises:
        ValueError: a position is not finite, the sides have different columns, a label comes twice in a frame of a
            view, or only one side has views.
    """
    if truth.position.ndim != 2 or truth.position.shape[1:] != tracks.position.shape[1:]:
        raise ValueError("positions of truth and tracks must have equally many columns")
    n = len(truth.frame)
    if n and len(tracks.frame) and (truth.view is None) != (tracks.view is None):
        raise ValueError("views must be given for both truth and tracks, or for neither")
    both_views = np.concatenate([_views(truth), _views(tracks)])
    both_frames = np.concatenate([truth.frame, tracks.frame]).astype(np.int64)
    key, cell = _numbered(both_views, both_frames)
    truth_key, target = _numbered(both_views[:n], truth.label)
    track_key, track = _numbered(both_views[n:], tracks.label)
    truth_row, truth_start = _sorted(truth, cell[:n], target, len(key))
    track_row, track_start = _sorted(tracks, cell[n:], track, len(key))
    return MatchedFrames(
        frame=key[:, 1],
        view=key[:, 0],
        truth=target[truth_row],
        track=track[track_row],
        truth_start=truth_start,
        track_start=track_start,
        truth_position=_rows_of(truth, truth_row),
        track_position=_rows_of(tracks, track_row),
        truth_key=truth_key,
        track_key=track_key,
        truth_row=truth_row,
        track_row=track_row,
        limit=limit,
    )


def _rows_of(side: Objects, rows: Ints) -> Floats:
    """Return the positions (k, d) of the rows `rows` (k,) of one side, as contiguous float64."""
    return np.ascontiguousarray(side.position[rows], dtype=np.float64)


def _views(side: Objects) -> Ints:
    """Return the (n,) view of each row; 0 without views. ValueError if a position is not finite."""
    if not np.isfinite(side.position).all():
        raise ValueError("positions must be finite; omit objects without one")
    return np.zeros(len(side.frame), dtype=np.int64) if side.view is None else side.view.astype(np.int64)


def _numbered(first: Ints, second: Ints) -> tuple[Ints, Ints]:
    """Return the distinct pairs (K, 2) of two columns, sorted, and for each row the index (n,) of its pair.

    Args:
        first: (n,) first column, by which pairs are sorted first.
        second: (n,) second column.
    """
    a, at_a = np.unique(first, return_inverse=True)
    b, at_b = np.unique(second, return_inverse=True)
    codes, number = np.unique(at_a * max(len(b), 1) + at_b, return_inverse=True)
    pairs = np.column_stack([a[codes // max(len(b), 1)], b[codes % max(len(b), 1)]])
    return pairs.astype(np.int64), number.astype(np.int64)


def _sorted(side: Objects, cell: Ints, number: Ints, cells: int) -> tuple[Ints, Ints]:
    """Return the rows (n,) of one side sorted by frame and label, and the first sorted row of each frame (cells + 1,).

    Args:
        side: truth or tracks, of n rows.
        cell: (n,) index of each row's pair of view and frame.
        number: (n,) index of its label.
        cells: number of pairs of view and frame.

    Raises:
        ValueError: a label comes twice in a frame of a view.
    """
    order = np.lexsort((number, cell))
    same = (np.diff(cell[order]) == 0) & (np.diff(number[order]) == 0)
    if same.any():
        row = order[int(np.flatnonzero(same)[0])]
        raise ValueError(
            f"label {side.label[row]} comes twice in frame {side.frame[row]}; of truth, and of "
            "tracks, a label may come once in a frame"
        )
    return order.astype(np.int64), np.searchsorted(cell[order], np.arange(cells + 1)).astype(np.int64)


@kernel
def _overlaps(a: Floats, b: Floats) -> Floats:
    """Return the (n, m) intersection over union of boxes `a` (n, 4) and `b` (m, 4): left, top, width, height.

    As loops: fast for few boxes.
    """
    out = np.zeros((len(a), len(b)))
    for i in range(len(a)):
        for j in range(len(b)):
            width = min(a[i, 0] + a[i, 2], b[j, 0] + b[j, 2]) - max(a[i, 0], b[j, 0])
            height = min(a[i, 1] + a[i, 3], b[j, 1] + b[j, 3]) - max(a[i, 1], b[j, 1])
            if width > 0.0 and height > 0.0:
                shared = width * height
                # Rounding of the corners may make the shared area larger than a box.
                out[i, j] = min(1.0, shared / (a[i, 2] * a[i, 3] + b[j, 2] * b[j, 3] - shared))
    return out


@kernel
def _distances(a: Floats, b: Floats) -> Floats:
    """Return the (n, m) Euclidean distances of points `a` (n, d) and `b` (m, d)."""
    out = np.zeros((len(a), len(b)))
    for i in range(len(a)):
        for j in range(len(b)):
            total = 0.0
            for k in range(a.shape[1]):
                total += (a[i, k] - b[j, k]) ** 2
            out[i, j] = np.sqrt(total)
    return out


DENSE = 1 << 23
"""Most sums that are kept as a matrix of targets and tracks; of more, those of the couples alone that ever meet."""
PENDING = 1 << 18
"""Additions that are kept at least until they are summed up, where there is no matrix."""


class TargetTrackSums:
    """Sums for each couple of a target and a track, 0 until something is added.

    In a long recording few of the possible couples coexist: memory grows with the couples to which something was added.
    """

    def __init__(self, targets: int, tracks: int, sums: int = 1) -> None:
        """Create `sums` sums per couple, all 0.

        Args:
            targets: number of all targets.
            tracks: number of all tracks.
            sums: how many sums each couple has.
        """
        self._targets, self._tracks, self._sums = targets, tracks, sums
        self._matrix = np.zeros((sums, targets, tracks)) if sums * targets * tracks <= DENSE else None
        self._keys, self._values = np.zeros(0, dtype=np.int64), np.zeros((sums, 0))
        self._pending: list[tuple[Ints, Floats]] = []
        self._waiting = 0

    def add(self, target: Ints, track: Ints, values: Floats) -> None:
        """Add values to the sums of couples, each of which occurs once.

        Args:
            target: (n,) numbers of targets.
            track: (n,) numbers of tracks.
            values: (sums, n) addends, by sum and couple.
        """
        if self._matrix is not None:
            self._matrix[:, target, track] += values
            return
        some = values.any(axis=0)  # of a crowd most couples are too far apart to add anything
        self._pending.append((target[some] * max(self._tracks, 1) + track[some], values[:, some]))
        self._waiting += int(some.sum())
        if self._waiting > PENDING + len(self._keys) // 2:
            self._settle()

    def at(self, target: Ints, track: Ints) -> Floats:
        """Return the (sums, n) sums of the couples of target numbers `target` (n,) and track numbers `track` (n,).

        0 if nothing was added.
        """
        if self._matrix is not None:
            return np.asarray(self._matrix[:, target, track])
        self._settle()
        keys = target * max(self._tracks, 1) + track
        index = np.searchsorted(self._keys, keys)
        index[index == len(self._keys)] = 0
        out = np.zeros((self._sums, len(keys)))
        known = self._keys[index] == keys if len(self._keys) else np.zeros(len(keys), dtype=np.bool_)
        out[:, known] = self._values[:, index[known]]
        return out

    def all(self) -> tuple[Ints, Ints, Floats]:
        """Return the couples with a nonzero sum, sorted: targets (n,), tracks (n,) and sums (sums, n)."""
        if self._matrix is not None:
            target, track = np.nonzero(self._matrix.any(axis=0))
            return target, track, self._matrix[:, target, track]
        self._settle()
        tracks = max(self._tracks, 1)
        return self._keys // tracks, self._keys % tracks, self._values

    def merge(self, other: TargetTrackSums) -> None:
        """Append the couples of another recording, with its targets and tracks numbered after these."""
        (target, track, values), (its_target, its_track, more) = self.all(), other.all()
        tracks = self._tracks + other._tracks
        theirs = (its_target + self._targets) * tracks + its_track + self._tracks
        self._keys = np.concatenate([target * tracks + track, theirs])
        self._values = np.concatenate([values, more], axis=1)
        self._matrix, self._targets, self._tracks = None, self._targets + other._targets, tracks

    def _settle(self) -> None:
        """Add the pending additions to the sums, in the order in which they were made; sums of 0 are dropped."""
        if not self._pending:
            return
        keys = np.concatenate([self._keys, *(key for key, _ in self._pending)])
        values = np.concatenate([self._values, *(value for _, value in self._pending)], axis=1)
        self._keys, index = np.unique(keys, return_inverse=True)
        self._values = np.stack([np.bincount(index, each, minlength=len(self._keys)) for each in values])
        some = self._values.any(axis=0)
        self._keys, self._values = self._keys[some], self._values[:, some]
        self._pending, self._waiting = [], 0
