"""Drawings as Foxglove messages (also for Lichtblick): scenes in space, and annotations of images.

For Rerun, which does not draw Foxglove's lines and areas, drawings are clouds of coloured points.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.Point2_pb2 import Point2
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from occlog.array_types import Floats, Ints
from occlog.records.scene import Camera

from .shapes import Cylinder, DrawingGroup, Fill, Polyline, Rgba, Text, around, at_height, dashes, dense

DASH, DASH_PX = 0.08, 5.0
"""Length of a dash in space [m] and in an image [px]."""
GROUND: Rgba = (0.06, 0.06, 0.06, 0.7)
"""Behind words in an image."""


def scene_update(things: Iterable[DrawingGroup], t_ns: int, frame: str) -> bytes:
    """Return an encoded `foxglove.SceneUpdate` that shows these shapes and removes all others of its topic.

    Since each message replaces earlier ones, a jump in time shows the same as continuous playback.

    Args:
        things: shapes, in metres.
        t_ns: their time [ns].
        frame: name of the coordinate frame.
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


def _colour(target: object, colour: Rgba) -> None:
    target.r, target.g, target.b, target.a = colour  # type: ignore[attr-defined]


def _place(pose: Pose, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> None:
    pose.position.SetInParent()  # the schema requires it even at the origin
    pose.position.x, pose.position.y, pose.position.z = x, y, z
    pose.orientation.w = 1.0


def _points(points: Floats) -> list[Point3]:
    return [Point3(x=x, y=y, z=z) for x, y, z in points.tolist()]


def _drawn(lines: Sequence[Polyline], dash: float) -> Iterator[Floats]:
    """Generate the points (k, d) of each polyline to draw: its vertices, or the ends of its dashes of length `dash`."""
    ends = iter(dashes([line.points for line in lines if line.dashed], dash))
    return (next(ends) if line.dashed else line.points for line in lines)


def _add_line(entity: SceneEntity, line: Polyline, points: Floats) -> None:
    kind = LinePrimitive.Type.LINE_LIST if line.dashed else LinePrimitive.Type.LINE_STRIP
    part = entity.lines.add(type=kind, thickness=line.width, scale_invariant=True)
    _place(part.pose)
    part.points.extend(_points(points))
    _colour(part.color, line.colour)


def _add_column(entity: SceneEntity, column: Cylinder) -> None:
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


def image_annotations(things: Sequence[DrawingGroup], t_ns: int) -> bytes:
    """Return an encoded `foxglove.ImageAnnotations` with the lines and texts of shapes over an image.

    Points of the shapes are in pixels with centres at integers. `t_ns`: time of the image [ns].
    """
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


STEP, STEP_PX = 0.04, 2.0
"""Distance between the points of a drawn line, in space [m] and in an image [px]."""
MOST, FEWEST = 400, 8
"""Points of one line at most, a longer one is downsampled; and where there are very many lines."""
MAX_OF_ALL = 40_000
"""Points of the lines of one message, down to `FEWEST` each: shadows of a crowd have thousands of edges."""
DEPTH = 0.4
"""Depth of the plane of image overlays in front of the camera [m]."""
PLACED = np.dtype([("xyz", "<f4", 3), ("rgba", "u1", 4)])


def point_cloud(things: Iterable[DrawingGroup], t_ns: int, frame: str) -> bytes:
    """Return an encoded `foxglove.PointCloud` with points along the lines and edges of shapes, and their dots.

    Args:
        things: shapes, in metres; their texts are omitted.
        t_ns: time [ns].
        frame: name of the coordinate frame of the points.
    """
    things = list(things)
    cut = iter(_cut([line for thing in things for line in thing.lines], DASH))
    ways: list[Floats] = []
    colours: list[Rgba] = []
    for thing in things:
        parts = [(next(cut), line.colour) for line in thing.lines]
        parts += [(_column(column), column.colour) for column in thing.columns]
        parts += [(_edges(fill), fill.colour) for fill in thing.fills]
        for own, colour in parts:
            ways += own
            colours += len(own) * [colour]
    most = max(min(MOST, MAX_OF_ALL // max(len(ways), 1)), FEWEST)
    points, counts = dense(ways, STEP, most) if ways else (np.empty((0, 3)), np.empty(0, dtype=np.int64))
    dots = [each for thing in things for each in thing.dots]
    points = np.concatenate([points, *(each.points for each in dots)])
    counts = np.concatenate([counts, np.array([len(each.points) for each in dots], dtype=np.int64)])
    return _message(points, counts, colours + [each.colour for each in dots], t_ns, frame)


def image_cloud(things: Sequence[DrawingGroup], t_ns: int, frame: str, camera: Camera) -> bytes:
    """Return an encoded `foxglove.PointCloud` of lines over an image, in a plane in front of the camera.

    Seen from the camera, the points cover the lines in the image (without distortion, as viewers assume).

    Args:
        things: shapes in pixels with centres at integers.
        t_ns: time [ns].
        frame: name of the camera's coordinate frame: x to the right, y down, z forward.
        camera: camera of the image.
    """
    lines = [line for thing in things for line in thing.lines]
    cut = _cut(lines, DASH_PX)
    colours = [line.colour for line, own in zip(lines, cut, strict=True) for _ in own]
    if not lines:
        return _message(np.empty((0, 3)), np.empty(0, dtype=np.int64), [], t_ns, frame)
    pixels, counts = dense([way for own in cut for way in own], STEP_PX, MOST)
    points = at_height((pixels - camera.principal_px) / camera.focal_px * DEPTH, DEPTH)
    return _message(points, counts, colours, t_ns, frame)


def _message(points: Floats, counts: Ints, colours: Sequence[Rgba], t_ns: int, frame: str) -> bytes:
    """Return an encoded `foxglove.PointCloud`.

    Args:
        points: (N, 3) [m].
        counts: (k,) numbers of successive points of one colour; they sum to N.
        colours: k colours.
        t_ns: time [ns].
        frame: name of the coordinate frame.
    """
    packed = np.zeros(len(points), dtype=PLACED)
    if len(points):
        packed["xyz"] = points
        packed["rgba"] = np.repeat(np.rint(255.0 * np.array(colours)).astype(np.uint8), counts, axis=0)
    message = PointCloud(frame_id=frame, point_stride=PLACED.itemsize, data=packed.tobytes())
    message.timestamp.FromNanoseconds(t_ns)
    message.pose.position.SetInParent()
    message.pose.orientation.w = 1.0
    for n, name in enumerate("xyz"):
        message.fields.add(name=name, offset=4 * n, type=PackedElementField.NumericType.FLOAT32)
    for n, name in enumerate(("red", "green", "blue", "alpha")):
        message.fields.add(name=name, offset=12 + n, type=PackedElementField.NumericType.UINT8)
    data: bytes = message.SerializeToString(deterministic=True)
    return data


def _cut(lines: Sequence[Polyline], dash: float) -> list[list[Floats]]:
    """Return for each polyline what is drawn of it, as polylines (k, d): itself, or its dashes of length `dash`."""
    ends = iter(dashes([line.points for line in lines if line.dashed], dash))
    return [list(next(ends).reshape(-1, 2, line.points.shape[1])) if line.dashed else [line.points] for line in lines]


def _column(column: Cylinder) -> list[Floats]:
    """Return the lines (k, 3) that draw a cylinder: both rims, and four vertical ones."""
    ring = around(column.foot[:2], np.full(2, 0.5 * column.width))
    low, high = float(column.foot[2]), float(column.foot[2]) + column.height
    sides = [np.array([[*ring[k], low], [*ring[k], high]]) for k in range(0, len(ring) - 1, len(ring) // 4)]
    return [at_height(ring, low), at_height(ring, high), *sides]


def _edges(fill: Fill) -> list[Floats]:
    """Return the border of a filled area as edges (2, 3): those that belong to one triangle only."""
    corners = np.round(fill.corners, 6).reshape(-1, 3, 3)
    edges: dict[tuple[tuple[float, ...], ...], int] = {}
    for triangle in corners.tolist():
        for k in range(3):
            edge = tuple(sorted((tuple(triangle[k]), tuple(triangle[(k + 1) % 3]))))
            edges[edge] = edges.get(edge, 0) + 1
    return list(np.array([edge for edge, count in edges.items() if count == 1]))
