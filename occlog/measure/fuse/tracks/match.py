"""Matching of tracks of two groups of cameras to people, by time step.

Also consistent identities over several groups, and covariance intersection of estimates with unknown common errors.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Floats, Ints
from occlog.core.numerics.assignment import assign
from occlog.records.tables import PeopleTracks

MAX_DISTANCE_GATES = 4.0
"""A distance counts at most this many times the gate, so that a quarter of the time steps may be far off."""
CONTINUITY_BONUS_CHI2 = 4.0
"""The pairs of the time step before are preferred by so much of the squared distance in standard deviations."""


def match_tracks(first: PeopleTracks, second: PeopleTracks, error: float, gate: float, span_s: float) -> Ints:
    """For each row of the first group's tracks, find the row of the same person in the second group's.

    Tracks are compared by their squared Mahalanobis distance, averaged over `span_s` around the time step and
    clipped to `MAX_DISTANCE_GATES` times the squared gate. Pairs within the gate are assigned one to one at each
    time step; pairs of the time step before are preferred.

    Args:
        first: n rows at common time steps, ordered by time.
        second: tracks of another group of cameras at the same time steps, ordered by time.
        error: standard deviation of the difference of positions beyond their covariances, per axis [length].
        gate: limit in standard deviations.
        span_s: time over which tracks are compared, half of it before and half after [s].

    Returns:
        (n,) rows of the second group; -1: no match.
    """
    out = np.full(len(first), -1, dtype=np.int64)
    found = _compared(first, second, error, gate, span_s)
    if not len(found[0]):
        return out
    rows, others, cost = found
    order = np.lexsort([others, rows])  # rows of `first` are in the order of time
    rows, others, cost = rows[order], others[order], cost[order]
    cuts = np.flatnonzero(np.diff(first.t_ns[rows])) + 1
    before: set[tuple[int, int]] = set()
    for part in np.split(np.arange(len(rows)), cuts):
        mine, where = np.unique(rows[part], return_inverse=True)
        theirs, there = np.unique(others[part], return_inverse=True)
        pairs = list(zip(first.target_id[rows[part]].tolist(), second.target_id[others[part]].tolist(), strict=True))
        held = np.array([pair in before for pair in pairs])
        table = np.full((len(mine), len(theirs)), np.inf)
        # Costs below 0 are not taken by the assignment; the gate is for the distance alone
        table[where, there] = np.where(
            cost[part] <= gate**2, cost[part] + np.where(held, 0.0, CONTINUITY_BONUS_CHI2), np.inf
        )
        a, b = assign(table, gate**2 + CONTINUITY_BONUS_CHI2)
        out[mine[a]] = theirs[b]
        before = set(zip(first.target_id[mine[a]].tolist(), second.target_id[theirs[b]].tolist(), strict=True))
    return out


class GroundPositions(NamedTuple):
    """n positions on the ground, x and y (n,), with the elements xx, xy, yy (n,) of their covariances."""

    x: Floats  # (n,)
    y: Floats
    xx: Floats  # covariance
    xy: Floats
    yy: Floats

    @classmethod
    def of(cls, tracks: PeopleTracks) -> GroundPositions:
        """Positions and covariances of all rows of tracks."""
        tracks = tracks.with_covariance()
        return cls(tracks.x, tracks.y, tracks.cov_xx, tracks.cov_xy, tracks.cov_yy)

    def take(self, rows: Ints) -> GroundPositions:
        """The positions with these indices, in this order."""
        return GroundPositions(*(values[rows] for values in self))


def distances(first: GroundPositions, second: GroundPositions, error: float) -> Floats:
    """(n,) squared Mahalanobis distances between pairs of positions; chi-square with 2 degrees of freedom.

    Args:
        first: n positions.
        second: n positions with errors independent of the first.
        error: additional standard deviation of their difference, per axis [length].
    """
    dx, dy = second.x - first.x, second.y - first.y
    xx, xy, yy = first.xx + second.xx + error**2, first.xy + second.xy, first.yy + second.yy + error**2
    determinant = np.maximum(xx * yy - xy**2, np.finfo(np.float64).tiny)
    squared: Floats = (yy * dx**2 - 2.0 * xy * dx * dy + xx * dy**2) / determinant
    return squared


def _compared(
    first: PeopleTracks, second: PeopleTracks, error: float, gate: float, span_s: float
) -> tuple[Ints, Ints, Floats]:
    """Pairs of rows of two groups at equal times, for all tracks that are ever near each other, with mean distances.

    Args:
        first: tracks of one group of cameras.
        second: tracks of the other group.
        error: standard deviation of the difference of positions beyond their covariances, per axis [length].
        gate: limit in standard deviations.
        span_s: time over which distances are averaged [s].

    Returns:
        (n,) rows of the first group, (n,) rows of the second, (n,) moving averages of squared Mahalanobis distances,
        each clipped to `MAX_DISTANCE_GATES` gate^2. Not sorted.
    """
    positions = GroundPositions.of(first), GroundPositions.of(second)
    rows_of = [{i: np.flatnonzero(g.target_id == i) for i in np.unique(g.target_id).tolist()} for g in (first, second)]
    none = np.zeros(0, dtype=np.int64)
    parts: list[tuple[Ints, Ints, Floats]] = [(none, none, np.zeros(0))]
    for a, b in _ever_near(first, second, error, gate):
        mine, theirs = rows_of[0][a], rows_of[1][b]
        _, i, j = np.intersect1d(first.t_ns[mine], second.t_ns[theirs], assume_unique=True, return_indices=True)
        mine, theirs = mine[i], theirs[j]
        far = np.minimum(
            distances(positions[0].take(mine), positions[1].take(theirs), error), MAX_DISTANCE_GATES * gate**2
        )
        parts.append((mine, theirs, _windowed(far, first.t_ns[mine], round(0.5 * span_s * NS))))
    a_rows, b_rows, cost = zip(*parts, strict=True)
    return np.concatenate(a_rows), np.concatenate(b_rows), np.concatenate(cost)


def _ever_near(first: PeopleTracks, second: PeopleTracks, error: float, gate: float) -> list[tuple[int, int]]:
    """Sorted pairs of identities, one of each group, that are within the gate at some time step.

    `error` is the standard deviation of the difference of positions beyond their covariances [length], `gate` the
    limit in standard deviations.
    """
    positions = GroundPositions.of(first), GroundPositions.of(second)
    near: set[tuple[int, int]] = set()
    times, start, number = np.unique(second.t_ns, return_index=True, return_counts=True)
    asked, begin, people = np.unique(first.t_ns, return_index=True, return_counts=True)
    _, at, where = np.intersect1d(asked, times, assume_unique=True, return_indices=True)
    for a, b in zip(at.tolist(), where.tolist(), strict=True):
        mine = np.repeat(np.arange(begin[a], begin[a] + people[a]), number[b])
        theirs = np.tile(np.arange(start[b], start[b] + number[b]), people[a])
        close = distances(positions[0].take(mine), positions[1].take(theirs), error) <= gate**2
        mine, theirs = mine[close], theirs[close]
        near.update(zip(first.target_id[mine].tolist(), second.target_id[theirs].tolist(), strict=True))
    return sorted(near)


def _windowed(values: Floats, t_ns: Ints, half_ns: int) -> Floats:
    """(n,) moving averages of values (n,) over +-`half_ns` [ns] around each of the increasing times `t_ns` (n,)."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    low = np.searchsorted(t_ns, t_ns - half_ns, side="left")
    high = np.searchsorted(t_ns, t_ns + half_ns, side="right")
    mean: Floats = (total[high] - total[low]) / (high - low)
    return mean


Member = tuple[int, int]
"""Group of cameras, and identity there."""
NO_ID = -1


@dataclass
class IdentityMatcher:
    """Assigns identities to people tracked by one or several groups, over time steps.

    A person keeps the identity while one of the tracks continues. When tracks separate, the one that has had the
    identity longest keeps it.

    Attributes:
        doubts: pairs of identities that may have been exchanged in the last time step.
    """

    doubts: list[tuple[int, int]] = field(default_factory=list)
    _held: dict[Member, int] = field(default_factory=dict)  # the identity that a track has now
    _own: dict[Member, int] = field(default_factory=dict)  # the first identity that a track had
    _next: int = 0

    def step(self, people: list[tuple[Member, ...]]) -> list[int]:
        """Identity of each person (a set of tracks) at the next time step; `doubts` has possible exchanges."""
        self.doubts = []
        taken: dict[int, int] = {}
        # The oldest identity goes first, to those with tracks that have had it all along
        for identity, index in self._claims(people):
            if identity not in taken and index not in taken.values():
                taken[identity] = index
        given = {index: identity for identity, index in taken.items()}
        for index, members in enumerate(people):
            identity = given.get(index, NO_ID)
            if identity == NO_ID:
                identity = given[index] = self._again(members, taken)
                taken[identity] = index
            before = {self._held[m] for m in members if m in self._held} - {identity}
            self.doubts += [(identity, other) for other in sorted(before)]
            for member in members:
                self._held[member] = identity
                self._own.setdefault(member, identity)
        return [given[index] for index in range(len(people))]

    def _claims(self, people: list[tuple[Member, ...]]) -> Iterator[tuple[int, int]]:
        """Generate pairs of an identity and the index of a person with a track that has it, the oldest identity first.

        Tracks that had the identity from the start have priority.
        """
        claims = [
            (self._held[m], self._own[m] != self._held[m], m, index)
            for index, members in enumerate(people)
            for m in members
            if m in self._held
        ]
        for identity, _, _, index in sorted(claims):
            yield identity, index

    def _again(self, members: tuple[Member, ...], taken: dict[int, int]) -> int:
        """Identity that a track had before it was merged with another person; else a new one.

        Args:
            members: tracks that are one person.
            taken: identities in use at this time step.
        """
        for member in members:
            own = self._own.get(member)
            if own is not None and own not in taken:
                return own
        self._next += 1
        return self._next - 1


LEAST = 1e-12
"""Part of the larger variance that the smaller one is taken to be at least: exact positions have no inverse."""


def weights(first: Floats, second: Floats) -> Floats:
    """Weights of the first estimate that minimise the area of the fused position's error ellipse.

    With the information matrices A and B and the eigenvalues d of A^-1 B, the determinant of w A + (1 - w) B is
    proportional to the product of w + (1 - w) d, a parabola in w with known vertex.

    Args:
        first: (n, 2, 2) covariances of the position.
        second: (n, 2, 2) the same.

    Returns:
        (n,) from 0 to 1.
    """
    # det(A^-1 B - d I) = d^2 - trace d + determinant
    ratio = first @ np.linalg.inv(second)
    trace, determinant = np.trace(ratio, axis1=1, axis2=2), np.linalg.det(ratio)
    # (w + (1 - w) d1) (w + (1 - w) d2) = a w^2 + b w + c
    a, b = 1.0 - trace + determinant, trace - 2.0 * determinant
    with np.errstate(divide="ignore", invalid="ignore"):
        vertex = -b / (2.0 * a)
    # The parabola has a maximum inside where a < 0; else, as where it ends first, the end that is higher
    ends = np.where(determinant < 1.0, 1.0, 0.0)
    inside = (a < -1e-12) & (vertex > 0.0) & (vertex < 1.0)
    return np.where(inside, vertex, ends)


def intersect(means: tuple[Floats, Floats], covariances: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    """Fuse two estimates with unknown correlation by covariance intersection (Julier and Uhlmann 1997).

    P^-1 = w A^-1 + (1 - w) B^-1, P^-1 x = w A^-1 a + (1 - w) B^-1 b; w by `weights`.

    Args:
        means: two times (n, k) states, the first two numbers the position.
        covariances: two times (n, k, k), finite.

    Returns:
        (n, k) fused states, and (n, k, k) covariances, which are at least those of the errors if both given ones are.
    """
    first, second = (_invertible(c) for c in covariances)
    w = weights(first[:, :2, :2], second[:, :2, :2])[:, None, None]
    of_first, of_second = w * np.linalg.inv(first), (1.0 - w) * np.linalg.inv(second)
    covariance = np.linalg.inv(of_first + of_second)
    mean = covariance @ (of_first @ means[0][..., None] + of_second @ means[1][..., None])
    return mean[..., 0], 0.5 * (covariance + np.swapaxes(covariance, 1, 2))


def _invertible(covariance: Floats) -> Floats:
    k = covariance.shape[-1]
    floor = np.maximum(LEAST * np.trace(covariance, axis1=1, axis2=2), LEAST)
    made: Floats = covariance + floor[:, None, None] * np.eye(k)
    return made
