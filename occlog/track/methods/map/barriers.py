"""Obstacles of a record: walls and static occluders, and views in which the target was not seen."""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.core.plane import convex_pieces, counter_clockwise, offset
from occlog.track.methods.map.kernels.paths_around_obstacles import Obstacle

from .config import MapConfig
from .measurements import SensorStations
from .record import TargetRecord

ARC = math.radians(10.0)
"""The far end of a view is a polygon with such sides."""
BORDER = 2.0
"""Standard deviations from the border of a view, or from a wall in it, within which a target may go unseen."""


def obstacles(
    record: TargetRecord, at: SensorStations, config: MapConfig, extent: float, T: int
) -> tuple[Obstacle, ...]:
    """Return the obstacles of a record: walls, and views in which a camera did not detect the target.

    Args:
        record: measurements of the target.
        at: the sensors and walls; obstacles are in their coordinates.
        config: settings; a camera's view counts if its own or this detection probability P_D is known, and a state
            inside costs -log(1 - P_D).
        extent: size of the scene; views are cut at twice this distance.
        T: number of states.
    """
    always, nowhere = np.ones(T, dtype=np.bool_), np.zeros(2)
    walls = [Obstacle(counter_clockwise(w), tuple(convex_pieces(w)), None, nowhere, always, math.inf) for w in at.walls]
    return (*walls, *(_view(s, when, at, config, extent) for s, when in _unseen(record, at, config, T)))


def _unseen(record: TargetRecord, at: SensorStations, config: MapConfig, T: int) -> list[tuple[int, Bools]]:
    """Return each camera with known detection probability that missed the target: its index, and (T,) the states.

    States with priors of moving occluders do not count.
    """
    found = []
    unseen = ~record.rows.seen
    for s in np.unique(record.rows.sensor[unseen]).tolist():
        if at.focal_px[s] > 0.0 and not math.isnan(_detection(s, at, config)):
            when = np.zeros(T, dtype=np.bool_)
            when[record.state[unseen & (record.rows.sensor == s)]] = True
            # Among moving occluders `occlog.track.methods.map.occlusion` models "not seen"
            when[[t for t, priors in enumerate(record.occluders) if priors is not None]] = False
            found.append((s, when))
    return found


def _detection(s: int, at: SensorStations, config: MapConfig) -> float:
    """Return the detection probability of the sensor with index `s`; NaN: unknown.

    It is the sensor's own, else that of the settings.
    """
    own = float(at.detection[s])
    if math.isnan(own) and config.detection_probability is not None:
        return config.detection_probability
    return own


def _view(s: int, when: Bools, at: SensorStations, config: MapConfig, extent: float) -> Obstacle:
    """Return the field of view of a camera, up to its range, as an obstacle; its border is narrowed by uncertainty.

    Args:
        s: index of the camera.
        when: (T,) states at which the camera missed the target.
        at: the sensors.
        config: settings, with the detection probability.
        extent: size of the scene.
    """
    missed = 1.0 - _detection(s, at, config)
    price = -math.log(missed) if missed > 0.0 else math.inf
    unsure = BORDER * max(float(at.sigma_yaw[s]), float(at.read_px[s] / at.focal_px[s]))
    fov = max(float(at.fov[s]) - 2.0 * unsure, 0.1 * float(at.fov[s]))
    corners = view_polygon(at.position[s], float(at.yaw[s]), fov, min(float(at.range[s]), 2.0 * extent))
    hiding = tuple(_wider(piece, at.position[s], unsure) for w in at.blockers[s] for piece in convex_pieces(w))
    return Obstacle(corners, tuple(convex_pieces(corners)), hiding, at.position[s], when, price)


def _wider(wall: Floats, eye: Floats, angle: float) -> Floats:
    """Return a wall (K, 2) offset outwards so that it hides at least `angle` [rad] more on both sides.

    The angle is as seen from `eye` (2,).
    """
    return offset(wall, angle * float(np.hypot(*(wall - eye).T).max()))


def view_polygon(position: Floats, yaw: float, fov: float, reach: float) -> Floats:
    """Return the counter-clockwise polygon (K, 2) of a field of view: the camera, and an arc of sides of at most `ARC`.

    Args:
        position: (2,) of the camera.
        yaw: azimuth of its optical axis [rad].
        fov: full field of view [rad]; at most 2 pi is used.
        reach: radius of the arc.
    """
    half = 0.5 * min(fov, 2.0 * math.pi - 1e-3)
    n = max(1, math.ceil(2.0 * half / ARC))
    angle = yaw + np.linspace(-half, half, n + 1)
    arc = position + reach * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.vstack([position[None], arc])
