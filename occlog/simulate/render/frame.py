"""One frame: the empty room, shadows, bodies, light and noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from occlog.array_types import Bytes, Floats, Floats32, Ints
from occlog.records.scene import Camera, Scene

from .body import STATURE, Clothes, solids
from .bounds import around_ellipsoids, around_shadows, ideal_limits, pixel_boxes
from .gait import poses
from .kernel import Bodies, Room, finish_into, resolve_into, shadow_into, trace_into
from .light import AMBIENT, lamps
from .room import Background, background, blank

NEAR = 0.05
"""Nothing nearer to the camera is drawn [m]."""
RADIUS = 0.22
"""Of the cylinder that throws a body's shadow [m]."""
SHADOW_REACH = 2.5
"""A shadow is drawn up to this distance from its body [m]."""


class Canvas(NamedTuple):
    """What one camera keeps from frame to frame."""

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


class Drawn(NamedTuple):
    """A frame and what is in it."""

    image: Bytes  # (H, W, 3) BGR
    present: Ints  # (m,) which objects were there to be drawn
    extent: Ints  # (m, 5) left, top, right, bottom pixel and sight lines, hidden parts included
    visible: Ints  # (m, 5) the same of the visible parts


def canvas(scene: Scene, camera: Camera, metre: float, noise: Floats32, contrast: float = 1.0) -> Canvas:
    """Everything about a camera that does not change, and its work space.

    Args:
        scene: room and occluders.
        camera: with image size and pose.
        metre: a metre in scene units.
        noise: (N,) standard normal numbers; every row of a frame takes a stretch of them from
            a random place on.  N must be well above three times the width of the image.
        contrast: of the surfaces' grain.
    """
    lights = lamps(scene.region, scene.room_height)
    return _on(camera, background(scene, camera, metre, contrast), lights, metre, noise)


def bare_canvas(camera: Camera, lights: Floats, metre: float) -> Canvas:
    """A canvas for bodies alone, on black and without noise."""
    width = (camera.image_size or (0, 0))[0]
    return _on(camera, blank(camera, len(lights)), lights, metre, np.zeros(4 * width, dtype=np.float32))


def _on(camera: Camera, empty: Background, lights: Floats, metre: float, noise: Floats32) -> Canvas:
    return Canvas(
        camera,
        empty,
        Room(camera.position, lights, AMBIENT, metre, NEAR * metre),
        ideal_limits(camera),
        np.empty_like(empty.colour),
        empty.depth.copy(),
        np.full(empty.depth.shape, -1, dtype=np.int32),
        np.zeros(empty.depth.shape, dtype=np.int64),
        noise,
        np.zeros(1, dtype=np.int64),
    )


def draw(
    c: Canvas,
    rows: Floats,
    clothes: Clothes,
    gain: float,
    sigmas: tuple[float, float],
    shadows: bool,
    rng: np.random.Generator,
) -> Drawn:
    """One frame.

    Args:
        c: the camera's canvas; its work space is used, so that a canvas draws one frame at a time.
        rows: (n, 5) x, y, vx, vy, phase of the objects; a row with NaN is not there.
        clothes: of the n objects.
        gain: factor of the light.
        sigmas: standard deviation of the noise common to the three colours, and of that of each colour [grey levels].
        shadows: whether bodies throw shadows on the floor.
        rng: source of the noise.
    """
    np.copyto(c.image, c.empty.colour)
    present = np.flatnonzero(np.isfinite(rows).all(axis=1))
    worn = Clothes(*(part[present] for part in clothes))  # type: ignore[arg-type]
    if shadows:
        _shadows(c, rows[present], worn)
    extent, visible = _bodies(c, rows[present], worn)
    stretches = rng.integers(0, len(c.noise) - 3 * c.image.shape[1], (len(c.image), 2), endpoint=True)
    image = np.empty(c.image.shape, dtype=np.uint8)
    finish_into(image, c.image, c.noise, stretches, gain, *sigmas)
    return Drawn(image, present, extent, visible)


def _shadows(c: Canvas, rows: Floats, worn: Clothes) -> None:
    metre = c.room.metre
    height: Floats = STATURE * metre * worn.stature
    radius: Floats = RADIUS * metre * worn.stature
    reach = np.full(len(rows), SHADOW_REACH * metre)
    around = around_shadows(rows[:, :2], height, radius, c.room.lights, reach)
    boxes = pixel_boxes(c.camera, c.limits, around)
    for k in range(len(rows)):
        x, y = float(rows[k, 0]), float(rows[k, 1])
        shadow_into(c.image, c.empty.floor, c.empty.lamp, x, y, float(height[k]), float(radius[k]), boxes[k], c.room)


def _bodies(c: Canvas, rows: Floats, worn: Clothes) -> tuple[Ints, Ints]:
    """Draw the bodies; returns extent and visible part of each."""
    n = len(rows)
    parts = solids(poses(rows), worn, c.room.metre)
    boxes = pixel_boxes(c.camera, c.limits, around_ellipsoids(parts.centre, parts.axes, parts.half))
    bodies = Bodies(
        np.ascontiguousarray(parts.centre),
        np.ascontiguousarray(parts.axes),
        np.ascontiguousarray(parts.half),
        parts.body,
        worn.first[parts.body, parts.part],
        worn.second[parts.body, parts.part],
        worn.pattern[parts.body, parts.part],
        boxes,
    )
    height, width = c.depth.shape[:2]
    extent = np.tile(np.array([width, height, -1, -1, 0]), (n, 1))
    visible = extent.copy()
    trace_into(c.depth, c.label, c.stamp, extent, c.empty.rays, bodies, c.room, int(c.last[0]) + 1)
    c.last[0] += n
    resolve_into(c.image, c.depth, c.label, visible, c.empty.depth, c.empty.rays, extent, bodies, c.room)
    return extent, visible
