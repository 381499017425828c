"""Bearings of a target as lines of sight and half-planes of its trajectory ([Rahimi] Secs. 4 and 5)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.geometry.camera import wrap_angle
from occlog.core.plane import convex_pieces, counter_clockwise, pockets
from occlog.records.scene import Scene
from occlog.scans.grouping import Scan
from occlog.track.methods.apf.model import MIN_SIGMA
from occlog.track.methods.map.kernels.problem import NO_PLANES, BearingLinesByStep, HalfPlanes, join_planes, some_lines

from .config import MapConfig
from .record import TargetRecord

MAX_OFF_AXIS_RAD = math.radians(89.0)
"""A bearing farther off the optical axis cannot be read off a picture; it counts as a direction."""
BESIDE_WALL = 4.0
"""Standard deviations by which a line of sight must meet a wall to say that the target is before it."""


class SensorStations(NamedTuple):
    """All S sensors of a scene (cameras, then microphone arrays) as arrays, relative to the origin of the search.

    Columns (S,): position (S, 2), azimuth `yaw` of the optical axis, focal length [px] (0: not a camera), standard
    deviations of a reading [px], of position and of yaw [rad], range, field of view [rad] and detection probability
    (NaN: none). `blockers` are the polygons that hide things from each sensor, `hull` (K, 2) the room's convex hull
    (None: unbounded), `walls` the polygons in which the target cannot be.
    """

    position: Floats  # (S, 2)
    yaw: Floats  # (S,)
    focal_px: Floats  # (S,) 0: not a camera
    read_px: Floats  # (S,)
    sigma_position: Floats  # (S,)
    sigma_yaw: Floats  # (S,)
    range: Floats  # (S,)
    fov: Floats  # (S,) [rad]; NaN: not a camera
    detection: Floats  # (S,) a camera's own probability of detection; NaN: not known
    blockers: tuple[tuple[Floats, ...], ...]  # polygons that hide things from each sensor
    hull: Floats | None  # (K, 2) convex hull of the room, counter-clockwise; None: unbounded
    walls: tuple[Floats, ...]  # polygons in which the target cannot be: static occluders and pockets of the room


def stations(scene: Scene, origin: Floats, *, walls: bool) -> SensorStations:
    """Return the sensors of a scene in coordinates relative to an origin.

    Args:
        scene: cameras and arrays, room and static occluders.
        origin: (2,) in the scene's coordinates.
        walls: whether room and static occluders constrain the target; else there are no `blockers` and `walls`, and
            `hull` is None.
    """
    cameras, arrays = scene.cameras, scene.arrays
    none = [0.0] * len(arrays)
    columns = (
        [c.yaw for c in cameras] + [a.yaw for a in arrays],
        [float(c.focal_px[0]) for c in cameras] + none,
        [c.sigma_read_px for c in cameras] + none,
        [c.sigma_position for c in cameras] + none,
        [c.sigma_yaw for c in cameras] + none,
        [c.range for c in cameras] + [a.range for a in arrays],
        [c.fov for c in cameras] + [math.nan] * len(arrays),
        [math.nan if c.detection is None else c.detection for c in cameras] + [math.nan] * len(arrays),
    )
    positions = np.array([c.position[:2] for c in cameras] + [a.position[:2] for a in arrays], dtype=np.float64)
    positions = positions.reshape(-1, 2)
    blockers: list[tuple[Floats, ...]] = [()] * len(positions)
    if walls:
        blockers[: len(cameras)] = [tuple(b - origin for b in scene.blockers(c.ground)) for c in cameras]
    hull = convex_hull(scene.room) - origin if walls and scene.room is not None else None
    yaw, focal, read, position, turn, reach, fov, found = (np.array(c, dtype=np.float64) for c in columns)
    solid: tuple[Floats, ...] = ()
    if walls:
        solid = tuple(o.polygon - origin for o in scene.occluders)
        solid += () if scene.room is None else tuple(p - origin for p in pockets(scene.room))
    return SensorStations(
        position=positions - origin,
        yaw=yaw,
        focal_px=focal,
        read_px=read,
        sigma_position=position,
        sigma_yaw=turn,
        range=reach,
        fov=fov,
        detection=found,
        blockers=tuple(blockers),
        hull=hull,
        walls=solid,
    )


def convex_hull(polygon: Floats) -> Floats:
    """Return the (K, 2) counter-clockwise corners of a polygon's convex hull."""
    from scipy.spatial import ConvexHull

    return np.asarray(counter_clockwise(polygon[ConvexHull(polygon).vertices]))


def lines_of_sight(record: TargetRecord, at: SensorStations) -> BearingLinesByStep:
    """Return the bearings of the record's rows that saw the target as lines of sight, with their variances.

    A camera's pixel reading has the noise of [Ercan] Eq. 2 (reading, yaw and position of the camera); readings farther
    off-axis than `MAX_OFF_AXIS_RAD`, and bearings without a pixel, count as directions.
    """
    seen = record.rows.take(record.rows.seen)
    sensor, u = seen.sensor, seen.u_px
    off_axis = np.abs(wrap_angle(seen.bearing - at.yaw[sensor]))
    pixel = np.isfinite(u) & (off_axis < MAX_OFF_AXIS_RAD)
    f = np.where(pixel, at.focal_px[sensor], 1.0)
    z = np.where(pixel, -u, 0.0)
    angle = np.where(pixel, at.yaw[sensor], seen.bearing)
    sigma_px = np.where(np.isfinite(seen.sigma_px), seen.sigma_px, at.read_px[sensor])
    sigma = np.maximum(np.where(pixel, sigma_px, seen.sigma), MIN_SIGMA)
    # The poses' part of Eq. 2, at the reading itself; the distance stays.
    ratio2 = 1.0 + (z / f) ** 2
    yaw2 = np.where(pixel, f**2 * ratio2**2 * at.sigma_yaw[sensor] ** 2, 0.0)
    place2 = np.where(pixel, f**2 * ratio2 * at.sigma_position[sensor] ** 2, 0.0)
    return BearingLinesByStep(
        step=record.state[record.rows.seen],
        position=np.ascontiguousarray(at.position[sensor]),
        axis=np.column_stack([np.cos(angle), np.sin(angle)]),
        focal=f,
        reading=z,
        c0=sigma**2 + yaw2,
        c1=place2,
        direction=~pixel,
        volume=np.zeros(len(sensor)),
        lean=np.zeros(len(sensor)),
    )


def constraints(
    lines: BearingLinesByStep,
    record: TargetRecord,
    at: SensorStations,
    config: MapConfig,
    T: int,
    inlier: Bools | None = None,
) -> HalfPlanes:
    """Return the half-planes of a trajectory: in front of each camera that saw the target, in range, in the room.

    A target that is seen is on the camera's side of the first wall behind it on its line of sight.

    Args:
        lines: N lines of sight, of the rows of the record that saw the target.
        record: measurements of the target at T times.
        at: the sensors.
        config: settings, which state what constraints there are.
        T: number of states.
        inlier: (N,) which lines of sight constrain the trajectory; None: all.
    """
    seen = record.rows.take(record.rows.seen)
    if inlier is not None:
        lines, seen = some_lines(lines, inlier), seen.take(inlier)
    along = np.einsum("ni,ni->n", lines.axis, lines.position)
    # A direction determines the side of the target, whatever is known of cameras.
    ahead = lines.direction | config.in_front_constraint
    parts = [HalfPlanes(lines.step[ahead], lines.axis[ahead], along[ahead] + config.min_depth)]
    if config.in_front_constraint:
        reach = at.range[seen.sensor]
        far = np.isfinite(reach)
        parts += [
            HalfPlanes(lines.step[far], -lines.axis[far], -along[far] - reach[far]),
            _before_walls(lines, seen, at),
        ]
    if at.hull is not None:
        edges = np.roll(at.hull, -1, axis=0) - at.hull
        inward = np.column_stack([-edges[:, 1], edges[:, 0]]) / np.hypot(*edges.T)[:, None]
        bound = np.einsum("ki,ki->k", inward, at.hull) + config.wall_clearance
        K = len(bound)
        parts.append(HalfPlanes(np.repeat(np.arange(T), K), np.tile(inward, (T, 1)), np.tile(bound, T)))
    return join_planes(NO_PLANES, *parts)


def _before_walls(lines: BearingLinesByStep, seen: Scan, at: SensorStations) -> HalfPlanes:
    """Return half-planes that keep the target on the camera's side of the first wall on each line of sight.

    A line of sight that may pass next to that wall, by its standard deviation, gives none. `lines` are the lines of
    sight of the rows `seen`, in their order.
    """
    focal2 = lines.focal * (1.0 + (lines.reading / lines.focal) ** 2)
    away = BESIDE_WALL * np.maximum(np.sqrt(lines.c0) / focal2, seen.sigma)
    rows, normals, offsets = [np.empty(0, dtype=np.int64)], [np.empty((0, 2))], [np.empty(0)]
    for s in np.unique(seen.sensor).tolist():
        if at.blockers[s]:
            own = np.flatnonzero(seen.sensor == s)
            kept, normal, offset = _before(at.position[s], seen.bearing[own], away[own], at.blockers[s])
            rows.append(own[kept])
            normals.append(normal)
            offsets.append(offset)
    return HalfPlanes(lines.step[np.concatenate(rows)], np.vstack(normals), np.concatenate(offsets))


def _before(position: Floats, bearing: Floats, away: Floats, walls: tuple[Floats, ...]) -> tuple[Ints, Floats, Floats]:
    """Return indices (k,) of the lines of sight that surely meet a wall, and half-planes before these walls.

    Half-planes are normals (k, 2) and offsets (k,), with normal . xy >= offset. If all angles within the uncertainty
    meet one edge, it is that edge's line; around a corner of a convex wall it is the line across the line of sight at
    the farther of the two outermost hits.

    Args:
        position: (2,) of the sensor.
        bearing: (n,) directions of the lines of sight [rad].
        away: (n,) angles by which a line may be off [rad].
        walls: polygons (K, 2).
    """
    start = np.vstack(walls)
    edge = np.vstack([np.roll(w, -1, axis=0) for w in walls]) - start
    which = np.repeat(np.arange(len(walls)), [len(w) for w in walls])
    bulges = np.array([len(convex_pieces(w)) == 1 for w in walls], dtype=np.bool_)
    left, middle, right = (first_hit(position, bearing + k * away, start, edge) for k in (-1, 0, 1))
    one = (left == middle) & (right == middle)
    same = (which[left] == which[middle]) & (which[right] == which[middle]) & bulges[which[middle]]
    met = (np.minimum(np.minimum(left, middle), right) >= 0) & (away < 0.5 * math.pi)
    kept = np.flatnonzero(met & (one | same))
    left, middle, right, one = left[kept], middle[kept], right[kept], one[kept]
    outward = np.column_stack([edge[:, 1], -edge[:, 0]]) / np.hypot(*edge.T)[:, None]
    outward *= np.sign(np.einsum("ki,ki->k", outward, position - start))[:, None]
    support = np.einsum("ki,ki->k", outward, start)
    back = -np.column_stack([np.cos(bearing[kept]), np.sin(bearing[kept])])
    reach = np.zeros(len(kept))
    for k, hit in ((-1, left), (1, right)):
        angle = bearing[kept] + k * away[kept]
        ray = np.column_stack([np.cos(angle), np.sin(angle)])
        distance = (support[hit] - outward[hit] @ position) / np.einsum("ni,ni->n", outward[hit], ray)
        reach = np.maximum(reach, distance * np.cos(away[kept]))
    return kept, np.where(one[:, None], outward[middle], back), np.where(one, support[middle], back @ position - reach)


def first_hit(position: Floats, bearing: Floats, start: Floats, edge: Floats) -> Ints:
    """Return (n,) index of the edge that each line of sight from one position hits first; -1: none.

    Args:
        position: (2,) origin of the lines of sight.
        bearing: (n,) their directions [rad].
        start: (E, 2) one end of each edge.
        edge: (E, 2) vector from there to the other end.
    """
    ray = np.column_stack([np.cos(bearing), np.sin(bearing)])[:, None, :]
    to = (start - position)[None]
    cross = ray[..., 0] * edge[None, :, 1] - ray[..., 1] * edge[None, :, 0]
    safe = np.where(np.abs(cross) > 1e-12, cross, np.inf)
    distance = (to[..., 0] * edge[None, :, 1] - to[..., 1] * edge[None, :, 0]) / safe
    share = (to[..., 0] * ray[..., 1] - to[..., 1] * ray[..., 0]) / safe
    met = (np.abs(cross) > 1e-12) & (distance > 1e-9) & (share >= 0.0) & (share <= 1.0)
    return np.where(met.any(axis=1), np.argmin(np.where(met, distance, np.inf), axis=1), -1)
