"""Every message of exported files is valid: what the published schemas state of fields, one by one, holds.

The rules are those of the comments in Foxglove's schemas (`foxglove-schemas-protobuf`).  Where OCCLOG_FOXGLOVE_SCHEMAS
names a folder of the JSON schemas of npm's `@foxglove/schemas`, one file a message, each message is checked by its own.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.json_format import MessageToDict
from google.protobuf.unknown_fields import UnknownFieldSet
from mcap.reader import make_reader
from viewer_runs import fill

from occlog.cli.main import run
from occlog.errors import ExitCode

KINDS: dict[str, Any] = {
    kind.DESCRIPTOR.full_name: kind
    for kind in (CameraCalibration, CompressedImage, FrameTransforms, ImageAnnotations, Log, PointCloud, SceneUpdate)
}
DISTORTIONS = {"": 0, "plumb_bob": 5, "rational_polynomial": 8, "kannala_brandt": 4}
MAGIC = {"png": b"\x89PNG", "jpeg": b"\xff\xd8\xff"}
SIZES = {PackedElementField.NumericType.FLOAT32: 4, PackedElementField.NumericType.UINT8: 1}
PUBLISHED = os.environ.get("OCCLOG_FOXGLOVE_SCHEMAS")
FORMATS = ("viewers", "foxglove", "rerun")
Row = tuple[str, int, Any]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Row]]:
    """Topic, time and message of Foxglove's schemas in the file of each format."""
    folder = fill(tmp_path_factory.mktemp("validity"))
    found = {}
    for to in FORMATS:
        path = folder / f"{to}.mcap"
        assert run(["export", str(folder), "--to", to, "-o", str(path), "-q"]) == ExitCode.DONE
        found[to] = list(rows(path))
    return found


def rows(path: Path) -> Iterator[Row]:
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            if schema is not None and schema.name in KINDS:
                yield channel.topic, message.log_time, KINDS[schema.name].FromString(message.data)


def parts(message: Any) -> Iterator[Any]:
    """A message and all that is in it."""
    yield message
    for field, value in message.ListFields():
        if field.message_type is not None:
            for each in value if field.is_repeated else [value]:
                yield from parts(each)


def numbers(message: Any) -> Iterator[float]:
    for field, value in message.ListFields():
        if field.cpp_type in (field.CPPTYPE_DOUBLE, field.CPPTYPE_FLOAT):
            yield from value if field.is_repeated else [value]


@pytest.mark.parametrize("to", FORMATS)
def test_every_field_is_known_set_and_in_range(files: dict[str, list[Row]], to: str) -> None:
    for topic, _, message in files[to]:
        for part in parts(message):
            kind = part.DESCRIPTOR
            where = f"{topic}: {kind.full_name}"
            assert not len(UnknownFieldSet(part)), where
            assert np.isfinite(list(numbers(part))).all(), where
            for field in kind.fields:
                if field.message_type is not None and not field.is_repeated:
                    assert part.HasField(field.name), f"{where}.{field.name} is missing"
                if field.enum_type is not None:
                    assert getattr(part, field.name) in field.enum_type.values_by_number, where
            if kind.full_name == "foxglove.Color":
                assert all(0 <= getattr(part, name) <= 1 for name in "rgba"), where
            if kind.full_name == "foxglove.Quaternion":
                assert sum(getattr(part, name) ** 2 for name in "xyzw") == pytest.approx(1.0), where


@pytest.mark.parametrize("to", FORMATS)
def test_every_message_says_its_time(files: dict[str, list[Row]], to: str) -> None:
    for topic, t_ns, message in files[to]:
        stamped = [part for part in parts(message) if "timestamp" in part.DESCRIPTOR.fields_by_name]
        assert stamped or isinstance(message, FrameTransforms | ImageAnnotations | SceneUpdate), topic
        assert all(part.timestamp.ToNanoseconds() == t_ns for part in stamped), topic


@pytest.mark.parametrize("to", FORMATS)
def test_every_frame_hangs_on_the_one_root_of_the_tree(files: dict[str, list[Row]], to: str) -> None:
    edges = {
        entry.child_frame_id: entry.parent_frame_id
        for _, _, message in files[to]
        if isinstance(message, FrameTransforms)
        for entry in message.transforms
    }
    (root,) = set(edges.values()) - set(edges)
    for frame in edges:
        seen = {frame}
        while frame != root:
            frame = edges[frame]
            assert frame not in seen, "a loop"
            seen.add(frame)
    named = {
        part.frame_id
        for _, _, message in files[to]
        for part in parts(message)
        if "frame_id" in part.DESCRIPTOR.fields_by_name
    }
    assert named
    assert named <= {root, *edges}


@pytest.mark.parametrize("to", FORMATS)
def test_calibrations_have_the_sizes_and_names_that_are_demanded(files: dict[str, list[Row]], to: str) -> None:
    images = {topic: message for topic, _, message in files[to] if isinstance(message, CompressedImage)}
    seen = 0
    for topic, _, message in files[to]:
        if isinstance(message, CameraCalibration):
            seen += 1
            assert len(message.D) == DISTORTIONS[message.distortion_model]
            assert (len(message.K), len(message.R), len(message.P)) == (9, 9, 12)
            image = images[topic.replace("/calibration", "/image")]
            height, width = cv2.imdecode(np.frombuffer(image.data, np.uint8), cv2.IMREAD_COLOR).shape[:2]
            assert (message.width, message.height, message.frame_id) == (width, height, image.frame_id)
            k = np.array(message.K).reshape(3, 3)
            np.testing.assert_array_equal(np.array(message.P).reshape(3, 4)[:, :3], k)
            assert k[2].tolist() == [0, 0, 1]
            assert k[0, 0] > 0 < k[1, 1]
    assert seen == len(images)


@pytest.mark.parametrize("to", FORMATS)
def test_images_are_what_their_format_says(files: dict[str, list[Row]], to: str) -> None:
    for _, _, message in files[to]:
        if isinstance(message, CompressedImage):
            assert message.data.startswith(MAGIC[message.format])


@pytest.mark.parametrize("to", ["viewers", "foxglove"])
def test_annotations_lie_over_an_image_of_their_topic_and_time(files: dict[str, list[Row]], to: str) -> None:
    frames = {(topic, t_ns) for topic, t_ns, message in files[to] if isinstance(message, CompressedImage)}
    lying = [(topic, t_ns, m) for topic, t_ns, m in files[to] if isinstance(m, ImageAnnotations)]
    assert lying
    for topic, t_ns, message in lying:
        assert (topic.rpartition("/")[0], t_ns) in frames
        for part in message.points:
            assert part.type in (PointsAnnotation.Type.LINE_STRIP, PointsAnnotation.Type.LINE_LIST)
            assert len(part.points) % (2 if part.type == PointsAnnotation.Type.LINE_LIST else 1) == 0
            assert part.thickness > 0
        assert all(text.font_size > 0 < len(text.text) for text in message.texts)


@pytest.mark.parametrize("to", ["viewers", "foxglove"])
def test_entities_have_names_of_their_own_and_whole_primitives(files: dict[str, list[Row]], to: str) -> None:
    updates = [(topic, m) for topic, _, m in files[to] if isinstance(m, SceneUpdate)]
    assert updates
    for topic, message in updates:
        names = [entity.id for entity in message.entities]
        assert len(set(names)) == len(names), topic
        for entity in message.entities:
            for line in entity.lines:
                assert len(line.points) >= 2, topic
                assert len(line.points) % (2 if line.type == LinePrimitive.Type.LINE_LIST else 1) == 0, topic
                assert not line.colors, topic
                assert not line.indices, topic
                assert line.thickness > 0, topic
            for fill_ in entity.triangles:
                assert len(fill_.points) % 3 == 0 < len(fill_.points), topic
            for body in entity.cylinders:
                assert min(body.size.x, body.size.y, body.size.z) > 0, topic
                assert 0 <= body.bottom_scale <= 1 >= body.top_scale >= 0, topic
            assert all(text.font_size > 0 < len(text.text) for text in entity.texts), topic


@pytest.mark.parametrize("to", ["viewers", "rerun"])
def test_clouds_hold_whole_points_of_the_fields_that_they_name(files: dict[str, list[Row]], to: str) -> None:
    clouds = [m for _, _, m in files[to] if isinstance(m, PointCloud)]
    assert clouds
    for message in clouds:
        assert len(message.data) % message.point_stride == 0
        assert [field.name for field in message.fields] == ["x", "y", "z", "red", "green", "blue", "alpha"]
        ends = [field.offset + SIZES[field.type] for field in message.fields]
        assert [field.offset for field in message.fields] == [0, *ends[:-1]]
        assert ends[-1] == message.point_stride
        assert np.isfinite(np.frombuffer(message.data, "<f4").reshape(-1, 4)[:, :3]).all()


def test_numbers_for_rerun_are_messages_of_ros_2_that_say_their_columns(tmp_path: Path) -> None:
    stores = pytest.importorskip("rosbags.typesys")
    store = stores.get_typestore(stores.Stores.ROS2_HUMBLE)
    path = tmp_path / "r.mcap"
    assert run(["export", str(fill(tmp_path)), "-o", str(path), "-q"]) == ExitCode.DONE
    found: dict[str, list[tuple[int, str, list[float]]]] = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            if schema is not None and schema.encoding == "ros2msg":
                assert (schema.name, channel.message_encoding) == ("std_msgs/msg/Float64MultiArray", "cdr")
                kinds = stores.get_types_from_msg(schema.data.decode(), schema.name)
                assert all(kinds[name][1] == store.fielddefs[name][1] for name in kinds)  # as ROS 2 publishes it
                array = store.deserialize_cdr(message.data, schema.name)
                (dim,) = array.layout.dim
                assert (dim.size, dim.stride, array.layout.data_offset) == (len(array.data), len(array.data), 0)
                found.setdefault(channel.topic, []).append((message.log_time, dim.label, array.data.tolist()))
    second = 10**9
    (first, *others) = found["diagnostics/3"]
    assert first == (second, "ess", [80.5])
    # Not known at the second time: no other number takes its place
    assert [(t_ns, label, bool(np.isnan(data).all())) for t_ns, label, data in others] == [(2 * second, "ess", True)]
    assert found["tracks/3"] == [(second, "x,y", [2.0, 1.0]), (2 * second, "x,y", [2.5, 1.0])]
    assert set(found) == {"diagnostics/3", "tracks/3", "tracks/7"}


@pytest.mark.skipif(PUBLISHED is None, reason="OCCLOG_FOXGLOVE_SCHEMAS names no folder of published JSON schemas")
@pytest.mark.parametrize("to", FORMATS)
def test_every_message_is_valid_by_its_published_json_schema(files: dict[str, list[Row]], to: str) -> None:
    jsonschema = pytest.importorskip("jsonschema")
    for _, _, message in files[to]:
        name = message.DESCRIPTOR.name
        schema = json.loads((Path(str(PUBLISHED)) / f"{name}.json").read_text())
        value = MessageToDict(
            message,
            preserving_proto_field_name=True,
            use_integers_for_enums=True,
            always_print_fields_with_no_presence=True,
        )
        jsonschema.validate(in_json(message, value), schema, cls=jsonschema.Draft202012Validator)


def in_json(message: Any, value: dict[str, Any]) -> dict[str, Any]:
    """Times and durations as Foxglove's JSON has them: seconds and nanoseconds."""
    for field, inner in message.ListFields():
        if field.message_type is None:
            continue
        if field.message_type.full_name in ("google.protobuf.Timestamp", "google.protobuf.Duration"):
            value[field.name] = {"sec": inner.seconds, "nsec": inner.nanos}
        elif field.is_repeated:
            for each, out in zip(inner, value[field.name], strict=True):
                in_json(each, out)
        else:
            in_json(inner, value[field.name])
    return value
