"""Round obstacles and walls for robots: nearest points, and least distances during a step.

Moving people as obstacles.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Floats, Ints, Ints32
from occlog.core.numerics.interpolate import interpolate_positions

from .forces import direction, distance

MIN_SHARE = 1e-6
"""Relative offset towards the centre of the nearest point of a disc, for positions inside it."""


def nearest_on_discs(xy: Floats, centre: Floats, radius: Floats) -> Floats:
    """Return the (N, K, 2) points on the borders of K discs nearest to N positions (centres for a radius of 0).

    For a position inside a disc it is a point just behind the position, as seen from outside, so that the direction
    from the point to the position leads out.

    Args:
        xy: (N, 2) positions.
        centre: (K, 2) centres, or (N, K, 2) if each position has its own discs.
        radius: (K,) radii.
    """
    at = np.broadcast_to(centre, (len(xy), *centre.shape[-2:]))
    border = np.minimum(radius, distance(xy[:, None], at) * (1.0 - MIN_SHARE))
    return at + border[..., None] * direction(xy[:, None], at)


def nearest_on_segments(xy: Floats, segments: Floats) -> Floats:
    """Return the (N, E, 2) points of segments (E, 2, 2), given by their ends, nearest to positions (N, 2)."""
    along = segments[:, 1] - segments[:, 0]
    length2 = np.sum(along**2, axis=1)
    share = np.sum((xy[:, None] - segments[:, 0]) * along, axis=2) / np.where(length2 > 0.0, length2, 1.0)
    return np.asarray(segments[:, 0] + np.clip(share, 0.0, 1.0)[..., None] * along)


def nearest_on_polygons(xy: Floats, corners: Floats, starts: np.ndarray[tuple[int], np.dtype[np.int64]]) -> Floats:
    """Return the (N, P, 2) border points of P polygons that are nearest to N positions.

    Args:
        xy: (N, 2) positions.
        corners: (V, 2) of all polygons, packed by `pack_polygons`.
        starts: (P + 1,) first corner of each polygon.
    """
    out = np.empty((len(xy), len(starts) - 1, 2))
    for p in range(len(starts) - 1):
        points = nearest_on_segments(xy, edges(corners[starts[p] : starts[p + 1]]))
        best = np.argmin(distance(xy[:, None], points), axis=1)
        out[:, p] = points[np.arange(len(xy)), best]
    return out


def edges(polygon: Floats) -> Floats:
    """Return the edges (K, 2, 2) of a polygon (K, 2), by their ends; the last one leads back to the first corner."""
    return np.stack([polygon, np.roll(polygon, -1, axis=0)], axis=1)


def least_to_points(start: Floats, end: Floats, first: Floats, last: Floats) -> Floats:
    """Return the (N, K) least distances between N robots and K points that move uniformly during a step.

    Args:
        start: (N, 2) positions of the robots before the step.
        end: (N, 2) positions after it.
        first: (K, 2) positions of the points before the step.
        last: (K, 2) positions after it.
    """
    before, after = start[:, None] - first, end[:, None] - last
    change = after - before
    length2 = np.sum(change**2, axis=2)
    share = np.clip(-np.sum(before * change, axis=2) / np.where(length2 > 0.0, length2, 1.0), 0.0, 1.0)
    least = before + share[..., None] * change
    return np.asarray(np.hypot(least[..., 0], least[..., 1]))


def least_to_segments(start: Floats, end: Floats, segments: Floats) -> Floats:
    """Return the (N, E) least distances between the robots' straight steps and E segments; 0 if they cross.

    Args:
        start: (N, 2) positions before the step.
        end: (N, 2) positions after it.
        segments: (E, 2, 2) both ends of each segment.
    """
    ends = [distance(p[:, None], nearest_on_segments(p, segments)) for p in (start, end)]
    steps = np.stack([start, end], axis=1)
    for corner in (segments[:, 0], segments[:, 1]):
        ends.append(distance(corner[:, None], nearest_on_segments(corner, steps)).T)
    p, q = segments[:, 0], segments[:, 1]
    one = _side(start[:, None], end[:, None], p) * _side(start[:, None], end[:, None], q)
    other = _side(p, q, start[:, None]) * _side(p, q, end[:, None])
    return np.where((one < 0.0) & (other < 0.0), 0.0, np.minimum.reduce(ends))


def _side(a: Floats, b: Floats, c: Floats) -> Floats:
    """Return twice the signed area (...) of triangles a, b, c, each (..., 2): > 0 if c is left of the line a-b."""
    ab, ac = b - a, c - a
    return np.asarray(ab[..., 0] * ac[..., 1] - ab[..., 1] * ac[..., 0])


BLOCK = 256
"""Steps for which positions are interpolated at a time."""


class StepClock(NamedTuple):
    """Step times of robots: step k is at `start_ns` + k `step_s`."""

    start_ns: int  # time of step 0
    step_s: float


class MovingObstacles(NamedTuple):
    """M moving obstacles with centre and radius at the start and the end of a step; NaN if absent.

    Also their displacement in the step before.
    """

    xy: Floats  # (M, 2)
    radius: Floats  # (M,)
    after: Floats  # (M, 2) a step later
    radius_after: Floats  # (M,)
    move: Floats  # (M, 2) how each moved in the step before; 0 where that is not known

    def expected(self) -> MovingObstacles:
        """Return the step as predicted at its start: obstacles move as in the step before, with constant radius."""
        return self._replace(after=self.xy + self.move, radius_after=self.radius)


class MovingObstacleTracks:
    """Moving obstacles with positions at their own times, interpolated linearly at the times of robots' steps."""

    def __init__(self, t_ns: Ints, ids: Ints32, positions: Floats, clock: StepClock, limit_ns: int) -> None:
        """Group the rows by obstacle.

        Args:
            t_ns: (R,) times [ns], not decreasing.
            ids: (R,) numbers of the obstacles.
            positions: (R, 3) x, y and radius.
            clock: times of the steps.
            limit_ns: longest gap between two rows of an obstacle that is bridged [ns].
        """
        self.clock, self._limit_ns, self._first = clock, limit_ns, -BLOCK
        self.ids = np.unique(ids)
        own = [ids == name for name in self.ids.tolist()]
        self._known = [(t_ns[rows], positions[rows]) for rows in own]
        self._block = np.empty((0, len(own), 3))

    def at(self, step: int) -> MovingObstacles:
        """Return the obstacles at the start and the end of a step, in the order of `ids`.

        It is fastest for increasing steps: positions are interpolated for `BLOCK` steps at a time.
        """
        if not self._first <= step < self._first + BLOCK:
            self._first = step
            self._block = self._positions_at(np.arange(step - 1, step + BLOCK + 1))
        before, now, after = self._block[step - self._first : step - self._first + 3]
        return MovingObstacles(
            xy=now[:, :2],
            radius=now[:, 2],
            after=after[:, :2],
            radius_after=after[:, 2],
            move=np.nan_to_num(now[:, :2] - before[:, :2]),
        )

    def _positions_at(self, steps: Ints) -> Floats:
        """Return (T, M, 3) x, y and radius of all obstacles at the step numbers `steps` (T,); NaN where absent."""
        t_ns = self.clock.start_ns + np.rint(steps * (self.clock.step_s * NS)).astype(np.int64)
        positions = [interpolate_positions(t_ns, known, columns, self._limit_ns)[0] for known, columns in self._known]
        return np.stack(positions, axis=1) if positions else np.empty((len(steps), 0, 3))
