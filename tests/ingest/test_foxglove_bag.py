"""`occlog ingest` of MCAP files with messages of Foxglove, which need no package of ROS."""

from __future__ import annotations

import base64
import json
import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from mcap.writer import Writer

from occlog.cli.main import run
from occlog.core.geometry.camera import rotation_from_angles
from occlog.errors import ExitCode
from occlog.io.recording.reader import open_recording
from occlog.records.tables import Truth

START = 1_700_000_000_000_000_000
Rows = list[tuple[str, str, int, bytes]]


def write(path: Path, rows: Rows, encoding: str) -> Path:
    """Write (topic, type, time, data) of messages; definitions of protobuf are not needed for well-known types."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channels: dict[str, int] = {}
        for topic, kind, t_ns, data in rows:
            if topic not in channels:
                language = "protobuf" if encoding == "protobuf" else "jsonschema"
                schema = writer.register_schema(kind, language, b"{}")
                channels[topic] = writer.register_channel(topic, encoding, schema)
            writer.add_message(channels[topic], t_ns, data, t_ns)
        writer.finish()
    return path


def jpeg() -> bytes:
    return cv2.imencode(".jpg", np.full((48, 64, 3), 90, np.uint8))[1].tobytes()


def test_protobuf_gives_images_lenses_places_and_truth(tmp_path: Path) -> None:
    turn = cv2.Rodrigues(rotation_from_angles(math.radians(60), math.radians(-15), 0.0))[0].reshape(3)
    angle = float(np.linalg.norm(turn))
    q = [*(turn / angle * math.sin(angle / 2)), math.cos(angle / 2)]
    place = FrameTransform(parent_frame_id="map", child_frame_id="left_optical")
    place.translation.x, place.translation.y, place.translation.z = 1, 2, 3
    place.rotation.x, place.rotation.y, place.rotation.z, place.rotation.w = q
    lens = CameraCalibration(frame_id="left_optical", width=64, height=48, distortion_model="plumb_bob")
    lens.K.extend([50, 0, 31.5, 0, 50, 23.5, 0, 0, 1])
    lens.D.extend([-0.1, 0.02, 0, 0, 0])
    rows: Rows = [
        ("/tf", "foxglove.FrameTransform", START, place.SerializeToString()),
        ("/left/calibration", "foxglove.CameraCalibration", START, lens.SerializeToString()),
    ]
    for k in range(3):
        image = CompressedImage(frame_id="left_optical", data=jpeg(), format="jpeg")
        image.timestamp.FromNanoseconds(START + k * 10**8)
        rows.append(("/left/image", "foxglove.CompressedImage", START, image.SerializeToString()))
    pixels = RawImage(frame_id="left_optical", width=64, height=48, encoding="mono8", step=64, data=bytes(64 * 48))
    pixels.timestamp.FromNanoseconds(START)
    rows.append(("/thermal/image", "foxglove.RawImage", START, pixels.SerializeToString()))
    at = PoseInFrame(frame_id="map")
    at.timestamp.FromNanoseconds(START)
    at.pose.position.x, at.pose.position.y = 4, 5
    rows.append(("/walker", "foxglove.PoseInFrame", START, at.SerializeToString()))
    bag, out = write(tmp_path / "b.mcap", rows, "protobuf"), tmp_path / "out.mcap"
    named = ("--topic", "left=/left/image", "--topic", "7=/walker")
    assert run(["ingest", str(bag), "-o", str(out), "-q", *named]) == ExitCode.DONE
    recording = open_recording(out)
    assert [f.t_ns - START for f in recording.frames()] == [0, 10**8, 2 * 10**8]
    assert recording.scene is not None
    (camera,) = recording.scene.cameras
    assert np.allclose(camera.position, [1, 2, 3])
    assert math.degrees(camera.yaw) == pytest.approx(60)
    assert camera.distortion.tolist() == [-0.1, 0.02, 0, 0, 0]
    truth = recording.read(Truth)
    assert (truth.target_id.tolist(), truth.x.tolist(), truth.y.tolist()) == ([7], [4.0], [5.0])


def test_json_gives_images_and_a_damaged_first_one_is_only_one_loss(tmp_path: Path) -> None:
    rows: Rows = []
    for k in range(3):
        data = base64.b64encode(jpeg()[:-20] if k == 0 else jpeg()).decode()
        stamp = {"sec": START // 10**9 + k, "nsec": 5}
        message = {"timestamp": stamp, "frame_id": "cam", "format": "jpeg", "data": data}
        rows.append(("/cam/image", "foxglove.CompressedImage", START, json.dumps(message).encode()))
    bag, out = write(tmp_path / "b.mcap", rows, "json"), tmp_path / "out.mcap"
    assert run(["ingest", str(bag), "-o", str(out), "-q", "--allow-uncalibrated"]) == ExitCode.LOSSY
    recording = open_recording(out)
    assert [f.t_ns - START for f in recording.frames()] == [10**9 + 5, 2 * 10**9 + 5]
    assert [(loss.place, loss.count) for loss in recording.losses] == [("/cam/image", 1)]
