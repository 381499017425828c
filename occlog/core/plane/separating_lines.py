"""Lines that separate segments from convex polygons, and ways around a polygon."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.jit import kernel


class Separation(NamedTuple):
    """The widest gaps between n segments and a convex polygon."""

    gap: Floats  # (n,) distance between two parallel lines that hold them apart; negative: how deep they overlap
    normal: Floats  # (n, 2) of these lines, away from the polygon
    support: Floats  # (n,) largest normal . corner: the line through the polygon


def separate(start: Floats, end: Floats, polygon: Floats) -> Separation:
    """Find the separating lines, by the separating axis theorem: they run along an edge or along the segment.

    Args:
        start: (n, 2) one end of each segment.
        end: (n, 2) the other one; equal to it for points.
        polygon: (K, 2) convex, counter-clockwise.
    """
    n = len(start)
    out = Separation(np.empty(n), np.empty((n, 2)), np.empty(n))
    _separate(np.ascontiguousarray(start), np.ascontiguousarray(end), np.ascontiguousarray(polygon), out)
    return out


@kernel
def _separate(start: Floats, end: Floats, polygon: Floats, out: Separation) -> None:
    K = polygon.shape[0]
    for i in range(start.shape[0]):
        ax, ay, bx, by = start[i, 0], start[i, 1], end[i, 0], end[i, 1]
        best = -math.inf
        for c in range(K + 2):
            if c < K:
                d = (c + 1) % K
                nx, ny = polygon[d, 1] - polygon[c, 1], polygon[c, 0] - polygon[d, 0]
            elif c == K:
                nx, ny = by - ay, ax - bx
            else:
                nx, ny = ay - by, bx - ax
            length = math.hypot(nx, ny)
            if length == 0.0:
                continue
            nx, ny = nx / length, ny / length
            high = -math.inf
            for k in range(K):
                high = max(high, nx * polygon[k, 0] + ny * polygon[k, 1])
            gap = min(nx * ax + ny * ay, nx * bx + ny * by) - high
            if gap > best:
                best = gap
                out.gap[i], out.normal[i, 0], out.normal[i, 1], out.support[i] = gap, nx, ny, high


def route(corners: Floats, a: Floats, b: Floats, away: float, *, ccw: bool) -> Floats:
    """(m, 2) places that lead from near a around a polygon to near b, at a distance from it.

    Args:
        corners: (K, 2) simple polygon, counter-clockwise.
        a: (2,) outside it.
        b: (2,) outside it.
        away: distance that is kept, > 0 and small against its edges.
        ccw: around it counter-clockwise, else clockwise.
    """
    K = len(corners)
    (i, from_a), (j, to_b) = nearest_edge(corners, a, away), nearest_edge(corners, b, away)
    moved = offset(corners, away)
    if ccw:  # along edge i to corner i + 1, ..., to the start of edge j
        count = (j - i) % K
        if count == 0 and _along(corners, i, to_b) < _along(corners, i, from_a):
            count = K
        chain: Ints = (i + 1 + np.arange(count)) % K
    else:
        count = (i - j) % K
        if count == 0 and _along(corners, i, to_b) > _along(corners, i, from_a):
            count = K
        chain = (i - np.arange(count)) % K
    return np.vstack([from_a[None], moved[chain], to_b[None]])


def nearest_edge(corners: Floats, xy: Floats, away: float) -> tuple[int, Floats]:
    """The edge of a polygon nearest to a place, and the place beside it at a distance outside."""
    ends = np.roll(corners, -1, axis=0)
    edge = ends - corners
    share = np.clip(np.einsum("ki,ki->k", xy - corners, edge) / np.einsum("ki,ki->k", edge, edge), 0.0, 1.0)
    foot = corners + share[:, None] * edge
    k = int(np.argmin(np.hypot(*(xy - foot).T)))
    return k, beside(corners, k, foot[k], away)


def beside(corners: Floats, k: int, foot: Floats, away: float) -> Floats:
    """A place outside edge k, at a distance from a point on it."""
    edge = corners[(k + 1) % len(corners)] - corners[k]
    return np.asarray(foot + away * np.array([edge[1], -edge[0]]) / np.hypot(*edge))


def _along(corners: Floats, k: int, xy: Floats) -> float:
    edge = corners[(k + 1) % len(corners)] - corners[k]
    return float((xy - corners[k]) @ edge)


def offset(corners: Floats, away: float) -> Floats:
    """Corners moved outwards so that the edges move by a distance (very sharp corners by less than that takes)."""
    edge = np.roll(corners, -1, axis=0) - corners
    normal = np.column_stack([edge[:, 1], -edge[:, 0]]) / np.hypot(*edge.T)[:, None]
    before = np.roll(normal, 1, axis=0)
    both = normal + before
    return np.asarray(corners + 2.0 * away * both / np.maximum(np.sum(both**2, axis=1), 0.1)[:, None])


def spread_along(a: Floats, places: Floats, b: Floats, steps: int) -> Floats | None:
    """(steps - 1, 2) places on the way from a by all of `places` to b, so that each of them is one; None: too few.

    Args:
        a: (2,)
        places: (m, 2)
        b: (2,)
        steps: from a to b.
    """
    way = np.vstack([a[None], places, b[None]])
    leg = np.hypot(*np.diff(way, axis=0).T)
    if steps < len(leg):
        return None
    spare = steps - len(leg)
    total = float(leg.sum())
    wish = spare * (leg / total if total > 0.0 else np.full(len(leg), 1.0 / len(leg)))
    each = np.floor(wish).astype(np.int64)
    rest = np.argsort(each - wish, kind="stable")[: spare - int(each.sum())]
    each[rest] += 1
    each += 1
    share = np.concatenate([(np.arange(n) + 1) / n for n in each])
    first = np.repeat(np.arange(len(leg)), each)
    return np.asarray(way[first] + share[:, None] * (way[first + 1] - way[first]))[:-1]
