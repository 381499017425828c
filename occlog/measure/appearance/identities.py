"""Whom each track follows, by all of its boxes; and tracks under the identities of the gallery."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np

from occlog.array_types import Bools, Floats, Ints, Ints32
from occlog.records.declared.gallery import SUSPENDED, AppearanceMatches
from occlog.records.tables import Tracks

from .sightings import NOBODY

T = TypeVar("T", bound=Tracks)


class Evidence(NamedTuple):
    """Sums over the boxes of K tracks that were compared with R targets."""

    track: Ints32  # (K,) rising
    target: Ints32  # (R,) rising
    likeness: Floats  # (K, R) sum of coefficients without their bias
    boxes: Ints  # (K, R)


class EvidenceTally:
    """The sums, gathered while tables stream by."""

    def __init__(self) -> None:
        """Nothing yet."""
        self._sums: dict[tuple[int, int], tuple[float, int]] = {}

    def add(self, part: AppearanceMatches) -> None:
        """Count the pairs that were compared."""
        rows = np.flatnonzero((part.decision != SUSPENDED) & (part.track_id != NOBODY))
        columns = (part.track_id[rows], part.target_id[rows], part.rho_corrected[rows])
        for track, target, value in zip(*(c.tolist() for c in columns), strict=True):
            total, n = self._sums.get((track, target), (0.0, 0))
            self._sums[track, target] = total + value, n + 1

    def evidence(self) -> Evidence:
        """The sums so far."""
        track, target = (np.unique(np.array([k[i] for k in self._sums], dtype=np.int32)) for i in (0, 1))
        likeness, boxes = np.zeros((len(track), len(target))), np.zeros((len(track), len(target)), dtype=np.int64)
        for (name, other), (total, n) in self._sums.items():
            place = np.searchsorted(track, name), np.searchsorted(target, other)
            likeness[place], boxes[place] = total, n
        return Evidence(track, target, likeness, boxes)


def identities(evidence: Evidence, together: Bools, least_likeness: float, least_boxes: int) -> dict[int, int]:
    """Target of each track that is surely enough of one; tracks of one target may follow one another.

    The pair of track and target with the highest mean likeness comes first.  A track is of one target, and two tracks
    that are there at the same time are not of one target.

    Args:
        evidence: of K tracks and R targets.
        together: (K, K) pairs of tracks that are there at the same time.
        least_likeness: mean over a track's boxes.
        least_boxes: fewest of them.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = evidence.likeness / evidence.boxes
    mean = np.where((evidence.boxes >= least_boxes) & (mean >= least_likeness), mean, -np.inf)
    out: dict[int, int] = {}
    while mean.size and np.isfinite(mean.max()):
        track, target = np.unravel_index(int(mean.argmax()), mean.shape)
        out[int(evidence.track[track])] = int(evidence.target[target])
        mean[track] = -np.inf
        mean[together[track], target] = -np.inf
    return out


def tracks_together(tracks: Tracks, which: Ints32) -> Bools:
    """(K, K) whether the spans of two of the tracks have a time in common; true of a track and itself."""
    first, last = np.full(len(which), np.iinfo(np.int64).max), np.full(len(which), np.iinfo(np.int64).min)
    for k, name in enumerate(which.tolist()):
        own = tracks.t_ns[tracks.target_id == name]
        if len(own):
            first[k], last[k] = own[0], own[-1]
    return np.asarray((first[:, None] <= last[None, :]) & (first[None, :] <= last[:, None]))


def renamed(tracks: T, named: dict[int, int], gallery: Iterable[int]) -> tuple[T, dict[int, int]]:
    """The tracks under the targets' identities, and the new name of every track.

    Tracks of nobody in the gallery get numbers above all of the gallery's, in the order of their own.
    """
    names = np.unique(tracks.target_id)
    free = 1 + max(gallery, default=-1)
    rest = [name for name in names.tolist() if name not in named]
    new = named | {name: free + k for k, name in enumerate(rest)}
    target = np.array([new[name] for name in names.tolist()], dtype=np.int32)[np.searchsorted(names, tracks.target_id)]
    return replace(tracks, target_id=target).sorted(), {name: new[name] for name in names.tolist()}
