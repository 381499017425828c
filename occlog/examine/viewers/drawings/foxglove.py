"""Drawings as messages of Foxglove, which Lichtblick shows too: scenes in space, annotations of images."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Point2_pb2 import Point2
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from occlog.array_types import Floats
from occlog.examine.viewers.drawings.shapes import Column, Fill, Line, Rgba, Text, Thing
from occlog.examine.viewers.drawings.ways import dashes

DASH, DASH_PX = 0.08, 5.0
"""Length of a dash in space [m] and in an image [px]."""
GROUND: Rgba = (0.06, 0.06, 0.06, 0.7)
"""Behind words in an image."""


def scene_update(things: Iterable[Thing], t_ns: int, frame: str) -> bytes:
    """A `foxglove.SceneUpdate` that shows these things and nothing else of its topic.

    Each message says all: what was drawn before goes, so that a jump in time shows the same as playing up to it.

    Args:
        things: in metres.
        t_ns: their time.
        frame: of reference.
    """
    message = SceneUpdate()
    message.deletions.add(type=SceneEntityDeletion.Type.ALL).timestamp.FromNanoseconds(t_ns)
    things = list(things)
    ends = _drawn([line for thing in things for line in thing.lines], DASH)
    for thing in things:
        entity = message.entities.add(frame_id=frame, id=thing.name)
        entity.timestamp.FromNanoseconds(t_ns)
        entity.lifetime.SetInParent()  # until it is deleted
        for line in thing.lines:
            _add_line(entity, line, next(ends))
        for column in thing.columns:
            _add_column(entity, column)
        for fill in thing.fills:
            _add_fill(entity, fill)
        for text in thing.texts:
            _add_text(entity, text)
    data: bytes = message.SerializeToString(deterministic=True)
    return data


def _colour(place: object, colour: Rgba) -> None:
    place.r, place.g, place.b, place.a = colour  # type: ignore[attr-defined]


def _place(pose: Pose, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> None:
    pose.position.SetInParent()  # the schema wants it said even at the origin
    pose.position.x, pose.position.y, pose.position.z = x, y, z
    pose.orientation.w = 1.0


def _points(points: Floats) -> list[Point3]:
    return [Point3(x=x, y=y, z=z) for x, y, z in points.tolist()]


def _drawn(lines: Sequence[Line], dash: float) -> Iterator[Floats]:
    """The points of each line: its corners, or the ends of its dashes."""
    ends = iter(dashes([line.points for line in lines if line.dashed], dash))
    return (next(ends) if line.dashed else line.points for line in lines)


def _add_line(entity: SceneEntity, line: Line, points: Floats) -> None:
    kind = LinePrimitive.Type.LINE_LIST if line.dashed else LinePrimitive.Type.LINE_STRIP
    part = entity.lines.add(type=kind, thickness=line.width, scale_invariant=True)
    _place(part.pose)
    part.points.extend(_points(points))
    _colour(part.color, line.colour)


def _add_column(entity: SceneEntity, column: Column) -> None:
    part = entity.cylinders.add(bottom_scale=1.0, top_scale=1.0)
    x, y, z = column.foot.tolist()
    _place(part.pose, x, y, z + 0.5 * column.height)
    part.size.x = part.size.y = column.width
    part.size.z = column.height
    _colour(part.color, column.colour)


def _add_fill(entity: SceneEntity, fill: Fill) -> None:
    part = entity.triangles.add()
    _place(part.pose)
    part.points.extend(_points(fill.corners))
    _colour(part.color, fill.colour)


def _add_text(entity: SceneEntity, text: Text) -> None:
    part = entity.texts.add(billboard=True, font_size=text.size, scale_invariant=False, text=text.words)
    _place(part.pose, *text.at.tolist())
    _colour(part.color, text.colour)


def image_annotations(things: Sequence[Thing], t_ns: int) -> bytes:
    """A `foxglove.ImageAnnotations` of lines and words over an image, in its pixels, their centres at whole numbers."""
    message = ImageAnnotations()
    if "timestamp" in ImageAnnotations.DESCRIPTOR.fields_by_name:  # since 0.4 of the schemas
        message.timestamp.FromNanoseconds(t_ns)
    lines = [line for thing in things for line in thing.lines]
    for line, ends in zip(lines, _drawn(lines, DASH_PX), strict=True):
        kind = PointsAnnotation.Type.LINE_LIST if line.dashed else PointsAnnotation.Type.LINE_STRIP
        part = message.points.add(type=kind, thickness=line.width)
        part.timestamp.FromNanoseconds(t_ns)
        # There pixels begin at whole numbers
        part.points.extend([Point2(x=x, y=y) for x, y in (ends + 0.5).tolist()])
        _colour(part.outline_color, line.colour)
        part.fill_color.SetInParent()  # none
    for text in (text for thing in things for text in thing.texts):
        words = message.texts.add(text=text.words, font_size=text.size)
        words.timestamp.FromNanoseconds(t_ns)
        words.position.x, words.position.y = np.asarray(text.at + 0.5).tolist()
        _colour(words.text_color, text.colour)
        _colour(words.background_color, GROUND)
    data: bytes = message.SerializeToString(deterministic=True)
    return data
