"""In which part of an image a thing can be: bounds of projected points that are safe to search in."""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.sight.camera import distort
from occlog.records.scene import Camera

NEAR = 1e-6
BORDER = np.linspace(0.0, 1.0, 9)


def ideal_limits(camera: Camera) -> Floats:
    """(4,) least and greatest ideal normalised image coordinates of the image's pixels: x0, y0, x1, y1."""
    width, height = camera.image_size or (0, 0)
    across, down = np.linspace(-0.5, width - 0.5, 65), np.linspace(-0.5, height - 0.5, 65)
    sides = [np.column_stack([np.full(65, x), down]) for x in (-0.5, width - 0.5)]
    ends = [np.column_stack([across, np.full(65, y)]) for y in (-0.5, height - 0.5)]
    local = camera.rays(np.vstack(sides + ends)) @ camera.rotation
    return np.concatenate([local[:, :2].min(axis=0), local[:, :2].max(axis=0)])


def pixel_boxes(camera: Camera, limits: Floats, points: Floats) -> Ints:
    """Pixels in which things can be whose convex hulls are given by points.

    Args:
        camera: with an image size.
        limits: (4,) `ideal_limits` of the camera.
        points: (P, m, 3) world points around each of P things.

    Returns:
        (P, 4) left, top, right, bottom, half-open; empty behind the camera or beside the
        image, the whole image for a thing that reaches from before to behind the camera.
    """
    width, height = camera.image_size or (0, 0)
    local = (points - camera.position) @ camera.rotation
    depth = local[..., 2]
    behind = np.all(depth <= NEAR, axis=1)
    through = np.any(depth <= NEAR, axis=1) & ~behind
    flat = local[..., :2] / np.maximum(depth, NEAR)[..., None]
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
    """Bounds in the recorded image of boxes in ideal normalised coordinates; lens distortion bends their sides."""
    u = np.concatenate([BORDER, BORDER, 0 * BORDER, 0 * BORDER + 1])
    v = np.concatenate([0 * BORDER, 0 * BORDER + 1, BORDER, BORDER])
    border = low[:, None] + (high - low)[:, None] * np.stack([u, v], axis=-1)
    bent = distort(border.reshape(-1, 2), camera.distortion, camera.distortion_model).reshape(border.shape)
    pixels = bent * camera.focal_px + camera.principal_px
    slack = 0.0 if not np.any(camera.distortion) else 2.0
    return pixels.min(axis=1) - slack, pixels.max(axis=1) + slack


def around_ellipsoids(centre: Floats, axes: Floats, half: Floats) -> Floats:
    """(P, 8, 3) corners of the boxes around ellipsoids |A (p - c)| = 1; `half` are the lengths of the axes."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
    edges = axes * half[..., None] ** 2  # rows: axis direction times half length
    return np.asarray(centre[:, None] + np.einsum("ck,pkj->pcj", signs, edges))


def around_shadows(xy: Floats, height: Floats, radius: Floats, lights: Floats, reach: Floats) -> Floats:
    """(n, m, 3) floor points around the shadows of upright cylinders, cut at `reach` from the cylinder."""
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
