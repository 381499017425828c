"""IDF1: how long each target is followed by the one track that follows it best.

Ristani et al. 2016, "Performance measures and a data set for multi-target, multi-camera tracking".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from occlog.array_types import Ints

from .errors import ratio
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


def identity(frames: Frames, threshold: float = 0.5) -> Identity:
    """Compute IDF1 and its parts, with targets and tracks assigned one to one over all frames.

    Args:
        frames: truth and tracks.
        threshold: least similarity at which a track meets a target.
    """
    # Count the rows in which each target is met by each track
    targets, tracks = len(frames.truth_key), len(frames.track_key)
    met = np.zeros((targets, tracks), dtype=np.int64)
    for t in frames.meeting():
        left, right = frames.rows(t)
        # No label comes twice in a frame, so no element is added to twice.
        met[frames.truth[left][:, None], frames.track[right][None, :]] += reaches(frames.compare(t)[1], threshold)
    # Assign: the least IDFN + IDFP = N + M - 2 IDTP has the most IDTP
    rows, columns = linear_sum_assignment(met, maximize=True)
    idtp, n, m = int(met[rows, columns].sum()), len(frames.truth), len(frames.track)
    given = np.full(targets, -1, dtype=np.int64)
    given[rows] = np.where(met[rows, columns] > 0, columns, -1)
    return Identity(
        idtp=idtp,
        idfp=m - idtp,
        idfn=n - idtp,
        idf1=ratio(2 * idtp, n + m),
        idp=ratio(idtp, m),
        idr=ratio(idtp, n),
        track=given,
    )
