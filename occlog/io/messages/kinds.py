"""What types of messages mean: images, calibrations, transforms, poses, boxes, directions.

ROS 2 and Foxglove say the same things with other names; the readers here make one form of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from enum import Enum
from typing import Any, NamedTuple

import numpy as np

from occlog.array_types import NS, Floats
from occlog.errors import InputError
from occlog.records.times import bounded_ns


class Kind(Enum):
    """What a topic can be taken as."""

    IMAGE = "images"
    INFO = "calibration"
    TRANSFORM = "transforms"
    POSE = "true positions"
    BOX = "boxes"
    DIRECTION = "directions"


class Header(NamedTuple):
    """When a message was measured [ns since 1970; 0: not stated] and in which frame of reference."""

    stamp_ns: int
    frame: str


class ImageMessage(NamedTuple):
    """An image: compressed, or raw pixels.

    Attributes:
        header: time and frame.
        data: bytes as they are in the message.
        encoding: of raw pixels, such as `bgr8`; of compressed ones what the message says, such as `jpeg`.
        size: width and height of raw pixels; None: compressed.
        step: bytes of a row of raw pixels.
    """

    header: Header
    data: bytes
    encoding: str
    size: tuple[int, int] | None = None
    step: int = 0


class InfoMessage(NamedTuple):
    """A calibration as `sensor_msgs/CameraInfo` defines it."""

    header: Header
    size: tuple[int, int]
    model: str
    distortion: Floats
    k: Floats  # (3, 3) of the raw image
    r: Floats  # (3, 3) rectified-from-raw rotation
    p: Floats  # (3, 4) of the rectified image
    binning: tuple[int, int]
    roi: tuple[int, int, int, int]  # x, y, width, height; all 0: the whole image


class TransformMessage(NamedTuple):
    """The pose of a frame in its parent."""

    parent: str
    child: str
    translation: Floats
    quaternion: Floats  # x, y, z, w


class PoseMessage(NamedTuple):
    """Positions (n, 3) in one frame at one time."""

    header: Header
    positions: Floats


class Detection(NamedTuple):
    """A box [px] of a detector; `id` and `label` are empty where they are not stated."""

    left: float
    top: float
    width: float
    height: float
    score: float
    label: str
    id: str


class BoxMessage(NamedTuple):
    """The boxes of one image."""

    header: Header
    boxes: tuple[Detection, ...]


class Source(NamedTuple):
    """A source of sound: identity (0: none; -1: not tracked), unit vector, and activity or energy."""

    id: int
    vector: tuple[float, float, float]
    strength: float


class DirectionMessage(NamedTuple):
    """The sources that were heard at one time."""

    header: Header
    sources: tuple[Source, ...]


def kind_of(name: str) -> Kind | None:
    """What messages of a type can be taken as; None: nothing."""
    found = _TYPES.get(bare(name))
    return None if found is None else found[0]


def bare(name: str) -> str:
    """The name of a type without the part that ROS 2 puts between package and name."""
    return name.replace("/msg/", "/").replace("/", ".")


def read_message(name: str, message: Any) -> Any:
    """A decoded message of a known type in its one form; an iterator for types that hold several transforms."""
    return _TYPES[bare(name)][1](message)


def _time_ns(time: Any) -> int:
    """A time [ns] of ROS (sec, nanosec), protobuf (seconds, nanos) or Foxglove's JSON (sec, nsec).

    ValueError where it is out of range.
    """
    for whole, rest in (("sec", "nanosec"), ("seconds", "nanos"), ("sec", "nsec")):
        if hasattr(time, whole) and hasattr(time, rest):
            return bounded_ns(int(getattr(time, whole)) * NS + int(getattr(time, rest)))
    return bounded_ns(int(time.sec) * NS)


def _header(message: Any) -> Header:
    header = message.header
    return Header(_time_ns(header.stamp), _frame(header.frame_id))


def _own_header(message: Any) -> Header:
    """Time and frame of Foxglove's types, which have no header."""
    stamp = getattr(message, "timestamp", None)
    return Header(0 if stamp is None else _time_ns(stamp), _frame(getattr(message, "frame_id", "")))


def _frame(name: object) -> str:
    """The name of a frame; a slash before it, as in ROS 1, means nothing."""
    return str(name).lstrip("/")


def _bytes(data: Any) -> bytes:
    """Bytes of an array, of bytes, or of base64 text."""
    if isinstance(data, str):
        import base64

        return base64.b64decode(data, validate=True)
    return data.tobytes() if isinstance(data, np.ndarray) else bytes(data)


def _compressed(message: Any) -> ImageMessage:
    return ImageMessage(_header(message), _bytes(message.data), str(message.format))


def _foxglove_compressed(message: Any) -> ImageMessage:
    return ImageMessage(_own_header(message), _bytes(message.data), str(message.format))


def _raw(message: Any) -> ImageMessage:
    size = (int(message.width), int(message.height))
    return ImageMessage(_header(message), _bytes(message.data), str(message.encoding), size, int(message.step))


def _foxglove_raw(message: Any) -> ImageMessage:
    size = (int(message.width), int(message.height))
    return ImageMessage(_own_header(message), _bytes(message.data), str(message.encoding), size, int(message.step))


def _matrix(values: Any, rows: int, columns: int) -> Floats:
    """A matrix by rows; all zeros where it is not stated."""
    found = np.asarray(list(values), dtype=np.float64)
    return found.reshape(rows, columns) if found.size else np.zeros((rows, columns))


def _info(message: Any) -> InfoMessage:
    roi = message.roi
    return InfoMessage(
        header=_header(message),
        size=(int(message.width), int(message.height)),
        model=str(message.distortion_model),
        distortion=np.asarray(list(message.d), dtype=np.float64),
        k=_matrix(message.k, 3, 3),
        r=_matrix(message.r, 3, 3),
        p=_matrix(message.p, 3, 4),
        binning=(int(message.binning_x), int(message.binning_y)),
        roi=(int(roi.x_offset), int(roi.y_offset), int(roi.width), int(roi.height)),
    )


def _foxglove_info(message: Any) -> InfoMessage:
    return InfoMessage(
        header=_own_header(message),
        size=(int(message.width), int(message.height)),
        model=str(message.distortion_model),
        distortion=np.asarray(list(message.D), dtype=np.float64),
        k=_matrix(message.K, 3, 3),
        r=_matrix(message.R, 3, 3),
        p=_matrix(message.P, 3, 4),
        binning=(0, 0),
        roi=(0, 0, 0, 0),
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


def _positions(header: Header, places: list[Any]) -> PoseMessage:
    return PoseMessage(header, np.array([_vector(place) for place in places]).reshape(-1, 3))


def _vision(message: Any) -> BoxMessage:
    return BoxMessage(_header(message), tuple(_detection(entry) for entry in message.detections))


def _detection(entry: Any) -> Detection:
    """A `vision_msgs/Detection2D` of any release: fields moved from one to the next."""
    centre = entry.bbox.center
    place = getattr(centre, "position", centre)
    width, height = float(entry.bbox.size_x), float(entry.bbox.size_y)
    if float(getattr(centre, "theta", 0.0)):
        raise InputError(f"a box that is turned by {float(centre.theta):g} rad; upright ones were expected")
    best: tuple[float, str] = (float("nan"), "")
    for result in entry.results:
        hypothesis = getattr(result, "hypothesis", result)
        score = float(hypothesis.score)
        if not best[0] >= score:
            best = (score, str(getattr(hypothesis, "class_id", getattr(hypothesis, "id", ""))))
    identity = str(getattr(entry, "tracking_id", "") or getattr(entry, "id", ""))
    left, top = float(place.x) - width / 2, float(place.y) - height / 2
    return Detection(left=left, top=top, width=width, height=height, score=best[0], label=best[1], id=identity)


def _odas(message: Any) -> DirectionMessage:
    def source(entry: Any) -> Source:
        # Tracked sources have id and activity, found ones the energy E, which is `e` in newer releases.
        strength = next((getattr(entry, key) for key in ("activity", "E", "e") if hasattr(entry, key)), float("nan"))
        vector = (float(entry.x), float(entry.y), float(entry.z))
        return Source(int(getattr(entry, "id", -1)), vector, float(strength))

    return DirectionMessage(_header(message), tuple(source(entry) for entry in message.sources))


_TYPES: dict[str, tuple[Kind, Callable[[Any], Any]]] = {
    "sensor_msgs.Image": (Kind.IMAGE, _raw),
    "sensor_msgs.CompressedImage": (Kind.IMAGE, _compressed),
    "foxglove.RawImage": (Kind.IMAGE, _foxglove_raw),
    "foxglove.CompressedImage": (Kind.IMAGE, _foxglove_compressed),
    "sensor_msgs.CameraInfo": (Kind.INFO, _info),
    "foxglove.CameraCalibration": (Kind.INFO, _foxglove_info),
    "tf2_msgs.TFMessage": (Kind.TRANSFORM, _tf),
    "foxglove.FrameTransform": (Kind.TRANSFORM, _foxglove_transform),
    "foxglove.FrameTransforms": (Kind.TRANSFORM, _foxglove_transforms),
    "geometry_msgs.PointStamped": (Kind.POSE, lambda m: _positions(_header(m), [m.point])),
    "geometry_msgs.PoseStamped": (Kind.POSE, lambda m: _positions(_header(m), [m.pose.position])),
    "geometry_msgs.PoseWithCovarianceStamped": (Kind.POSE, lambda m: _positions(_header(m), [m.pose.pose.position])),
    "geometry_msgs.PoseArray": (Kind.POSE, lambda m: _positions(_header(m), [p.position for p in m.poses])),
    "nav_msgs.Odometry": (Kind.POSE, lambda m: _positions(_header(m), [m.pose.pose.position])),
    "foxglove.PoseInFrame": (Kind.POSE, lambda m: _positions(_own_header(m), [m.pose.position])),
    "foxglove.PosesInFrame": (Kind.POSE, lambda m: _positions(_own_header(m), [p.position for p in m.poses])),
    "vision_msgs.Detection2DArray": (Kind.BOX, _vision),
    "odas_ros_msgs.OdasSstArrayStamped": (Kind.DIRECTION, _odas),
    "odas_ros_msgs.OdasSslArrayStamped": (Kind.DIRECTION, _odas),
    "odas_ros.OdasSstArrayStamped": (Kind.DIRECTION, _odas),
    "odas_ros.OdasSslArrayStamped": (Kind.DIRECTION, _odas),
}
