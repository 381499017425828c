"""What a sensor can see, and where sight lines meet: plane geometry for drawing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.sight.camera import wrap_angle
from occlog.core.sight.triangulate import MET, sight_lines_meet
from occlog.records.scene import Scene
from occlog.records.tables import UNLABELLED, Bearings, Tracks

RAYS = 121


def visible_area(origin: Floats, yaw: float, fov: float, reach: float, walls: Floats) -> Floats:
    """Polygon that a sensor sees: a wedge cut off where a wall stands in the way.

    Args:
        origin: (2,) position of the sensor.
        yaw: azimuth of the optical axis [rad].
        fov: full opening angle [rad]; 2 pi or more is all around.
        reach: farthest distance, finite and > 0.
        walls: (S, 2, 2) line segments that hide what is behind them.

    Returns:
        (K, 2) corners, the sensor first (unless it sees all around).
    """
    half = min(fov / 2.0, np.pi)
    corners = walls.reshape(-1, 2) - origin
    toward = wrap_angle(np.arctan2(corners[:, 1], corners[:, 0]) - yaw)
    toward = np.concatenate([toward - 1e-6, toward + 1e-6])
    offsets = np.concatenate([np.linspace(-half, half, RAYS), toward[np.abs(toward) <= half]])
    azimuth = yaw + np.unique(offsets)
    direction = np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    edge = origin + np.minimum(_hits(origin, direction, walls), reach)[:, None] * direction
    return edge if half >= np.pi else np.vstack([origin, edge])


def _hits(origin: Floats, direction: Floats, walls: Floats) -> Floats:
    """(R,) distance along each ray to the nearest wall; inf where there is none."""
    if not len(walls):
        return np.full(len(direction), np.inf)
    start, along = walls[:, 0] - origin, walls[:, 1] - walls[:, 0]
    cross = direction[:, :1] * along[:, 1] - direction[:, 1:] * along[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0]) / cross
        place = (start[:, 0] * direction[:, 1:] - start[:, 1] * direction[:, :1]) / cross
    # A sensor may be mounted on the wall itself: such a wall does not hide anything from it.
    near = 1e-6 * (1.0 + np.abs(walls).max())
    hit = (distance > near) & (place >= -1e-9) & (place <= 1.0 + 1e-9)
    return np.asarray(np.where(hit, distance, np.inf).min(axis=1))


def edges_of(polygon: Floats) -> Floats:
    """(K, 2, 2) edges of a closed polygon."""
    return np.stack([polygon, np.roll(polygon, -1, axis=0)], axis=1)


def places(scene: Scene) -> dict[str, Floats]:
    """(2,) position on the ground of each sensor whose pose is known, by name."""
    cameras = {c.name: c.ground for c in scene.cameras if c.placed}
    return cameras | {a.name: a.position[:2] for a in scene.arrays}


def positions_at(tracks: Tracks, target: int, t_ns: Ints) -> Floats:
    """(N, 2) estimated positions of a target at given times, by linear interpolation; NaN outside the track."""
    rows = np.flatnonzero(tracks.target_id == target)
    if not len(rows):
        return np.full((len(t_ns), 2), np.nan)
    # Times relative to the track's start, so that a float carries nanoseconds.
    start = tracks.t_ns[rows[0]]
    known, wanted = (tracks.t_ns[rows] - start).astype(float), (t_ns - start).astype(float)
    return np.column_stack([np.interp(wanted, known, v[rows], left=np.nan, right=np.nan) for v in (tracks.x, tracks.y)])


@dataclass(frozen=True, eq=False)
class Residuals:
    """Measured minus expected direction of a target at each sighting, ordered by time."""

    t_ns: Ints
    sensor: Ints  # index into names
    names: tuple[str, ...]
    residual: Floats  # rad, in [-pi, pi)
    sigma: Floats  # rad


def residuals(tracks: Tracks, bearings: Bearings, scene: Scene, target: int) -> Residuals:
    """How far a track is from the sight lines of the sensors that saw its target.

    Sightings outside the track's time and those of sensors without a pose are left out.
    Where no bearing is labelled with the target, the candidate nearest to the track is
    taken from each frame that has any.
    """
    known = places(scene)
    names = tuple(known)
    index = _index(bearings.sensor, names)
    label = target if (bearings.target_id == target).any() else UNLABELLED
    rows = np.flatnonzero((bearings.target_id == label) & bearings.seen & (index >= 0))
    estimate = positions_at(tracks, target, bearings.t_ns[rows])
    origins = np.array([known[n] for n in names]).reshape(-1, 2)[index[rows]]
    delta = estimate - origins
    value = wrap_angle(bearings.bearing[rows] - np.arctan2(delta[:, 1], delta[:, 0]))
    keep = np.flatnonzero(np.isfinite(value))
    if label == UNLABELLED:
        keep = _nearest(bearings.t_ns[rows], index[rows], value, keep)
    rows = rows[keep]
    return Residuals(
        t_ns=bearings.t_ns[rows], sensor=index[rows], names=names, residual=value[keep], sigma=bearings.sigma[rows]
    )


def _nearest(t_ns: Ints, sensor: Ints, value: Floats, rows: Ints) -> Ints:
    """Of the given rows the one with the smallest value for each time and sensor, ascending."""
    order = rows[np.lexsort([np.abs(value[rows]), sensor[rows], t_ns[rows]])]
    first = np.ones(len(order), dtype=bool)
    first[1:] = (np.diff(t_ns[order]) != 0) | (np.diff(sensor[order]) != 0)
    return np.sort(order[first])


def _index(names: np.ndarray, known: tuple[str, ...]) -> Ints:
    """(N,) position of each name in `known`, -1 where it is not there."""
    unique, inverse = np.unique(names, return_inverse=True)
    numbers = np.array([known.index(n) if n in known else -1 for n in unique], dtype=np.int64)
    return numbers[inverse] if len(unique) else np.empty(0, np.int64)


def meeting_points(bearings: Bearings, scene: Scene, target: int) -> tuple[Ints, Floats]:
    """Times (N,) and most likely points (N, 2) where the sight lines of at least two sensors meet.

    Scans whose sight lines are all but parallel or do not meet are left out; a line that
    misses the others counts for less (Huber's loss).
    """
    known = places(scene)
    names = tuple(known)
    index = _index(bearings.sensor, names)
    rows = np.flatnonzero((bearings.target_id == target) & bearings.seen & (index >= 0))
    rows, scan = _scans(bearings.t_ns, index, rows)
    origins = np.array([known[n] for n in names]).reshape(-1, 2)[index[rows]]
    _, first = np.unique(scan, return_index=True)
    starts = np.append(first, len(rows))
    meeting = sight_lines_meet(origins, bearings.bearing[rows], bearings.sigma[rows], starts=starts, loss="huber")
    met = meeting.status == MET
    return bearings.t_ns[rows[first]][met], meeting.xy[met]


def _scans(t_ns: Ints, sensor: Ints, rows: Ints) -> tuple[Ints, Ints]:
    """Rows that form scans, and the scan of each, ascending; a scan has each sensor at most once.

    A scan is all rows of equal time; where sensors do not share their times, it is all
    rows within one period of a sensor.
    """
    if not len(rows):
        return rows, rows
    _, scan, count = np.unique(t_ns[rows], return_inverse=True, return_counts=True)
    if np.mean(count[scan] > 1) < 0.5:
        steps = [
            np.median(np.diff(t_ns[own])) for s in np.unique(sensor[rows]) if len(own := rows[sensor[rows] == s]) > 1
        ]
        period = max(int(np.median(steps)) if steps else 1, 1)
        scan = (t_ns[rows] - t_ns[rows[0]]) // period
    _, first = np.unique(np.column_stack([scan, sensor[rows]]), axis=0, return_index=True)
    first = np.sort(first)
    return rows[first], scan[first]


def distances(tracks: Tracks, bearings: Bearings, scene: Scene, target: int) -> tuple[Ints, Floats]:
    """Times and distances between a track and the point where the sight lines of a scan meet."""
    t_ns, meeting = meeting_points(bearings, scene, target)
    distance = np.hypot(*(positions_at(tracks, target, t_ns) - meeting).T)
    ok = np.isfinite(distance)
    return t_ns[ok], distance[ok]
