"""Scene files (YAML) to scenes and back.

`schemas/scene.json` is made from the declared keys, their types, limits and meanings.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
import yaml
from msgspec import Meta
from shapely.geometry import Polygon
from shapely.validation import explain_validity

from occlog.array_types import Floats
from occlog.errors import InputError
from occlog.io.files.texts.yaml import parse_yaml, read_yaml
from occlog.records.declared.sensors import MIN_SIGMA_PX, MIN_SIGMA_RAD
from occlog.records.lens import COEFFICIENTS
from occlog.records.names import first_double
from occlog.records.scene import (
    MAX_COORDINATE,
    MAX_FOCAL_PX,
    MAX_SIGMA_DEG,
    MIN_FOCAL_PX,
    MIN_SIGMA_DEG,
    Camera,
    Clock,
    CommonNoise,
    MicrophoneArray,
    Occluder,
    Scene,
    TagReader,
    camera_fov,
    camera_rotation,
)

MAX_RADIANS = 6.2832
"""Largest angle, either way, that is taken to be in radians: a turn."""
MAX_PX = 100_000
"""Width and height of an image at most [px]."""
MAX_OFFSET_NS = 4 * 10**18
"""Maximum offset of a clock, either way: 126 years, so that times plus offsets fit into 64 bits."""
Positive = Annotated[float, Meta(gt=0, le=MAX_COORDINATE)]
Rate = Annotated[float, Meta(ge=1e-9, le=1e6)]
"""[Hz]: periods from a microsecond to 32 years are whole nanoseconds that a time can hold."""
Radians = Annotated[float, Meta(ge=-1e6, le=1e6)]
Degrees = Annotated[float, Meta(ge=-1e6, le=1e6)]
"""Angle [deg]; for larger values rounding leaves no direction."""
SigmaRadians = Annotated[float, Meta(ge=MIN_SIGMA_RAD, le=6.2832)]
SigmaDegrees = Annotated[float, Meta(ge=MIN_SIGMA_DEG, le=MAX_SIGMA_DEG)]
FocalLength = Annotated[float, Meta(ge=MIN_FOCAL_PX, le=MAX_FOCAL_PX)]
Name = Annotated[str, Meta(min_length=1, max_length=64, pattern=r"^(?!\.{1,2}$)[^\s,/=:\x00-\x1f\x7f]+$")]
Coordinate = Annotated[float, Meta(ge=-MAX_COORDINATE, le=MAX_COORDINATE)]
Point2 = tuple[Coordinate, Coordinate]
Point3 = Annotated[list[Coordinate], Meta(min_length=3, max_length=3)]
Place = Annotated[list[Coordinate], Meta(min_length=2, max_length=3)]
Pixel = Annotated[float, Meta(ge=-MAX_FOCAL_PX, le=MAX_FOCAL_PX)]
Corners = Annotated[list[Point2], Meta(min_length=3)]


class SceneFileSpec(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    """Base class of all mappings in a scene file; unknown keys are errors."""


class NoiseSpec(SceneFileSpec, kw_only=True):
    """Standard deviations of a camera's pose and measurements ([Ercan] Eq. 2), and detection probabilities."""

    position: Annotated[
        float, Meta(ge=0, le=MAX_COORDINATE, description="of the camera's position, in the length unit")
    ] = 0.0
    yaw: Annotated[float, Meta(ge=0, le=6.2832, description="of the camera's yaw, in radians")] | None = None
    yaw_deg: Annotated[float, Meta(ge=0, le=360, description="of the camera's yaw, in degrees")] | None = None
    measurement_noise_px: Annotated[
        float, Meta(ge=MIN_SIGMA_PX, le=1e9, description="of a bearing in the image, in pixels")
    ] = 2.0
    detection_probability: (
        Annotated[float, Meta(gt=0, le=1, description="probability that a target in plain view is detected")] | None
    ) = None
    false_alarm_probability: (
        Annotated[float, Meta(ge=0, le=1, description="probability that a target not detected is reported anywhere")]
        | None
    ) = None


class DistortionSpec(SceneFileSpec, kw_only=True):
    """Lens distortion in normalised image coordinates: model and coefficients."""

    model: Literal["brown", "opencv", "tsai", "equidistant"] = "brown"
    coefficients: Annotated[
        list[float],
        Meta(
            max_length=14,
            description="k1, k2, p1, p2, k3; opencv: and k4, k5, k6, s1 to s4, tau_x, tau_y; k1 to k4 of equidistant",
        ),
    ]


class CameraSpec(SceneFileSpec, kw_only=True):
    """A camera in a scene file: intrinsics, pose, field of view and noise; without a pose it gives no bearings."""

    name: Name
    position: Annotated[Place, Meta(description="x, y and, where known, height z")] | None = None
    yaw: Annotated[Radians, Meta(description="azimuth of the optical axis, radians from +x towards +y")] | None = None
    yaw_deg: Degrees | None = None
    pitch: Annotated[Radians, Meta(description="upwards")] | None = None
    pitch_deg: Degrees | None = None
    roll: Annotated[Radians, Meta(description="clockwise, seen from behind the camera")] | None = None
    roll_deg: Degrees | None = None
    rotation: (
        Annotated[
            list[Annotated[list[float], Meta(min_length=3, max_length=3)]],
            Meta(min_length=3, max_length=3, description="world-from-camera matrix by rows, instead of the angles"),
        ]
        | None
    ) = None
    focal_px: Annotated[
        FocalLength | Annotated[list[FocalLength], Meta(min_length=2, max_length=2)],
        Meta(description="one, or x and y"),
    ]
    principal_point_px: Annotated[tuple[Pixel, Pixel], Meta(description="default: the middle of the image")] | None = (
        None
    )
    image_size_px: (
        Annotated[
            list[Annotated[int, Meta(gt=0, le=MAX_PX)]],
            Meta(min_length=2, max_length=2, description="width and height"),
        ]
        | None
    ) = None
    distortion: DistortionSpec | None = None
    fov: Annotated[float, Meta(gt=0, le=6.2832, description="full horizontal field of view, radians")] | None = None
    fov_deg: Annotated[float, Meta(gt=0, le=360)] | None = None
    range: Annotated[Positive, Meta(description="farthest distance at which a target is seen")] | None = None
    noise: NoiseSpec = msgspec.field(default_factory=NoiseSpec)
    rate_hz: Rate | None = None
    clock: Name | None = None


class ArraySpec(SceneFileSpec, kw_only=True):
    """One microphone array, or another sensor that delivers directions only."""

    name: Name
    position: Place
    yaw: Radians | None = None
    yaw_deg: Degrees | None = None
    pitch: Radians | None = None
    pitch_deg: Degrees | None = None
    roll: Radians | None = None
    roll_deg: Degrees | None = None
    microphones: Annotated[list[Point3], Meta(description="positions in the array's frame")] = []
    sigma: SigmaRadians | None = None
    sigma_deg: SigmaDegrees | None = None
    sigma_elevation: SigmaRadians | None = None
    sigma_elevation_deg: SigmaDegrees | None = None
    resolution: (
        Annotated[
            float,
            Meta(ge=0, le=6.2832, description="directions nearer to each other than this are heard as one, radians"),
        ]
        | None
    ) = None
    resolution_deg: Annotated[float, Meta(ge=0, le=360)] | None = None
    planar: Annotated[bool, Meta(description="measures no elevation")] = False
    range: Positive | None = None
    rate_hz: Rate | None = None
    clock: Name | None = None


class ReaderSpec(SceneFileSpec, kw_only=True):
    """A reader of radio tags in a scene file."""

    name: Name
    position: Place
    range: Annotated[Positive, Meta(description="farthest distance on the ground at which it reads a tag")] | None = (
        None
    )
    power: (
        Annotated[float, Meta(ge=-200, le=100, description="strength of a tag's signal at a distance of 1 m, dBm")]
        | None
    ) = None
    rate_hz: Rate | None = None
    clock: Name | None = None


class OccluderSpec(SceneFileSpec, kw_only=True):
    """A static occluder in a scene file: a polygon on the ground and a height."""

    name: Name
    polygon: Corners
    height: Positive = 2.5


class ClockSpec(SceneFileSpec, kw_only=True):
    """Clock: world time = sensor time - offset - drift x (sensor time - start)."""

    name: Name
    offset_ns: Annotated[int, Meta(ge=-MAX_OFFSET_NS, le=MAX_OFFSET_NS)] = 0
    drift_ppm: Annotated[float, Meta(gt=-1e6, lt=1e6)] = 0.0


class CommonNoiseSpec(SceneFileSpec, kw_only=True):
    """Standard deviations of a similarity transform of the ground that is common to all cameras."""

    center: Annotated[Point2, Meta(description="x and y, about which all cameras are turned and scaled")]
    position: Annotated[
        float, Meta(ge=0, le=MAX_COORDINATE, description="of x and y of all cameras, in the length unit")
    ] = 0.0
    yaw_deg: Annotated[float, Meta(ge=0, le=360, description="of the direction of all cameras, in degrees")] = 0.0
    scale: Annotated[float, Meta(ge=0, le=10, description="of all lengths, relative")] = 0.0


class SceneSpec(SceneFileSpec, kw_only=True):
    """Content of a scene file: room, static occluders, sensors and clocks, in one unit of length."""

    occlog_scene: Annotated[Literal[1], Meta(description="version of this format")]
    length_unit: Annotated[Literal["m", "unit", "ft", "in", "px"], Meta(description="unit of every length")] = "m"
    room: Annotated[Corners, Meta(description="corners of the floor")] | None = None
    room_height: Positive = 2.5
    static_occluders: list[OccluderSpec] = []
    cameras: list[CameraSpec] = []
    microphone_arrays: list[ArraySpec] = []
    readers: list[ReaderSpec] = []
    clocks: list[ClockSpec] = []
    common_noise: CommonNoiseSpec | None = None


OLD_NOISE_KEYS = {
    "read_px": "measurement_noise_px",
    "detection": "detection_probability",
    "false_alarm": "false_alarm_probability",
}
"""Keys of `noise` in scenes, and in recordings, of the last release."""


def _renamed(raw: dict[str, Any]) -> dict[str, Any]:
    """Copy of the values of a scene file in which keys of the last release (`OLD_NOISE_KEYS`) have their new names."""

    def camera(given: Any) -> Any:
        noise = given.get("noise") if isinstance(given, dict) else None
        if not isinstance(noise, dict):
            return given
        names = {key: new for key, new in OLD_NOISE_KEYS.items() if key in noise and new not in noise}
        return given | {"noise": {names.get(key, key): value for key, value in noise.items()}}

    cameras = raw.get("cameras")
    return raw | {"cameras": [camera(each) for each in cameras]} if isinstance(cameras, list) else raw


def read_scene(path: Path) -> Scene:
    """Read a scene from a YAML file; InputError names line, key, value and limit of a fault."""
    spec = read_yaml(path, SceneSpec, "a scene file (YAML)", _renamed)
    return _build(spec, str(path))


def scene_from_yaml(text: str, source: str) -> Scene:
    """Parse a scene from YAML text; InputError names the fault, with `source` as its file."""
    return _build(parse_yaml(text, source, SceneSpec, _renamed), source)


def _plain(value: object) -> object:
    """Python number for a NumPy scalar, for serialisation; TypeError for other values."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"a scene with {value!r} cannot be written as YAML; numbers and texts were expected")


def scene_to_yaml(scene: Scene) -> str:
    """Format a scene as YAML text, from which `scene_from_yaml` makes an equal scene."""
    raw = msgspec.to_builtins(_spec(scene), enc_hook=_plain)
    return yaml.safe_dump(raw, sort_keys=False, default_flow_style=None, width=110, allow_unicode=True)


def _build(spec: SceneSpec, source: str) -> Scene:
    room = _polygon(spec.room, f"{source}: room") if spec.room is not None else None
    scene = Scene(
        cameras=tuple(_camera(c, f"{source}: camera {c.name}") for c in spec.cameras),
        arrays=tuple(_array(a, f"{source}: microphone array {a.name}") for a in spec.microphone_arrays),
        readers=tuple(
            TagReader(r.name, _place(r.position), r.range or math.inf, r.power, r.rate_hz, r.clock)
            for r in spec.readers
        ),
        occluders=tuple(
            Occluder(o.name, _polygon(o.polygon, f"{source}: static occluder {o.name}"), o.height)
            for o in spec.static_occluders
        ),
        clocks=tuple(Clock(c.name, c.offset_ns, c.drift_ppm) for c in spec.clocks),
        room=room,
        room_height=spec.room_height,
        length_unit=spec.length_unit,
        common_noise=_common_noise(spec.common_noise),
    )
    _check_names(scene, source)
    return scene


def _common_noise(spec: CommonNoiseSpec | None) -> CommonNoise | None:
    if spec is None:
        return None
    return CommonNoise(spec.center, spec.position, math.radians(spec.yaw_deg), spec.scale)


def _check_names(scene: Scene, source: str) -> None:
    if (double := first_double([s.name for s in scene.sensors])) is not None:
        raise InputError(f"{source}: two sensors are named {double!r}; names must differ", id="duplicate-name")
    if (double := first_double([c.name for c in scene.clocks])) is not None:
        raise InputError(f"{source}: two clocks are named {double!r}; names must differ", id="duplicate-name")
    clocks = {c.name for c in scene.clocks}
    for sensor, clock in ((s.name, s.clock) for s in scene.sensors):
        if clock is not None and clock not in clocks:
            known = ", ".join(sorted(clocks)) or "none"
            raise InputError(
                f"{source}: {sensor}: clock {clock!r} is not defined; define it in clocks, or name one of: {known}",
                id="unknown-name",
            )


def _polygon(corners: list[tuple[float, float]], where: str) -> Floats:
    """(K, 2) corners of a polygon, counter-clockwise; InputError unless it is simple and has an area.

    `where` is the file and object, for messages.
    """
    polygon = Polygon(corners)
    if not np.all(np.isfinite(np.asarray(corners))):
        raise InputError(f"{where}: corners must be finite numbers")
    with np.errstate(all="ignore"):  # too large values have no area
        sound = polygon.is_valid and 0.0 < polygon.area < math.inf
        why = "" if sound else explain_validity(polygon)
    if not sound:
        raise InputError(f"{where}: not a simple polygon with an area ({why}); list the corners in order around it")
    points = np.asarray(corners, dtype=np.float64)
    return points if polygon.exterior.is_ccw else points[::-1].copy()


def _angle(radians: float | None, degrees: float | None, key: str, where: str) -> float | None:
    """Angle [rad] that a scene file states in radians or degrees; None: in neither.

    Args:
        radians: value of the key `key`.
        degrees: value of the key with `_deg` appended.
        key: name of the key, for messages.
        where: file and object, for messages.

    Raises:
        InputError: both are given, or the radians are more than a turn.
    """
    if radians is not None and degrees is not None:
        raise InputError(f"{where}: both {key} and {key}_deg are given; keep one", id="conflicting-values")
    if radians is not None and abs(radians) > MAX_RADIANS:
        raise InputError(
            f"{where}: {key} is {radians:g}, more than a turn in radians; if it is in degrees, name it {key}_deg",
            id="unit-mismatch",
        )
    return math.radians(degrees) if degrees is not None else radians


def _camera(spec: CameraSpec, where: str) -> Camera:
    focal = np.broadcast_to(np.asarray(spec.focal_px, dtype=np.float64), (2,)).copy()
    size = (spec.image_size_px[0], spec.image_size_px[1]) if spec.image_size_px else None
    rotation, placed = _rotation(spec, where)
    middle = ((size[0] - 1) / 2, (size[1] - 1) / 2) if size else (0.0, 0.0)
    principal = np.asarray(spec.principal_point_px or middle, dtype=np.float64)
    distortion, model = _distortion(spec.distortion, where)
    fov = _angle(spec.fov, spec.fov_deg, "fov", where)
    if fov is None:
        if size is None:
            raise InputError(f"{where}: give fov_deg, or image_size_px to compute it", id="missing-image-size")
        fov = camera_fov(size, focal, principal, distortion, model, rotation)
    return Camera(
        name=spec.name,
        position=_place(spec.position or [0.0, 0.0]),
        rotation=rotation,
        focal_px=focal,
        principal_px=principal,
        image_size=size,
        distortion=distortion,
        distortion_model=model,
        fov=fov,
        range=spec.range or math.inf,
        sigma_position=spec.noise.position,
        sigma_yaw=_angle(spec.noise.yaw, spec.noise.yaw_deg, "noise.yaw", where) or 0.0,
        sigma_read_px=spec.noise.measurement_noise_px,
        detection=spec.noise.detection_probability,
        false_alarm=spec.noise.false_alarm_probability,
        rate_hz=spec.rate_hz,
        clock=spec.clock,
        placed=placed,
    )


def _distortion(spec: DistortionSpec | None, where: str) -> tuple[Floats, str]:
    if spec is None:
        return np.zeros(5), "brown"
    coefficients = np.zeros(COEFFICIENTS[spec.model])
    if len(spec.coefficients) > len(coefficients):
        raise InputError(
            f"{where}: {len(spec.coefficients)} distortion coefficients; model {spec.model} has at most "
            f"{len(coefficients)}; omit those beyond, or name a model with more (`model: opencv` has 14)",
            id="invalid-calibration",
        )
    coefficients[: len(spec.coefficients)] = spec.coefficients
    return coefficients, spec.model


def _rotation(spec: CameraSpec, where: str) -> tuple[Floats, bool]:
    """World-from-camera rotation (3, 3) of a camera in a scene file, and whether the camera has a pose.

    The rotation is stated as a matrix or by angles; without a pose it is that of yaw, pitch and roll 0.

    Args:
        spec: camera in the file.
        where: file and camera, for messages.

    Raises:
        InputError: only a part of the pose is stated, both matrix and angles are, or the matrix is not a rotation.
    """
    angles = [_angle(getattr(spec, k), getattr(spec, f"{k}_deg"), k, where) for k in ("yaw", "pitch", "roll")]
    if spec.rotation is not None:
        if any(a is not None for a in angles):
            raise InputError(f"{where}: both a rotation matrix and angles are given; keep one", id="conflicting-values")
        matrix = np.asarray(spec.rotation, dtype=np.float64)
        error = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
        if not error < 1e-3 or np.linalg.det(matrix) < 0:
            raise InputError(
                f"{where}: rotation is not orthonormal (off by {error:.2g}, limit 0.001) or has determinant -1; "
                "correct it",
                id="invalid-calibration",
            )
        return matrix, spec.position is not None
    if spec.position is None:
        if any(a is not None for a in angles):
            raise InputError(f"{where}: has angles but no position; add it, or omit the angles too", id="missing-value")
        return camera_rotation(0.0, 0.0, 0.0), False
    if angles[0] is None:
        raise InputError(f"{where}: has a position but no yaw_deg; add it", id="missing-pose")
    return camera_rotation(angles[0], angles[1] or 0.0, angles[2] or 0.0), True


def _place(values: list[float]) -> Floats:
    return np.array([*values, 0.0][:3], dtype=np.float64)


def _array(spec: ArraySpec, where: str) -> MicrophoneArray:
    return MicrophoneArray(
        name=spec.name,
        position=_place(spec.position),
        yaw=_angle(spec.yaw, spec.yaw_deg, "yaw", where) or 0.0,
        microphones=np.asarray(spec.microphones, dtype=np.float64).reshape(-1, 3),
        sigma=_angle(spec.sigma, spec.sigma_deg, "sigma", where) or math.radians(3.0),
        range=spec.range or math.inf,
        rate_hz=spec.rate_hz,
        clock=spec.clock,
        pitch=_angle(spec.pitch, spec.pitch_deg, "pitch", where) or 0.0,
        roll=_angle(spec.roll, spec.roll_deg, "roll", where) or 0.0,
        sigma_elevation=_angle(spec.sigma_elevation, spec.sigma_elevation_deg, "sigma_elevation", where),
        resolution=_angle(spec.resolution, spec.resolution_deg, "resolution", where) or 0.0,
        planar=spec.planar,
    )


def _floats(values: Floats) -> list[float]:
    return [float(value) for value in values]


def _rows(values: Floats) -> list[list[float]]:
    return [_floats(row) for row in values]


def _corners(polygon: Floats) -> list[Point2]:
    return [(float(x), float(y)) for x, y in polygon]


def _spec(scene: Scene) -> SceneSpec:
    common = scene.common_noise
    return SceneSpec(
        occlog_scene=1,
        length_unit=scene.length_unit,  # type: ignore[arg-type]
        room=_corners(scene.room) if scene.room is not None else None,
        room_height=scene.room_height,
        static_occluders=[
            OccluderSpec(name=o.name, polygon=_corners(o.polygon), height=o.height) for o in scene.occluders
        ],
        cameras=[_camera_spec(c) for c in scene.cameras],
        microphone_arrays=[_array_spec(a) for a in scene.arrays],
        readers=[_reader_spec(r) for r in scene.readers],
        clocks=[ClockSpec(name=c.name, offset_ns=c.offset_ns, drift_ppm=c.drift_ppm) for c in scene.clocks],
        common_noise=None if common is None else _common_noise_spec(common),
    )


def _common_noise_spec(common: CommonNoise) -> CommonNoiseSpec:
    yaw_deg = math.degrees(common.yaw)
    return CommonNoiseSpec(center=common.center, position=common.position, yaw_deg=yaw_deg, scale=common.scale)


def _camera_spec(c: Camera) -> CameraSpec:
    distortion = DistortionSpec(model=c.distortion_model, coefficients=_floats(c.distortion))  # type: ignore[arg-type]
    return CameraSpec(
        name=c.name,
        position=_floats(c.position) if c.placed else None,
        rotation=_rows(c.rotation) if c.placed else None,
        focal_px=_floats(c.focal_px),
        principal_point_px=(float(c.principal_px[0]), float(c.principal_px[1])),
        image_size_px=list(c.image_size) if c.image_size else None,
        distortion=None if c.straight else distortion,
        fov=c.fov,
        range=None if math.isinf(c.range) else c.range,
        noise=NoiseSpec(
            position=c.sigma_position,
            yaw=c.sigma_yaw,
            measurement_noise_px=c.sigma_read_px,
            detection_probability=c.detection,
            false_alarm_probability=c.false_alarm,
        ),
        rate_hz=c.rate_hz,
        clock=c.clock,
    )


def _array_spec(a: MicrophoneArray) -> ArraySpec:
    return ArraySpec(
        name=a.name,
        position=_floats(a.position),
        yaw=a.yaw,
        microphones=_rows(a.microphones),
        sigma=a.sigma,
        range=None if math.isinf(a.range) else a.range,
        rate_hz=a.rate_hz,
        clock=a.clock,
        pitch=a.pitch or None,
        roll=a.roll or None,
        sigma_elevation=a.sigma_elevation,
        resolution=a.resolution or None,
        planar=a.planar,
    )


def _reader_spec(r: TagReader) -> ReaderSpec:
    return ReaderSpec(
        name=r.name,
        position=_floats(r.position),
        range=None if math.isinf(r.range) else r.range,
        power=r.power,
        rate_hz=r.rate_hz,
        clock=r.clock,
    )
