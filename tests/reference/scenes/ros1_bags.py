"""Bags of ROS 1 with the messages of `ros_bags`, by the writer of rosbags."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from ros_bags import Row
from rosbags.interfaces import Nodetype
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

STORE = get_typestore(Stores.ROS1_NOETIC)
for _name, _text in {
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
    "tf/msg/tfMessage": "geometry_msgs/TransformStamped[] transforms\n",
    "vision_msgs/msg/ObjectHypothesisWithPose": "int64 id\nfloat64 score\ngeometry_msgs/PoseWithCovariance pose\n",
    "vision_msgs/msg/BoundingBox2D": "geometry_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y\n",
    "vision_msgs/msg/Detection2D": "Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
    "vision_msgs/BoundingBox2D bbox\nbool is_tracking\nstring tracking_id\n",
    "vision_msgs/msg/Detection2DArray": "Header header\nvision_msgs/Detection2D[] detections\n",
}.items():
    STORE.register(get_types_from_msg(_text, _name))
COMPRESSIONS = {"bz2": Writer.CompressionFormat.BZ2, "lz4": Writer.CompressionFormat.LZ4}


def of_ros1(message: Any, kind: str) -> Any:
    """A message of ROS 2 with the fields of ROS 1."""
    return _value(message, (Nodetype.NAME, kind))


def _value(value: Any, of: Any) -> Any:
    node, inner = of
    if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        return [_value(each, inner[0]) for each in value] if inner[0][0] == Nodetype.NAME else value
    if node == Nodetype.BASE:
        return value
    fields = {name: _value(_field(value, name), of) for name, of in STORE.fielddefs[inner][1]}
    return SimpleNamespace(**fields)


def _field(value: Any, name: str) -> Any:
    """A field of a message of ROS 2 by its name in ROS 1."""
    if name == "seq":
        return 0
    if name == "is_tracking":
        return bool(value.id)
    if name == "tracking_id":
        return value.id
    if hasattr(value, "hypothesis") and name in ("id", "score"):
        return int(value.hypothesis.class_id) if name == "id" else value.hypothesis.score
    if hasattr(value, "theta") and name in ("x", "y"):
        return getattr(value.position, name)
    return getattr(value, name) if hasattr(value, name) else getattr(value, name.lower())


def serialized(row: Row) -> bytes:
    return bytes(STORE.serialize_ros1(of_ros1(row[3], row[1]), row[1]))


def write_bag(
    path: Path, rows: Iterable[Row], *, compression: str = "none", chunk_size: int = 4096, parts: bool = True
) -> Path:
    """Write a bag of ROS 1; without `parts` the definitions lack those of the types of their fields."""
    writer = Writer(path)
    if compression != "none":
        writer.set_compression(COMPRESSIONS[compression])
    writer.chunk_threshold = chunk_size
    with writer:
        connections: dict[str, Any] = {}
        for row in rows:
            topic, kind, t_ns, _ = row
            if topic not in connections:
                text, md5 = STORE.generate_msgdef(kind)
                text = text if parts else text.split("=" * 80)[0]
                connections[topic] = writer.add_connection(topic, kind, msgdef=text, md5sum=md5)
            writer.write(connections[topic], t_ns, serialized(row))
    return path


def without_index(path: Path, rows: Sequence[Row], compression: str = "none") -> Path:
    """A bag that a killed recorder leaves: no index, and a last chunk without its length."""
    data = write_bag(path, rows, compression=compression).read_bytes()
    index = int.from_bytes(data[data.index(b"index_pos=") + 10 :][:8], "little")
    data = bytearray(data[:index].replace(b"index_pos=" + index.to_bytes(8, "little"), b"index_pos=" + bytes(8), 1))
    field = f"compression={compression}".encode()
    last = data.rindex(field)
    size = data.index(b"size=", last) + 5
    data[size : size + 8] = bytes(8)
    path.write_bytes(data)
    return path
