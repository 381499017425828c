"""A scene and a scan as the arrays that the filters in space want.

Priors of a target in space: around a given start, or along the lines of sight of a first scan; and the likelihood.
"""

from __future__ import annotations

import math
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.random import Generator

from occlog.array_types import Bools, Floats, Ints
from occlog.core.geometry.projected_planes import AXES, direction, direction_angles, polar_from_elevation
from occlog.core.geometry.visibility import MIN_RELATIVE_DISTANCE
from occlog.core.plane import Floor, make_floor, on_floor
from occlog.filtering.motion.white_acceleration import AccelerationModel
from occlog.records.scene import Scene
from occlog.scans.grouping import Scan

from .config import PLANES, SpaceConfig
from .kernels.likelihood import (
    UNIFORM,
    UNIFORM_AZIMUTH,
    ReportProbabilities,
    ScanDirectionSet,
    log_cone,
    log_product,
    scan_log_likelihood,
)

MIN_SIGMA_RAD = 1e-9
"""Angles without any noise get this much [rad], so that densities stay finite."""


class ArrayGeometry(NamedTuple):
    """Positions, rotations, ranges and pose errors of S sensors, cameras first, then microphone arrays.

    The rotation of a camera is the identity, since its directions are azimuths in the world.
    """

    position: Floats  # (S, 3)
    rotation: Floats  # (S, 3, 3) world-from-sensor; a camera's is that of the world, since it tells azimuths
    reach: Floats  # (S,)
    sigma_yaw: Floats  # (S,) of the pose [rad]
    sigma_position: Floats  # (S,)


class ScanDirections(NamedTuple):
    """R directions of a scan of N sensors: in the world (`sights`), and as angles in sensor axes."""

    sights: ScanDirectionSet
    theta: Floats  # (R,) measured azimuths in the sensor's frame [rad]
    rotation: Floats  # (R, 3, 3) world-from-sensor
    uniform: Floats  # (R,) density of clutter
    sensor: Ints  # (N,) index in `sensor_names` of each sensor that had a frame
    flat: Bools  # (R,) azimuth only


def pack_ears(scene: Scene) -> ArrayGeometry:
    """Return positions, rotations (identity for cameras), ranges and pose errors of all sensors, cameras first."""
    cameras, arrays = scene.cameras, scene.arrays
    eye = np.eye(3)
    return ArrayGeometry(
        np.array([c.position for c in cameras] + [a.position for a in arrays], dtype=np.float64).reshape(-1, 3),
        np.array([eye] * len(cameras) + [a.rotation for a in arrays]).reshape(-1, 3, 3),
        np.array([c.range for c in cameras] + [a.range for a in arrays], dtype=np.float64),
        np.array([c.sigma_yaw for c in cameras] + [0.0] * len(arrays)),
        np.array([c.sigma_position for c in cameras] + [0.0] * len(arrays)),
    )


def pack_directions(scan: Scan, ears: ArrayGeometry, near: Floats, *, use_score: bool) -> ScanDirections:
    """Return the directions of a scan in world and sensor axes; rows without a detection are omitted.

    Args:
        scan: rows by sensor.
        ears: all sensors of the scene.
        near: (2,) rough position of the target, for the angle that an error of a camera's position makes.
        use_score: weigh candidates by their score, where they have one.
    """
    start = np.flatnonzero(np.diff(scan.sensor, prepend=-1))
    before = np.concatenate([[0], np.cumsum(scan.seen)])
    first = np.concatenate([before[start], before[-1:]])
    keep = np.asarray(scan.seen)
    sensor, bearing = scan.sensor[keep], scan.bearing[keep]
    up, sigma_up = scan.elevation[keep], scan.sigma_elevation[keep]
    flat = np.isnan(up) | np.isnan(sigma_up)
    rotation = np.where(flat[:, None, None], np.eye(3), ears.rotation[sensor])
    world = direction(bearing, polar_from_elevation(np.where(flat, 0.0, up)))
    theta, phi = direction_angles((world[:, None, :] @ rotation)[:, 0])
    weigh = np.isfinite(scan.score[keep]) & ~scan.labelled[keep] & use_score
    sights = ScanDirectionSet(
        first=first,
        labelled=scan.labelled[start],
        position=ears.position[sensor],
        frame=_frames(theta, rotation),
        phi=np.where(flat, np.nan, phi),
        sigma_theta=_with_pose(scan.sigma[keep], sensor, ears, near),
        sigma_phi=np.maximum(np.where(flat, 1.0, sigma_up), MIN_SIGMA_RAD),
        reach=ears.reach[sensor],
        share=np.where(weigh, scan.score[keep], 1.0),
    )
    uniform = np.where(flat, UNIFORM_AZIMUTH, UNIFORM)
    return ScanDirections(
        sights=sights, theta=theta, rotation=rotation, uniform=uniform, sensor=scan.sensor[start], flat=flat
    )


def _frames(theta: Floats, rotation: Floats) -> Floats:
    """Return (R, 3, 3) frames of directions in world axes: rows along the azimuth, to its left, and up.

    `theta` (R,) are azimuths in sensor axes [rad], `rotation` (R, 3, 3) world-from-sensor.
    """
    c, s = np.cos(theta)[:, None], np.sin(theta)[:, None]
    x, y = rotation[:, :, 0], rotation[:, :, 1]
    frame = np.empty((len(theta), 3, 3))
    frame[:, 0], frame[:, 1], frame[:, 2] = c * x + s * y, c * y - s * x, rotation[:, :, 2]
    return frame


def _with_pose(sigma: Floats, sensor: Ints, ears: ArrayGeometry, near: Floats) -> Floats:
    """Return (R,) standard deviations [rad] of azimuths, including the sensors' pose errors.

    Args:
        sigma: (R,) standard deviations of the readings [rad].
        sensor: (R,) indices of the sensors in `ears`.
        ears: all sensors of the scene.
        near: (2,) rough position of the target, at which position errors are converted to angles.
    """
    offset = near - ears.position[sensor, :2]
    distance = np.maximum(np.hypot(offset[:, 0], offset[:, 1]), 3.0 * ears.sigma_position[sensor])
    shift = ears.sigma_position[sensor] / np.where(distance > 0, distance, 1.0)
    return np.maximum(np.sqrt(sigma**2 + ears.sigma_yaw[sensor] ** 2 + shift**2), MIN_SIGMA_RAD)


def agrees(positions: Floats, heard: ScanDirections, gate: float) -> Bools:
    """Return (K, N) booleans: whether a sensor has a direction within `gate` standard deviations of a position.

    The limit holds for each angle; near the pole, where azimuths mean little, for the arc between the directions
    instead of the azimuth.

    Args:
        positions: (K, 3) positions.
        heard: directions of the scan by N sensors.
        gate: limit in standard deviations.
    """
    s = heard.sights
    counts = np.diff(s.first)
    if not len(s.phi):
        return np.zeros((len(positions), len(counts)), dtype=np.bool_)
    to = positions[:, None, :, None] - s.position[:, :, None]
    local = (s.frame @ to)[..., 0]
    ground = np.hypot(local[..., 0], local[..., 1])
    off = np.abs(np.arctan2(local[..., 1], local[..., 0]))
    phi = np.arctan2(ground, local[..., 2])
    spread = np.hypot(np.sin(s.phi), np.cos(s.phi) * s.sigma_phi)
    arc = np.abs(2.0 * np.sin(0.5 * off)) * np.sin(phi)
    good = (off <= gate * s.sigma_theta) | (arc <= gate * s.sigma_theta * spread)
    good &= heard.flat | (np.abs(phi - s.phi) <= gate * s.sigma_phi)
    out = np.zeros((len(positions), len(counts)), dtype=np.bool_)
    some = counts > 0
    out[:, some] = np.logical_or.reduceat(good, s.first[:-1][some], axis=1)
    return out


DEFENSIVE_FRACTION = 0.1
"""Share of the initial particles from the bootstrap proposal."""


C = TypeVar("C", bound=SpaceConfig)


class SpaceModel(NamedTuple, Generic[C]):
    """Scene and settings as constants of the filters in space.

    `cone`: whether likelihoods are those of the angle from the direction. `low` and `high` (3,) span the box of the
    room and all sensors; `far` (S,) is how far each sensor sees or hears in a scene without a room.
    """

    config: C
    ears: ArrayGeometry
    motion: AccelerationModel
    chances: ReportProbabilities
    cone: bool
    low: Floats  # (3,) of the box that holds the room and all sensors
    high: Floats  # (3,)
    floor: Floor | None  # None: no room is known
    ceiling: float
    far: Floats | None  # (S,) how far each sensor sees or hears, in a scene without a room; None: there is a room


def motion_of(config: SpaceConfig) -> AccelerationModel:
    """Return the motion model in space that the settings state."""
    up = config.process_noise_density if config.process_noise_density_z is None else config.process_noise_density_z
    axes = AXES[PLANES.index(config.turn_plane)]
    return AccelerationModel(
        np.array(config.acceleration),
        np.array([config.process_noise_density, config.process_noise_density, up]),
        config.turn_acceleration,
        axes,
    )


def chances_of(config: SpaceConfig) -> ReportProbabilities:
    """Return the probabilities of false alarms, candidates and clutter that the settings state."""
    return ReportProbabilities(
        config.false_alarm_probability,
        config.out_of_range_likelihood,
        config.candidate_detection_probability,
        config.clutter_rate,
    )


def make_space(scene: Scene, config: C, *, cone: bool = False) -> SpaceModel[C]:
    """Return the scene in the filters' form; `cone` selects likelihoods of the angle from the line of sight."""
    ears = pack_ears(scene)
    ground = np.concatenate([scene.region, ears.position[:, :2]])
    heights = np.append(ears.position[:, 2], [0.0, scene.room_height])
    low = np.append(ground.min(axis=0), heights.min())
    high = np.append(ground.max(axis=0), heights.max())
    floor = None if scene.room is None else make_floor(scene.room, [o.polygon for o in scene.occluders])
    return SpaceModel(
        config,
        ears,
        motion_of(config),
        chances_of(config),
        cone,
        low,
        high,
        floor,
        float(scene.room_height),
        None if scene.views is None else scene.views.far,
    )


def log_likelihood(xyz: Floats, heard: ScanDirections, space: SpaceModel[C]) -> Floats:
    """Return (L,) log likelihoods of a scan for positions `xyz` (3, L), up to a constant.

    Densities are those of the angle from the direction if `space.cone`, else products of azimuth and elevation.
    """
    s = heard.sights
    each = (log_cone if space.cone else log_product)(xyz, s, space.chances.soften)
    uniform = heard.uniform
    if space.cone:
        uniform = np.where(heard.flat, uniform, np.abs(np.sin(np.where(heard.flat, 0.0, s.phi))) / (4.0 * math.pi))
        uniform = np.maximum(uniform, 1e-6)
    return scan_log_likelihood(each, s.first, s.labelled, s.share, uniform, space.chances)


def log_room_factor(before: Floats | None, after: Floats, space: SpaceModel[C]) -> Floats:
    """Return (L,) log factors: log `out_of_room_likelihood` for particles that leave the room in a step, else 0.

    Args:
        before: (3, L) positions before a step; None: nothing was known, and the target was in the room.
        after: (3, L) positions after it.
        space: the room and `out_of_room_likelihood`.
    """
    stays = in_room(after, space)
    if before is not None:
        stays |= ~in_room(before, space)
    return np.where(stays, 0.0, math.log(space.config.out_of_room_likelihood))


def in_room(xyz: Floats, space: SpaceModel[C]) -> Bools:
    """Return (L,) booleans: positions `xyz` (3, L) are in the room, on its free floor; True if no room is known."""
    if space.floor is None:
        return np.ones(xyz.shape[1], dtype=np.bool_)
    inside = on_floor(np.ascontiguousarray(xyz[:2].T), *space.floor)
    return np.asarray(inside & (xyz[2] >= 0.0) & (xyz[2] <= space.ceiling))


def particles_around(space: SpaceModel[C], start: tuple[float, ...], n: int, rng: Generator) -> Floats:
    """Return (6, n) particles (x, y, z, vx, vy, vz), Gaussian around a start.

    Args:
        space: settings, and the height of the room.
        start: x, y, sigma; x, y, z, sigma; x, y, z, vx, vy, vz, sigma of positions, sigma of velocities; or these six
            with six sigmas. Without z heights are uniform over the room; velocities not given are drawn about 0.
        n: number of particles.
        rng: source of random numbers.
    """
    unit = rng.standard_normal((6, n))
    mean, sigma = np.zeros(6), np.append(np.zeros(3), _speeds(space))
    known = {3: 2, 4: 3}.get(len(start), 6)
    mean[:known] = start[:known]
    rest = start[known:]
    sigma[:known] = rest if len(rest) == 6 else np.repeat(rest, min(known, 3))
    cloud = mean[:, None] + sigma[:, None] * unit
    if known == 2:
        cloud[2] = space.ceiling * rng.random(n)
    return np.asarray(cloud)


def particles_from_scan(space: SpaceModel[C], heard: ScanDirections, n: int, rng: Generator) -> tuple[Floats, Floats]:
    """Draw `n` particles from a scan; return them (6, n) with their log weights (n,).

    Positions are drawn along the directions of all candidates to the border of the box of the room and all sensors, and
    some anywhere in it. The weights correspond to a uniform prior in the room (without a room, uniform in distance from
    a sensor up to its far limit) times the scan's likelihood.
    """
    s = heard.sights
    R = len(s.phi)
    each = math.floor(n * (1.0 - DEFENSIVE_FRACTION) / R) if R else 0
    parts = [_along(space, s, r, each, rng) for r in range(R)]
    parts.append(space.low[:, None] + (space.high - space.low)[:, None] * rng.random((3, n - R * each)))
    xyz = np.ascontiguousarray(np.concatenate(parts, axis=1))
    volume = float(np.prod(space.high - space.low))
    density = np.full(n, 1.0 - R * each / n)  # times the volume
    if R:
        density += volume * each / n * np.sum(np.exp(log_product(xyz, s, 1.0) - _log_volume(xyz, s, space)), axis=0)
    inside = np.all((xyz >= space.low[:, None]) & (xyz <= space.high[:, None]), axis=0)
    log_density = log_likelihood(xyz, heard, space) + log_room_factor(None, xyz, space)
    weights = np.where(inside, log_density - np.log(density), -math.inf)
    if space.far is not None:
        weights = weights + np.log(volume) + _log_prior(xyz, space.ears.position, space.far)
    speeds = _speeds(space)[:, None] * rng.standard_normal((3, n))
    return np.concatenate([xyz, speeds]), weights


def _log_prior(xyz: Floats, position: Floats, far: Floats) -> Floats:
    """Return (n,) log prior densities at positions `xyz` (3, n) in a scene without a room.

    The prior is a mixture over S sensors: uniform in direction and in distance up to `far` (S,) from `position` (S, 3).
    """
    r = np.sqrt(np.sum((xyz.T[:, None] - position) ** 2, axis=2))
    each = np.where(r <= far, 1.0 / (4.0 * math.pi * far * np.maximum(r, MIN_RELATIVE_DISTANCE * far) ** 2), 0.0)
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(each.mean(axis=1)))


def _speeds(space: SpaceModel[C]) -> Floats:
    """Return (3,) standard deviations of the initial velocity along x, y and z."""
    return np.array(
        [
            space.config.sigma_initial_velocity,
            space.config.sigma_initial_velocity,
            space.config.sigma_initial_velocity_z,
        ]
    )


def _along(space: SpaceModel[C], s: ScanDirectionSet, r: int, n: int, rng: Generator) -> Floats:
    """Draw (3, n) positions along direction `r` (row of `s`), uniform in distance up to the box's border or the range.

    Angles are drawn by their standard deviations. For an azimuth alone heights are uniform over the box.
    """
    flat = math.isnan(s.phi[r])
    theta = s.sigma_theta[r] * rng.standard_normal(n)
    phi = np.full(n, 0.5 * math.pi) if flat else s.phi[r] + s.sigma_phi[r] * rng.standard_normal(n)
    own = np.stack([np.cos(theta) * np.sin(phi), np.sin(theta) * np.sin(phi), np.cos(phi)])
    line = s.frame[r].T @ own
    far = np.minimum(_way_out(space, s.position[r], line, flat), s.reach[r])
    positions = s.position[r][:, None] + far * rng.random(n) * line
    if flat:
        positions[2] = space.low[2] + (space.high[2] - space.low[2]) * rng.random(n)
    return np.asarray(positions)


def _log_volume(xyz: Floats, s: ScanDirectionSet, space: SpaceModel[C]) -> Floats:
    """Return (R, n) logs of the volume elements of the sampling density of `_along`, for R directions at n positions.

    An element is the volume per unit of both angles (or of azimuth and share of height) and per share of the length;
    inf beyond a direction's far end, where no position is drawn. `xyz` (3, n) are the positions.
    """
    out = np.empty((len(s.phi), xyz.shape[1]))
    height = space.high[2] - space.low[2]
    for r, (position, frame) in enumerate(zip(s.position, s.frame, strict=True)):
        flat = math.isnan(s.phi[r])
        local = frame @ (xyz - position[:, None])
        ground = np.maximum(np.hypot(local[0], local[1]), 1e-9)
        distance = ground if flat else np.hypot(ground, local[2])
        far = np.minimum(_way_out(space, position, (xyz - position[:, None]) / distance, flat), s.reach[r])
        across = height if flat else distance
        beyond = np.where(distance > far * (1 + 1e-9), math.inf, 0.0)  # none of its positions are there
        out[r] = np.log(far * ground * across) + beyond
    return out


def _way_out(space: SpaceModel[C], position: Floats, line: Floats, flat: bool) -> Floats:
    """Return (n,) distances, > 0, from a sensor to the border of the box of the room and all sensors.

    Args:
        space: has the box.
        position: (3,) position of the sensor.
        line: (3, n) directions.
        flat: only the horizontal borders x and y count.
    """
    d = 2 if flat else 3
    p = position[:d]
    with np.errstate(divide="ignore", invalid="ignore"):
        edge = np.where(line[:d] > 0, (space.high[:d] - p)[:, None], (space.low[:d] - p)[:, None])
        out = np.min(np.where(line[:d] != 0, edge / line[:d], np.inf), axis=0)
    size = math.hypot(*(space.high - space.low))
    return np.asarray(np.clip(out, 1e-3 * size, size))
