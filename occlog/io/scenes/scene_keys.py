"""The keys of a scene file, with types, limits and meanings: `schemas/scene.json` is made from this."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

Positive = Annotated[float, Meta(gt=0)]
Name = Annotated[str, Meta(min_length=1, max_length=64, pattern=r"^[^\s,/=:]+$")]
Point2 = tuple[float, float]
Place = Annotated[list[float], Meta(min_length=2, max_length=3)]
Polygon = Annotated[list[Point2], Meta(min_length=3)]


class Spec(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    """Base of all parts: unknown keys are errors."""


class NoiseSpec(Spec, kw_only=True):
    """Standard deviations of [Ercan] Eq. 2, and how reliable detection is."""

    position: Annotated[float, Meta(ge=0, description="of the camera's position, in the length unit")] = 0.0
    yaw: Annotated[float, Meta(ge=0, description="of the camera's yaw, in radians")] | None = None
    yaw_deg: Annotated[float, Meta(ge=0, description="of the camera's yaw, in degrees")] | None = None
    read_px: Annotated[float, Meta(gt=0, description="of a reading in the image, in pixels")] = 2.0
    detection: (
        Annotated[float, Meta(gt=0, le=1, description="probability that a target in plain view is detected")] | None
    ) = None
    false_alarm: (
        Annotated[float, Meta(ge=0, le=1, description="probability that a target not detected is reported anywhere")]
        | None
    ) = None


class DistortionSpec(Spec, kw_only=True):
    """Lens distortion on normalised image coordinates."""

    model: Literal["brown", "tsai"] = "brown"
    coefficients: Annotated[list[float], Meta(max_length=5, description="k1, k2, p1, p2, k3")]


class CameraSpec(Spec, kw_only=True):
    """One camera."""

    name: Name
    position: Annotated[Place, Meta(description="x, y and, where known, height z")] | None = None
    yaw: Annotated[float, Meta(description="azimuth of the optical axis, radians from +x towards +y")] | None = None
    yaw_deg: float | None = None
    pitch: Annotated[float, Meta(description="upwards")] | None = None
    pitch_deg: float | None = None
    roll: Annotated[float, Meta(description="clockwise, seen from behind the camera")] | None = None
    roll_deg: float | None = None
    rotation: (
        Annotated[
            list[Annotated[list[float], Meta(min_length=3, max_length=3)]],
            Meta(min_length=3, max_length=3, description="world-from-camera matrix by rows, instead of the angles"),
        ]
        | None
    ) = None
    focal_px: Annotated[
        Positive | Annotated[list[Positive], Meta(min_length=2, max_length=2)], Meta(description="one, or x and y")
    ]
    principal_point_px: Annotated[Point2, Meta(description="default: the middle of the image")] | None = None
    image_size_px: (
        Annotated[list[Annotated[int, Meta(gt=0)]], Meta(min_length=2, max_length=2, description="width and height")]
        | None
    ) = None
    distortion: DistortionSpec | None = None
    fov: Annotated[float, Meta(gt=0, le=6.2832, description="full horizontal field of view, radians")] | None = None
    fov_deg: Annotated[float, Meta(gt=0, le=360)] | None = None
    range: Annotated[float, Meta(gt=0, description="farthest distance at which a target is seen")] | None = None
    noise: NoiseSpec = msgspec.field(default_factory=NoiseSpec)
    rate_hz: Positive | None = None
    clock: Name | None = None


class ArraySpec(Spec, kw_only=True):
    """One microphone array, or another sensor that delivers directions only."""

    name: Name
    position: Place
    yaw: float | None = None
    yaw_deg: float | None = None
    pitch: float | None = None
    pitch_deg: float | None = None
    roll: float | None = None
    roll_deg: float | None = None
    microphones: Annotated[
        list[Annotated[list[float], Meta(min_length=3, max_length=3)]],
        Meta(description="positions in the array's frame"),
    ] = []
    sigma: Positive | None = None
    sigma_deg: Positive | None = None
    sigma_elevation: Positive | None = None
    sigma_elevation_deg: Positive | None = None
    resolution: (
        Annotated[float, Meta(ge=0, description="directions nearer to each other than this are heard as one, radians")]
        | None
    ) = None
    resolution_deg: Annotated[float, Meta(ge=0)] | None = None
    planar: Annotated[bool, Meta(description="tells no elevation")] = False
    range: Positive | None = None
    rate_hz: Positive | None = None
    clock: Name | None = None


class OccluderSpec(Spec, kw_only=True):
    """One static occluder."""

    name: Name
    polygon: Polygon
    height: Positive = 2.5


class ClockSpec(Spec, kw_only=True):
    """World time = sensor time - offset - drift x (sensor time - start)."""

    name: Name
    offset_ns: int = 0
    drift_ppm: float = 0.0


class SceneSpec(Spec, kw_only=True):
    """A scene file."""

    occlog_scene: Annotated[Literal[1], Meta(description="version of this format")]
    length_unit: Annotated[Literal["m", "unit", "ft", "in", "px"], Meta(description="unit of every length")] = "m"
    room: Annotated[Polygon, Meta(description="corners of the floor")] | None = None
    room_height: Positive = 2.5
    static_occluders: list[OccluderSpec] = []
    cameras: list[CameraSpec] = []
    microphone_arrays: list[ArraySpec] = []
    clocks: list[ClockSpec] = []
