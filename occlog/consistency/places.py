"""Where bearings alone say that a target is, against what the scene says: walls in between, and the border of the room.

A filter that knows walls draws its estimate to where no wall contradicts what was seen, and one that knows the room
keeps it inside.  Wrong walls thus leave residuals that are small, and errors that are not.  The place at which the
believed bearings of a moment meet, without motion, walls and room, does not hide them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.plane.polygons import inside_polygon
from occlog.core.sight.camera import wrap_angle
from occlog.core.sight.visibility import behind_walls
from occlog.records.scene import Scene
from occlog.records.tables import Residuals, Tracks

from .doubts import covariances

CLEAR = 2.0
"""A meeting place is clearly somewhere if all of the ellipse of so many standard deviations is there."""
AROUND = 12
"""Points of that ellipse that are tested."""
STEPS = 3
"""Gauss-Newton steps from the estimate to the meeting place."""
FLAT = 1e-3
"""Sight lines do not meet if their information has axes with a ratio below this, squared."""
BLUNT = 0.2
"""Bearings with a larger standard deviation [rad] do not count: sight lines of such errors are no straight lines."""
NEARER = 0.5
"""A meeting place counts if its ellipse is smaller than this share of the distance of each of its sensors."""
SETTLED = 0.1
"""A search has found the meeting place if its last step is below so many standard deviations."""
LEAST_SHARE = 1e-9
"""A residual whose variance is all the bearing's does not say what that is; see `_bearings`."""


class Meeting(NamedTuple):
    """Where the believed bearings of M rows meet."""

    row: Ints  # (M,) rows of the tracks
    xy: Floats  # (M, 2)
    border: Floats  # (M, AROUND, 2) the ellipse of `CLEAR` standard deviations


@dataclass
class Places:
    """Counts rows whose bearings meet where the scene says that the target cannot be.

    Attributes:
        rows: rows with bearings of two sensors or more that meet.
        outside: rows that meet clearly outside the room.
        hidden: by camera, rows in which it saw the target, and how many of them meet clearly behind a wall for it;
            microphone arrays hear past walls.
    """

    rows: int = 0
    outside: int = 0
    hidden: dict[str, tuple[int, int]] = field(default_factory=dict)

    def add(self, tracks: Tracks, residuals: Residuals, scene: Scene) -> None:
        """Count some more rows; scenes without a room and without walls say nothing."""
        sensors: dict[str, Floats] = {c.name: c.position[:2] for c in scene.cameras}
        sensors |= {a.name: a.position[:2] for a in scene.arrays}
        walls = {c.name: scene.blockers(c.ground) for c in scene.cameras}
        if not len(residuals) or (scene.room is None and not any(walls.values())):
            return
        used = residuals.take(residuals.believed >= 0.5)
        row = _rows(tracks, used)
        met = meetings(tracks, used, row, np.array([sensors[name] for name in used.sensor.tolist()]).reshape(-1, 2))
        self.rows += len(met.row)
        if (room := scene.room) is not None:
            self.outside += int(np.count_nonzero(~_anywhere(met, partial(inside_polygon, polygon=room))))
        for name, polygons in walls.items():
            if polygons:
                saw = np.isin(met.row, row[used.sensor == name])
                own = Meeting(met.row[saw], met.xy[saw], met.border[saw])
                behind = int(np.count_nonzero(~_anywhere(own, partial(_in_sight, sensors[name], polygons))))
                before = self.hidden.get(name, (0, 0))
                self.hidden[name] = before[0] + len(own.row), before[1] + behind


def meetings(tracks: Tracks, used: Residuals, row: Ints, origin: Floats) -> Meeting:
    """Least squares of the bearings of each row of tracks that two sight lines or more determine.

    Args:
        tracks: estimates, from which the search begins.
        used: N residuals at them.
        row: (N,) their rows.
        origin: (N, 2) places of their sensors.
    """
    start = np.column_stack([tracks.x, tracks.y])
    bearing, sigma = _bearings(start[row], covariances(tracks)[row], origin, used)
    count, xy = len(tracks), start.copy()
    information = np.zeros((count, 2, 2))
    told = sigma <= BLUNT
    row, origin, bearing, sigma = row[told], origin[told], bearing[told], sigma[told]
    good = np.zeros(count, dtype=np.bool_)
    step = np.zeros((count, 2))
    for _ in range(STEPS):
        away = xy[row] - origin
        r2 = np.maximum(np.sum(away**2, axis=1), 1e-24)
        g = np.column_stack([-away[:, 1], away[:, 0]]) / r2[:, None] / sigma[:, None]
        off = wrap_angle(bearing - np.arctan2(away[:, 1], away[:, 0])) / sigma
        information, pull = np.zeros((count, 2, 2)), np.zeros((count, 2))
        np.add.at(information, row, g[:, :, None] * g[:, None, :])
        np.add.at(pull, row, g * off[:, None])
        trace = information[:, 0, 0] + information[:, 1, 1]
        good = np.linalg.det(information) > FLAT * np.maximum(trace, 1e-300) ** 2
        step[good] = np.linalg.solve(information[good], pull[good][:, :, None])[:, :, 0]
        xy[good] += step[good]
    # Where sight lines are nearly parallel, or the sensors near, the place is no linear function of the bearings
    good &= np.einsum("ni,nij,nj->n", step, information, step) < SETTLED**2
    nearest = np.full(count, np.inf)
    np.minimum.at(nearest, row, np.hypot(*(xy[row] - origin).T))
    least = np.linalg.eigvalsh(np.where(good[:, None, None], information, np.eye(2)))[:, 0]
    good &= NEARER * nearest * np.sqrt(np.maximum(least, 0.0)) > CLEAR
    found = np.flatnonzero(good)
    root = np.linalg.cholesky(np.linalg.inv(information[found]))
    angle = 2.0 * np.pi * np.arange(AROUND) / AROUND
    circle = CLEAR * np.column_stack([np.cos(angle), np.sin(angle)])
    return Meeting(found, xy[found], xy[found][:, None] + np.einsum("mij,aj->mai", root, circle))


def _bearings(xy: Floats, covariance: Floats, origin: Floats, used: Residuals) -> tuple[Floats, Floats]:
    """Bearings (N,) and their standard deviations (N,) from what residuals are in units of these.

    The variance that is expected of a residual is 1 - g'Pg / sigma^2; where it says nothing of sigma (no uncertainty
    of the estimate, or more than the bearing's), the standard deviation is NaN.
    """
    away = xy - origin
    r2 = np.maximum(np.sum(away**2, axis=1), 1e-24)
    g = np.column_stack([-away[:, 1], away[:, 0]]) / r2[:, None]
    share = 1.0 - used.expected
    told = (share > LEAST_SHARE) & (used.expected > 0.0)
    square = np.einsum("ni,nij,nj->n", g, covariance, g)
    sigma = np.sqrt(np.divide(square, share, out=np.full(len(used), np.nan), where=told))
    return np.arctan2(away[:, 1], away[:, 0]) + used.residual * sigma, sigma


def _rows(tracks: Tracks, used: Residuals) -> Ints:
    """(N,) the row of the tracks of each residual."""
    order = np.lexsort((tracks.t_ns, tracks.target_id))
    row = np.empty(len(used), dtype=np.int64)
    for target in np.unique(used.target_id).tolist():
        of = order[tracks.target_id[order] == target]
        own = used.target_id == target
        row[own] = of[np.searchsorted(tracks.t_ns[of], used.t_ns[own])]
    return row


def _in_sight(origin: Floats, walls: Sequence[Floats], xy: Floats) -> Bools:
    """(N,) which of the (N, 2) places no wall hides from the (2,) origin."""
    return np.asarray(~behind_walls(origin, xy, walls))


def _anywhere(met: Meeting, test: Callable[[Floats], Bools]) -> Bools:
    """(M,) whether a test of (N, 2) places holds for the meeting place or for any point of its ellipse."""
    points = np.concatenate([met.xy[:, None], met.border], axis=1)
    return np.asarray(test(np.ascontiguousarray(points.reshape(-1, 2))).reshape(points.shape[:2]).any(axis=1))
