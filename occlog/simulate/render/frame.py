"""One frame: the empty room, shadows, bodies, light and noise.

A body or a shadow is traced only within the bounds of its projection, which are safe: no pixel
that it covers is outside.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from occlog.array_types import Bytes, Floats, Floats32, Ints
from occlog.core.geometry.lens import distort
from occlog.records.scene import Camera, Scene

from .body import STATURE, Clothes, poses, solids
from .kernel import Bodies, Room, finish_into, resolve_into, shadow_into, trace_into
from .room import Background, background, blank
from .surfaces import AMBIENT, lamps

IN_FRONT = 1e-6
"""Least depth of a point with a valid projection."""
BORDER = np.linspace(0.0, 1.0, 9)


def ideal_limits(camera: Camera) -> Floats:
    """(4,) bounds x0, y0, x1, y1 of the image in undistorted normalised coordinates.

    These are x / z and y / z in the camera's frame.
    """
    width, height = camera.image_size or (0, 0)
    across, down = np.linspace(-0.5, width - 0.5, 65), np.linspace(-0.5, height - 0.5, 65)
    sides = [np.column_stack([np.full(65, x), down]) for x in (-0.5, width - 0.5)]
    ends = [np.column_stack([across, np.full(65, y)]) for y in (-0.5, height - 0.5)]
    local = camera.rays(camera.to_usable(np.vstack(sides + ends))) @ camera.rotation
    return np.concatenate([local[:, :2].min(axis=0), local[:, :2].max(axis=0)])


def pixel_boxes(camera: Camera, limits: Floats, points: Floats) -> Ints:
    """Boxes of pixels that contain P things, given by points of their convex hulls.

    Args:
        camera: camera with an image size.
        limits: (4,) bounds of the image in normalised coordinates, by `ideal_limits`.
        points: (P, m, 3) world points around each thing.

    Returns:
        (P, 4) left, top, right, bottom, half-open; empty behind the camera or outside the
        image, the whole image for a thing that reaches from before to behind the camera.
    """
    width, height = camera.image_size or (0, 0)
    local = (points - camera.position) @ camera.rotation
    depth = local[..., 2]
    behind = np.all(depth <= IN_FRONT, axis=1)
    through = np.any(depth <= IN_FRONT, axis=1) & ~behind
    flat = local[..., :2] / np.maximum(depth, IN_FRONT)[..., None]
    low, high = flat.min(axis=1), flat.max(axis=1)
    low = np.where(through[:, None], limits[:2], np.clip(low, limits[:2], limits[2:]))
    high = np.where(through[:, None], limits[2:], np.clip(high, limits[:2], limits[2:]))
    empty = behind | np.any(high <= low, axis=1)
    low_px, high_px = _to_pixels(camera, low, high)
    left_top = np.clip(np.floor(low_px).astype(np.int64) - 1, 0, [width, height])
    right_bottom = np.clip(np.ceil(high_px).astype(np.int64) + 2, 0, [width, height])
    boxes = np.concatenate([left_top, right_bottom], axis=1)
    boxes[empty] = 0
    return boxes


def _to_pixels(camera: Camera, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Convert bounding boxes in undistorted normalised coordinates to pixel bounds of the distorted image.

    Args:
        camera: camera with its lens.
        low: (n, 2) left and top.
        high: (n, 2) right and bottom.

    Returns:
        (n, 2) left and top, and (n, 2) right and bottom [px], 2 px wider if the lens has distortion.
    """
    u = np.concatenate([BORDER, BORDER, 0 * BORDER, 0 * BORDER + 1])
    v = np.concatenate([0 * BORDER, 0 * BORDER + 1, BORDER, BORDER])
    border = low[:, None] + (high - low)[:, None] * np.stack([u, v], axis=-1)
    bent = distort(border.reshape(-1, 2), camera.distortion, camera.distortion_model).reshape(border.shape)
    pixels = bent * camera.focal_px + camera.principal_px
    slack = 0.0 if camera.straight else 2.0
    return pixels.min(axis=1) - slack, pixels.max(axis=1) + slack


def around_ellipsoids(centre: Floats, axes: Floats, half: Floats) -> Floats:
    """(P, 8, 3) corners of the oriented boxes around ellipsoids, in world coordinates.

    Args:
        centre: (P, 3) centres.
        axes: (P, 3, 3) matrices; rows are the unit directions of the axes over the half lengths.
        half: (P, 3) half lengths of the axes.
    """
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
    edges = axes * half[..., None] ** 2  # rows: axis direction times half length
    return np.asarray(centre[:, None] + np.einsum("ck,pkj->pcj", signs, edges))


def around_shadows(xy: Floats, height: Floats, radius: Floats, lights: Floats, reach: Floats) -> Floats:
    """(n, m, 3) floor points around n upright cylinders and their shadows, in world coordinates.

    Args:
        xy: (n, 2) axes of the cylinders.
        height: (n,) heights.
        radius: (n,) radii.
        lights: (L, 5) lamps: x, y, z, power, and half-light distance.
        reach: (n,) distance from the axis at which shadows are cut off.
    """
    turns = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    ring = np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    parts = [xy[:, None] + 2.2 * radius[:, None, None] * ring]
    for x, y, z, *_ in lights:
        away = xy - (x, y)
        distance = np.maximum(np.hypot(away[:, 0], away[:, 1]), 1e-9)
        length = np.where(z > 1.1 * height, distance * 1.1 * height / np.maximum(z - 1.1 * height, 1e-9), np.inf)
        tip = xy + away / distance[:, None] * np.minimum(length, reach)[:, None]
        parts.append(tip[:, None] + 2.2 * radius[:, None, None] * ring)
    flat = np.concatenate(parts, axis=1)
    return np.concatenate([flat, np.zeros((*flat.shape[:2], 1))], axis=-1)


NEAR = 0.05
"""Near clipping distance [m]."""
RADIUS = 0.22
"""Radius of the cylinder that casts a body's shadow [m]."""
SHADOW_REACH = 2.5
"""A shadow is drawn up to this distance from its body [m]."""


class Canvas(NamedTuple):
    """Camera, empty room and buffers for rendering the frames of one camera.

    `limits` (4,) are the bounds of the image (`ideal_limits`); `image`, `depth`, `label` and `stamp` are work space
    that is restored after a frame; `noise` (N,) are standard normal numbers, `last` (1,) the last stamp used.
    """

    camera: Camera
    empty: Background
    room: Room
    limits: Floats
    image: Floats32  # (H, W, 3) work space
    depth: Floats32  # (H, W, 4) equal to the empty room's between frames
    label: NDArray[np.int32]  # (H, W, 4) -1 between frames
    stamp: Ints  # (H, W, 4)
    noise: Floats32  # (N,) standard normal numbers
    last: Ints  # (1,) last stamp used


class RenderedFrame(NamedTuple):
    """A rendered frame (H, W, 3) BGR, and which m objects it shows.

    `present` (m,) are the indices of the objects with a position; `extent` (m, 5) left, top, right, bottom pixel
    and number of lines of sight of their whole bodies; `visible` (m, 5) those of the visible parts.
    """

    image: Bytes  # (H, W, 3) BGR
    present: Ints  # (m,) which objects were there to be drawn
    extent: Ints  # (m, 5) left, top, right, bottom pixel and lines of sight, hidden parts included
    visible: Ints  # (m, 5) the same of the visible parts


def canvas(scene: Scene, camera: Camera, metre: float, noise: Floats32, contrast: float = 1.0) -> Canvas:
    """Prepare the renderer of one camera: background image, depth buffer and noise, computed once for all frames.

    Args:
        scene: room and occluders.
        camera: camera with image size and pose.
        metre: length of a metre in scene units.
        noise: (N,) standard normal numbers; every row of a frame takes a section of them from a random position on.  N
            must be well above three times the width of the image.
        contrast: factor of the surfaces' texture.
    """
    lights = lamps(scene.surroundings, scene.room_height)
    return _on(camera, background(scene, camera, metre, contrast), lights, metre, noise)


def bare_canvas(camera: Camera, lights: Floats, metre: float) -> Canvas:
    """Prepare a renderer for bodies alone, on a black background and without noise.

    Args:
        camera: camera with an image size.
        lights: (L, 5) lamps: x, y, z, power, and half-light distance.
        metre: length of a metre in scene units.
    """
    width = (camera.image_size or (0, 0))[0]
    return _on(camera, blank(camera, len(lights)), lights, metre, np.zeros(4 * width, dtype=np.float32))


def _on(camera: Camera, empty: Background, lights: Floats, metre: float, noise: Floats32) -> Canvas:
    return Canvas(
        camera=camera,
        empty=empty,
        room=Room(camera.position, lights, AMBIENT, metre, NEAR * metre),
        limits=ideal_limits(camera),
        image=np.empty_like(empty.colour),
        depth=empty.depth.copy(),
        label=np.full(empty.depth.shape, -1, dtype=np.int32),
        stamp=np.zeros(empty.depth.shape, dtype=np.int64),
        noise=noise,
        last=np.zeros(1, dtype=np.int64),
    )


def draw(
    c: Canvas,
    rows: Floats,
    clothes: Clothes,
    gain: float,
    sigmas: tuple[float, float],
    shadows: bool,
    rng: np.random.Generator,
) -> RenderedFrame:
    """Render one frame of a camera with bodies, shadows and noise.

    Args:
        c: canvas of the camera; its work space is used, so that a canvas renders one frame at a time.
        rows: (n, 5) x, y, vx, vy, gait phase of n objects; NaN: absent.
        clothes: clothes of the n objects.
        gain: factor of the light.
        sigmas: standard deviations of the noise common to the three colours, and of that of each colour [grey levels].
        shadows: whether bodies cast shadows on the floor.
        rng: generator of the noise.
    """
    np.copyto(c.image, c.empty.colour)
    present = np.flatnonzero(np.isfinite(rows).all(axis=1))
    worn = Clothes(*(part[present] for part in clothes))  # type: ignore[arg-type]
    if shadows:
        _shadows(c, rows[present], worn)
    extent, visible = _bodies(c, rows[present], worn)
    segments = rng.integers(0, len(c.noise) - 3 * c.image.shape[1], (len(c.image), 2), endpoint=True)
    image = np.empty(c.image.shape, dtype=np.uint8)
    finish_into(image, c.image, c.noise, segments, gain, *sigmas)
    return RenderedFrame(image, present, extent, visible)


def _shadows(c: Canvas, rows: Floats, worn: Clothes) -> None:
    metre = c.room.metre
    height: Floats = STATURE * metre * worn.stature
    radius: Floats = RADIUS * metre * worn.stature
    reach = np.full(len(rows), SHADOW_REACH * metre)
    around = around_shadows(xy=rows[:, :2], height=height, radius=radius, lights=c.room.lights, reach=reach)
    boxes = pixel_boxes(c.camera, c.limits, around)
    for k in range(len(rows)):
        x, y = float(rows[k, 0]), float(rows[k, 1])
        shadow_into(
            image=c.image,
            floor=c.empty.floor,
            lamp=c.empty.lamp,
            x=x,
            y=y,
            height=float(height[k]),
            radius=float(radius[k]),
            box=boxes[k],
            room=c.room,
        )


def _bodies(c: Canvas, rows: Floats, worn: Clothes) -> tuple[Ints, Ints]:
    """Draw n bodies into the canvas; return the image bounds (n, 5) of each body and of its visible part.

    Bounds are left, top, right and bottom pixel, and the number of lines of sight.

    Args:
        c: canvas, updated in place.
        rows: (n, 5) x, y, vx, vy [m/s] and gait phase [rad].
        worn: clothes of the bodies.
    """
    n = len(rows)
    parts = solids(poses(rows), worn, c.room.metre)
    boxes = pixel_boxes(c.camera, c.limits, around_ellipsoids(parts.centre, parts.axes, parts.half))
    bodies = Bodies(
        centre=np.ascontiguousarray(parts.centre),
        axes=np.ascontiguousarray(parts.axes),
        half=np.ascontiguousarray(parts.half),
        body=parts.body,
        first=worn.first[parts.body, parts.part],
        second=worn.second[parts.body, parts.part],
        pattern=worn.pattern[parts.body, parts.part],
        boxes=boxes,
    )
    height, width = c.depth.shape[:2]
    extent = np.tile(np.array([width, height, -1, -1, 0]), (n, 1))
    visible = extent.copy()
    trace_into(
        depth=c.depth,
        label=c.label,
        stamp=c.stamp,
        extent=extent,
        rays=c.empty.rays,
        bodies=bodies,
        room=c.room,
        first_stamp=int(c.last[0]) + 1,
    )
    c.last[0] += n
    resolve_into(
        image=c.image,
        depth=c.depth,
        label=c.label,
        visible=visible,
        empty_depth=c.empty.depth,
        rays=c.empty.rays,
        extent=extent,
        bodies=bodies,
        room=c.room,
    )
    return extent, visible
