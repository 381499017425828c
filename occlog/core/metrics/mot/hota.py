"""HOTA: detection and association in equal parts, over thresholds of localisation.

Luiten et al. 2021, "HOTA: a higher order metric for evaluating multi-object tracking".

IDF1: how long each target is followed by the one track that follows it best.

Ristani et al. 2016, "Performance measures and a data set for multi-target, multi-camera tracking".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from occlog.array_types import Floats, Ints
from occlog.core.numerics.assignment import maximum_weight_matching

from ..errors import Sum, ratio_or_nan
from .frame_pairs import EPS, MatchedFrames, TargetTrackSums, reaches

ALPHAS: Floats = np.arange(1, 20) / 20.0
"""Thresholds of similarity, 0.05 to 0.95."""


class Hota(NamedTuple):
    """HOTA figures by threshold, (A,) each; the published HOTA is the mean over thresholds.

    A threshold at which nothing is paired has 0 everywhere, and `loc_a` 1, as in TrackEval.
    TP, FN and FP count pairs, true rows without a pair, and rows of tracks without one.  TPA, FNA and FPA of a
    pair count rows of its target and its track: pairs of the two, other rows of the target,
    other rows of the track.

    Attributes:
        alpha: thresholds.
        hota: sqrt(det_a ass_a).
        det_a: TP / (TP + FN + FP).
        ass_a: mean over the pairs of TPA / (TPA + FNA + FPA).
        loc_a: mean similarity of the pairs.
        det_re: TP / (TP + FN).
        det_pr: TP / (TP + FP).
        ass_re: mean over the pairs of TPA / (TPA + FNA).
        ass_pr: mean over the pairs of TPA / (TPA + FPA).
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
        """Return the mean of each figure over the thresholds, by name: `hota`, `det_a`, `ass_a` etc., without `tp`."""
        names = ("hota", "det_a", "ass_a", "loc_a", "det_re", "det_pr", "ass_re", "ass_pr")
        return {name: float(np.mean(getattr(self, name))) for name in names}


class Alignment:
    """Global alignment score of HOTA for each target and track: how well the two agree over all frames.

    `life` (G,) and `length` (K,) are the numbers of rows of targets and tracks.
    """

    def __init__(self, targets: int, tracks: int) -> None:
        """Start without frames; `targets` and `tracks` are the numbers of all targets and tracks."""
        self._met = TargetTrackSums(targets, tracks)
        self.life = np.zeros(targets, dtype=np.int64)
        self.length = np.zeros(tracks, dtype=np.int64)

    def update(self, frames: MatchedFrames) -> None:
        """Add frames, with target and track numbers of the whole recording.

        A pair with the similarity s adds s / (sum of the similarities of its target to all tracks and of its track to
        all targets - s).
        """
        for t in frames.meeting():
            left, right = frames.rows(t)
            similarity = frames.compare(t)[1]
            whole = similarity.sum(axis=0)[None, :] + similarity.sum(axis=1)[:, None] - similarity
            some = whole > EPS
            share = similarity * some / np.where(some, whole, 1.0)
            i, j = np.nonzero(share)
            self._met.add(frames.truth[left][i], frames.track[right][j], share[None, i, j])
        self.life += np.bincount(frames.truth, minlength=len(self.life))
        self.length += np.bincount(frames.track, minlength=len(self.length))

    def of(self, target: Ints, track: Ints) -> Floats:
        """Return the (n,) global alignment scores, 0 to 1, of couples of targets `target` (n,) and tracks `track` (n,).

        It is the sum of what `update` adds for the couple, divided by the rows of both less this sum.
        """
        (met,) = self._met.at(target, track)
        either = self.life[target] + self.length[track] - met
        return np.asarray(met / np.where(either > 0, either, 1.0))


class HotaCounts:
    """Counts of HOTA, accumulated over frames, given the alignment over all frames.

    A couple is a target with a track with which it is paired at least once.
    """

    def __init__(self, known: Alignment, alphas: Floats = ALPHAS) -> None:
        """Start without frames.

        Args:
            known: global alignment scores of all frames of the recording.
            alphas: (A,) thresholds of similarity in (0, 1).
        """
        self._known, self._alphas = known, alphas
        self._couples = np.zeros(0, dtype=np.int64)  # target times number of tracks plus track, ascending
        self._tpa = np.zeros((0, len(alphas)), dtype=np.int64)
        self._similarity = [Sum() for _ in alphas]

    def update(self, frames: MatchedFrames) -> None:
        """Add frames; their targets and tracks are numbered as in the alignment."""
        _, target, track, similarity = _assigned(frames, self._known)
        couple = target * max(len(self._known.length), 1) + track
        both = np.union1d(self._couples, couple)
        counts = np.zeros((len(both), len(self._alphas)), dtype=np.int64)
        counts[np.searchsorted(both, self._couples)] = self._tpa
        index = np.searchsorted(both, couple)
        for a, alpha in enumerate(self._alphas):
            # True positives: pairs that are similar enough
            good = similarity >= alpha - EPS
            counts[:, a] += np.bincount(index[good], minlength=len(both))
            self._similarity[a].add(float(np.sum(similarity[good])))
        self._couples, self._tpa = both, counts

    def merge(self, other: HotaCounts) -> None:
        """Add another recording, with its targets and tracks numbered after these; no frame may be added afterwards.

        Both have the same thresholds.
        """
        mine, its = self._known, other._known
        targets, own, more = len(mine.life), max(len(mine.length), 1), max(len(its.length), 1)
        tracks = max(len(mine.length) + len(its.length), 1)
        target, track = self._couples // own, self._couples % own
        its_target, its_track = targets + other._couples // more, len(mine.length) + other._couples % more
        self._couples = np.concatenate([target * tracks + track, its_target * tracks + its_track])
        self._tpa = np.concatenate([self._tpa, other._tpa])
        for similarity, theirs in zip(self._similarity, other._similarity, strict=True):
            similarity.merge(theirs)
        self._known = Alignment(0, 0)
        self._known.life = np.concatenate([mine.life, its.life])
        self._known.length = np.concatenate([mine.length, its.length])

    def result(self) -> Hota:
        """Return HOTA and its parts over all frames, at each threshold."""
        alphas, tracks = self._alphas, max(len(self._known.length), 1)
        life, length = self._known.life[self._couples // tracks], self._known.length[self._couples % tracks]
        tp, loc_a = self._tpa.sum(axis=0), np.ones(len(alphas))
        ass_a, ass_re, ass_pr = np.zeros(len(alphas)), np.zeros(len(alphas)), np.zeros(len(alphas))
        for a in range(len(alphas)):
            if not tp[a]:
                continue
            loc_a[a] = self._similarity[a].value / tp[a]
            # True positive associations of each couple; its figures count once for each of them in the means
            tpa = self._tpa[:, a].astype(np.float64)
            ass_a[a] = np.sum(tpa**2 / (life + length - tpa)) / tp[a]  # TPA / (TPA + FNA + FPA)
            ass_re[a] = np.sum(tpa**2 / life) / tp[a]  # TPA / (TPA + FNA)
            ass_pr[a] = np.sum(tpa**2 / length) / tp[a]  # TPA / (TPA + FPA)
        # Detection: N = TP + FN true rows, M = TP + FP rows of tracks
        n, m = int(self._known.life.sum()), int(self._known.length.sum())
        det_a, det_re, det_pr = tp / np.maximum(n + m - tp, 1), tp / max(n, 1), tp / max(m, 1)
        return Hota(
            alpha=np.asarray(alphas),
            hota=np.sqrt(det_a * ass_a),
            det_a=det_a,
            ass_a=ass_a,
            loc_a=loc_a,
            det_re=det_re,
            det_pr=det_pr,
            ass_re=ass_re,
            ass_pr=ass_pr,
            tp=tp,
        )


def hota(frames: MatchedFrames, alphas: Floats = ALPHAS) -> Hota:
    """Return HOTA and its parts at each threshold.

    Args:
        frames: truth and tracks.
        alphas: (A,) thresholds of similarity in (0, 1).
    """
    counts = HotaCounts(_aligned(frames), alphas)
    counts.update(frames)
    return counts.result()


def associations(frames: MatchedFrames, alphas: Floats = ALPHAS) -> tuple[Ints, Floats, Floats]:
    """Return the association score of each pair, from which HOTA = sqrt(sum of scores / (TP + FN + FP)).

    Args:
        frames: truth and tracks.
        alphas: (A,) thresholds of similarity in (0, 1).

    Returns:
        (n,) index of each pair's frame; (n, A) 1 where it is a pair at a threshold, else 0; (n, A) its score TPA / (TPA
        + FNA + FPA) there, 0 where it is none.
    """
    frame, couple, life, length, similarity = _paired(frames)
    good = (similarity[:, None] >= alphas - EPS).astype(np.float64)
    belonging = np.zeros_like(good)
    for a in range(len(alphas)):
        tpa = np.bincount(couple, good[:, a], minlength=len(life))
        belonging[:, a] = good[:, a] * (tpa / np.maximum(life + length - tpa, 1))[couple]
    return frame, good, belonging


def _paired(frames: MatchedFrames) -> tuple[Ints, Ints, Ints, Ints, Floats]:
    """Return the pairs of all frames with their couples (a target and a track that are paired at least once).

    Returns:
        (n,) index of each pair's frame, (n,) number of its couple; of each couple the rows of its target (TPA + FNA)
        and of its track (TPA + FPA); (n,) similarity of each pair.
    """
    known = _aligned(frames)
    frame, target, track, similarity = _assigned(frames, known)
    tracks = max(len(frames.track_key), 1)
    couples, couple = np.unique(target * tracks + track, return_inverse=True)
    return frame, couple, known.life[couples // tracks], known.length[couples % tracks], similarity


def _aligned(frames: MatchedFrames) -> Alignment:
    """Return the global alignment scores over all frames."""
    out = Alignment(len(frames.truth_key), len(frames.track_key))
    out.update(frames)
    return out


def _assigned(frames: MatchedFrames, known: Alignment) -> tuple[Ints, Ints, Ints, Floats]:
    """Return the pairs of all frames: indices of frames, targets, tracks and similarities, four arrays (n,).

    In each frame the assignment maximises similarity times global alignment score (`known`), so that of two equally
    near tracks the one that agrees with the target over all frames is chosen.
    """
    none = np.zeros(0, dtype=np.int64)
    indices, targets, tracks, similarities = [none], [none], [none], [np.zeros(0)]
    for t in frames.meeting():
        left, right = frames.rows(t)
        truth, track = frames.truth[left], frames.track[right]
        similarity = frames.compare(t)[1]
        worth, (near, by) = np.zeros_like(similarity), np.nonzero(similarity)
        worth[near, by] = similarity[near, by] * known.of(truth[near], track[by])
        i, j = linear_sum_assignment(worth, maximize=True)
        indices.append(np.full(len(i), t, dtype=np.int64))
        targets.append(truth[i])
        tracks.append(track[j])
        similarities.append(similarity[i, j])
    return np.concatenate(indices), np.concatenate(targets), np.concatenate(tracks), np.concatenate(similarities)


class Identity(NamedTuple):
    """IDF1 counts and rates, with tracks assigned to targets one to one; rates are NaN if the divisor is 0.

    Attributes:
        idtp: true rows that are matched by the track assigned to their target.
        idfp: other rows of tracks.
        idfn: other true rows.
        idf1: 2 idtp / (2 idtp + idfp + idfn).
        idp: idtp / (idtp + idfp).
        idr: idtp / (idtp + idfn).
        track: (G,) number of the track assigned to each target; -1: none.
    """

    idtp: int
    idfp: int
    idfn: int
    idf1: float
    idp: float
    idr: float
    track: Ints


class IdentityCounts:
    """Counts of IDF1, accumulated over frames: the number of rows in which each target matches each track."""

    def __init__(self, targets: int, tracks: int, threshold: float = 0.5) -> None:
        """Start without frames.

        Args:
            targets: number of all targets.
            tracks: number of all tracks.
            threshold: least similarity of a match.
        """
        self._met, self._targets = TargetTrackSums(targets, tracks), targets
        self._objects = self._estimates = 0
        self._threshold = threshold

    def update(self, frames: MatchedFrames) -> None:
        """Add the matches of frames; target and track numbers are the same in all parts of a recording."""
        self._objects, self._estimates = self._objects + len(frames.truth), self._estimates + len(frames.track)
        for t in frames.meeting():
            left, right = frames.rows(t)
            i, j = np.nonzero(reaches(frames.compare(t)[1], self._threshold))
            # No label comes twice in a frame, so no couple is added to twice.
            self._met.add(frames.truth[left][i], frames.track[right][j], np.ones((1, len(i))))

    def merge(self, other: IdentityCounts) -> None:
        """Add another recording, with its targets and tracks numbered after these."""
        self._met.merge(other._met)
        self._targets += other._targets
        self._objects, self._estimates = self._objects + other._objects, self._estimates + other._estimates

    def result(self) -> Identity:
        """Return IDF1 and its parts, with targets and tracks assigned one to one with the largest IDTP.

        This minimises IDFN + IDFP = N + M - 2 IDTP.
        """
        n, m = self._objects, self._estimates
        target, track, (met,) = self._met.all()
        made = maximum_weight_matching(target, track, met)
        idtp = int(met[made].sum())
        given = np.full(self._targets, -1, dtype=np.int64)
        given[target[made]] = track[made]
        return Identity(
            idtp=idtp,
            idfp=m - idtp,
            idfn=n - idtp,
            idf1=ratio_or_nan(2 * idtp, n + m),
            idp=ratio_or_nan(idtp, m),
            idr=ratio_or_nan(idtp, n),
            track=given,
        )


def identity(frames: MatchedFrames, threshold: float = 0.5) -> Identity:
    """Return IDF1 and its parts, with targets and tracks assigned one to one over all frames.

    Args:
        frames: truth and tracks.
        threshold: least similarity at which a row of a track matches a row of a target.
    """
    counts = IdentityCounts(len(frames.truth_key), len(frames.track_key), threshold)
    counts.update(frames)
    return counts.result()
