"""The empty room as a camera sees it: colours, depths and lines of sight of every pixel, computed once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from occlog.array_types import Floats, Floats32, Ints
from occlog.core.numerics.jit import kernel
from occlog.core.plane import pack_polygons, point_inside
from occlog.records.scene import Camera, Scene

from . import surfaces as texture
from .surfaces import AMBIENT, lamps, light_at, shade_into

SAMPLES = ((-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25))
"""Positions in a pixel at which lines of sight are cast, against jagged edges."""

SKY = np.array([212.0, 196.0, 178.0])
NOTHING, FLOOR, CEILING, FACES = -1, 0, 1, 2
"""Surface hit by a line of sight: nothing, floor, ceiling; face k is FACES + k, cap k comes after the faces."""

LAMP_SPREAD = 0.12
"""Half the width of a lamp, in metres."""

BAND = 32
"""Rows computed at a time."""


class Solid(NamedTuple):
    """Walls, pillars and lamps of the scene visible to one camera, as arrays for the kernels.

    `faces` (F, 5) are visible upright faces: ax, ay, bx, by, height, and `wall` (F,) the mask of those of the room.
    `caps` (S, 2), `starts` (P + 1,) and `heights` (P,) are the packed outlines of the pillars; `reach` (P, 3)
    circles x, y, radius around them. `room` (K, 2) is the outline under the ceiling at `height`, (0, 2) without
    one. Lamps (L, 5): x, y, z, power, half-light distance. `metre` is the length of a metre in scene units,
    `contrast` a factor of the textures.
    """

    faces: Floats  # (F, 5) visible upright faces: ax, ay, bx, by, height
    wall: NDArray[np.bool_]  # (F,) a wall of the room, not a face of a pillar
    caps: Floats  # (S, 2) packed outlines of the pillars
    starts: Ints  # (P + 1,)
    heights: Floats  # (P,)
    reach: Floats  # (P, 3) circles around the pillars that hold all ways to a lamp they may block
    room: Floats  # (K, 2) outline under the ceiling; (0, 2): no ceiling
    height: float  # of the ceiling
    lights: Floats  # (L, 5)
    metre: float  # a metre in scene units
    contrast: float  # of the surfaces' grain


class Background(NamedTuple):
    """The empty room as seen by one camera, with four lines of sight per pixel and L lamps.

    Attributes:
        colour: (H, W, 3) BGR.
        depth: (H, W, 4) distance along the optical axis to what each line of sight hits.
        rays: (H, W, 4, 3) directions of the lines of sight in the world, with unit forward component.
        floor: (H, W, 3) x, y on the floor in the pixel's middle, and the share of the pixel that is floor.
        lamp: (H, W, L) light of each lamp on the floor there, without shadows.
    """

    colour: Floats32
    depth: Floats32
    rays: Floats32
    floor: Floats32
    lamp: Floats32


@kernel
def cast(
    origin: Floats,
    rays: Floats,
    faces: Floats,
    room: Floats,
    height: float,
    caps: Floats,
    starts: Ints,
    heights: Floats,
) -> tuple[Floats, Ints]:
    """Find the nearest hits of N lines of sight with the room.

    Args:
        origin: (3,) common origin of the lines.
        rays: (N, 3) directions.
        faces: (F, 5) upright faces: ax, ay, bx, by, height.
        room: (K, 2) outline under the ceiling; (0, 2): no ceiling.
        height: height of the ceiling.
        caps: (S, 2) outlines of P pillars, one after the other.
        starts: (P + 1,) index of the first corner of each, then S.
        heights: (P,) heights of the pillars.

    Returns:
        (N,) distances in ray lengths, inf without a hit, and (N,) surfaces: -1 none, 0 floor, 1 ceiling, then the
        faces, then the tops of the pillars.
    """
    cx, cy, cz = origin[0], origin[1], origin[2]
    t_out = np.full(rays.shape[0], np.inf)
    hit = np.full(rays.shape[0], -1, dtype=np.int64)
    for n in range(rays.shape[0]):
        dx, dy, dz = rays[n, 0], rays[n, 1], rays[n, 2]
        best, what = np.inf, -1
        if dz < 0.0:
            best, what = -cz / dz, 0
        elif dz > 0.0 and room.shape[0] > 0 and cz < height:
            t = (height - cz) / dz
            if point_inside(cx + t * dx, cy + t * dy, room):
                best, what = t, 1
        for f in range(faces.shape[0]):
            ax, ay = faces[f, 0], faces[f, 1]
            ex, ey = faces[f, 2] - ax, faces[f, 3] - ay
            cross = dx * ey - dy * ex
            if cross != 0.0:
                t = ((ax - cx) * ey - (ay - cy) * ex) / cross
                s = ((ax - cx) * dy - (ay - cy) * dx) / cross
                z = cz + t * dz
                if 0.0 < t < best and 0.0 <= s <= 1.0 and 0.0 <= z <= faces[f, 4]:
                    best, what = t, 2 + f
        for p in range(heights.shape[0]):
            if dz < 0.0 and cz > heights[p]:
                t = (heights[p] - cz) / dz
                if t < best and point_inside(cx + t * dx, cy + t * dy, caps[starts[p] : starts[p + 1]]):
                    best, what = t, 2 + faces.shape[0] + p
        t_out[n], hit[n] = best, what
    return t_out, hit


def solid_scene(scene: Scene, camera: Camera, metre: float, contrast: float) -> Solid:
    """Collect the surfaces that a camera can see: the sides of walls and pillars that face it, and pillar tops.

    `metre` is the length of a metre in scene units, `contrast` a factor of the surfaces' texture.
    """
    sides: list[list[float]] = []
    wall: list[bool] = []
    if scene.room is not None:
        sides += _sides(scene.room, scene.room_height, camera.ground, inner=True)
        wall += [True] * len(sides)
    for pillar in scene.occluders:
        found = _sides(pillar.polygon, pillar.height, camera.ground, inner=False)
        sides += found
        wall += [False] * len(found)
    return Solid(
        np.array(sides).reshape(-1, 5),
        np.array(wall, dtype=np.bool_),
        *pack_polygons([o.polygon for o in scene.occluders]),
        np.array([o.height for o in scene.occluders], dtype=np.float64),
        np.array([_circle(o.polygon, 2 * LAMP_SPREAD * metre) for o in scene.occluders]).reshape(-1, 3),
        np.empty((0, 2)) if scene.room is None else scene.room,
        scene.room_height,
        lamps(scene.surroundings, scene.room_height),
        metre,
        contrast,
    )


def _circle(polygon: Floats, margin: float) -> list[float]:
    middle = 0.5 * (polygon.min(axis=0) + polygon.max(axis=0))
    return [*middle, float(np.hypot(*(polygon - middle).T).max()) + margin]


def _sides(polygon: Floats, height: float, ground: Floats, inner: bool) -> list[list[float]]:
    """Edges of a counter-clockwise polygon with one side, inner or outer, turned to the camera.

    Args:
        polygon: (K, 2) corners.
        height: height of the face on each edge.
        ground: (2,) ground position of the camera.
        inner: the inner sides, of a room; otherwise the outer ones, of a pillar.

    Returns:
        ax, ay, bx, by (both ends) and height of each.
    """
    found = []
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        left = (b[0] - a[0]) * (ground[1] - a[1]) - (b[1] - a[1]) * (ground[0] - a[0])
        if (left > 0) if inner else (left < 0):
            found.append([*a, *b, height])
    return found


def background(scene: Scene, camera: Camera, metre: float, contrast: float = 1.0) -> Background:
    """Render the empty room for one camera, with four lines of sight per pixel.

    `metre` is the length of a metre in scene units, `contrast` a factor of the surfaces' texture.
    """
    solid = solid_scene(scene, camera, metre, contrast)
    out = blank(camera, len(solid.lights))
    height = out.depth.shape[0]
    for top in range(0, height, BAND):
        _band_into(out, camera, solid, top, min(top + BAND, height))
    return out


def blank(camera: Camera, n_lights: int) -> Background:
    """Black background at infinite depth without a floor, with the camera's lines of sight, for `n_lights` lamps.

    ValueError for a camera without image size.
    """
    if camera.image_size is None:
        raise ValueError(f"camera {camera.name} has no image size; give image_size_px in the scene")
    width, height = camera.image_size
    out = Background(
        colour=np.zeros((height, width, 3), np.float32),
        depth=np.full((height, width, 4), np.inf, np.float32),
        rays=np.empty((height, width, 4, 3), np.float32),
        floor=np.zeros((height, width, 3), np.float32),
        lamp=np.zeros((height, width, n_lights), np.float32),
    )
    for top in range(0, height, BAND):
        rows = out.rays[top : top + BAND]
        rows[:] = _lines_of_sight(camera, top, top + len(rows), width).reshape(rows.shape)
    return out


def _lines_of_sight(camera: Camera, top: int, bottom: int, width: int) -> Floats:
    """(rows * width * 4, 3) directions in the world of lines of sight, four for each pixel of some image rows.

    The rows are `top` <= row < `bottom`.
    """
    v, u = np.mgrid[top:bottom, 0:width].astype(np.float64)
    pixels = np.stack([np.stack([u + du, v + dv], axis=-1) for du, dv in SAMPLES], axis=2)
    return camera.rays(camera.to_usable(pixels.reshape(-1, 2)))


def _band_into(out: Background, camera: Camera, solid: Solid, top: int, bottom: int) -> None:
    """Render some rows of the image of the empty room, in place.

    Args:
        out: background with the directions of its pixels; colours, depths, positions on the floor and the light there
            are filled.
        camera: camera from which the room is seen.
        solid: surfaces of the scene.
        top: first row.
        bottom: row after the last one.
    """
    width = out.depth.shape[1]
    rays = out.rays[top:bottom].reshape(-1, 3).astype(np.float64)
    t, hit = cast(
        origin=camera.position,
        rays=rays,
        faces=solid.faces,
        room=solid.room,
        height=solid.height,
        caps=solid.caps,
        starts=solid.starts,
        heights=solid.heights,
    )
    colour = surface_colours(camera.position, rays, t, hit, solid)
    shape = (bottom - top, width, 4)
    out.colour[top:bottom] = colour.reshape(*shape, 3).mean(axis=2)
    out.depth[top:bottom] = t.reshape(shape)
    on_floor = (hit == FLOOR).reshape(shape).mean(axis=2)
    centre = rays.reshape(*shape, 3).mean(axis=2)
    floor_into(out.floor[top:bottom], out.lamp[top:bottom], on_floor, centre, camera.position, solid.lights)


@kernel
def floor_into(floor: Floats32, lamp: Floats32, share: Floats, rays: Floats, origin: Floats, lights: Floats) -> None:
    """Compute, in place, the position on the floor seen by each pixel, and the light of each lamp there.

    Args:
        floor: (H, W, 3) x, y and share of the pixel that is floor; filled where that is above 0.
        lamp: (H, W, L) light of each lamp; filled where the share is above 0.
        share: (H, W) share of each pixel that is floor, 0 to 1.
        rays: (H, W, 3) directions through the middles of the pixels.
        origin: (3,) position of the camera.
        lights: (L, 5) lamps: x, y, z, power, and half-light distance.
    """
    for row in range(share.shape[0]):
        for col in range(share.shape[1]):
            if share[row, col] > 0.0 and rays[row, col, 2] < 0.0:
                t = -origin[2] / rays[row, col, 2]
                x, y = origin[0] + t * rays[row, col, 0], origin[1] + t * rays[row, col, 1]
                floor[row, col, 0], floor[row, col, 1], floor[row, col, 2] = x, y, share[row, col]
                for k in range(lights.shape[0]):
                    lamp[row, col, k] = light_at(x, y, 0.0, 0.0, 0.0, 1.0, lights[k : k + 1], 0.0)


def surface_colours(origin: Floats, rays: Floats, t: Floats, hit: Ints, solid: Solid) -> Floats:
    """(N, 3) lit BGR colours of the surface points hit by lines of sight; the sky colour for misses.

    Args:
        origin: (3,) common origin of the lines.
        rays: (N, 3) directions.
        t: (N,) distances in ray lengths, inf without a hit.
        hit: (N,) surfaces as numbered by `cast`, -1 without a hit.
        solid: surfaces of the scene.
    """
    colour = np.tile(SKY, (len(rays), 1))
    normals = np.zeros((len(rays), 3))
    points = origin + np.where(np.isfinite(t), t, 0.0)[:, None] * rays
    metres = points / solid.metre
    for what in np.unique(hit[hit >= 0]).tolist():
        here = hit == what
        colour[here], normals[here] = _surface(what, metres[here], solid)
    brightness = np.empty(len(rays))
    shade_into(
        out=brightness,
        points=points,
        normals=normals,
        lights=solid.lights,
        spread=LAMP_SPREAD * solid.metre,
        walls=solid.caps,
        starts=solid.starts,
        heights=solid.heights,
        reach=solid.reach,
        ambient=AMBIENT,
    )
    return np.where((hit >= 0)[:, None], colour * brightness[:, None], colour)


def _surface(what: int, metres: Floats, solid: Solid) -> tuple[Floats, Floats]:
    """Unlit BGR colours (N, 3) of points on one surface, and the surface's unit normal (3,).

    Args:
        what: surface as numbered by `cast`.
        metres: (N, 3) points in the world [m].
        solid: surfaces of the scene.
    """
    x, y, z = metres.T
    k, contrast = what - FACES, solid.contrast
    if what == FLOOR:
        return texture.floor_colour(x, y, contrast), np.array([0.0, 0.0, 1.0])
    if what == CEILING:
        return texture.ceiling_colour(x, y, contrast), np.array([0.0, 0.0, -1.0])
    if k >= len(solid.faces):
        return texture.pillar_colour(x, y, k, contrast), np.array([0.0, 0.0, 1.0])
    ax, ay, bx, by, height = solid.faces[k]
    length = np.hypot(bx - ax, by - ay)
    ex, ey = (bx - ax) / length, (by - ay) / length
    along = (x - ax / solid.metre) * ex + (y - ay / solid.metre) * ey
    if solid.wall[k]:
        return texture.wall_colour(along, z, k, height / solid.metre, contrast), np.array([-ey, ex, 0.0])
    return texture.pillar_colour(along, z, k, contrast), np.array([ey, -ex, 0.0])
