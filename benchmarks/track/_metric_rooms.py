"""Rooms of 10 x 8 m with sharp cameras, one person in five kinds of motion, and false bearings."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.geometry.camera import planar_offsets, u_to_azimuth
from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.records.scene import Camera, Scene
from occlog.records.tables import Bearings

SIZE = np.array([10.0, 8.0])
PLACES = ((0, 0, 45), (10, 8, 225), (10, 0, 135), (0, 8, 315), (5, 0, 90), (5, 8, 270), (10, 4, 180), (0, 4, 0))
"""x, y [m] and yaw [deg] of the cameras: the corners first."""
FOV_DEG = 100.0
RATE, SECONDS = 5.0, 40.0
MOTIONS = ("walk", "stop-and-go", "zig-zag", "still", "acceleration")


class Recording(NamedTuple):
    """What the cameras report, which rows are false, and the truth."""

    scene: Scene
    bearings: Bearings
    false: Bools  # (R,)
    t_ns: Ints  # (T,)
    xy: Floats  # (T, 2)


def room(cameras: int, focal_px: float, sigma_px: float) -> Scene:
    """The room with its first cameras."""
    lines = ["occlog_scene: 1", "length_unit: m", "room: [[0, 0], [10, 0], [10, 8], [0, 8]]", "cameras:"]
    for n, (x, y, yaw) in enumerate(PLACES[:cameras], start=1):
        lines.append(
            f"- {{name: cam{n}, position: [{x}, {y}], yaw_deg: {yaw}, focal_px: {focal_px:g}, fov_deg: {FOV_DEG:g}, "
            f"noise: {{position: 0, yaw: 0, measurement_noise_px: {sigma_px:g}}}}}"
        )
    return scene_from_yaml("\n".join(lines) + "\n", "a room with sharp cameras")


def path(motion: str, rng: np.random.Generator) -> Floats:
    """(T, 2) places of a person, a quarter of a metre from the walls at least."""
    dt, T = 1.0 / RATE, round(RATE * SECONDS)
    low, high = np.array([0.8, 0.8]), SIZE - 0.8
    speed = {"walk": 1.2, "stop-and-go": 1.2, "zig-zag": 2.5, "still": 0.0, "acceleration": 0.0}[motion]
    at, goal, out, rest = rng.uniform(low, high), rng.uniform(low, high), [], 0
    velocity = np.zeros(2)
    for _ in range(T):
        out.append(at.copy())
        if motion == "acceleration":
            # White acceleration, drawn to the middle of the room and damped
            velocity += dt * (0.25 * (0.5 * SIZE - at) - 0.3 * velocity) + 0.5 * math.sqrt(dt) * rng.standard_normal(2)
            at = np.clip(at + velocity * dt, low, high)
        elif rest > 0:
            rest -= 1
        elif speed > 0.0:
            away = goal - at
            far = float(np.hypot(*away))
            at = at + away / max(far, 1e-9) * min(speed * dt, far)
            if far <= speed * dt or (motion == "zig-zag" and rng.random() < 0.2):
                goal = rng.uniform(low, high)
                rest = int(rng.integers(5, 25)) if motion == "stop-and-go" else 0
    return np.array(out)


def record(
    motion: str,
    cameras: int = 4,
    *,
    focal_px: float = 600.0,
    sigma_px: float = 3.0,
    miss: float = 0.3,
    false: float = 0.0,
    asynchronous: bool = False,
    seed: int = 0,
) -> Recording:
    """A recording of one person.

    Args:
        motion: one of `MOTIONS`.
        cameras: how many of `PLACES`.
        focal_px: of all cameras.
        sigma_px: true and stated standard deviation of readings.
        miss: probability that a camera does not see the person.
        false: probability that a bearing is one drawn uniformly from the image.
        asynchronous: at each time one camera alone looks, in turn.
        seed: of all random numbers.
    """
    rng = np.random.default_rng([seed, MOTIONS.index(motion)])
    scene, xy = room(cameras, focal_px, sigma_px), path(motion, rng)
    T = len(xy)
    t_ns = np.round(np.arange(T) / RATE * 1e9).astype(np.int64)
    tables, wrong = [], []
    for n, camera in enumerate(scene.cameras):
        table, bad = _looks(camera, t_ns, xy, (sigma_px, miss, false), rng)
        rows = np.arange(T) % cameras == n if asynchronous else np.ones(T, dtype=np.bool_)
        tables.append(table.take(rows))
        wrong.append(dict(zip(t_ns[rows].tolist(), bad[rows].tolist(), strict=True)))
    bearings = Bearings.merge(tables)
    numbers = [int(name[3:]) - 1 for name in bearings.sensor.tolist()]
    bad = [wrong[n][t] for n, t in zip(numbers, bearings.t_ns.tolist(), strict=True)]
    return Recording(scene, bearings, np.array(bad, dtype=np.bool_), t_ns, xy)


def _looks(
    camera: Camera, t_ns: Ints, xy: Floats, chances: tuple[float, float, float], rng: np.random.Generator
) -> tuple[Bearings, Bools]:
    """One camera's rows, and which are false; chances are the noise [px], that of a miss, and that of a false one."""
    T, (sigma_px, miss, share) = len(t_ns), chances
    f, half = float(camera.focal_px[0]), math.tan(0.5 * camera.fov)
    h, d = planar_offsets(xy, camera.ground, camera.yaw)
    draw, noise = rng.random((3, T)), rng.standard_normal(T)
    seen = (d > 0.0) & (np.abs(h) < half * d) & (draw[0] >= miss)
    z = f * h / np.maximum(d, 1e-3) + sigma_px * noise
    false = seen & (draw[1] < share)
    z = np.where(false, f * half * (2.0 * draw[2] - 1.0), z)
    columns = {
        "bearing": u_to_azimuth(-z, camera.yaw, f),
        "sigma": sigma_px / (f * (1.0 + (z / f) ** 2)),
        "u_px": -z,
        "sigma_px": np.full(T, sigma_px),
    }
    table = Bearings.of(
        t_ns=t_ns,
        sensor=np.full(T, camera.name),
        target_id=np.zeros(T, dtype=np.int32),
        seen=seen,
        score=np.full(T, np.nan),
        **{name: np.where(seen, values, np.nan) for name, values in columns.items()},
    )
    return table, false
