"""True paths to the bearings that cameras report: [Ercan] Eqs. 1-4 with everything that hides a target.

A camera sees a target that is in front of it, in its field of view and range, not
behind a static occluder or a wall, and not behind the disc of another object.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.geometry.camera import noise_variance, planar_offsets, u_to_azimuth
from occlog.core.geometry.visibility import behind_objects, behind_walls, in_view
from occlog.core.numerics.interpolate import SensorFrames, TimeGrid, frames_at
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.records.scene import Camera, Scene
from occlog.records.tables import Bearings, Truth
from occlog.simulate.config import ObserveConfig
from occlog.simulate.world.scripted_paths import truth_grid


class SimulatedCamera(NamedTuple):
    """A camera with its walls, true pose and random generators, constant over all its frames.

    Attributes:
        camera: camera as stated in the scene.
        walls: polygons (K, 2) that no line of sight crosses.
        true_ground, true_yaw: true ground position (2,) and yaw [rad]; they differ from the stated ones if calibration
            errors are simulated.
        noise: random numbers of the readings.
        chance: random numbers of misses and false alarms.
    """

    camera: Camera
    walls: tuple[Floats, ...]
    true_ground: Floats
    true_yaw: float
    noise: np.random.Generator
    chance: np.random.Generator


def observe(
    scene: Scene, truth_chunks: Iterable[Truth | TimeGrid], config: ObserveConfig, seed: int
) -> Iterator[Bearings]:
    """Simulate the bearings of all targets by every camera with a pose ([Ercan] Sec. 3, Eqs. 1-2).

    Each camera delivers frames at its own rate from the first time of the truth on, or at
    every time of the truth if it has none.  Times are world times (a camera's clock is
    taken to be corrected).  `sigma_px` is the camera's read noise; `sigma` is the angle
    that belongs to [Ercan] Eq. 2 with all its parts at the target's true position, which a real
    camera could not know exactly.

    Args:
        scene: cameras, static occluders, room.
        truth_chunks: true paths of targets and occluders, in the order of time, as tables or grids.
        config: noise, misses and false alarms.
        seed: seed of all random numbers; each camera has its own.

    Returns:
        Generator of one table per chunk, with a row for each frame and target, detected (`seen`) or not.
    """
    sensors = [_simulated_camera(scene, c, i, config, seed) for i, c in enumerate(scene.cameras) if c.placed]
    rates = [s.camera.rate_hz for s in sensors]
    for grid, found in frames_at(map(truth_grid, truth_chunks), rates):
        parts = [_report(s, frames, grid, config) for s, frames in zip(sensors, found, strict=True)]
        yield Bearings.merge(parts)


def _simulated_camera(scene: Scene, camera: Camera, number: int, config: ObserveConfig, seed: int) -> SimulatedCamera:
    """Create a camera with its own random generators, at its true pose if calibration errors are simulated.

    Args:
        scene: scene with the walls.
        camera: camera as in the scene, with the standard deviations of its pose.
        number: its index in the scene.
        config: states whether calibration errors are simulated.
        seed: seed of the random numbers.
    """
    ground, yaw = camera.ground, camera.yaw
    if config.pose_noise == "calibration":
        error = generator(seed, RandomStream.CAMERA_CALIBRATION, number).standard_normal(3)
        ground = ground + camera.sigma_position * error[:2]
        yaw += camera.sigma_yaw * float(error[2])
    return SimulatedCamera(
        camera=camera,
        walls=scene.blockers(camera.ground),
        true_ground=ground,
        true_yaw=yaw,
        noise=generator(seed, RandomStream.CAMERA_NOISE, number),
        chance=generator(seed, RandomStream.CAMERA_CHANCE, number),
    )


def visible(camera: Camera, walls: tuple[Floats, ...], xyz: Floats, k: int, diameter: float) -> Bools:
    """(T,) mask of times at which the camera sees object k; False where the object is absent.

    Args:
        camera: camera at its stated pose.
        walls: polygons (K, 2) that occlude.
        xyz: (T, n, 3) positions of all objects, NaN if absent.
        k: index of the object.
        diameter: diameter of other objects, which occlude; 0: they do not.
    """
    xy = xyz[:, k, :2]
    # In front of the camera, in its field of view and range
    seen: Bools = in_view(*planar_offsets(xy, camera.ground, camera.yaw), camera.fov, camera.range)
    # Not behind a static occluder or a wall
    seen[seen] = ~behind_walls(camera.ground, xy[seen], walls)
    # Not behind the disc of another object
    if diameter > 0:
        others = np.delete(xyz[seen][:, :, :2], k, axis=1)
        seen[seen] = ~behind_objects(camera.ground, xy[seen], others, diameter)
    return seen


def _report(sensor: SimulatedCamera, sensor_frames: SensorFrames, grid: TimeGrid, config: ObserveConfig) -> Bearings:
    """Simulate one camera's rows for all targets; random numbers are drawn for every frame and target, used or not.

    Args:
        sensor: camera with its random generators.
        sensor_frames: its frames, with positions of all objects.
        grid: states which objects are targets, and their numbers.
        config: settings of the measurements.
    """
    frames, targets = len(sensor_frames.t_ns), np.flatnonzero(grid.target)
    noise = sensor.noise.standard_normal((frames, len(targets)))
    chance = sensor.chance.random((frames, len(targets), 3))
    parts = [
        _report_target(
            sensor, sensor_frames, k, target=int(grid.ids[k]), noise=noise[:, j], chance=chance[:, j], config=config
        )
        for j, k in enumerate(targets.tolist())
    ]
    return Bearings.merge(parts)


def _report_target(
    sensor: SimulatedCamera,
    frames: SensorFrames,
    k: int,
    target: int,
    noise: Floats,
    chance: Floats,
    config: ObserveConfig,
) -> Bearings:
    """Simulate one camera's rows for object k, which is target number `target`.

    Args:
        sensor: camera with its true pose.
        frames: T times with the positions of all objects.
        k: index of the object among those positions.
        target: number of the target.
        noise: (T,) standard normal numbers.
        chance: (T, 3) uniform numbers in [0, 1): of a miss, of a false alarm, and its position in the image.
        config: noise, misses and false alarms.
    """
    camera = sensor.camera
    xy, f = frames.xyz[:, k, :2], float(camera.focal_px[0])
    h, d = planar_offsets(xy, camera.ground, camera.yaw)
    true_h, true_d = planar_offsets(xy, sensor.true_ground, sensor.true_yaw)
    seen = visible(camera, sensor.walls, frames.xyz, k, diameter=config.diameter) & (true_d > 0)
    # Miss
    miss = config.miss_probability if camera.detection is None else 1.0 - camera.detection
    seen &= chance[:, 0] >= miss
    # Measure: z = f h / d + v ([Ercan] Eq. 1), v with the variance of Eq. 2
    z = np.full(len(h), np.nan)
    if config.pose_noise == "white":
        spread = np.sqrt(_variance(camera, h[seen], d[seen]))
        z[seen] = f * h[seen] / d[seen] + spread * noise[seen]
    else:
        z[seen] = f * true_h[seen] / true_d[seen] + camera.sigma_read_px * noise[seen]
    # False alarm: uniform over the image, of a field of view below 170 degrees
    false_alarm = config.false_alarm_probability if camera.false_alarm is None else camera.false_alarm
    false = ~seen & (chance[:, 1] < false_alarm) & np.isfinite(h)
    half = f * math.tan(0.5 * min(camera.fov, math.radians(170.0)))
    z[false] = half * (2.0 * chance[false, 2] - 1.0)
    return _rows(camera, frames.t_ns, target, seen=seen | false, z=z, distance=np.hypot(h, d))


def _variance(camera: Camera, h: Floats, d: Floats) -> Floats:
    """(n,) variances [px^2] of readings of targets at lateral offsets h and depths d, each (n,) ([Ercan] Eq. 2)."""
    f = float(camera.focal_px[0])
    return noise_variance(
        h, d, f, sigma_position=camera.sigma_position, sigma_yaw=camera.sigma_yaw, sigma_read_px=camera.sigma_read_px
    )


def _rows(camera: Camera, t_ns: Ints, target: int, seen: Bools, z: Floats, distance: Floats) -> Bearings:
    """Rows of bearings of one target from readings in the image.

    In angles [Ercan] Eq. 2 is sigma_yaw^2 + sigma_position^2 / distance^2
    + sigma_read^2 / (f (1 + z^2 / f^2))^2, by d(bearing) = dz / (f (1 + z^2 / f^2)).

    Args:
        camera: camera that measures.
        t_ns: (T,) times [ns].
        target: number of the target.
        seen: (T,) mask of detections; other rows are without a measurement.
        z: (T,) readings: horizontal offset from the image centre [px], positive to the left.
        distance: (T,) true distances from the camera.
    """
    f = float(camera.focal_px[0])
    z, distance = np.where(seen, z, np.nan), np.where(seen, distance, np.nan)
    read = camera.sigma_read_px / (f * (1.0 + (z / f) ** 2))
    sigma = np.sqrt(camera.sigma_yaw**2 + (camera.sigma_position / distance) ** 2 + read**2)
    n = len(t_ns)
    return Bearings.of(
        t_ns=t_ns,
        sensor=np.full(n, camera.name),
        target_id=np.full(n, target, dtype=np.int32),
        seen=seen,
        bearing=u_to_azimuth(-z, camera.yaw, f),
        sigma=sigma,
        u_px=-z,
        sigma_px=np.where(seen, camera.sigma_read_px, np.nan),
        score=np.full(n, np.nan),
    )
