"""HOTA: detection and association in equal parts, over thresholds of localisation.

Luiten et al. 2021, "HOTA: a higher order metric for evaluating multi-object tracking".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from occlog.array_types import Floats, Ints

from .frames import EPS, Frames

ALPHAS: Floats = np.arange(1, 20) / 20.0
"""Thresholds of similarity, 0.05 to 0.95."""


class Hota(NamedTuple):
    """Figures by threshold, (A,) each; the figure that is published is the mean over thresholds.

    A threshold at which nothing is paired has 0 everywhere, and `loc_a` 1, as in TrackEval.

    Attributes:
        alpha: thresholds.
        hota: sqrt(det_a ass_a).
        det_a: TP / (TP + FN + FP).
        ass_a: mean over the pairs of how much of target and track together the two share.
        loc_a: mean similarity of the pairs.
        det_re: TP / (TP + FN).
        det_pr: TP / (TP + FP).
        ass_re: as ass_a, of the target alone.
        ass_pr: as ass_a, of the track alone.
        tp: number of pairs.
    """

    alpha: Floats
    hota: Floats
    det_a: Floats
    ass_a: Floats
    loc_a: Floats
    det_re: Floats
    det_pr: Floats
    ass_re: Floats
    ass_pr: Floats
    tp: Ints

    def means(self) -> dict[str, float]:
        """Mean of each figure over the thresholds."""
        names = ("hota", "det_a", "ass_a", "loc_a", "det_re", "det_pr", "ass_re", "ass_pr")
        return {name: float(np.mean(getattr(self, name))) for name in names}


def hota(frames: Frames, alphas: Floats = ALPHAS) -> Hota:
    """HOTA and its parts at each threshold.

    Args:
        frames: truth and tracks; for points the similarity is that of `mot_frames`.
        alphas: (A,) thresholds of similarity in (0, 1).
    """
    target, track, similarity = _assigned(frames)
    tracks = max(len(frames.track_key), 1)
    couples, couple = np.unique(target * tracks + track, return_inverse=True)
    life = np.bincount(frames.truth, minlength=1)[couples // tracks]
    length = np.bincount(frames.track, minlength=1)[couples % tracks]
    tps, locs = np.zeros(len(alphas), dtype=np.int64), np.ones(len(alphas))
    ass: list[list[float]] = []
    for a, alpha in enumerate(alphas):
        good = similarity >= alpha - EPS
        tp = int(np.count_nonzero(good))
        shared = np.bincount(couple[good], minlength=len(couples)).astype(np.float64)
        tps[a], locs[a] = tp, np.mean(similarity[good]) if tp else 1.0
        ass.append([float(np.sum(shared**2 / whole)) / max(tp, 1) for whole in (life + length - shared, life, length)])
    n, m = len(frames.truth), len(frames.track)
    det = [tps / np.maximum(whole, 1) for whole in (n + m - tps, n, m)]
    parts = np.reshape(ass, (-1, 3))
    joint = np.sqrt(det[0] * parts[:, 0])
    return Hota(np.asarray(alphas), joint, det[0], parts[:, 0], locs, det[1], det[2], parts[:, 1], parts[:, 2], tps)


def _assigned(frames: Frames) -> tuple[Ints, Ints, Floats]:
    """Target, track, similarity of the pairs of all frames: similar now, and alike over all frames."""
    alike = _alignment(frames)
    targets, tracks, similarities = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)], [np.zeros(0)]
    for t in frames.meeting():
        left, right = frames.rows(t)
        truth, track = frames.truth[left], frames.track[right]
        similarity = frames.compare(t)[1]
        i, j = linear_sum_assignment(similarity * alike[truth[:, None], track[None, :]], maximize=True)
        targets.append(truth[i])
        tracks.append(track[j])
        similarities.append(similarity[i, j])
    return np.concatenate(targets), np.concatenate(tracks), np.concatenate(similarities)


def _alignment(frames: Frames) -> Floats:
    """(G, K) how well each target and track agree over all frames: shared over what either has, 0 to 1."""
    met = np.zeros((len(frames.truth_key), len(frames.track_key)))
    for t in frames.meeting():
        left, right = frames.rows(t)
        similarity = frames.compare(t)[1]
        whole = similarity.sum(axis=0)[None, :] + similarity.sum(axis=1)[:, None] - similarity
        some = whole > EPS
        met[frames.truth[left][:, None], frames.track[right][None, :]] += similarity * some / np.where(some, whole, 1.0)
    life = np.bincount(frames.truth, minlength=len(frames.truth_key))
    length = np.bincount(frames.track, minlength=len(frames.track_key))
    return np.asarray(met / (life[:, None] + length[None, :] - met))
