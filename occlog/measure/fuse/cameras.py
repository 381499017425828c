"""Cameras with a pose: which places each sees, how reliably it detects, and at which bearing it would see a place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.core.plane.polygons import inside_polygon
from occlog.core.sight.camera import azimuth_to_u, noise_variance, planar_offsets, wrap_angle
from occlog.core.sight.visibility import Sensors, make_sensors, seen_from
from occlog.errors import InputError
from occlog.measure.fuse.kernels.sight_lines import Place, Sight
from occlog.records.scene import Camera, Scene

from .config import FuseConfig

ANYWHERE = 1e7
"""Half of the side of the square in which targets are if the scene has no room."""


@dataclass(frozen=True, eq=False)
class PlacedCameras:
    """Cameras with a pose, in the order of the scene."""

    placed: tuple[Camera, ...]
    sensors: Sensors
    region: Floats  # (K, 2) polygon in which objects can be
    far: Floats  # (C,) distance of the farthest place of the room in range
    p_miss: Floats  # (C,) probability that a camera misses what it could see, [Lee] P_M
    p_false: Floats  # (C,) probability that a camera reports what is not there, [Lee] P_F
    person_height: float | None  # None: not known

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the cameras."""
        return tuple(c.name for c in self.placed)

    def sees(self, xy: Floats, which: int) -> Bools:
        """(N,) whether a camera can see each of (N, 2) places: field of view, range, walls, border of the image."""
        seen = seen_from(np.ascontiguousarray(xy), which, self.sensors)
        camera = self.placed[which]
        if self.person_height is None or camera.image_size is None or not camera.above_floor:
            return seen
        middle = camera.project(np.column_stack([xy, np.full(len(xy), 0.5 * self.person_height)]))
        with np.errstate(invalid="ignore"):
            inside = (middle >= -0.5) & (middle <= np.array(camera.image_size) - 0.5)
        return np.asarray(seen & inside.all(axis=1))

    def along(self, line: Sight, n: int) -> Floats:
        """(m, 2) places on a sight line that its own camera can see, at most `n`, at least one."""
        which = int(line.sensor[0])
        reach = np.linspace(0.0, self.far[which], n + 1)[1:]
        xy = line.origin + reach[:, None] * np.column_stack([np.cos(line.azimuth), np.sin(line.azimuth)])
        good = inside_polygon(np.ascontiguousarray(xy), self.region) & self.sees(xy, which)
        return np.asarray(xy[good] if good.any() else xy[:1])


def placed_cameras(scene: Scene, config: FuseConfig) -> PlacedCameras:
    """The cameras of a scene that have a pose; InputError if there are fewer than two of them.

    Args:
        scene: the scene.
        config: settings in the scene's unit.
    """
    cameras = tuple(c for c in scene.cameras if c.placed)
    if len(cameras) < 2:
        blind = len(scene.cameras) - len(cameras)
        why = f"; {blind} more have no pose" if blind else ""
        raise InputError(
            f"fuse: the scene has {len(cameras)} camera{'s' * (len(cameras) != 1)} with a pose{why}; fusion wants at "
            "least two, calibrated"
        )
    region = scene.room
    if region is None:
        region = ANYWHERE * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    walls = [scene.blockers(c.ground) for c in cameras]
    ground = np.array([c.ground for c in cameras])
    corners = scene.region
    size = np.hypot(*(corners[None] - ground[:, None]).transpose(2, 0, 1)).max(axis=1)
    reach = np.array([c.range for c in cameras])
    sensors = make_sensors(ground, np.array([c.yaw for c in cameras]), np.array([c.fov for c in cameras]), reach, walls)
    return PlacedCameras(
        placed=cameras,
        sensors=sensors,
        region=np.ascontiguousarray(region, dtype=np.float64),
        far=np.minimum(size, reach),
        p_miss=np.array([config.p_miss if c.detection is None else 1.0 - c.detection for c in cameras]),
        p_false=np.array([config.p_false if c.false_alarm is None else c.false_alarm for c in cameras]),
        person_height=config.person_height,
    )


def expected_sight(camera: Camera, place: Place) -> tuple[float, float, float, float]:
    """Bearing, sigma [rad], u_px and sigma_px at which a camera would see a place.

    `sigma_px` is the uncertainty of the place across the sight line; `sigma` has that of the camera's pose
    ([Ercan] Eq. 2) besides.  There is no reading, so no reading noise.
    """
    away = place.xy - camera.ground
    bearing = float(np.arctan2(away[1], away[0]))
    focal = float(camera.focal_px[0])
    h, d = planar_offsets(place.xy[None], camera.ground, camera.yaw)
    across = np.array([-away[1], away[0]]) / float(away @ away)
    slope = focal * (1.0 + float(h[0] / d[0]) ** 2)
    pose = float(
        noise_variance(
            h, d, focal_px=focal, sigma_position=camera.sigma_position, sigma_yaw=camera.sigma_yaw, sigma_read_px=0.0
        )[0]
    )
    sigma_px = slope * float(np.sqrt(across @ place.cov @ across))
    u_px = float(azimuth_to_u(np.asarray(bearing), camera.yaw, focal))
    return float(wrap_angle(bearing)), float(np.hypot(sigma_px, np.sqrt(pose))) / slope, u_px, sigma_px
