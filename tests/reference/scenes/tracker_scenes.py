"""Scenes, scans and a waypoint walker for tests of trackers."""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats
from occlog.core.geometry.camera import noise_variance, planar_offsets, rotation_from_angles
from occlog.records.scene import Camera, MicrophoneArray, Occluder, Scene
from occlog.records.tables import Bearings
from occlog.scans.grouping import Scan

SECOND = 1_000_000_000
ROOM = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 100.0], [0.0, 100.0]])
PILLAR = np.array([[40.0, 40.0], [60.0, 40.0], [60.0, 60.0], [40.0, 60.0]])
PLACES = [(0, 0), (50, 0), (100, 0), (100, 50), (100, 100), (50, 100), (0, 100), (0, 50)]
YAWS = [45, 90, 135, 180, 225, 270, 315, 0]


def camera(name: str, xy, yaw_deg: float, **options) -> Camera:
    values = {
        "focal": 70.0,
        "fov": np.pi / 2,
        "sigma_position": 1.0,
        "sigma_yaw": 0.01,
        "sigma_read_px": 2.0,
        **options,
    }
    focal = values.pop("focal")
    return Camera(
        name,
        np.array([*xy, 0.0], dtype=float),
        rotation_from_angles(np.radians(yaw_deg), 0.0, 0.0),
        np.array([focal, focal]),
        np.zeros(2),
        **values,
    )


def room100(pillar: bool = True, cameras: int = 8, unit: str = "unit", **options) -> Scene:
    """The reference scene of [Ercan] Sec. 6."""
    return Scene(
        cameras=tuple(camera(f"cam{i + 1}", PLACES[i], YAWS[i], **options) for i in range(cameras)),
        occluders=(Occluder("pillar", PILLAR),) if pillar else (),
        room=ROOM,
        length_unit=unit,
    )


def with_array(scene: Scene, xy, **options) -> Scene:
    array = MicrophoneArray("array", np.array([*xy, 0.0], dtype=float), **options)
    return Scene(scene.cameras, (array,), scene.occluders, scene.clocks, scene.room, length_unit=scene.length_unit)


def scan(t_s: float, rows, labelled=True) -> Scan:
    """A scan of rows (sensor, u_px) - None: not seen - or (sensor, u_px, sigma_px, score); NaN pixels: see `Scan`."""
    rows = sorted(((*row, np.nan, np.nan)[:4] for row in rows), key=lambda row: row[0])
    sensor, u, sigma, score = (list(c) for c in zip(*rows, strict=True))
    seen = np.array([value is not None for value in u])
    u = np.array([np.nan if value is None else value for value in u], dtype=float)
    n = len(rows)
    return Scan.of(
        round(t_s * SECOND),
        sensor,
        target_id=np.full(n, 0 if labelled else -1),
        seen=seen,
        bearing=np.where(seen, 0.0, np.nan),
        sigma=np.where(seen, 1.0, np.nan),
        u_px=u,
        sigma_px=sigma,
        score=score,
    )


def true_u(scene: Scene, xy) -> list[float]:
    """Readings u_px without noise of every camera, NaN behind it."""
    out = []
    for c in scene.cameras:
        h, d = planar_offsets(np.atleast_2d(np.asarray(xy, dtype=float)), c.ground, c.yaw)
        out.append(float(-c.focal_px[0] * h[0] / d[0]) if d[0] > 0 else np.nan)
    return out


def walk(steps: int, rng: np.random.Generator, sigma: float = 0.33, speed: float = 1.0) -> Floats:
    """(steps, 2) random waypoints in the empty room of 100 x 100, [Ercan] Sec. 6."""
    xy, destination = rng.uniform(10, 90, 2), rng.uniform(0, 100, 2)
    path = np.empty((steps, 2))
    for t in range(steps):
        if np.hypot(*(destination - xy)) < speed:
            destination = rng.uniform(0, 100, 2)
        e = (destination - xy) / np.hypot(*(destination - xy))
        xy = np.clip(xy + speed * e + sigma * rng.standard_normal(2), 0.01, 99.99)
        path[t] = xy
    return path


def observe(scene: Scene, path: Floats, rng: np.random.Generator, target: int = 0, step_s: float = 1.0) -> Bearings:
    """Bearings of all cameras with Eq. 2's noise; not hidden by anything but the field of view."""
    parts = []
    for c in scene.cameras:
        h, d = planar_offsets(path, c.ground, c.yaw)
        seen = (d > 0) & (np.abs(np.arctan2(h, d)) <= c.fov / 2)
        h, d = np.where(seen, h, 0.0), np.where(seen, d, 1.0)
        f = float(c.focal_px[0])
        spread = np.sqrt(noise_variance(h, d, f, c.sigma_position, c.sigma_yaw, c.sigma_read_px))
        z = np.where(seen, f * h / d + spread * rng.standard_normal(len(path)), np.nan)
        n = len(path)
        parts.append(
            Bearings.of(
                t_ns=np.rint(np.arange(n) * step_s * SECOND).astype(np.int64),
                sensor=np.full(n, c.name),
                target_id=np.full(n, target, dtype=np.int32),
                seen=seen,
                bearing=wrap(c.yaw + np.arctan(z / f)),
                sigma=np.where(seen, spread / f, np.nan),
                u_px=-z,
                sigma_px=np.full(n, np.nan),
                score=np.full(n, np.nan),
            )
        )
    return Bearings.merge(parts)


def wrap(angle: Floats) -> Floats:
    return (np.asarray(angle) + np.pi) % (2 * np.pi) - np.pi
