"""IDF1: how long each target is followed by the one track that follows it best.

Ristani et al. 2016, "Performance measures and a data set for multi-target, multi-camera tracking".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Ints
from occlog.core.numerics.assignment import maximum_weight_matching

from ..errors import ratio
from .couples import Couples
from .frame_pairs import Frames, reaches


class Identity(NamedTuple):
    """Counts and rates; rates are NaN where nothing is there to divide by.

    Attributes:
        idtp: rows in which a target is met by the track that is given to it.
        idfp: the other rows of tracks.
        idfn: the other true rows.
        idf1: 2 idtp / (2 idtp + idfp + idfn).
        idp: idtp / (idtp + idfp).
        idr: idtp / (idtp + idfn).
        track: (G,) number of the track that is given to each target; -1: none ever meets it.
    """

    idtp: int
    idfp: int
    idfn: int
    idf1: float
    idp: float
    idr: float
    track: Ints


class IdentityCounts:
    """IDF1 of frames that come in parts: the rows in which each target is met by each track."""

    def __init__(self, targets: int, tracks: int, threshold: float = 0.5) -> None:
        """No frame yet; number of all targets and tracks, and the least similarity at which a track meets a target."""
        self._met, self._targets = Couples(targets, tracks), targets
        self._objects = self._estimates = 0
        self._threshold = threshold

    def update(self, frames: Frames) -> None:
        """Count some more frames; targets and tracks have the same numbers in all parts."""
        self._objects, self._estimates = self._objects + len(frames.truth), self._estimates + len(frames.track)
        for t in frames.meeting():
            left, right = frames.rows(t)
            i, j = np.nonzero(reaches(frames.compare(t)[1], self._threshold))
            # No label comes twice in a frame, so no couple is added to twice.
            self._met.add(frames.truth[left][i], frames.track[right][j], np.ones((1, len(i))))

    def merge(self, other: IdentityCounts) -> None:
        """Take in another recording, whose targets and tracks get the numbers behind these."""
        self._met.merge(other._met)
        self._targets += other._targets
        self._objects, self._estimates = self._objects + other._objects, self._estimates + other._estimates

    def result(self) -> Identity:
        """Assign targets and tracks: the least IDFN + IDFP = N + M - 2 IDTP has the most IDTP."""
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
            idf1=ratio(2 * idtp, n + m),
            idp=ratio(idtp, m),
            idr=ratio(idtp, n),
            track=given,
        )


def identity(frames: Frames, threshold: float = 0.5) -> Identity:
    """Compute IDF1 and its parts, with targets and tracks assigned one to one over all frames.

    Args:
        frames: truth and tracks.
        threshold: least similarity at which a track meets a target.
    """
    counts = IdentityCounts(len(frames.truth_key), len(frames.track_key), threshold)
    counts.update(frames)
    return counts.result()
