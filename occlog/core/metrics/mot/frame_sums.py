"""Contribution of each frame to multi-target metrics, so that parts of a recording can be reweighted.

MOTA, the RMSE of pairs and rates are ratios of sums over frames. IDF1 and HOTA become such ratios with the associations
of the whole recording: the track assigned to each target (IDF1), and the association score of each couple (HOTA). Sums
over all frames give exactly the figures of `identity`, `hota` and `clear_mot`; of a part of them they are those of the
part within the recording, not of the part alone.
"""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats

from .clear_mot import CLASSIC, ClearRule, match
from .frame_pairs import MatchedFrames, reaches
from .hota import ALPHAS, associations, identity

COUNTS = ("objects", "estimates", "paired", "switches", "near", "squares", "idtp")
"""The first sums; then, for each threshold of HOTA, pairs and the sum of their associations."""
A = len(ALPHAS)
PLACE = {name: k for k, name in enumerate(COUNTS)}
SIZE = len(COUNTS) + 2 * A


def frame_sums(frames: MatchedFrames, cells: int, rule: ClearRule = CLASSIC) -> Floats:
    """Return the (cells, SIZE) contribution of each frame to the sums from which multi-target metrics are computed.

    Columns: true rows, track rows, CLEAR-MOT pairs, identity switches, pairs of the frame alone (without memory), their
    squared distances, IDTP; then for each of the A thresholds of HOTA the pairs, and for each the sum of their
    association scores.

    Args:
        frames: truth and tracks as points; numbers of frames are below `cells`.
        cells: number of frames, empty ones included.
        rule: pairing rule of CLEAR-MOT.
    """
    out = np.zeros((cells, SIZE))
    at = frames.frame

    def add(name: str, where: np.ndarray, values: Floats | None = None) -> None:
        out[:, PLACE[name]] += np.bincount(where, values, minlength=cells)

    add("objects", np.repeat(at, np.diff(frames.truth_start)))
    add("estimates", np.repeat(at, np.diff(frames.track_start)))
    made = match(frames, rule)
    add("paired", at[made.frame])
    add("switches", at[made.frame[made.switch]])
    # Errors are of pairs of each frame alone: CLEAR-MOT's keep a track that has gone over to a neighbour
    alone = match(frames, ClearRule(memory=0))
    add("near", at[alone.frame])
    add("squares", at[alone.frame], alone.distance**2)
    given = identity(frames).track
    for t in frames.meeting():
        left, right = frames.rows(t)
        met = reaches(frames.compare(t)[1], 0.5)
        own = given[frames.truth[left]][:, None] == frames.track[right][None, :]
        out[at[t], PLACE["idtp"]] += np.count_nonzero(met & own)
    where, pairs, belonging = associations(frames)
    for a in range(A):
        out[:, len(COUNTS) + a] = np.bincount(at[where], pairs[:, a], minlength=cells)
        out[:, len(COUNTS) + A + a] = np.bincount(at[where], belonging[:, a], minlength=cells)
    return out


def _of(sums: Floats, name: str) -> Floats:
    """Return one of the sums (...) in `sums` (..., SIZE), by its name in `COUNTS`."""
    return np.asarray(sums[..., PLACE[name]])


def _ratio(part: Floats, whole: Floats) -> Floats:
    """Return part / whole of arrays of one shape; NaN where the whole is not above 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(whole > 0, part / whole, np.nan))


def mota(sums: Floats) -> Floats:
    """Return MOTA (...), 1 - (missed + false + switches) / objects; NaN without objects.

    `sums` (..., SIZE) are those of `frame_sums`.
    """
    objects, paired = _of(sums, "objects"), _of(sums, "paired")
    return 1.0 - _ratio(objects + _of(sums, "estimates") - 2 * paired + _of(sums, "switches"), objects)


def idf1(sums: Floats) -> Floats:
    """Return IDF1 (...), 2 IDTP / (objects + estimates); NaN without either.

    `sums` (..., SIZE) are those of `frame_sums`.
    """
    return _ratio(2 * _of(sums, "idtp"), _of(sums, "objects") + _of(sums, "estimates"))


def recall(sums: Floats) -> Floats:
    """Return the recall (...), matched pairs over true objects; NaN without objects.

    `sums` (..., SIZE) are those of `frame_sums`.
    """
    return _ratio(_of(sums, "paired"), _of(sums, "objects"))


def precision(sums: Floats) -> Floats:
    """Return the precision (...), matched pairs over estimates; NaN without estimates.

    `sums` (..., SIZE) are those of `frame_sums`.
    """
    return _ratio(_of(sums, "paired"), _of(sums, "estimates"))


def matched_rmse(sums: Floats) -> Floats:
    """Return the root mean square distance (...) of the pairs of each frame alone; NaN without pairs.

    `sums` (..., SIZE) are those of `frame_sums`.
    """
    return np.asarray(np.sqrt(_ratio(np.maximum(_of(sums, "squares"), 0), _of(sums, "near"))))


def hota_of(sums: Floats) -> Floats:
    """Return HOTA (...): mean over thresholds of sqrt(sum of association scores / (TP + FN + FP)).

    `sums` (..., SIZE) are those of `frame_sums`; NaN without objects and estimates.
    """
    first = len(COUNTS)
    both = (_of(sums, "objects") + _of(sums, "estimates"))[..., None]
    pairs, belonging = sums[..., first : first + A], sums[..., first + A : first + 2 * A]
    return np.asarray(np.sqrt(np.maximum(_ratio(belonging, both - pairs), 0)).mean(axis=-1))


FIGURES = {
    "idf1": idf1, "hota": hota_of, "mota": mota, "recall": recall, "precision": precision, "matched_rmse": matched_rmse
}  # fmt: skip
"""Figures of sums, by name."""
LASTING = frozenset({"idf1", "hota"})
"""Figures in which an exchange of identities counts to the end of the recording."""
LESS_IS_BETTER = frozenset({"matched_rmse"})
