"""Which target is a track's own: the one of its number, the first one it is on, or the one it is on most."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from ..columns import Floats, Ints
from ..core.mot_failures import NONE
from ..core.mot_frames import Objects, of_points


class _Near(NamedTuple):
    """Pairs of a track's row and a true row that are near each other in a frame."""

    truth: Ints
    track: Ints
    share: Floats  # distance over tau


def own_targets(truth: Objects, tracks: Objects, tau: Floats, t_ns: Ints, how: str) -> Ints:
    """(m,) label of the target that each row's track belongs to; `NONE`: the track has no target.

    Args:
        truth: points.
        tracks: points; rows of one label are one track, in all views.
        tau: (n,) for each true row how near a track on it must be.
        t_ns: (m,) time of each row of the tracks.
        how: `label`: the target of the same label; `start`: the first target that the track is on,
            in any view, of several at that time the nearest in terms of tau; `best`: by the
            one-to-one assignment over all views in which most estimates are on their own target.
    """
    if how == "label":
        return tracks.label
    near = _near(truth, tracks, tau)
    own = _first(truth, tracks, near, t_ns) if how == "start" else _best(truth, tracks, near)
    keys, number = np.unique(tracks.label, return_inverse=True)
    return np.array([own.get(int(k), NONE) for k in keys], dtype=np.int64)[number]


def _near(truth: Objects, tracks: Objects, tau: Floats) -> _Near:
    frames = of_points(truth, tracks, 1.0)
    parts = [(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0))]
    reach = tau[frames.truth_row]
    for t in frames.meeting():
        left, right = frames.rows(t)
        share = frames.compare(t)[0] / reach[left, None]
        i, j = np.nonzero(share <= 1.0)
        parts.append((frames.truth_row[left][i], frames.track_row[right][j], share[i, j]))
    return _Near(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _first(truth: Objects, tracks: Objects, near: _Near, t_ns: Ints) -> dict[int, int]:
    out: dict[int, int] = {}
    label = truth.label[near.truth]
    for row in np.lexsort((label, near.share, t_ns[near.track])).tolist():
        out.setdefault(int(tracks.label[near.track[row]]), int(label[row]))
    return out


def _best(truth: Objects, tracks: Objects, near: _Near) -> dict[int, int]:
    targets, i = np.unique(truth.label, return_inverse=True)
    keys, j = np.unique(tracks.label, return_inverse=True)
    met = np.zeros((len(keys), len(targets)), dtype=np.int64)
    np.add.at(met, (j[near.track], i[near.truth]), 1)
    rows, columns = linear_sum_assignment(met, maximize=True)
    return {int(keys[r]): int(targets[c]) for r, c in zip(rows, columns, strict=True) if met[r, c]}
