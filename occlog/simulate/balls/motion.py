"""Simulated balls in a box, and the cameras around it: the world of [Qu] Sec. 4.1.

Lengths are pixels: cameras are distant with long lenses, so that a pixel is one unit everywhere in the box. The floor
is at z = 0, half an image height below the centre of the box.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.core.geometry.camera import rotation_from_angles
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.errors import InputError
from occlog.records.scene import Camera

from .config import FASTEST, BallsConfig

VIEWS = ((0.0, 0.0), (90.0, 0.0), (45.0, -15.0), (135.0, -15.0), (20.0, -10.0), (110.0, -10.0))
"""Yaw and pitch [deg] of the cameras that there may be: the two of the paper, then more that point down."""

TRIES = 5_000
"""Draws of starting positions before it is stated that the balls have no room."""


class BallPaths(NamedTuple):
    """True paths of n balls in T frames: centres (T, n, 3) in the world, and rotations world-from-ball (T, n, 3, 3)."""

    centres: Floats  # (T, n, 3)
    turns: Floats  # (T, n, 3, 3) world-from-ball rotations


def ball_cameras(config: BallsConfig) -> tuple[Camera, ...]:
    """Cameras `view1`, `view2`, ... around the box of the balls; a pixel is one unit at the centre of the box."""
    middle = np.array([0.0, 0.0, 0.5 * config.height])
    cameras = []
    for k, (yaw, pitch) in enumerate(VIEWS[: config.views]):
        rotation = rotation_from_angles(math.radians(yaw), math.radians(pitch), 0.0)
        camera = Camera(
            name=f"view{k + 1}",
            position=middle - config.distance * rotation[:, 2],
            rotation=rotation,
            focal_px=np.full(2, config.distance),
            principal_px=0.5 * np.array([config.width - 1.0, config.height - 1.0]),
            image_size=(config.width, config.height),
            fov=2.0 * math.atan(0.5 * config.width / config.distance),
        )
        cameras.append(camera)
    return tuple(cameras)


def ball_box(config: BallsConfig) -> Floats:
    """(3,) half lengths of the box in which balls move, in x, y, z [px].

    The box is as wide and high as the images, or smaller so that all views contain it.
    """
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
    half = 0.5 * np.array([config.width, config.width, config.height], dtype=np.float64)
    cameras, middle = ball_cameras(config), np.array([0.0, 0.0, 0.5 * config.height])
    return half * _largest(lambda scale: _all_inside(cameras, middle + scale * signs * half))


def _largest(good: Callable[[float], bool]) -> float:
    """Largest scale from 0 to 1 for which `good` (True up to a limit) is True, by bisection."""
    if good(1.0):
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(50):
        scale = 0.5 * (low + high)
        low, high = (scale, high) if good(scale) else (low, scale)
    return low


def _all_inside(cameras: tuple[Camera, ...], points: Floats) -> bool:
    """Whether all points (N, 3) in the world are in the images of all cameras, to 0.1 px."""
    for camera in cameras:
        pixels = camera.project(points)
        size = np.asarray(camera.image_size)
        if not ((pixels > -0.6) & (pixels < size - 0.4)).all():
            return False
    return True


def ball_paths(config: BallsConfig, seed: int) -> BallPaths:
    """Simulate the movement of the balls, in all frames ([Qu] Sec. 4.1).

    Args:
        config: number, radius and motion of the balls, images, and number T of frames.
        seed: seed of the random numbers.

    Raises:
        InputError: the balls do not fit into the box that all views see.
    """
    reach = ball_box(config) - config.radius
    if not (reach > 0).all():
        raise InputError(
            f"balls: a radius of {config.radius:g} px does not fit into the box of half lengths "
            f"{', '.join(f'{h:g}' for h in reach + config.radius)}; make the balls smaller or the images larger",
            id="no-room",
        )
    # Place the balls in the scene that all views see ([Qu] Sec. 4.1)
    start = _start(config, reach, generator(seed, RandomStream.WORLD_START))
    rngs = [generator(seed, RandomStream.WORLD_MOTION, k) for k in range(config.balls)]
    # Move them independently of each other, or as balls that collide
    speeds = config.ball_speed * np.array([rng.uniform(0.5, 1.5) for rng in rngs])
    velocity = speeds[:, None] * _directions(rngs)
    # Turn each about its own axis
    axes = _directions(rngs)
    first = np.array([rng.uniform(0.0, 2.0 * np.pi) for rng in rngs])
    angles = first + config.spin * np.arange(config.frames)[:, None]
    if config.collide:
        centres = _bounce(config, start, velocity, reach)
    else:
        centres = _folded(start + _way(config, velocity, rngs), reach)
    centres[..., 2] += 0.5 * config.height
    return BallPaths(centres, _rotations(axes, angles))


def _directions(rngs: list[np.random.Generator]) -> Floats:
    """(n, 3) uniformly distributed unit vectors, each from one of the n generators."""
    drawn = np.array([rng.standard_normal(3) for rng in rngs])
    return np.asarray(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))


def _start(config: BallsConfig, reach: Floats, rng: np.random.Generator) -> Floats:
    """(n, 3) start positions relative to the centre of the box, uniform in it.

    They are separated in all views if `start_separated`, and in space if balls collide. InputError if there is no room.
    `reach` (3,) are the half lengths of the box for centres.
    """
    cameras, middle = ball_cameras(config), np.array([0.0, 0.0, 0.5 * config.height])
    gap = 2.1 * config.radius
    placed = np.zeros((0, 3))
    for _ in range(TRIES):
        one = rng.uniform(-reach, reach)
        views = (
            [camera.project(middle + np.vstack([placed, one])) for camera in cameras] if config.start_separated else []
        )
        sets = [*views, np.vstack([placed, one])] if config.collide else views
        if all((np.linalg.norm(s[:-1] - s[-1], axis=1) > gap).all() for s in sets):
            placed = np.vstack([placed, one])
        elif rng.random() < 0.01:
            placed = np.zeros((0, 3))  # the first ones may leave no room for the rest
        if len(placed) == config.balls:
            return placed
    where = f"{config.balls} balls of radius {config.radius:g} px that start separately"
    if config.start_separated:
        raise InputError(
            f"balls: no room for {where}; take fewer or smaller ones, or let them overlap initially", id="no-room"
        )
    if config.collide:
        raise InputError(
            f"balls: no room for {where}, as balls that collide must; take fewer or smaller ones", id="no-room"
        )
    raise InputError(f"balls: {config.balls} are more than the {TRIES} that there can be; take fewer", id="no-room")


def _way(config: BallsConfig, velocity: Floats, rngs: list[np.random.Generator]) -> Floats:
    """(T, n, 3) paths of the balls from their starts, without walls [px].

    Args:
        config: kind of motion, speeds, and number T of frames.
        velocity: (n, 3) initial velocities [px/frame].
        rngs: random generator of each ball.
    """
    T = config.frames
    if config.ball_motion == "straight":
        return np.asarray(velocity * np.arange(T)[:, None, None])
    drawn = np.stack([rng.standard_normal((T - 1, 3)) for rng in rngs], axis=1)
    steps = config.ball_speed * drawn
    if config.ball_motion == "manoeuvre":
        v = velocity
        for t in range(T - 1):
            v = v + config.ball_acceleration * drawn[t]
            speed = np.linalg.norm(v, axis=1, keepdims=True)
            v = v * np.minimum(1.0, FASTEST * config.ball_speed / np.maximum(speed, 1e-12))
            steps[t] = v
    return np.concatenate([np.zeros((1, *velocity.shape)), np.cumsum(steps, axis=0)])


def _folded(way: Floats, reach: Floats) -> Floats:
    """(T, n, 3) positions of balls reflected by the walls: a path without walls, folded into the box.

    Args:
        way: (T, n, 3) positions without walls, relative to the centre of the box.
        reach: (3,) half lengths of the box for centres.
    """
    folded = np.mod(way + reach, 4.0 * reach)
    return np.asarray(np.where(folded > 2.0 * reach, 4.0 * reach - folded, folded) - reach)


def _bounce(config: BallsConfig, start: Floats, velocity: Floats, reach: Floats) -> Floats:
    """(T, n, 3) positions of balls of equal mass that collide with each other and the walls.

    Steps of time are so short that a ball moves at most a tenth of a radius.

    Args:
        config: number T of frames, speed and radius.
        start: (n, 3) positions in the first frame, relative to the centre of the box.
        velocity: (n, 3) initial velocities [px/frame].
        reach: (3,) half lengths of the box for centres.
    """
    position, v = start.copy(), velocity.copy()
    steps = max(1, math.ceil(1.5 * config.ball_speed / (0.1 * config.radius)))
    out = np.empty((config.frames, *start.shape))
    for t in range(config.frames):
        out[t] = position
        for _ in range(steps):
            position += v / steps
            outside = np.abs(position) > reach
            v = np.where(outside, -np.sign(position) * np.abs(v), v)
            position = np.clip(position, -reach, reach)
            _collide(position, v, 2.0 * config.radius)
    return out


def _collide(position: Floats, v: Floats, diameter: float) -> None:
    """Change the velocities `v` (n, 3), in place, by elastic collisions of balls that approach each other.

    Pairs with centres `position` (n, 3) nearer than `diameter` exchange their velocities along the line of centres.
    """
    for i in range(len(position)):
        for j in np.flatnonzero(np.linalg.norm(position[i + 1 :] - position[i], axis=1) < diameter) + i + 1:
            along = position[j] - position[i]
            along /= max(float(np.linalg.norm(along)), 1e-12)
            closing = (v[i] - v[j]) @ along
            if closing > 0.0:
                v[i] -= closing * along
                v[j] += closing * along


def _rotations(axes: Floats, angles: Floats) -> Floats:
    """(T, n, 3, 3) rotation matrices about unit axes (n, 3) by angles (T, n) [rad] (Rodrigues)."""
    x, y, z = axes.T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(-1, 3, 3)
    s, c = np.sin(angles)[..., None, None], np.cos(angles)[..., None, None]
    return np.asarray(np.eye(3) + s * cross + (1.0 - c) * (cross @ cross))


def ball_ellipses(camera: Camera, centres: Floats, radius: float) -> Floats:
    """Outlines of balls in an image without distortion and with square pixels, as ellipses.

    A ball at the angle t off the optical axis that spans the half angle u is an ellipse with
    half axes f sin(u) cos(u) / q away from the principal point and f sin(u) / sqrt(q) across,
    centred at f sin(t) cos(t) / q from it, q = cos(t)^2 - sin(u)^2.

    Args:
        camera: camera with its pose.
        centres: (..., 3) world positions of the balls, wholly in front of the camera.
        radius: radius of the balls, > 0.

    Returns:
        (..., 5) centre x, y [px], half axes away from the principal point and across [px], and the angle of the
        first from the x axis of the image towards y [rad].
    """
    local = (np.asarray(centres) - camera.position) @ camera.rotation
    x, y, z = local[..., 0], local[..., 1], local[..., 2]
    flat, f = np.hypot(x, y), camera.focal_px[0]
    distance = np.hypot(flat, z)
    sin_t, cos_t, sin_u = flat / distance, z / distance, radius / distance
    q = cos_t**2 - sin_u**2
    rho, out = np.arctan2(y, x), np.empty((*local.shape[:-1], 5))
    along = f * sin_t * cos_t / q
    out[..., 0] = camera.principal_px[0] + along * np.cos(rho)
    out[..., 1] = camera.principal_px[1] + along * np.sin(rho)
    out[..., 2] = f * sin_u * np.sqrt(1.0 - sin_u**2) / q
    out[..., 3] = f * sin_u / np.sqrt(q)
    out[..., 4] = np.where(flat > 0.0, rho, 0.0)
    return out
