"""Drawings as clouds of coloured points: what Rerun draws of Foxglove's messages, which has no lines or areas."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud

from occlog.array_types import Floats
from occlog.records.scene import Camera

from .foxglove import DASH, DASH_PX
from .shapes import Column, Fill, Line, Rgba, Thing, around, at_height, dashes

STEP, STEP_PX = 0.04, 2.0
"""From one point of a line to the next, in space [m] and in an image [px]."""
MOST = 400
"""Points of one line; those of a longer one are farther apart."""
DEPTH = 0.4
"""Of the plane on which what is drawn over an image stands before its camera [m]."""
PLACED = np.dtype([("xyz", "<f4", 3), ("rgba", "u1", 4)])


def point_cloud(things: Iterable[Thing], t_ns: int, frame: str) -> bytes:
    """A `foxglove.PointCloud` along the lines and edges of things [m], and of their dots; words are left out."""
    parts = [part for thing in things for part in _of_thing(thing)]
    return _message(parts, t_ns, frame)


def image_cloud(things: Sequence[Thing], t_ns: int, frame: str, camera: Camera) -> bytes:
    """The lines over an image as a `foxglove.PointCloud` in a plane before the camera, where they cover the image.

    Args:
        things: in pixels as recorded, their centres at whole numbers.
        t_ns: their time.
        frame: of the camera: x to the right, y down, z forward.
        camera: whose image it is. The viewer takes its images for ones without distortion, and so does this.
    """
    parts: list[tuple[Floats, Rgba]] = []
    for line in (line for thing in things for line in thing.lines):
        pixels = _along(line, STEP_PX, DASH_PX)
        parts.append((at_height((pixels - camera.principal_px) / camera.focal_px * DEPTH, DEPTH), line.colour))
    return _message(parts, t_ns, frame)


def _message(parts: Sequence[tuple[Floats, Rgba]], t_ns: int, frame: str) -> bytes:
    packed = np.zeros(sum(len(points) for points, _ in parts), dtype=PLACED)
    at = 0
    for points, colour in parts:
        packed["xyz"][at : at + len(points)] = points
        packed["rgba"][at : at + len(points)] = np.rint(255.0 * np.array(colour))
        at += len(points)
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


def _of_thing(thing: Thing) -> list[tuple[Floats, Rgba]]:
    lines = [(_along(line, STEP, DASH), line.colour) for line in thing.lines]
    columns = [(_column(column), column.colour) for column in thing.columns]
    dots = [(each.points, each.colour) for each in thing.dots]
    return lines + columns + dots + [(_edges(fill), fill.colour) for fill in thing.fills]


def _along(line: Line, step: float, dash: float) -> Floats:
    """Points along a line, those in gaps left out."""
    if not line.dashed:
        return _dense(line.points, step)
    pairs = dashes(line.points, dash).reshape(-1, 2, line.points.shape[1])
    return np.concatenate([_dense(pair, step) for pair in pairs])


def _dense(points: Floats, step: float) -> Floats:
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    count = int(np.clip(np.ceil(way[-1] / step) + 1, 2, MOST))
    wanted = np.linspace(0.0, way[-1], count)
    return np.column_stack([np.interp(wanted, way, points[:, k]) for k in range(points.shape[1])])


def _column(column: Column) -> Floats:
    """Both rims of a cylinder, and four of its sides."""
    ring = around(column.foot[:2], np.full(2, 0.5 * column.width))
    low, high = float(column.foot[2]), float(column.foot[2]) + column.height
    sides = [np.array([[*ring[k], low], [*ring[k], high]]) for k in range(0, len(ring) - 1, len(ring) // 4)]
    ways = [at_height(ring, low), at_height(ring, high), *sides]
    return np.concatenate([_dense(way, STEP) for way in ways])


def _edges(fill: Fill) -> Floats:
    """The edges that belong to one triangle only: the border of an area."""
    corners = np.round(fill.corners, 6).reshape(-1, 3, 3)
    edges: dict[tuple[tuple[float, ...], ...], int] = {}
    for triangle in corners.tolist():
        for k in range(3):
            edge = tuple(sorted((tuple(triangle[k]), tuple(triangle[(k + 1) % 3]))))
            edges[edge] = edges.get(edge, 0) + 1
    border = [np.array(edge) for edge, count in edges.items() if count == 1]
    return np.concatenate([_dense(edge, STEP) for edge in border]) if border else np.empty((0, 3))
