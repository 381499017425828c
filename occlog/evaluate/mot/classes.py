"""Truth with classes, as the MOTChallenge and TrackEval treat it before they score.

Tracks of a box that is a person in some way, but no pedestrian to be followed, are neither right nor wrong and are
dropped; so are true boxes that are marked 0 or of another class than pedestrian.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from occlog.array_types import Bools, Ints
from occlog.core.metrics.errors import box_overlap
from occlog.core.metrics.mot.frame_pairs import EPS, Objects
from occlog.io.boxes.mot_classes import PEDESTRIAN, Marks

from .truth_and_tracks import TruthAndTracks

OVERLAP = 0.5
"""Intersection over union from which a track is of a true box here, whatever it is later."""


def pedestrians(compared: TruthAndTracks, marks: Marks, distractors: tuple[int, ...]) -> TruthAndTracks:
    """The truth that counts, and the tracks that are not of distractors.

    In each frame tracks are paired one to one with all true boxes, of any class and mark, so that the sum of overlaps
    of at least one half is largest; a track whose box is a distractor's is dropped.

    Args:
        compared: truth and tracks of one view, with every row of the truth.
        marks: what the truth says of its boxes.
        distractors: classes of distractors.

    Raises:
        KeyError: a true box has no mark.
    """
    known = {key: n for n, key in enumerate(zip(marks.frame.tolist(), marks.target_id.tolist(), strict=True))}
    numbers = compared.number[0][compared.truth.frame].tolist()
    row = np.array([known[key] for key in zip(numbers, compared.truth.label.tolist(), strict=True)], dtype=np.int64)
    kind, counts = marks.kind[row], marks.counts[row]
    ignored = _on(compared, np.isin(kind, distractors))
    keep = counts & (kind == PEDESTRIAN)
    dropped = {"tracks_on_distractors": np.count_nonzero(ignored), "objects_ignored": np.count_nonzero(~keep)}
    return compared._replace(
        truth=_taken(compared.truth, keep),
        tracks=_taken(compared.tracks, ~ignored),
        visible=compared.visible[keep],
        counts=compared.counts | {name: float(n) for name, n in dropped.items()},
    )


def _on(compared: TruthAndTracks, distractor: Bools) -> Bools:
    """(m,) tracks that are paired with a true box that is a distractor."""
    truth, tracks = _by_frame(compared.truth), _by_frame(compared.tracks)
    out = np.zeros(len(compared.tracks.frame), dtype=np.bool_)
    for frame, ours in tracks.items():
        theirs = truth.get(frame)
        if theirs is None:
            continue
        overlap = box_overlap(compared.truth.place[theirs], compared.tracks.place[ours])
        overlap[overlap < OVERLAP - EPS] = 0.0
        i, j = linear_sum_assignment(overlap, maximize=True)
        met = overlap[i, j] > EPS
        out[ours[j[met]]] = distractor[theirs[i[met]]]
    return out


def _by_frame(side: Objects) -> dict[int, Ints]:
    """Rows of each frame, by label."""
    order = np.lexsort((side.label, side.frame))
    frames, first = np.unique(side.frame[order], return_index=True)
    return dict(zip(frames.tolist(), np.split(order, first)[1:], strict=True))


def _taken(side: Objects, keep: Bools) -> Objects:
    view = None if side.view is None else side.view[keep]
    return Objects(side.frame[keep], side.label[keep], side.place[keep], view)
