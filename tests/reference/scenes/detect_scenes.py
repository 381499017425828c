"""A made-up room with cameras, and images of upright ellipses of known colour at known places in it."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable

import cv2
import numpy as np

from occlog.core.geometry.camera import rotation_from_angles
from occlog.errors import InputError
from occlog.records.frames import Frame
from occlog.records.scene import Camera, Scene

STEP_NS = 100_000_000
SIZE = (160, 120)
RED, BLUE = (20, 45, 220), (220, 60, 20)


def camera(name: str, x: float, y: float, yaw_deg: float, **other: object) -> Camera:
    values: dict[str, object] = {
        "position": np.array([x, y, 2.5]),
        "rotation": rotation_from_angles(np.radians(yaw_deg), np.radians(-15.0), np.radians(5.0)),
        "focal_px": np.array([110.0, 110.0]),
        "principal_px": np.array([79.5, 59.5]),
        "image_size": SIZE,
        **other,
    }
    return Camera(name, **values)  # type: ignore[arg-type]


def scene(*cameras: Camera) -> Scene:
    given = cameras or (camera("a", 0.0, 0.0, 45.0), camera("b", 8.0, 0.0, 135.0))
    return Scene(cameras=given, room=np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 8.0], [0.0, 8.0]]))


@functools.cache
def background(name: str) -> np.ndarray:
    rng = np.random.default_rng(sum(name.encode()))
    image = cv2.GaussianBlur(rng.integers(0, 255, (SIZE[1], SIZE[0], 3), dtype=np.uint8), (0, 0), 4)
    image = cv2.normalize(image, None, 90, 170, cv2.NORM_MINMAX)
    image.flags.writeable = False
    return image


def picture(cam: Camera, people: Iterable[tuple[float, float, tuple[int, int, int]]], seed: int) -> np.ndarray:
    """Image of people (x, y, colour), farther ones first, with a little noise."""
    image = background(cam.name).astype(np.float64)
    v, u = np.mgrid[0 : SIZE[1], 0 : SIZE[0]]
    for x, y, colour in sorted(people, key=lambda p: -np.hypot(p[0] - cam.position[0], p[1] - cam.position[1])):
        foot, head = cam.project(np.array([[x, y, 0.0], [x, y, 1.7]]))
        if not np.isfinite(foot).all():
            continue
        axis = head - foot
        length = np.hypot(*axis)
        d = np.stack([u - 0.5 * (foot + head)[0], v - 0.5 * (foot + head)[1]], axis=-1)
        along, across = d @ axis / length, d @ np.array([-axis[1], axis[0]]) / length
        image[(along / (length / 2)) ** 2 + (across / (0.16 * length)) ** 2 <= 1.0] = colour
    noise = np.random.default_rng(seed).normal(0, 2, image.shape)
    return np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)


def walk(n: int) -> list[tuple[float, float, tuple[int, int, int]]]:
    """Somebody in red who crosses the room."""
    return [(2.5 + 3.0 * k / max(n - 1, 1), 4.0 + 1.0 * k / max(n - 1, 1), RED) for k in range(n)]


def frames(
    made_scene: Scene, n: int, people: Callable[[int], list[tuple[float, float, tuple[int, int, int]]]]
) -> list[Frame]:
    """Frames of all cameras at n times."""
    out = []
    for k in range(n):
        for number, cam in enumerate(made_scene.cameras):
            image = picture(cam, people(k), 1000 * number + k)
            out.append(Frame(k * STEP_NS, cam.name, k, functools.partial(_copy, image)))
    return out


def replaced(items: list[Frame], sensor: str, index: int, decode: Callable[[], np.ndarray]) -> list[Frame]:
    """The frames, with another image in one of them."""
    return [Frame(f.t_ns, f.sensor, f.index, decode) if (f.sensor, f.index) == (sensor, index) else f for f in items]


def broken() -> np.ndarray:
    raise InputError("walk.mcap: camera a: frame 5: the image cannot be decoded (12 bytes)")


def _copy(image: np.ndarray) -> np.ndarray:
    return image.copy()
