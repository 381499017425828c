"""Sums for couples, a target with a track, while frames come by."""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats, Ints

DENSE = 1 << 22
"""Most sums that are kept as a matrix of targets and tracks; of more, those of the couples alone that ever meet."""
PENDING = 1 << 18
"""Additions that are kept at least until they are summed up, where there is no matrix."""


class Couples:
    """Some sums for each couple of a target and a track.

    A long recording has a hundred thousand of each, of which few are ever there together: memory grows with the couples
    that something was added to.
    """

    def __init__(self, targets: int, tracks: int, sums: int = 1) -> None:
        """Sums of 0.

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
        """Add to some couples, of which none comes twice.

        Args:
            target: (n,) numbers of targets.
            track: (n,) numbers of tracks.
            values: (sums, n).
        """
        if self._matrix is not None:
            self._matrix[:, target, track] += values
            return
        self._pending.append((target * max(self._tracks, 1) + track, values))
        self._waiting += len(target)
        if self._waiting > PENDING + len(self._keys) // 2:
            self._settle()

    def at(self, target: Ints, track: Ints) -> Floats:
        """(sums, n) sums of couples, 0 where nothing was added."""
        if self._matrix is not None:
            return np.asarray(self._matrix[:, target, track])
        self._settle()
        keys = target * max(self._tracks, 1) + track
        place = np.searchsorted(self._keys, keys)
        place[place == len(self._keys)] = 0
        out = np.zeros((self._sums, len(keys)))
        known = self._keys[place] == keys if len(self._keys) else np.zeros(len(keys), dtype=np.bool_)
        out[:, known] = self._values[:, place[known]]
        return out

    def all(self) -> tuple[Ints, Ints, Floats]:
        """(n,) targets and (n,) tracks of the couples that have a sum other than 0, by target and track; (sums, n)."""
        if self._matrix is not None:
            target, track = np.nonzero(self._matrix.any(axis=0))
            return target, track, self._matrix[:, target, track]
        self._settle()
        tracks = max(self._tracks, 1)
        return self._keys // tracks, self._keys % tracks, self._values

    def merge(self, other: Couples) -> None:
        """Take in the couples of other targets and tracks, which get the numbers behind these."""
        (target, track, values), (its_target, its_track, more) = self.all(), other.all()
        tracks = self._tracks + other._tracks
        theirs = (its_target + self._targets) * tracks + its_track + self._tracks
        self._keys = np.concatenate([target * tracks + track, theirs])
        self._values = np.concatenate([values, more], axis=1)
        self._matrix, self._targets, self._tracks = None, self._targets + other._targets, tracks

    def _settle(self) -> None:
        """Sum up what was added since, in the order in which it was, as a matrix does."""
        if not self._pending:
            return
        keys = np.concatenate([self._keys, *(key for key, _ in self._pending)])
        values = np.concatenate([self._values, *(value for _, value in self._pending)], axis=1)
        self._keys, place = np.unique(keys, return_inverse=True)
        self._values = np.stack([np.bincount(place, each, minlength=len(self._keys)) for each in values])
        some = self._values.any(axis=0)
        self._keys, self._values = self._keys[some], self._values[:, some]
        self._pending, self._waiting = [], 0
