"""Visibility of targets along their paths for each sensor, and Fisher information about their positions.

Moving people occlude by discs ([Ercan] Fig. 3), with their height if known.
"""

from __future__ import annotations

import math
import zlib
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.bounds.in_plane import bearing_information, camera_information
from occlog.core.bounds.in_space import direction_information, ground_information
from occlog.core.geometry.camera import planar_offsets
from occlog.core.geometry.visibility import behind_walls, in_view
from occlog.core.numerics.jit import kernel
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.records.scene import Camera, MicrophoneArray, Scene

from .config import PlanConfig
from .walks import Walked


@kernel
def hide_behind_crowd(
    seen: Bools,
    ways: Floats,
    origin: Floats,
    people: Floats,
    first: Ints,
    own: Ints,
    diameter: float,
    least_share: float,
) -> None:
    """Set `seen` to False, in place, where a person's disc occludes the target from the sensor.

    A disc occludes if its centre is in the rectangle from the sensor to the target, as wide as the disc ([Ercan] Fig.
    3).

    Args:
        seen: (N, T) mask of steps at which the sensor would see the target without a crowd.
        ways: (N, T, 2) positions of targets.
        origin: (2,) ground position of the sensor.
        people: (K, n, 2) positions of all people in K steps.
        first: (N,) step in `people` at which each target's path begins.
        own: (N,) index of the target among the people, who does not occlude itself; -1: none of them.
        diameter: diameter of a disc [length].
        least_share: share of the line of sight, from the sensor, beyond which it is below people's heads; 0: all of it.
    """
    half = 0.5 * diameter
    for i in range(ways.shape[0]):
        for t in range(ways.shape[1]):
            if not seen[i, t]:
                continue
            x, y = ways[i, t, 0], ways[i, t, 1]
            dx, dy = x - origin[0], y - origin[1]
            r = math.hypot(dx, dy)
            if r == 0.0:
                continue
            dx, dy = dx / r, dy / r
            k = first[i] + t
            for j in range(people.shape[1]):
                if j == own[i]:
                    continue
                px, py = people[k, j, 0] - origin[0], people[k, j, 1] - origin[1]
                if abs(dx * py - dy * px) >= half:
                    continue
                along = dx * px + dy * py
                if 0.0 < along < r and along >= least_share * r:
                    seen[i, t] = False
                    break


Sensor = Camera | MicrophoneArray


class ExpectedInformation(NamedTuple):
    """Simulated reports of one sensor, or several together, about N targets in T time steps.

    Mask (N, T) of reports, and xx, xy, yy of the Fisher information about the position (3, N, T) [length^-2], 0 without
    a report.
    """

    seen: Bools  # (N, T) whether it reports the target
    information: Floats  # (3, N, T) xx, xy, yy of the Fisher information about the position; 0 where not seen


def rate_of(sensor: Sensor, config: PlanConfig) -> float:
    """Return the frame rate [Hz] of a sensor; that of the configuration if the scene states none."""
    return config.rate_hz if sensor.rate_hz is None else sensor.rate_hz


def detection_of(sensor: Sensor) -> float:
    """Probability that a sensor reports an unoccluded target."""
    return 1.0 if isinstance(sensor, MicrophoneArray) or sensor.detection is None else sensor.detection


def unoccluded_view(sensor: Sensor, scene: Scene, walked: Walked, config: PlanConfig) -> Bools:
    """Mask (N, T) of targets that a sensor can see or hear in each step of their paths.

    For a camera targets are in the field of view and range, and not hidden by obstacles or people; an array hears all
    within its range. `walked` has the paths of targets and people.
    """
    n, steps = walked.ways.shape[:2]
    xy = walked.ways.reshape(-1, 2)
    if isinstance(sensor, MicrophoneArray):
        up = config.target_height - sensor.position[2]
        return np.asarray(np.hypot(np.hypot(*(xy - sensor.position[:2]).T), up) <= sensor.range).reshape(n, steps)
    seen: Bools = in_view(*planar_offsets(xy, sensor.ground, sensor.yaw), sensor.fov, sensor.range)
    seen[seen] = ~behind_walls(sensor.ground, xy[seen], scene.blockers(sensor.ground))
    seen = np.ascontiguousarray(seen.reshape(n, steps))
    if walked.people.shape[1]:
        hide_behind_crowd(
            seen,
            walked.ways,
            np.ascontiguousarray(sensor.ground, dtype=np.float64),
            walked.people,
            walked.first,
            walked.own,
            config.person_diameter,
            share_below_heads(sensor, config),
        )
    return seen


def share_below_heads(camera: Camera, config: PlanConfig) -> float:
    """Share of the line of sight from a camera to the target, 0 to 1, beyond which it is below people's heads.

    0 if the height of the people or the camera is unknown, or the camera is not above them: all can occlude.
    """
    above = float(camera.position[2])
    if config.height is None or not camera.has_height or above <= config.height:
        return 0.0
    if config.target_height >= config.height:
        return 1.0
    return (above - config.height) / (above - config.target_height)


def information_of_sensor(
    sensor: Sensor, scene: Scene, walked: Walked, config: PlanConfig, seed: int
) -> ExpectedInformation:
    """Simulate the reports of one sensor about all targets, and compute their Fisher information.

    It reports a target that it sees in a new frame, with its probability of detection. Random numbers depend on the
    sensor's name and the seed only.
    """
    seen = unoccluded_view(sensor, scene, walked, config)
    n, steps = seen.shape
    # Frames: the last step is one; others at the sensor's own rate
    frames = np.floor(np.arange(steps) * walked.dt * rate_of(sensor, config) * (1.0 + 1e-9))
    seen &= (np.diff(frames, prepend=-1.0) > 0.0)[::-1]
    detection = detection_of(sensor)
    if detection < 1.0:
        rng = generator(seed, RandomStream.PLAN, 2, zlib.crc32(sensor.name.encode()))
        seen &= rng.random(seen.shape) < detection
    information = np.zeros((3, n, steps), dtype=np.float64)
    xy = walked.ways[seen]
    found = _information(sensor, xy, config)
    information[:, seen] = found[:, 0, 0], found[:, 0, 1], found[:, 1, 1]
    return ExpectedInformation(seen, information)


def _information(sensor: Sensor, xy: Floats, config: PlanConfig) -> Floats:
    """Fisher information (N, 2, 2) of one report of a sensor about the target's position, at positions `xy` (N, 2)."""
    if isinstance(sensor, Camera):
        return camera_information(
            xy,
            position=sensor.ground,
            yaw=sensor.yaw,
            focal_px=float(sensor.focal_px[0]),
            sigma_position=sensor.sigma_position,
            sigma_yaw=sensor.sigma_yaw,
            sigma_read_px=np.full(len(xy), sensor.sigma_read_px),
        )
    if sensor.upright:
        return bearing_information(xy, sensor.position[:2], np.full(len(xy), sensor.sigma))
    xyz = np.column_stack([xy, np.full(len(xy), config.target_height)])
    elevation = sensor.sigma if sensor.sigma_elevation is None else sensor.sigma_elevation
    return ground_information(
        direction_information(xyz, sensor.position, sensor.rotation, sigma_theta=sensor.sigma, sigma_phi=elevation)
    )
