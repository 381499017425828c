"""Cameras and views in the fusion: distances of feet on the floor, visibility, expected bearings, recovered boxes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.geometry.camera import azimuth_to_u, noise_variance, planar_offsets, wrap_angle
from occlog.core.geometry.visibility import Sensors, make_sensors, seen_from
from occlog.core.plane import inside_polygon
from occlog.errors import InputError
from occlog.measure.clusters.person_size import FILL, person_in_image
from occlog.records.scene import Camera, Scene
from occlog.records.tables import APPEARANCE_BINS, Bearings, Views

from .config import FuseConfig
from .kernels import LocalDirections, PositionWithCovariance

DEFAULT_HALF_SIDE = 1e7
"""Half of the side of the square in which targets are if the scene has no room."""


@dataclass(frozen=True, eq=False)
class PlacedCameras:
    """C calibrated cameras of a scene, in its order, with what the fusion needs of them.

    Attributes:
        placed: the cameras.
        sensors: their packed geometry.
        region: (K, 2) polygon in which objects can be.
        far: (C,) distance of the farthest position of the room, at most the camera's range [length].
        p_miss: (C,) probability that a camera misses what it could see, [Lee] P_M.
        p_false: (C,) probability that a camera reports a false object, [Lee] P_F.
        person_height: height of a person [length]; None: unknown.
    """

    placed: tuple[Camera, ...]
    sensors: Sensors
    region: Floats
    far: Floats
    p_miss: Floats
    p_false: Floats
    person_height: float | None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the cameras."""
        return tuple(c.name for c in self.placed)

    def sees(self, xy: Floats, which: int) -> Bools:
        """(N,) mask of ground positions `xy` (N, 2) that the camera with index `which` can see.

        By its field of view, range and walls; if the height of a person and the image size are known, the middle of
        a person there must also be inside the image.
        """
        seen = seen_from(np.ascontiguousarray(xy), which, self.sensors)
        camera = self.placed[which]
        if self.person_height is None or camera.image_size is None or not camera.above_floor:
            return seen
        middle = camera.project(np.column_stack([xy, np.full(len(xy), 0.5 * self.person_height)]))
        with np.errstate(invalid="ignore"):
            inside = (middle >= -0.5) & (middle <= np.array(camera.image_size) - 0.5)
        return np.asarray(seen & inside.all(axis=1))

    def along(self, line: LocalDirections, n: int) -> Floats:
        """(m, 2) ground positions on the first line of sight that its own camera can see, 1 <= m <= n.

        `n` equidistant positions up to the camera's range are tried; if none is visible and in the region, the
        nearest one is returned alone.
        """
        which = int(line.sensor[0])
        reach = np.linspace(0.0, self.far[which], n + 1)[1:]
        xy = line.origin + reach[:, None] * np.column_stack([np.cos(line.azimuth), np.sin(line.azimuth)])
        good = inside_polygon(np.ascontiguousarray(xy), self.region) & self.sees(xy, which)
        return np.asarray(xy[good] if good.any() else xy[:1])


def placed_cameras(scene: Scene, config: FuseConfig) -> PlacedCameras:
    """Collect the cameras of a scene that have a pose, with their probabilities of misses and false alarms.

    Probabilities of the scene have priority over those of `config`. InputError if fewer than two cameras have a pose.
    """
    cameras = tuple(c for c in scene.cameras if c.placed)
    if len(cameras) < 2:
        blind = len(scene.cameras) - len(cameras)
        why = f"; {blind} more have no pose" if blind else ""
        raise InputError(
            f"fuse: the scene has {len(cameras)} camera{'s' * (len(cameras) != 1)} with a pose{why}; fusion needs at "
            "least two, calibrated",
            id="too-few-sensors",
        )
    region = scene.room
    if region is None:
        region = DEFAULT_HALF_SIDE * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
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
        p_miss=np.array([config.miss_probability if c.detection is None else 1.0 - c.detection for c in cameras]),
        p_false=np.array([config.false_alarm_probability if c.false_alarm is None else c.false_alarm for c in cameras]),
        person_height=config.person_height,
    )


def expected_sight(camera: Camera, position: PositionWithCovariance) -> tuple[float, float, float, float]:
    """Expected bearing, sigma [rad], u_px and sigma_px [px] of a ground position in a camera.

    `u_px` is the horizontal offset from the centre of the levelled image, positive to the right. `sigma_px` is the
    uncertainty of the position across the line of sight in the image; `sigma` includes it and that of the camera's pose
    ([Ercan] Eq. 2), but no measurement noise.
    """
    away = position.xy - camera.ground
    bearing = float(np.arctan2(away[1], away[0]))
    focal = float(camera.focal_px[0])
    h, d = planar_offsets(position.xy[None], camera.ground, camera.yaw)
    across = np.array([-away[1], away[0]]) / float(away @ away)
    slope = focal * (1.0 + float(h[0] / d[0]) ** 2)
    pose = float(
        noise_variance(
            h, d, focal_px=focal, sigma_position=camera.sigma_position, sigma_yaw=camera.sigma_yaw, sigma_read_px=0.0
        )[0]
    )
    sigma_px = slope * float(np.sqrt(across @ position.cov @ across))
    u_px = float(azimuth_to_u(np.asarray(bearing), camera.yaw, focal))
    return float(wrap_angle(bearing)), float(np.hypot(sigma_px, np.sqrt(pose))) / slope, u_px, sigma_px


BORDER_PX = 1.5  # a box that comes this near to the border of the image is cut by it
STATURE = (0.75, 1.33)
"""A box this much shorter or taller than a person at its lower edge does not show where the feet are."""
FOOT = 0.05
"""Standard deviation of the feet's row in the image, in heights of the box, also the reading noise."""

New = tuple[int, int, int, PositionWithCovariance]
"""Time, camera's position in `PlacedCameras`, target, global position of a detection that was recovered."""


def views_of(views: Views, bearings: Bearings) -> Ints:
    """(N,) row in `views` of the view of each of N bearings: same sensor, time and bearing; -1: none."""
    rows = {
        key: row
        for row, key in enumerate(zip(views.t_ns.tolist(), views.sensor.tolist(), views.bearing.tolist(), strict=True))
    }
    keys = zip(bearings.t_ns.tolist(), bearings.sensor.tolist(), bearings.bearing.tolist(), strict=True)
    found = [rows.get(key, -1) for key in keys]
    return np.where(bearings.seen, np.array(found, dtype=np.int64), -1)


def feet(views: Views, cameras: PlacedCameras) -> Floats:
    """(V, 2) ground distance of the feet of each of V views and its standard deviation [length]; NaN if unknown.

    The feet are at the middle of the lower edge of the box, on the floor z = 0. Unknown for a camera of unknown
    height, a box at the image border, or one too short or too tall for a person at that position.
    """
    out = np.full((len(views), 2), np.nan)
    for which, camera in enumerate(cameras.placed):
        mine = np.flatnonzero(views.sensor == camera.name)
        if len(mine) and camera.above_floor and cameras.person_height is not None:
            out[mine] = _feet_of(camera, cameras.person_height, views.take(mine), float(cameras.far[which]))
    return out


def _feet_of(camera: Camera, height: float, views: Views, far: float) -> Floats:
    bottom = views.top_px + views.height_px
    foot = np.column_stack([views.left_px + 0.5 * views.width_px, bottom])
    distance = _distance_to_ground_plane(camera, foot)
    sigma_px = np.hypot(camera.sigma_read_px, FOOT * views.height_px)
    step = np.column_stack([np.zeros(len(views)), sigma_px])
    sigma = 0.5 * np.abs(
        _distance_to_ground_plane(camera, foot + step) - _distance_to_ground_plane(camera, foot - step)
    )
    spots = camera.ground + distance[:, None] * np.column_stack([np.cos(views.bearing), np.sin(views.bearing)])
    with np.errstate(invalid="ignore"):
        _, spans = person_in_image(camera, spots, height)
        stature = views.height_px / np.abs(spans[..., 1]).sum(axis=1)
        good = (distance > 0) & (distance < far) & (stature > STATURE[0]) & (stature < STATURE[1])
    if camera.image_size is not None:
        good &= (bottom < camera.image_size[1] - 0.5 - BORDER_PX) & (views.left_px > BORDER_PX - 0.5)
        good &= views.left_px + views.width_px < camera.image_size[0] - 0.5 - BORDER_PX
    good &= np.isfinite(sigma)
    return np.where(good[:, None], np.column_stack([distance, sigma]), np.nan)


def _distance_to_ground_plane(camera: Camera, pixels: Floats) -> Floats:
    """(N,) horizontal distances [length] at which rays through `pixels` (N, 2) meet the floor z = 0; NaN if not."""
    rays = camera.rays(pixels)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(rays[:, 2] < 0, -camera.position[2] / rays[:, 2] * np.hypot(rays[:, 0], rays[:, 1]), np.nan)


def recovered_views(
    new: Sequence[New], cameras: PlacedCameras, views: Views, bearings: Bearings, frames: dict[str, int]
) -> Views:
    """Views of recovered detections: a person's box at the global position, without appearance.

    None are made for frames of cameras without views so far, or if the height of people is unknown.

    Args:
        new: recovered detections: time [ns], index of the camera, identity, global position.
        cameras: calibrated cameras.
        views: views of the part before the fusion.
        bearings: bearings of the part before the fusion; each time of a sensor is a frame.
        frames: number of each camera's last frame so far by name, updated in place; a frame without views has the
            number after that of the frame before it.
    """
    counts: dict[tuple[int, str], int] = {}
    numbers = _numbers(views, bearings, frames, counts)
    height = cameras.person_height
    if height is None:
        return Views.empty()
    rows = []
    for t_ns, which, target, position in new:
        camera = cameras.placed[which]
        key = (t_ns, camera.name)
        if key not in numbers:
            continue
        cluster = counts.get(key, 0)
        counts[key] = cluster + 1
        rows.append(_view(t_ns, camera, numbers[key], cluster, target, position, height))
    return Views.merge(rows)


def _numbers(
    views: Views, bearings: Bearings, frames: dict[str, int], counts: dict[tuple[int, str], int]
) -> dict[tuple[int, str], int]:
    """Frame number of each time [ns] and sensor in views or bearings, counted on for frames without views.

    Frames of a sensor before its first frame with views have no number.

    Args:
        views: views with frame numbers.
        bearings: bearings of the same frames.
        frames: last frame number of each sensor by name, updated in place.
        counts: number of views in each frame, by time and sensor, updated in place.
    """
    number_of: dict[tuple[int, str], int] = {}
    for t_ns, name, number in zip(views.t_ns.tolist(), views.sensor.tolist(), views.frame.tolist(), strict=True):
        number_of[t_ns, name] = number
        counts[t_ns, name] = counts.get((t_ns, name), 0) + 1
    out: dict[tuple[int, str], int] = {}
    for key in sorted({*number_of, *zip(bearings.t_ns.tolist(), bearings.sensor.tolist(), strict=True)}):
        name = key[1]
        if key in number_of or name in frames:
            frames[name] = out[key] = number_of.get(key, frames.get(name, -1) + 1)
    return out


def _view(
    t_ns: int, camera: Camera, frame: int, cluster: int, target: int, position: PositionWithCovariance, height: float
) -> Views:
    """One row of `Views` with cause `recovered`: expected box, ellipse and bearing of a person at a ground position.

    Args:
        t_ns: time of the frame [ns].
        camera: camera of the frame.
        frame: number of the frame.
        cluster: number of the view in the frame.
        target: identity.
        position: ground position of the person.
        height: height of the person, in scene units.
    """
    middle, spans = person_in_image(camera, position.xy[None], height)
    x, y = middle[0].tolist()
    cov = np.einsum("ki,kj->ij", spans[0], spans[0]) / 12.0
    width, tall = np.abs(spans[0]).sum(axis=0).tolist()
    bearing, sigma, u_px, sigma_px = expected_sight(camera, position)
    return Views.of(
        t_ns=[t_ns],
        sensor=[camera.name],
        frame=[frame],
        cluster=np.array([cluster], dtype=np.int32),
        x_px=[x],
        y_px=[y],
        cov_xx_px=[cov[0, 0]],
        cov_xy_px=[cov[0, 1]],
        cov_yy_px=[cov[1, 1]],
        left_px=[x - 0.5 * width],
        top_px=[y - 0.5 * tall],
        width_px=[width],
        height_px=[tall],
        area_px=[FILL * width * tall],
        bearing=[bearing],
        sigma=[sigma],
        u_px=[u_px],
        sigma_px=[sigma_px],
        confidence=[np.nan],
        similarity=[np.nan],
        target_id=np.array([target], dtype=np.int32),
        appearance=np.full((1, APPEARANCE_BINS), np.nan, dtype=np.float32),
        cause=["recovered"],
    )
