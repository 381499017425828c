"""Obstacles of a trajectory: where it runs through one, and first guesses of detours around it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.plane.separating_lines import beside, route, separate, spread_along


class Obstacle(NamedTuple):
    """A polygon in which the target is not."""

    corners: Floats  # (K, 2) simple, counter-clockwise
    pieces: tuple[Floats, ...]  # convex, counter-clockwise; they make it up
    seen_through: tuple[Floats, ...] | None  # None: a wall. Else convex polygons that hide places in this view
    eye: Floats  # (2,) of a view: where the camera is
    when: Bools  # (T,) at which states it is there; a wall: always, and between them too
    price: float  # cost of a state inside; inf: none is


class Hold(NamedTuple):
    """States first .. last are kept out of an obstacle."""

    obstacle: int
    first: int
    last: int


def stretches(X: Floats, obstacles: tuple[Obstacle, ...], left_alone: Bools, touch: float) -> Iterator[Hold]:
    """Stretches of states inside an obstacle, or at the ends of a step through a wall."""
    xy = np.ascontiguousarray(X[:, ::2])
    for k, o in enumerate(obstacles):
        inside = overlaps(xy, o, touch) & ~left_alone[k]
        rows = np.flatnonzero(inside)
        if not len(rows):
            continue
        # Frames of a camera that comes and goes belong to one stretch.
        there = np.cumsum(o.when)
        cuts = np.flatnonzero(np.diff(there[rows]) > 1) + 1
        for rest in np.split(rows, cuts):
            yield Hold(k, int(rest[0]), int(rest[-1]))


def overlaps(xy: Floats, o: Obstacle, touch: float) -> Bools:
    """(T,) states inside an obstacle; of a wall also both ends of each step that cuts it."""
    out = np.zeros(len(xy), dtype=np.bool_)
    if o.seen_through is None:
        for piece in o.pieces:
            out |= separate(xy, xy, piece).gap < -touch
            cut = separate(xy[:-1], xy[1:], piece).gap < -touch
            out[:-1] |= cut
            out[1:] |= cut
        return out
    rows = np.flatnonzero(o.when)
    inside = np.zeros(len(rows), dtype=np.bool_)
    for piece in o.pieces:
        inside |= separate(xy[rows], xy[rows], piece).gap < -touch
    rows = rows[inside]
    eye = np.broadcast_to(o.eye, (len(rows), 2))
    hidden = np.zeros(len(rows), dtype=np.bool_)
    for wall in o.seen_through:
        hidden |= separate(eye, xy[rows], wall).gap < 0.0
    out[rows[~hidden]] = True
    return out


def guesses(
    X: Floats, obstacles: tuple[Obstacle, ...], stretch: Hold, extent: float, clearance: float
) -> Iterator[Floats]:
    """Trajectories that lead a stretch around its obstacle."""
    o, T = obstacles[stretch.obstacle], len(X)
    wall = o.seen_through is None
    away = (clearance if wall else 0.0) + 1e-3 * extent
    a, b = (stretch.first, stretch.last) if wall else (stretch.first - 1, stretch.last + 1)
    inside = overlaps(np.ascontiguousarray(X[:, ::2]), o._replace(when=np.ones(T, dtype=np.bool_)), 0.0)
    if wall:  # both ends of a step through it: the states themselves may be outside
        inside = _within(X[:, ::2], o)
    while a >= 0 and inside[a]:
        a -= 1
    while b < T and inside[b]:
        b += 1
    if a < 0 or b >= T:
        yield from _to_edges(X, o, max(a, -1), min(b, T), away)
        return
    # Around the obstacle on either side, from and to states as near as the number of states in between allows
    for ccw in (True, False):
        first, last = a, b
        guess = None
        while guess is None:
            places = route(o.corners, X[first, ::2], X[last, ::2], away, ccw=ccw)
            guess = spread_along(X[first, ::2], places, X[last, ::2], last - first)
            if guess is None:
                if first == 0 and last == T - 1:
                    break
                first, last = max(0, first - 1), min(T - 1, last + 1)
        if guess is None:
            continue
        Y = X.copy()
        Y[first + 1 : last, ::2] = guess
        yield Y


def _within(xy: Floats, o: Obstacle) -> Bools:
    """(T,) which places are inside."""
    points = np.ascontiguousarray(xy)
    return np.asarray(np.any([separate(points, points, piece).gap < 0.0 for piece in o.pieces], axis=0))


def _to_edges(X: Floats, o: Obstacle, a: int, b: int, away: float) -> Iterator[Floats]:
    """Trajectories whose states a + 1 .. b - 1 are beside one of the edges; for stretches at the start or the end."""
    K = len(o.corners)
    for k in range(K):
        edge = o.corners[(k + 1) % K] - o.corners[k]
        Y = X.copy()
        xy = X[a + 1 : b, ::2]
        share = np.clip((xy - o.corners[k]) @ edge / (edge @ edge), 0.0, 1.0)
        Y[a + 1 : b, ::2] = beside(o.corners, k, o.corners[k] + share[:, None] * edge, away)
        yield Y


def hidden_from_view(xy: Floats, o: Obstacle, rows: Ints) -> Bools:
    """Which of some states the camera of a view cannot see for a wall."""
    eye = np.broadcast_to(o.eye, (len(rows), 2))
    out = np.zeros(len(rows), dtype=np.bool_)
    for wall in o.seen_through or ():
        out |= separate(eye, xy[rows], wall).gap < 0.0
    return out
