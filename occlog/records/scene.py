"""The scene and its sensors: room, static occluders, cameras, microphone arrays, readers of tags, clocks.

A scene is validated once, when it is built; everything downstream trusts it.

Scenes with coordinates of maps, brought near the origin: sums of squares lose digits at millions of metres.

The part of the ground that the sensors of a scene can see: where targets can be if the scene has no room.

How far a camera sees is its `range`.  Where the scene gives none, it is the least of

* the distance at which a person is a fiftieth of the field of view wide or high (`PERSON_HEIGHT_M` over `MIN_SHARE` of
  the field of view), but at least twice the extent of all sensors;
* the farthest ground in the image, of a camera that points down, with an image that ends below the horizon.

A microphone array without a `range` hears `DEFAULT_ARRAY_RANGE_M`, and at least twice the extent of all sensors.

Scripted targets: where they start, how they move, and when they make a sound.

Times are seconds after the first step of the recording.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
import shapely

from occlog.array_types import Bools, Floats
from occlog.core.geometry import camera as cam
from occlog.core.geometry.lens import is_straight, is_usable, to_usable
from occlog.core.geometry.visibility import ViewPrior
from occlog.core.plane import inside_polygon, pockets
from occlog.errors import InputError
from occlog.settings import METRES

Triple = tuple[float, float, float]

PLANES: dict[str, tuple[int, int]] = {"xy": (0, 1), "yz": (1, 2), "zx": (2, 0)}
"""Axes of each plane; a turn is positive from the first towards the second."""


def to_ns(seconds: float) -> int:
    """Convert seconds to whole nanoseconds."""
    return round(seconds * 1e9)


@dataclass(frozen=True)
class Segment:
    """Motion of a scripted target from `from_s` to `until_s` [s after the start]; constant velocity by default.

    `lateral` is an acceleration perpendicular to the velocity in the plane `plane` (`xy`, `yz` or `zx`), which makes a
    turn; `acceleration` is constant along the world axes [scene unit/s^2]; `velocity` replaces the velocity at the
    start of the segment [scene unit/s].
    """

    from_s: float
    until_s: float = math.inf
    lateral: float = 0.0  # acceleration at a right angle to the velocity in the plane [length/s^2]: a turn
    plane: str = "xy"
    acceleration: Triple = (0.0, 0.0, 0.0)  # [length/s^2]
    velocity: Triple | None = None  # taken on at the start of the segment [length/s]


@dataclass(frozen=True)
class ScriptedTarget:
    """A scripted target, present from `from_s` to `until_s` (inclusive) [s after the first step of the recording].

    It starts at `position` with `velocity` and moves by its `segments`; `noise_density` adds white-noise acceleration.
    `silent` lists intervals (from, until) in which it makes no sound.
    """

    id: int
    position: Triple  # at from_s; z NaN: not known
    velocity: Triple = (0.0, 0.0, 0.0)
    role: Literal["target", "occluder"] = "target"
    from_s: float = 0.0
    until_s: float = math.inf
    noise_density: float = 0.0  # variance of the velocity accumulated over 1 s, for each axis [length^2/s^3]
    segments: tuple[Segment, ...] = ()  # in order of time, not overlapping
    silent: tuple[tuple[float, float], ...] = ()  # makes no sound from the first time up to the second


@dataclass(frozen=True)
class MotionScript:
    """All scripted targets, with length unit, duration [s] and rate [Hz] of the observation.

    None: the file does not state it.
    """

    targets: tuple[ScriptedTarget, ...]
    length_unit: str | None = None
    seconds: float | None = None
    rate_hz: float | None = None

    @property
    def heights(self) -> bool:
        """Whether the height of any target is known."""
        return any(not math.isnan(t.position[2]) for t in self.targets)


HEIGHT_SLACK = 1e-6
"""A camera centre nearer to z = 0 [scene unit] is at 0 but for the rounding of its calibration."""

MAX_COORDINATE = 1e12
"""Largest coordinate and length of a scene: what is computed of it has room up to the limit of tables."""
MAX_SENSORS = 10_000
"""Largest number of sensors of a scene."""
MIN_SIGMA_DEG, MAX_SIGMA_DEG = 1e-13, 360.0
"""Minimum and maximum standard deviation of directions."""
MIN_FOCAL_PX, MAX_FOCAL_PX = 1e-3, 1e9
"""Limits of a focal length [px]: no lens is beyond, and its squares and quotients with image sizes remain finite."""


@dataclass(frozen=True, eq=False)
class Camera:
    """A calibrated perspective or fisheye camera; lengths in the scene's unit, angles in radians.

    Camera frame: x to the right, y down, z forward; the columns of `rotation` are these axes in the world.
    `sigma_position` and `sigma_yaw` are standard deviations of the pose, `sigma_read_px` of a measured pixel
    coordinate. `placed` is false for a camera without a known pose: targets are detected in its images, but it gives no
    bearing.
    """

    name: str
    position: Floats  # (3,) centre; z is 0 when the height is not known
    rotation: Floats  # (3, 3) world-from-camera
    focal_px: Floats  # (2,)
    principal_px: Floats  # (2,)
    image_size: tuple[int, int] | None = None  # width, height
    distortion: Floats = field(default_factory=lambda: np.zeros(5))
    distortion_model: str = "brown"
    fov: float = np.pi / 2  # full horizontal field of view
    range: float = np.inf  # farthest distance at which a target is seen
    sigma_position: float = 0.0
    sigma_yaw: float = 0.0
    sigma_read_px: float = 2.0
    detection: float | None = None  # probability that it detects a target in plain view; None: the filter's setting
    false_alarm: float | None = None  # that it reports one it did not detect, anywhere in the image
    rate_hz: float | None = None
    clock: str | None = None
    placed: bool = True

    @cached_property
    def yaw(self) -> float:
        """Azimuth of the optical axis [rad]."""
        return cam.angles_from_rotation(self.rotation)[0]

    @property
    def intrinsic_matrix(self) -> Floats:
        """Intrinsics K (3, 3): focal lengths and principal point [px], without the lens distortion."""
        (fx, fy), (cx, cy) = self.focal_px, self.principal_px
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @property
    def extrinsics(self) -> tuple[Floats, Floats]:
        """Extrinsics R (3, 3) and t (3,) [scene unit]: a point x of the world is at R x + t in the camera frame."""
        return self.rotation.T, -self.rotation.T @ self.position

    @property
    def straight(self) -> bool:
        """Whether the lens has no distortion."""
        return is_straight(self.distortion, self.distortion_model)

    def usable(self, pixels: Floats) -> Bools:
        """(N,) mask of recorded pixels (N, 2) with a valid line of sight: all, or for a fisheye within 80 degrees."""
        return is_usable((pixels - self.principal_px) / self.focal_px, self.distortion, self.distortion_model)

    def to_usable(self, pixels: Floats) -> Floats:
        """Recorded pixels (N, 2) [px]; of a fisheye, those beyond 80 degrees are moved radially to that limit."""
        if self.distortion_model != "equidistant":
            return pixels
        moved = to_usable((pixels - self.principal_px) / self.focal_px, self.distortion, self.distortion_model)
        return moved * self.focal_px + self.principal_px

    @property
    def ground(self) -> Floats:
        """(2,) x and y of the camera centre in the world."""
        return self.position[:2]

    @property
    def has_height(self) -> bool:
        """Whether its pose is known in space; a camera at the ground (to `HEIGHT_SLACK`) has unknown height."""
        return self.placed and bool(abs(self.position[2]) > HEIGHT_SLACK)

    @property
    def above_floor(self) -> bool:
        """Whether it is above the floor z = 0 by more than `HEIGHT_SLACK`."""
        return bool(self.position[2] > HEIGHT_SLACK)

    def rays(self, pixels: Floats) -> Floats:
        """(N, 3) directions in the world of the lines of sight through recorded pixels (N, 2).

        NaN where none is valid.
        """
        return cam.pixels_to_rays(
            pixels, self.focal_px, self.principal_px, self.distortion, self.distortion_model, self.rotation
        )

    def project(self, points: Floats) -> Floats:
        """(N, 2) recorded (distorted) pixels of world points (N, 3); NaN for points behind the camera."""
        return cam.points_to_pixels(
            points,
            self.position,
            self.focal_px,
            self.principal_px,
            self.distortion,
            self.distortion_model,
            self.rotation,
        )

    def bearings(self, pixels: Floats) -> Floats:
        """(N,) world azimuths [rad], from +x towards +y, of the lines of sight through recorded pixels (N, 2)."""
        return cam.rays_to_azimuth(self.rays(pixels))

    def u_px(self, bearings: Floats) -> Floats:
        """(N,) horizontal pixel offsets from the principal point, to the right, of world azimuths (N,) [rad].

        They are those in the undistorted and levelled image (pitch and roll 0) with the camera's yaw and focal length.
        """
        return cam.azimuth_to_u(bearings, self.yaw, float(self.focal_px[0]))


@dataclass(frozen=True, eq=False)
class MicrophoneArray:
    """A microphone array that delivers directions of arrival; lengths in the scene's unit, angles in radians.

    Frame of the array: x forward, y to the left, z up; yaw, pitch and roll turn it in the world as those of a camera.
    """

    name: str
    position: Floats  # (3,)
    yaw: float = 0.0
    microphones: Floats = field(default_factory=lambda: np.zeros((0, 3)))  # (n, 3) in the array's frame
    sigma: float = float(np.radians(3.0))  # of an azimuth about its own z axis [rad]
    range: float = np.inf  # farthest distance at which a source is heard
    rate_hz: float | None = None
    clock: str | None = None
    pitch: float = 0.0  # of its own x axis above the horizontal plane
    roll: float = 0.0
    sigma_elevation: float | None = None  # of an elevation above its own xy plane [rad]; None: as `sigma`
    resolution: float = 0.0  # sources nearer to each other than this are heard as one [rad]
    planar: bool = False  # measures no elevation

    @cached_property
    def rotation(self) -> Floats:
        """(3, 3) world-from-array rotation; its columns are the array's axes (x forward, y left, z up) in the world."""
        return cam.array_rotation(self.yaw, self.pitch, self.roll)

    @property
    def upright(self) -> bool:
        """Whether its z axis is vertical."""
        return self.pitch == 0.0 and self.roll == 0.0


@dataclass(frozen=True, eq=False)
class TagReader:
    """A reader of radio tags (RFID, Bluetooth), which detects nearby tags without a direction."""

    name: str
    position: Floats  # (3,)
    range: float = np.inf  # farthest distance on the ground at which it reads a tag; infinite: not known
    power: float | None = None  # strength of a tag's signal at a distance of 1 m [dBm]; None: the method's setting
    rate_hz: float | None = None
    clock: str | None = None


@dataclass(frozen=True, eq=False)
class Occluder:
    """A static occluder: a vertical prism over a polygon on the ground, which hides targets behind it."""

    name: str
    polygon: Floats  # (K, 2), counter-clockwise
    height: float = 2.5


@dataclass(frozen=True, eq=False)
class Clock:
    """Clock model of a sensor: world time = sensor time - offset - drift * (sensor time - start of the recording).

    The offset is in ns, the drift in parts per million; both are positive if the sensor's clock is ahead or fast.
    """

    name: str
    offset_ns: int = 0
    drift_ppm: float = 0.0


@dataclass(frozen=True)
class CommonNoise:
    """Standard deviations of a similarity transform of the ground plane that all cameras of a scene have in common.

    Poses of cameras to each other do not contain it: where all of them are, turned and scaled about `center` (x, y) is
    not known better. Lengths are in the scene's unit, `yaw` in radians, `scale` is relative.
    """

    center: tuple[float, float]
    position: float = 0.0  # of x and of y
    yaw: float = 0.0
    scale: float = 0.0

    def covariances(self, states: Floats) -> Floats:
        """(n, 6, 6) covariances of states (n, 6), x, y, vx, vy, height and width, due to these errors."""
        from_center = np.array(states, dtype=np.float64)
        from_center[:, :2] -= self.center
        slope = np.zeros((len(states), 6, 4))
        slope[:, [0, 1], [0, 1]] = self.position
        slope[:, [0, 2], 2] = -self.yaw * from_center[:, [1, 3]]
        slope[:, [1, 3], 2] = self.yaw * from_center[:, [0, 2]]
        slope[:, :, 3] = self.scale * from_center
        return np.asarray(slope @ np.swapaxes(slope, 1, 2))


@dataclass(frozen=True, eq=False)
class Scene:
    """Static environment and sensors: room, static occluders, cameras, microphone arrays, tag readers, clocks."""

    cameras: tuple[Camera, ...] = ()
    arrays: tuple[MicrophoneArray, ...] = ()
    occluders: tuple[Occluder, ...] = ()
    clocks: tuple[Clock, ...] = ()
    room: Floats | None = None  # (K, 2), counter-clockwise; None: unbounded
    room_height: float = 2.5
    length_unit: str = "m"
    readers: tuple[TagReader, ...] = ()
    common_noise: CommonNoise | None = None  # None: the cameras are exact as a whole

    def __post_init__(self) -> None:
        """Check the number of sensors; InputError above `MAX_SENSORS`."""
        if (count := len(self.sensors)) > MAX_SENSORS:
            raise InputError(
                f"scene: {count} sensors, at most {MAX_SENSORS}; remove those without measurements",
                id="problem-too-large",
            )

    @property
    def sensors(self) -> tuple[Camera | MicrophoneArray | TagReader, ...]:
        """All sensors: cameras, then arrays, then readers."""
        return (*self.cameras, *self.arrays, *self.readers)

    def camera(self, name: str) -> Camera:
        """The camera with this name; InputError, which lists the existing ones, if there is none."""
        for camera in self.cameras:
            if camera.name == name:
                return camera
        known = ", ".join(c.name for c in self.cameras) or "none"
        raise InputError(f"scene: no camera named {name!r}; the scene has: {known}", id="unknown-sensor")

    @cached_property
    def views(self) -> ViewPrior | None:
        """Prior of target positions from the sensors' fields of view.

        None if the scene has a room, which then defines it.

        Raises:
            InputError: the scene has neither a room nor a camera nor a microphone array.
        """
        if self.room is not None:
            return None
        if not self.cameras and not self.arrays:
            raise InputError(
                "scene: has neither a room nor a sensor, which would define where targets can be; add `room`",
                id="missing-value",
            )
        return view_prior(self)

    @cached_property
    def region(self) -> Floats:
        """(K, 2) polygon of possible target positions: the room, or else the convex hull of what the sensors see."""
        views = self.views
        return self.surroundings if views is None else visible_region(views)

    @cached_property
    def surroundings(self) -> Floats:
        """(K, 2) room polygon, or else a box around all sensors: extent of a simulated world, and scale of the scene.

        Raises:
            InputError: the scene has neither a room nor a sensor.
        """
        if self.room is not None:
            return self.room
        if not self.cameras and not self.arrays and not self.readers:
            raise InputError(
                "scene: has neither a room nor a sensor, which would define where targets can be; add `room`",
                id="missing-value",
            )
        (x0, y0), (x1, y1) = box_around(self)
        return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])

    def blockers(self, ground: Floats) -> tuple[Floats, ...]:
        """Polygons (K, 2) that hide targets from a sensor at `ground` (2,) in the world.

        These are the static occluders and, of a room that is not convex, the pockets between room and convex hull,
        except one that contains the sensor itself: a line of sight inside the hull leaves the room if and only if it
        passes through a pocket.
        """
        walls = () if self.room is None else pockets(self.room)
        here = np.asarray(ground, dtype=np.float64)[None, :2]
        return (
            *(o.polygon for o in self.occluders),
            *(w for w in walls if not inside_polygon(here, w)[0]),
        )


def camera_rotation(yaw: float, pitch: float, roll: float) -> Floats:
    """(3, 3) world-from-camera rotation for yaw (from +x towards +y), pitch (up) and roll [rad].

    Roll is clockwise as seen from behind the camera.
    """
    return cam.rotation_from_angles(yaw, pitch, roll)


def other_angle_readings(rotation: Floats) -> Iterator[tuple[str, Floats]]:
    """Rotations that a scene may have meant by the angles of a camera, if these are in another unit or sense.

    Args:
        rotation: (3, 3) world-from-camera, as read.

    Yields:
        The mistake in words, and the (3, 3) world-from-camera rotation without it; radians are tried only where all
        angles are those of radians that were read as degrees.
    """
    yaw, pitch, roll = cam.angles_from_rotation(rotation)
    if max(abs(yaw), abs(pitch), abs(roll)) <= math.radians(2.0 * math.pi):
        yield "yaw_deg, pitch_deg, roll_deg are in radians", camera_rotation(*map(math.degrees, (yaw, pitch, roll)))
    if abs(pitch) <= math.radians(0.5 * math.pi):
        yield "pitch_deg is in radians", camera_rotation(yaw, math.degrees(pitch), roll)
    yield "pitch is positive downwards", camera_rotation(yaw, -pitch, roll)
    yield "yaw is clockwise from north (+y)", camera_rotation(0.5 * math.pi - yaw, pitch, roll)


def _border_rays(
    size: tuple[int, int], focal_px: Floats, principal_px: Floats, distortion: Floats, model: str, rotation: Floats
) -> Floats:
    """(132, 3) directions in the world through 33 points on each side of the image border.

    Of a fisheye, points outside the usable disc are moved to its edge.

    Args:
        size: width and height of the image [px].
        focal_px: (2,) focal lengths.
        principal_px: (2,) principal point.
        distortion: coefficients of the lens model.
        model: name of the lens model.
        rotation: (3, 3) world-from-camera rotation.
    """
    w, h = size
    across, down = np.linspace(-0.5, w - 0.5, 33), np.linspace(-0.5, h - 0.5, 33)
    sides = [np.column_stack([np.full(33, x), down]) for x in (-0.5, w - 0.5)]
    ends = [np.column_stack([across, np.full(33, y)]) for y in (-0.5, h - 0.5)]
    border = np.vstack(sides + ends)
    if model == "equidistant":
        border = to_usable((border - principal_px) / focal_px, distortion, model) * focal_px + principal_px
    return cam.pixels_to_rays(border, focal_px, principal_px, distortion, model, rotation)


def camera_fov(
    size: tuple[int, int], focal_px: Floats, principal_px: Floats, distortion: Floats, model: str, rotation: Floats
) -> float:
    """Full horizontal field of view [rad], at most 2 pi: twice the largest azimuth, off the axis, of a border pixel.

    A pitched camera sees a wider range of azimuths at the near edge of the floor; lines of sight steeper than 75
    degrees are omitted, where azimuth loses its meaning. 2 pi if all are.

    Args:
        size: width and height of the image [px].
        focal_px: (2,) focal lengths.
        principal_px: (2,) principal point.
        distortion: coefficients of the model.
        model: name of the distortion model.
        rotation: (3, 3) world-from-camera rotation.
    """
    rays = _border_rays(size, focal_px, principal_px, distortion, model, rotation)
    flat = np.hypot(rays[:, 0], rays[:, 1])
    rays = rays[flat > np.tan(np.radians(15.0)) * np.abs(rays[:, 2])]
    if not len(rays):
        return 2.0 * np.pi
    yaw = cam.angles_from_rotation(rotation)[0]
    return float(min(2.0 * np.abs(cam.wrap_angle(cam.rays_to_azimuth(rays) - yaw)).max(), 2.0 * np.pi))


SIDE = 1024.0
"""Scenes are moved by multiples of this, in units of length: those that are near stay, and nothing is rounded."""


def map_origin(cameras: Sequence[Camera]) -> Floats:
    """(2,) point of a grid with spacing `SIDE` nearest to the mean ground position of the cameras (at least one)."""
    return np.asarray(SIDE * np.round(np.mean([c.ground for c in cameras], axis=0) / SIDE))


def camera_from(camera: Camera, origin: Floats) -> Camera:
    """Copy of the camera with its position relative to an origin (2,) on the ground."""
    return replace(camera, position=camera.position - np.append(origin, 0.0))


def scene_from(scene: Scene, origin: Floats) -> Scene:
    """Copy of the scene with all positions relative to an origin (2,) on the ground."""
    by = np.append(origin, 0.0)
    return replace(
        scene,
        cameras=tuple(camera_from(c, origin) for c in scene.cameras),
        arrays=tuple(replace(a, position=a.position - by) for a in scene.arrays),
        readers=tuple(replace(r, position=r.position - by) for r in scene.readers),
        occluders=tuple(replace(o, polygon=o.polygon - origin) for o in scene.occluders),
        room=None if scene.room is None else scene.room - origin,
    )


SENSOR_MARGIN_M = 1.0
"""Width of the strip around the sensors that counts as near them, in addition to a tenth of their extent."""
PERSON_HEIGHT_M = 1.7
"""Height of a person [m]."""
MIN_SHARE = 0.02
"""A camera sees a person who takes up so much of its field of view."""
DEFAULT_ARRAY_RANGE_M = 20.0
"""How far an array without a `range` hears [m]."""
STEP = np.pi / 16
"""Angle between neighbouring corners of a wedge's rim, at most."""
BELOW_HORIZON = np.radians(0.5)
"""An image with its upper border less than this below the horizon shows the ground to any distance."""


def box_around(scene: Scene) -> tuple[Floats, Floats]:
    """Lower and upper corner, (2,) each, of a ground rectangle around all sensors.

    The margin on each side is 1 scene unit and a tenth of the longer side.
    """
    positions = np.array([s.position[:2] for s in scene.sensors])
    low, high = positions.min(axis=0), positions.max(axis=0)
    pad = SENSOR_MARGIN_M + 0.1 * float(np.max(high - low))
    return low - pad, high + pad


def view_prior(scene: Scene) -> ViewPrior:
    """Mixture prior of target positions on the ground: a circular sector for each camera, a disc for each array.

    Sensors with poses have equal weights, others 0; if no camera has a pose and there is no array, all are equal. Tag
    readers have no part in it, except in the box around the sensors.

    Args:
        scene: with at least one sensor.
    """
    low, high = box_around(scene)
    cameras, arrays = scene.cameras, scene.arrays
    placed = np.array([c.placed for c in cameras] + [True] * len(arrays))
    placed |= not placed.any()
    least = 2.0 * float(np.hypot(*(high - low)))
    metre = 1.0 / METRES.get(scene.length_unit, 1.0)
    far = [sight_limit(c, least, metre if scene.length_unit in METRES else None) for c in cameras]
    far += [a.range if np.isfinite(a.range) else max(DEFAULT_ARRAY_RANGE_M * metre, least) for a in arrays]
    return ViewPrior(
        origin=np.array([c.position[:2] for c in cameras] + [a.position[:2] for a in arrays], dtype=np.float64),
        axis=np.array([c.yaw for c in cameras] + [a.yaw for a in arrays], dtype=np.float64),
        fov=np.array([min(c.fov, 2.0 * np.pi) for c in cameras] + [2.0 * np.pi] * len(arrays), dtype=np.float64),
        far=np.array(far, dtype=np.float64),
        share=placed / np.count_nonzero(placed),
        low=low,
        high=high,
    )


def sight_limit(camera: Camera, least: float, metre: float | None) -> float:
    """Maximum distance at which a camera sees a target, in the scene's unit: its `range` if finite, else estimated.

    The estimate is the distance at which a person takes up the share `MIN_SHARE` of the field of view, at least
    `least`. If the upper image border is below the horizon, it is at most the distance of the farthest visible ground.

    Args:
        camera: with a pose.
        least: twice the extent of the sensors; a person's size does not limit the sight to less.
        metre: a metre in the scene's unit; None: a scene-specific unit, in which half the camera's height, where it is
            known, represents the size of a target.
    """
    if np.isfinite(camera.range):
        return camera.range
    height = float(camera.position[2])
    size = PERSON_HEIGHT_M * metre if metre is not None else 0.5 * abs(height) if height else PERSON_HEIGHT_M
    far = max(size / (MIN_SHARE * min(camera.fov, 2.0 * np.pi)), least)
    upper = highest_elevation(camera)
    if height > size and upper is not None and upper < -BELOW_HORIZON:
        far = min(far, height / np.tan(-upper))
    return float(far)


def highest_elevation(camera: Camera) -> float | None:
    """Highest elevation [rad] above the horizontal of the rays through the image border.

    None if the image size is unknown.
    """
    if camera.image_size is None:
        return None
    rays = _border_rays(
        camera.image_size,
        camera.focal_px,
        camera.principal_px,
        camera.distortion,
        camera.distortion_model,
        camera.rotation,
    )
    return float(np.arctan2(rays[:, 2], np.hypot(rays[:, 0], rays[:, 1])).max())


def visible_region(prior: ViewPrior) -> Floats:
    """(K, 2) convex polygon, counter-clockwise, around the fields of view of all sensors and the box around them.

    It is the convex hull, so that it has no gaps between views, which targets cross.
    """
    (x0, y0), (x1, y1) = prior.low, prior.high
    points = [np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]), prior.origin]
    seeing = prior.share > 0.0
    for origin, axis, fov, far in zip(*(part[seeing] for part in prior[:4]), strict=True):
        n = max(int(np.ceil(fov / STEP)), 1)
        turn = axis + np.linspace(-0.5 * fov, 0.5 * fov, n + 1)
        rim = far / np.cos(0.5 * fov / n)  # the chords of the rim lie outside the circle
        points.append(origin + rim * np.column_stack([np.cos(turn), np.sin(turn)]))
    hull = shapely.convex_hull(shapely.MultiPoint(np.concatenate(points)))
    return np.asarray(shapely.geometry.polygon.orient(hull).exterior.coords)[:-1].astype(np.float64)
