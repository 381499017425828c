"""Bags of ROS 2 as a recorder makes them: messages in CDR with their definitions, in MCAP or SQLite files."""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from occlog.core.geometry.camera import rotation_from_angles

START = 1_700_000_000_000_000_000
STEP = 50_000_000
STORE = get_typestore(Stores.ROS2_JAZZY)
for _name, _text in {
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score\n",
    "vision_msgs/msg/ObjectHypothesisWithPose": "vision_msgs/ObjectHypothesis hypothesis\n"
    "geometry_msgs/PoseWithCovariance pose\n",
    "vision_msgs/msg/Point2D": "float64 x\nfloat64 y\n",
    "vision_msgs/msg/Pose2D": "vision_msgs/Point2D position\nfloat64 theta\n",
    "vision_msgs/msg/BoundingBox2D": "vision_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y\n",
    "vision_msgs/msg/Detection2D": "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
    "vision_msgs/BoundingBox2D bbox\nstring id\n",
    "vision_msgs/msg/Detection2DArray": "std_msgs/Header header\nvision_msgs/Detection2D[] detections\n",
    "odas_ros_msgs/msg/OdasSst": "int64 id\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 activity\n",
    "odas_ros_msgs/msg/OdasSstArrayStamped": "std_msgs/Header header\nodas_ros_msgs/OdasSst[] sources\n",
}.items():
    STORE.register(get_types_from_msg(_text, _name))
Row = tuple[str, str, int, Any]
"""Topic, type, time of recording, message."""


def make(kind: str, **values: Any) -> Any:
    """A message of a type; `a__b` stands for the field b of the field a's type."""
    return STORE.types[kind](**values)


def header(t_ns: int, frame: str) -> Any:
    stamp = make("builtin_interfaces/msg/Time", sec=t_ns // 10**9, nanosec=t_ns % 10**9)
    return make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def picture(number: int, size: tuple[int, int] = (64, 48)) -> np.ndarray:
    """An image whose left half is as bright as its number says."""
    image = np.full((size[1], size[0], 3), 200, np.uint8)
    image[:, : size[0] // 2] = 10 * (number % 20)
    return image


def compressed(t_ns: int, frame: str, image: np.ndarray, kind: str = "jpeg") -> Any:
    data = cv2.imencode(f".{'jpg' if kind == 'jpeg' else kind}", image)[1]
    return make("sensor_msgs/msg/CompressedImage", header=header(t_ns, frame), format=kind, data=data.reshape(-1))


def raw(t_ns: int, frame: str, pixels: np.ndarray, encoding: str, step: int | None = None) -> Any:
    height, width = pixels.shape[:2]
    rows = pixels.reshape(height, -1)
    if step is not None:
        rows = np.pad(rows, ((0, 0), (0, step - rows.shape[1])))
    return make(
        "sensor_msgs/msg/Image", header=header(t_ns, frame), height=height, width=width, encoding=encoding,
        is_bigendian=0, step=rows.shape[1], data=rows.reshape(-1),
    )  # fmt: skip


def camera_info(t_ns: int, frame: str, **values: Any) -> Any:
    """A calibration of a camera of 64 x 48 px and f = 50 px, unless `values` say otherwise."""
    k = np.array([50.0, 0, 31.5, 0, 50.0, 23.5, 0, 0, 1])
    roi = make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    reported = {
        "height": 48, "width": 64, "distortion_model": "plumb_bob", "d": np.zeros(5), "k": k,
        "r": np.eye(3).reshape(-1), "p": np.insert(k.reshape(3, 3), 3, 0, axis=1).reshape(-1), "binning_x": 0,
        "binning_y": 0, "roi": roi, **values,
    }  # fmt: skip
    return make("sensor_msgs/msg/CameraInfo", header=header(t_ns, frame), **reported)


def quaternion(rotation: np.ndarray) -> tuple[float, float, float, float]:
    """x, y, z, w of a rotation of less than 180 degrees, by its axis and angle."""
    vector = cv2.Rodrigues(rotation)[0].reshape(3)
    angle = float(np.linalg.norm(vector))
    axis = vector / angle if angle > 1e-12 else vector
    return (*(axis * math.sin(angle / 2)), math.cos(angle / 2))  # type: ignore[return-value]


def transforms(t_ns: int, *frames: tuple[str, str, Sequence[float], np.ndarray]) -> Any:
    """A TFMessage of (parent, child, translation, rotation)."""
    vector, turn = "geometry_msgs/msg/Vector3", "geometry_msgs/msg/Quaternion"
    out = []
    for parent, child, place, rotation in frames:
        x, y, z, w = quaternion(rotation)
        pose = make(
            "geometry_msgs/msg/Transform",
            translation=make(vector, x=float(place[0]), y=float(place[1]), z=float(place[2])),
            rotation=make(turn, x=x, y=y, z=z, w=w),
        )
        kind = "geometry_msgs/msg/TransformStamped"
        out.append(make(kind, header=header(t_ns, parent), child_frame_id=child, transform=pose))
    return make("tf2_msgs/msg/TFMessage", transforms=out)


def pose(t_ns: int, frame: str, place: Sequence[float]) -> Any:
    at = make("geometry_msgs/msg/Point", x=float(place[0]), y=float(place[1]), z=float(place[2]))
    upright = make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    placed = make("geometry_msgs/msg/Pose", position=at, orientation=upright)
    return make("geometry_msgs/msg/PoseStamped", header=header(t_ns, frame), pose=placed)


def fix(t_ns: int, latitude: float, longitude: float, altitude: float, status: int = 0) -> Any:
    """A position of a satellite receiver in the frame of its antenna."""
    return make(
        "sensor_msgs/msg/NavSatFix", header=header(t_ns, "gps"),
        status=make("sensor_msgs/msg/NavSatStatus", status=status, service=1),
        latitude=latitude, longitude=longitude, altitude=altitude,
        position_covariance=np.zeros(9), position_covariance_type=0,
    )  # fmt: skip


def detections(t_ns: int, *boxes: tuple[float, float, float, float, float, str, str]) -> Any:
    """Boxes of left, top, width, height, score, class and identity."""
    nothing = STORE.types["geometry_msgs/msg/PoseWithCovariance"]
    at = make("geometry_msgs/msg/Point", x=0.0, y=0.0, z=0.0)
    upright = make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    unused = nothing(pose=make("geometry_msgs/msg/Pose", position=at, orientation=upright), covariance=np.zeros(36))
    out = []
    for left, top, width, height, score, label, identity in boxes:
        guess = make("vision_msgs/msg/ObjectHypothesis", class_id=label, score=score)
        centre = make(
            "vision_msgs/msg/Pose2D",
            position=make("vision_msgs/msg/Point2D", x=left + width / 2, y=top + height / 2), theta=0.0,
        )  # fmt: skip
        out.append(
            make(
                "vision_msgs/msg/Detection2D",
                header=header(t_ns, "front"),
                id=identity,
                results=[make("vision_msgs/msg/ObjectHypothesisWithPose", hypothesis=guess, pose=unused)],
                bbox=make("vision_msgs/msg/BoundingBox2D", center=centre, size_x=width, size_y=height),
            )
        )
    return make("vision_msgs/msg/Detection2DArray", header=header(t_ns, "front"), detections=out)


def sounds(t_ns: int, *sources: tuple[int, float, float, float, float]) -> Any:
    kind = "odas_ros_msgs/msg/OdasSst"
    heard = [make(kind, id=i, x=x, y=y, z=z, activity=a) for i, x, y, z, a in sources]
    return make("odas_ros_msgs/msg/OdasSstArrayStamped", header=header(t_ns, "odas"), sources=heard)


def two_cameras(frames: int = 6, delay_ns: int = 3_000_000) -> list[Row]:
    """Two cameras at (0, 0, 2) and (4, 0, 2), yaw 30 and 150 degrees, in the frame `map`, recorded after a delay."""
    rows: list[Row] = []
    frame_of = {"front": "front_optical", "back": "back_optical"}
    places = {"front": ((0.0, 0.0, 2.0), 30.0), "back": ((4.0, 0.0, 2.0), 150.0)}
    still = [
        ("map", frame_of[name], at, rotation_from_angles(math.radians(yaw), 0.0, 0.0))
        for name, (at, yaw) in places.items()
    ]
    rows.append(("/tf_static", "tf2_msgs/msg/TFMessage", START, transforms(START, *still)))
    for k in range(frames):
        t = START + k * STEP
        for name, frame in frame_of.items():
            info, image = camera_info(t, frame), compressed(t, frame, picture(k))
            rows.append((f"/cam_{name}/camera_info", "sensor_msgs/msg/CameraInfo", t + delay_ns, info))
            topic = f"/cam_{name}/image_raw/compressed"
            rows.append((topic, "sensor_msgs/msg/CompressedImage", t + delay_ns, image))
    return rows


def serialized(row: Row) -> bytes:
    return bytes(STORE.serialize_cdr(row[3], row[1]))


def write_mcap(path: Path, rows: Iterable[Row], *, chunk_size: int = 4096, finish: bool = True) -> Path:
    """Write an MCAP file as rosbag2 does."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=chunk_size, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="test")
        channels: dict[str, int] = {}
        for row in rows:
            topic, kind, t_ns, _ = row
            if topic not in channels:
                text = STORE.generate_msgdef(kind, ros_version=2)[0]
                schema = writer.register_schema(kind, "ros2msg", text.encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], t_ns, serialized(row), t_ns)
        if finish:
            writer.finish()
    return path


def write_db3(path: Path, rows: Sequence[Row]) -> Path:
    """Write a SQLite file as rosbag2 of ROS 2 Humble does, without definitions of types."""
    base = sqlite3.connect(path)
    base.execute(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, "
        "serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL)"
    )
    base.execute(
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, "
        "data BLOB NOT NULL)"
    )
    numbers: dict[str, int] = {}
    for row in rows:
        topic, kind, t_ns, _ = row
        if topic not in numbers:
            numbers[topic] = len(numbers) + 1
            base.execute("INSERT INTO topics VALUES(?, ?, ?, 'cdr', '')", (numbers[topic], topic, kind))
        data = serialized(row)
        base.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)", (numbers[topic], t_ns, data))
    base.commit()
    base.close()
    return path


def write_metadata(folder: Path, files: Sequence[str], counts: Mapping[str, int], mode: str = "") -> None:
    """Write the `metadata.yaml` of rosbag2."""
    lines = ["rosbag2_bagfile_information:", "  version: 8", "  storage_identifier: mcap", "  relative_file_paths:"]
    lines += [f"    - {name}" for name in files]
    lines += ["  topics_with_message_count:"]
    for name, count in counts.items():
        lines += [f"    - topic_metadata: {{name: {name}, type: x}}", f"      message_count: {count}"]
    lines += [f'  compression_mode: "{mode}"']
    (folder / "metadata.yaml").write_text("\n".join(lines) + "\n")
