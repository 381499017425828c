"""Message types and their meaning: images, calibrations, transforms, poses, boxes, directions.

ROS 1, ROS 2 (CDR) and Foxglove (protobuf, JSON) messages are decoded and converted to one common form.

Messages of ROS need the package rosbags (extra `ros2`), which also knows ROS' own types, for bags that do not define
them, or define them without the types of their fields.
"""

from __future__ import annotations

import importlib
import json
import math
import re
import struct
from collections.abc import Callable, Iterator
from enum import Enum
from functools import lru_cache
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from google.protobuf.message import DecodeError

from occlog.array_types import NS, Floats
from occlog.errors import InputError, UsageError
from occlog.records.columns import bounded_ns

from .mcap_file import BagTopic


class TopicKind(Enum):
    """What the messages of a topic hold; the value is the word used in messages."""

    IMAGE = "images"
    INFO = "calibration"
    TRANSFORM = "transforms"
    POSE = "true positions"
    BOX = "boxes"
    DIRECTION = "directions"


class MessageStamp(NamedTuple):
    """Header of a message: measurement time [ns since the Unix epoch] and name of the transform frame.

    The time is 0 if it is not stated.
    """

    stamp_ns: int
    frame: str


class ImageMessage(NamedTuple):
    """An image in a message: compressed, or raw pixels.

    Attributes:
        header: time and frame.
        data: bytes as they are in the message.
        encoding: of raw pixels, such as `bgr8`; of compressed ones what the message states, such as `jpeg` or `h264`.
        size: width and height of raw pixels; None: compressed.
        step: bytes of a row of raw pixels; 0: not stated.
    """

    header: MessageStamp
    data: bytes
    encoding: str
    size: tuple[int, int] | None = None
    step: int = 0


class InfoMessage(NamedTuple):
    """Camera calibration in a message, with the fields of `sensor_msgs/CameraInfo`."""

    header: MessageStamp
    size: tuple[int, int]
    model: str
    distortion: Floats
    k: Floats  # (3, 3) of the raw image
    r: Floats  # (3, 3) rectified-from-raw rotation
    p: Floats  # (3, 4) of the rectified image
    binning: tuple[int, int]
    roi: tuple[int, int, int, int]  # x, y, width, height; all 0: the whole image


class TransformMessage(NamedTuple):
    """Pose of a frame `child` in its `parent`: translation (3,) [m] and quaternion (4,) x, y, z, w."""

    parent: str
    child: str
    translation: Floats
    quaternion: Floats  # x, y, z, w


class PoseMessage(NamedTuple):
    """Positions (n, 3) [m] in one frame at one time.

    If `on_earth`, they are longitude, latitude [deg] and height [m].
    """

    header: MessageStamp
    positions: Floats
    on_earth: bool = False


class BoxDetection(NamedTuple):
    """A box [px] of a detector; `id` and `label` are empty if not stated."""

    left: float
    top: float
    width: float
    height: float
    score: float
    label: str
    id: str


class BoxMessage(NamedTuple):
    """Boxes that a detector found in one image."""

    header: MessageStamp
    boxes: tuple[BoxDetection, ...]


class SoundSource(NamedTuple):
    """Sound source in an array's frame: identity (0: empty slot; -1: not tracked), unit vector, activity or energy."""

    id: int
    vector: tuple[float, float, float]
    strength: float


class DirectionMessage(NamedTuple):
    """Sound sources that an array heard at one time."""

    header: MessageStamp
    sources: tuple[SoundSource, ...]


def kind_of(name: str) -> TopicKind | None:
    """What messages of the type `name` hold; None: the type is not supported."""
    found = _TYPES.get(bare(name))
    return None if found is None else found[0]


def bare(name: str) -> str:
    """Name of a message type in the form `sensor_msgs.Image`, for `sensor_msgs/Image` and `sensor_msgs/msg/Image`."""
    return name.replace("/msg/", "/").replace("/", ".")


def read_message(name: str, message: Any) -> Any:
    """Convert a decoded message of the type `name` to its common type (`ImageMessage`, ...).

    An iterator of `TransformMessage` for types of transforms. KeyError for unsupported types.
    """
    return _TYPES[bare(name)][1](message)


def _time_ns(time: Any) -> int:
    """Time [ns since the Unix epoch] from ROS (sec, nanosec), protobuf (seconds, nanos) or JSON (sec, nsec).

    ValueError if it is out of range.
    """
    for whole, rest in (("sec", "nanosec"), ("seconds", "nanos"), ("sec", "nsec")):
        if hasattr(time, whole) and hasattr(time, rest):
            return bounded_ns(int(getattr(time, whole)) * NS + int(getattr(time, rest)))
    return bounded_ns(int(time.sec) * NS)


def _header(message: Any) -> MessageStamp:
    header = message.header
    return MessageStamp(_time_ns(header.stamp), _frame(header.frame_id))


def _own_header(message: Any) -> MessageStamp:
    """Time and frame of a message of Foxglove, which has no header; 0 and "" if it states none."""
    stamp = getattr(message, "timestamp", None)
    return MessageStamp(0 if stamp is None else _time_ns(stamp), _frame(getattr(message, "frame_id", "")))


def _frame(name: object) -> str:
    """Frame name without the leading slash of ROS 1."""
    return str(name).lstrip("/")


def _bytes(data: Any) -> bytes:
    """Bytes of a message field: an array, bytes, or base64 text (JSON)."""
    if isinstance(data, str):
        import base64

        return base64.b64decode(data, validate=True)
    return data.tobytes() if isinstance(data, np.ndarray) else bytes(data)


def _compressed(message: Any, header: MessageStamp) -> ImageMessage:
    return ImageMessage(header, _bytes(message.data), str(message.format))


def _raw(message: Any, header: MessageStamp) -> ImageMessage:
    size = (int(message.width), int(message.height))
    return ImageMessage(header, _bytes(message.data), str(message.encoding), size, int(message.step))


def _matrix(values: Any, rows: int, columns: int) -> Floats:
    """(rows, columns) matrix of row-major values; zeros if they are not stated (empty)."""
    found = np.asarray(list(values), dtype=np.float64)
    return found.reshape(rows, columns) if found.size else np.zeros((rows, columns))


def _matrix_field(message: Any, name: str) -> Any:
    """Field `name` (d, k, r or p) of a `CameraInfo` message; ROS 1 has it in upper case."""
    return getattr(message, name) if hasattr(message, name) else getattr(message, name.upper())


def _info(
    message: Any,
    header: MessageStamp,
    binning: tuple[int, int] = (0, 0),
    roi: tuple[int, int, int, int] = (0, 0, 0, 0),
) -> InfoMessage:
    """Calibration in a message; those of Foxglove have no `binning` and no `roi` (x, y, width, height [px])."""
    return InfoMessage(
        header=header,
        size=(int(message.width), int(message.height)),
        model=str(message.distortion_model),
        distortion=np.asarray(list(_matrix_field(message, "d")), dtype=np.float64),
        k=_matrix(_matrix_field(message, "k"), 3, 3),
        r=_matrix(_matrix_field(message, "r"), 3, 3),
        p=_matrix(_matrix_field(message, "p"), 3, 4),
        binning=binning,
        roi=roi,
    )


def _ros_info(message: Any) -> InfoMessage:
    roi = message.roi
    binning = int(message.binning_x), int(message.binning_y)
    return _info(
        message, _header(message), binning, (int(roi.x_offset), int(roi.y_offset), int(roi.width), int(roi.height))
    )


def _vector(value: Any) -> Floats:
    return np.array([float(value.x), float(value.y), float(value.z)])


def _quaternion(value: Any) -> Floats:
    return np.array([float(value.x), float(value.y), float(value.z), float(value.w)])


def _tf(message: Any) -> Iterator[TransformMessage]:
    for entry in message.transforms:
        parent, child = _frame(entry.header.frame_id), _frame(entry.child_frame_id)
        pose = entry.transform
        yield TransformMessage(parent, child, _vector(pose.translation), _quaternion(pose.rotation))


def _foxglove_transform(message: Any) -> Iterator[TransformMessage]:
    parent, child = _frame(message.parent_frame_id), _frame(message.child_frame_id)
    yield TransformMessage(parent, child, _vector(message.translation), _quaternion(message.rotation))


def _foxglove_transforms(message: Any) -> Iterator[TransformMessage]:
    for entry in message.transforms:
        yield from _foxglove_transform(entry)


def _positions(header: MessageStamp, positions: list[Any]) -> PoseMessage:
    return PoseMessage(header, np.array([_vector(position) for position in positions]).reshape(-1, 3))


def _posed(message: Any) -> PoseMessage:
    return _positions(_header(message), [message.pose.pose.position])


def _fix(message: Any) -> PoseMessage:
    """Geodetic position in a message of a satellite receiver (`NavSatFix`, `LocationFix`); InputError without a fix."""
    status = int(getattr(getattr(message, "status", None), "status", 0))
    if status < 0:
        raise InputError(f"the satellite receiver had no position fix (status {status})")
    header = _header(message) if hasattr(message, "header") else _own_header(message)
    position = [float(message.longitude), float(message.latitude), float(message.altitude)]
    return PoseMessage(header, np.array([position]), on_earth=True)


def _vision(message: Any) -> BoxMessage:
    return BoxMessage(_header(message), tuple(_detection(entry) for entry in message.detections))


def _detection(entry: Any) -> BoxDetection:
    """Box of a `vision_msgs/Detection2D` of any release, with its most probable class; InputError for a rotated box."""
    centre = entry.bbox.center
    position = getattr(centre, "position", centre)
    width, height = float(entry.bbox.size_x), float(entry.bbox.size_y)
    if float(getattr(centre, "theta", 0.0)):
        raise InputError(
            f"a box that is rotated by {float(centre.theta):g} rad; boxes along the image axes were expected",
            id="unsupported-format",
        )
    best: tuple[float, str] = (float("nan"), "")
    for result in entry.results:
        hypothesis = getattr(result, "hypothesis", result)
        score = float(hypothesis.score)
        if not best[0] >= score:
            best = (score, str(getattr(hypothesis, "class_id", getattr(hypothesis, "id", ""))))
    identity = str(getattr(entry, "tracking_id", "") or getattr(entry, "id", ""))
    left, top = float(position.x) - width / 2, float(position.y) - height / 2
    return BoxDetection(left=left, top=top, width=width, height=height, score=best[0], label=best[1], id=identity)


def _odas(message: Any) -> DirectionMessage:
    def source(entry: Any) -> SoundSource:
        # Tracked sources have id and activity, found ones the energy E, which is `e` in newer releases.
        strength = next((getattr(entry, key) for key in ("activity", "E", "e") if hasattr(entry, key)), float("nan"))
        vector = (float(entry.x), float(entry.y), float(entry.z))
        return SoundSource(int(getattr(entry, "id", -1)), vector, float(strength))

    return DirectionMessage(_header(message), tuple(source(entry) for entry in message.sources))


_TYPES: dict[str, tuple[TopicKind, Callable[[Any], Any]]] = {
    "sensor_msgs.Image": (TopicKind.IMAGE, lambda m: _raw(m, _header(m))),
    "sensor_msgs.CompressedImage": (TopicKind.IMAGE, lambda m: _compressed(m, _header(m))),
    "foxglove.RawImage": (TopicKind.IMAGE, lambda m: _raw(m, _own_header(m))),
    "foxglove.CompressedImage": (TopicKind.IMAGE, lambda m: _compressed(m, _own_header(m))),
    "foxglove.CompressedVideo": (TopicKind.IMAGE, lambda m: _compressed(m, _own_header(m))),
    "sensor_msgs.CameraInfo": (TopicKind.INFO, _ros_info),
    "foxglove.CameraCalibration": (TopicKind.INFO, lambda m: _info(m, _own_header(m))),
    "tf2_msgs.TFMessage": (TopicKind.TRANSFORM, _tf),
    "tf.tfMessage": (TopicKind.TRANSFORM, _tf),
    "foxglove.FrameTransform": (TopicKind.TRANSFORM, _foxglove_transform),
    "foxglove.FrameTransforms": (TopicKind.TRANSFORM, _foxglove_transforms),
    "geometry_msgs.PointStamped": (TopicKind.POSE, lambda m: _positions(_header(m), [m.point])),
    "geometry_msgs.PoseStamped": (TopicKind.POSE, lambda m: _positions(_header(m), [m.pose.position])),
    "geometry_msgs.PoseWithCovarianceStamped": (TopicKind.POSE, _posed),
    "geometry_msgs.PoseArray": (TopicKind.POSE, lambda m: _positions(_header(m), [p.position for p in m.poses])),
    "nav_msgs.Odometry": (TopicKind.POSE, _posed),
    "foxglove.PoseInFrame": (TopicKind.POSE, lambda m: _positions(_own_header(m), [m.pose.position])),
    "foxglove.PosesInFrame": (TopicKind.POSE, lambda m: _positions(_own_header(m), [p.position for p in m.poses])),
    "sensor_msgs.NavSatFix": (TopicKind.POSE, _fix),
    "foxglove.LocationFix": (TopicKind.POSE, _fix),
    "vision_msgs.Detection2DArray": (TopicKind.BOX, _vision),
    "odas_ros_msgs.OdasSstArrayStamped": (TopicKind.DIRECTION, _odas),
    "odas_ros_msgs.OdasSslArrayStamped": (TopicKind.DIRECTION, _odas),
    "odas_ros.OdasSstArrayStamped": (TopicKind.DIRECTION, _odas),
    "odas_ros.OdasSslArrayStamped": (TopicKind.DIRECTION, _odas),
}


Decode = Callable[[bytes], Any]
"""Bytes of a message to an object with attributes that are the message's fields."""
FAILURES = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    DecodeError,
    LookupError,
    MemoryError,
    TypeError,
    ValueError,
    struct.error,
)
"""Exceptions of decoders for invalid messages."""
LISTS = ("FrameTransforms", "PosesInFrame")
"""Types of Foxglove that have lists of other types."""
INSTALL = "pip install rosbags"
ROS_RELEASES = {"cdr": "LATEST", "ros1": "ROS1_NOETIC"}
"""Encodings of ROS 2 and 1, and rosbags' name of ROS' own types, for those that a bag does not define."""
LONGEST_DEFINITION = 128 << 10
"""Bytes of a definition of ROS that is read, which takes about two seconds; types of ROS itself have a few thousand."""
MAX_ENTRIES = 10_000
"""Entries, but for numbers, of all arrays with a length that a definition gives."""
MAX_LISTED_BYTES = 4 << 20
"""Bytes of a message with lists of texts or types: each entry of a byte takes a hundred in memory."""
MAX_OBJECTS = 100_000
"""Objects and lists of a message in JSON: each takes 400 bytes in memory."""
_LINE = "=" * 80 + "\n"
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)+")
"""Pattern of a ROS type name: its package, optionally `msg`, and its own name."""


def decoder(topic: BagTopic) -> Decode:
    """Function that decodes the bytes of a topic's messages to objects with the fields as attributes.

    Raises:
        UsageError: it needs a package that is not installed.
        InputError: the encoding, or the definition of the message type, is not known.
    """
    if topic.encoding in ROS_RELEASES:
        return _ros(topic)
    if topic.encoding == "protobuf" and topic.kind.startswith("foxglove."):
        return _foxglove(topic)
    if topic.encoding == "json":
        return _json
    raise InputError(
        f"topic {topic.name}: messages of type {topic.kind or '(none)'} in the encoding {topic.encoding!r} cannot be "
        "read; known: ros1, cdr, json, and protobuf of foxglove's types",
        id="unsupported-format",
    )


def _json(data: bytes) -> object:
    if (objects := data.count(b"{") + data.count(b"[")) > MAX_OBJECTS:
        raise ValueError(f"{objects} objects and lists in a JSON message, limit {MAX_OBJECTS}")
    return json.loads(data, object_hook=lambda fields: SimpleNamespace(**fields))


def _foxglove(topic: BagTopic) -> Decode:
    name = topic.kind.removeprefix("foxglove.")
    try:
        module = importlib.import_module(f"foxglove_schemas_protobuf.{name}_pb2")
    except ImportError:
        raise InputError(
            f"topic {topic.name}: {topic.kind} is no known type of Foxglove; leave the topic out",
            id="unsupported-format",
        ) from None
    message: Any = getattr(module, name)
    listed = name in LISTS

    def decode(data: bytes) -> object:
        if listed:
            _check_listed(data)
        return message.FromString(data)

    return decode


def _check_listed(data: bytes) -> None:
    if len(data) > MAX_LISTED_BYTES:
        raise ValueError(f"a message with lists has {len(data)} bytes, limit {MAX_LISTED_BYTES}")


def is_readable(topic: BagTopic) -> bool:
    """Whether the messages of a topic are in an encoding that can be decoded; their type is not examined."""
    known = topic.encoding in (*ROS_RELEASES, "json")
    return known or (topic.encoding == "protobuf" and topic.kind.startswith("foxglove."))


def borrowed_types(topic: BagTopic) -> tuple[str, ...]:
    """Message types, sorted, that a bag does not define for a topic, so that the definitions of ROS are used.

    A topic without any definition, as in bags of ROS 2 before Iron, gives its own type. Empty if it cannot be
    determined, as without the package rosbags.
    """
    if topic.encoding not in ROS_RELEASES or len(topic.definition) > LONGEST_DEFINITION:
        return ()
    try:
        return _types(_ros_name(topic.kind), topic.encoding, topic.language, topic.definition).borrowed
    except Exception:  # the library's errors; `decoder` states them
        return ()


def _ros_name(kind: str) -> str:
    """Message type as rosbags names it: `std_msgs/msg/Header` for ROS 1's `std_msgs/Header`; others are unchanged."""
    package, mark, name = kind.partition("/")
    return f"{package}/msg/{name}" if mark and "/" not in name else kind


def _ros(topic: BagTopic) -> Decode:
    """Function that decodes messages of ROS 1 or 2, by the definition in the bag or, without one, by that of ROS.

    Raises:
        UsageError: the package rosbags is not installed.
        InputError: the definition is too long or cannot be read.
    """
    try:
        types = importlib.import_module("rosbags.typesys")
        serde = importlib.import_module("rosbags.serde")
    except ImportError:
        raise UsageError(
            f"topic {topic.name}: messages of ROS require the package rosbags, which is not installed; {INSTALL}",
            id="missing-package",
        ) from None
    if len(topic.definition) > LONGEST_DEFINITION:
        raise InputError(
            f"topic {topic.name}: the definition of type {topic.kind} has {len(topic.definition)} bytes (at most "
            f"{LONGEST_DEFINITION} are read); leave the topic out",
            id="input-too-large",
        )
    kind = _ros_name(topic.kind)
    try:
        store, listed, _ = _types(kind, topic.encoding, topic.language, topic.definition)
    except (*FAILURES, types.TypesysError, RecursionError) as error:
        reason = " ".join(str(error).split())[:80]
        what = f"its definition cannot be read ({reason})" if topic.definition else "neither the bag nor ROS defines it"
        raise InputError(
            f"topic {topic.name}: type {topic.kind}: {what}; convert the bag to MCAP by `ros2 bag convert` where the "
            "type is installed"
        ) from None

    deserialize = store.deserialize_ros1 if topic.encoding == "ros1" else store.deserialize_cdr

    def decode(data: bytes) -> object:
        if listed:
            _check_listed(data)
        try:
            return deserialize(data, kind)
        except serde.SerdeError as error:
            raise ValueError(str(error)) from None

    return decode


class _TypeStore(NamedTuple):
    """Message types for the topics of one type.

    Attributes:
        store: rosbags' store of the types.
        listed: they have lists of texts or types, which take much more memory than bytes.
        borrowed: types that the bag does not define, so that the definitions of ROS are used.
    """

    store: Any
    listed: bool
    borrowed: tuple[str, ...]


@lru_cache(maxsize=32)
def _types(kind: str, encoding: str, language: str, definition: bytes) -> _TypeStore:
    """Load a message type of ROS and the types of its fields; cached, since code is generated for them.

    Args:
        kind: type, as rosbags names it.
        encoding: of the topic, which states the release of ROS.
        language: of the definition (`ros2msg`, `ros2idl`, ...).
        definition: in the bag; empty: that of ROS is used.
    """
    types = importlib.import_module("rosbags.typesys")
    nodes = importlib.import_module("rosbags.interfaces").Nodetype
    release = types.Stores[ROS_RELEASES[encoding]]
    store = types.get_typestore(types.Stores.EMPTY if definition else release)
    text = definition.decode("utf-8", "replace")
    if language == "ros2idl":
        parts = [part.split("\n", 1)[1] for part in text.split(_LINE)[1:]] if text.startswith(_LINE) else [text]
        for part in parts:
            store.register(_checked(types.get_types_from_idl(part)))
    elif definition:
        store.register(_checked(types.get_types_from_msg(text, kind)))
    borrowed = _borrow(store, kind, types.get_typestore(release)) if definition else (kind,)
    store.get_msgdef(kind)
    field_types = [field for _, fields in store.fielddefs.values() for _, field in fields] if definition else []
    lists = [of for node, of in field_types if node == nodes.SEQUENCE]
    listed = any(kind != nodes.BASE or of[0] == "string" for (kind, of), _ in lists)
    return _TypeStore(store, listed, borrowed)


def _borrow(store: Any, kind: str, own: Any) -> tuple[str, ...]:
    """Add the types that the fields of `kind` need, and that `store` lacks, from those of ROS (`own`).

    Returns their names, sorted. ValueError for a type that ROS does not define either.
    """
    nodes = importlib.import_module("rosbags.interfaces").Nodetype
    seeking, seen, borrowed = [kind], set[str](), list[str]()
    while seeking:
        name = seeking.pop()
        if name in seen:
            continue
        seen.add(name)
        if name not in store.fielddefs:
            if name not in own.fielddefs:
                raise ValueError(f"it does not define {name}")
            store.register({name: own.fielddefs[name]})
            borrowed.append(name)
        for _, (node, of) in store.fielddefs[name][1]:
            inner = of[0] if node in (nodes.ARRAY, nodes.SEQUENCE) else (node, of)
            if inner[0] == nodes.NAME:
                seeking.append(inner[1])
    return tuple(sorted(borrowed))


def _checked(found: Any) -> Any:
    """Return the type definitions `found`, by name.

    ValueError if code generated from them would be invalid or unbounded. Generated code contains names, constants, and
    a line per entry of a fixed-length array; and a message may declare any number of entries that take no bytes.
    """
    nodes = importlib.import_module("rosbags.interfaces").Nodetype
    entries = 0
    for name, (constants, fields) in found.items():
        if not _NAME.fullmatch(name):
            raise ValueError(f"{name} is no name of a type")
        if not fields:
            raise ValueError(f"{name} has no fields")
        if any(isinstance(value, float) and not math.isfinite(value) for _, _, value in constants):
            raise ValueError(f"{name} has a constant that is not finite")
        for field, (node, field_type) in fields:
            if node == nodes.ARRAY:
                (kind, of), length = field_type
                entries += length if kind != nodes.BASE or of[0] == "string" else 0
                if length < 1 or entries > MAX_ENTRIES:
                    raise ValueError(
                        f"{field}: an array of {length} entries; 1 or more, and {MAX_ENTRIES} in all, are read"
                    )
    return found
