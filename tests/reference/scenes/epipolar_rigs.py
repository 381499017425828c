"""Random calibrated rigs of two cameras, and points that both see."""

import numpy as np

from occlog.core.geometry.camera import rotation_from_angles
from occlog.records.scene import Camera


def looking(name, position, target, focal, roll=0.0, **more):
    """A camera of 640 x 480 px that points from a place to another one."""
    d = np.asarray(target, dtype=float) - position
    yaw, pitch = np.arctan2(d[1], d[0]), np.arctan2(d[2], np.hypot(d[0], d[1]))
    rotation = rotation_from_angles(yaw, pitch, roll)
    inner = np.full(2, focal), np.array([319.5, 239.5])
    return Camera(name, np.asarray(position, dtype=float), rotation, *inner, image_size=(640, 480), **more)


def rig(rng, distance=None, **more):
    """Two cameras 20 to 120 degrees apart around a room of 5 x 5 x 2; `distance` keeps the size in view."""
    first = rng.uniform(-np.pi, np.pi)
    second = first + np.radians(rng.uniform(20, 120)) * rng.choice([-1, 1])
    cameras = []
    for name, angle in (("a", first), ("b", second)):
        r = rng.uniform(6, 14) if distance is None else distance
        focal = rng.uniform(450, 900) if distance is None else 62.5 * r
        position = [r * np.cos(angle), r * np.sin(angle), rng.uniform(1, 4)]
        cameras.append(looking(name, position, rng.normal([0, 0, 1], 0.3), focal, rng.normal(0, 0.1), **more))
    return cameras


def room_points(rng, n):
    return rng.uniform([-2.5, -2.5, 0.0], [2.5, 2.5, 2.0], (n, 3))


def flat_points(rng, n):
    """Points of a plane through the middle of the room."""
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    points = room_points(rng, n) - [0, 0, 1]
    return points - np.outer(points @ normal, normal) + [0, 0, 1]


def matches(rng, cameras, points, noise, wrong=0.0):
    """Noisy images of points in both views; the first ones, a share, are wrong in the second view."""
    a, b = (camera.project(points) + rng.normal(0, noise, (len(points), 2)) for camera in cameras)
    k = int(wrong * len(points))
    b[:k] = rng.uniform([0, 0], [640, 480], (k, 2))
    return a, b
