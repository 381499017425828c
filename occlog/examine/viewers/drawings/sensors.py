"""Where sensors are and how cameras see, as messages of Foxglove."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

from occlog.array_types import Floats
from occlog.records.scene import Camera, MicrophoneArray, Scene

WORLD = "world"
MODELS = {"brown": ("plumb_bob", 5), "equidistant": ("kannala_brandt", 4)}
"""Models of distortion by our names: the viewers' name, and how many coefficients it has."""


def world_of(scene: Scene | None) -> str:
    """Name of the world's frame of reference; those of sensors have their names."""
    names = () if scene is None else [sensor.name for sensor in scene.sensors]
    return WORLD if WORLD not in names else f"{WORLD}_"


def placed(scene: Scene) -> list[Camera | MicrophoneArray]:
    """The sensors whose poses are known."""
    return [*(camera for camera in scene.cameras if camera.placed), *scene.arrays]


def frame_transforms(scene: Scene, t_ns: int, metres: float) -> bytes:
    """A `foxglove.FrameTransforms` with the pose of each sensor in the world; lengths in metres, `metres` a unit."""
    message = FrameTransforms()
    for sensor in placed(scene):
        entry = message.transforms.add(parent_frame_id=world_of(scene), child_frame_id=sensor.name)
        entry.timestamp.FromNanoseconds(t_ns)
        place, turn = entry.translation, entry.rotation
        place.x, place.y, place.z = (metres * sensor.position).tolist()
        turn.x, turn.y, turn.z, turn.w = quaternion(sensor.rotation).tolist()
    data: bytes = message.SerializeToString(deterministic=True)
    return data


def camera_calibration(camera: Camera, size: tuple[int, int], t_ns: int) -> bytes:
    """A `foxglove.CameraCalibration` for images of `size` (width, height).

    The model of distortion that viewers do not know (`tsai`) is left out: what they project themselves is then
    off towards the edges of images.
    """
    fx, fy = camera.focal_px.tolist()
    cx, cy = camera.principal_px.tolist()
    model, count = MODELS.get(camera.distortion_model, ("", 0))
    message = CameraCalibration(
        frame_id=camera.name,
        width=size[0],
        height=size[1],
        distortion_model=model,
        D=camera.distortion[:count].tolist(),
        K=[fx, 0, cx, 0, fy, cy, 0, 0, 1],
        R=[1, 0, 0, 0, 1, 0, 0, 0, 1],
        P=[fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0],
    )
    message.timestamp.FromNanoseconds(t_ns)
    data: bytes = message.SerializeToString(deterministic=True)
    return data


def smaller_camera(camera: Camera, shrunk: float) -> Camera:
    """The camera of images that are made smaller."""
    return replace(
        camera,
        focal_px=shrunk * camera.focal_px,
        principal_px=shrunk * (camera.principal_px + 0.5) - 0.5,
        image_size=None,
    )


def quaternion(rotation: Floats) -> Floats:
    """(4,) x, y, z, w >= 0 of a rotation (3, 3): the eigenvector of Bar-Itzhack's matrix, stable for all angles."""
    r = rotation
    k = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], 0, 0, 0],
            [r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], 0, 0],
            [r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1], 0],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], r[0, 0] + r[1, 1] + r[2, 2]],
        ]
    )
    q = np.asarray(np.linalg.eigh(k)[1][:, -1])
    return q if q[3] >= 0 or math.isclose(q[3], 0.0) else -q
