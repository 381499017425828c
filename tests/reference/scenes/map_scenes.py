"""Scenes, paths and records for tests of the batch method."""

from __future__ import annotations

import numpy as np
from tracker_scenes import SECOND, camera

from occlog.records.scene import MicrophoneArray, Scene
from occlog.scans.grouping import Scan
from occlog.track.interface import SmoothedTrajectory
from occlog.track.methods.map.record import TargetRecord

FOCAL = 500.0
CLEAN = {"focal": FOCAL, "sigma_position": 0.0, "sigma_yaw": 0.0, "sigma_read_px": 0.5, "fov": np.radians(60.0)}


def square(half: float, x: float = 0.0, y: float = 0.0):
    return np.array([[-half, -half], [half, -half], [half, half], [-half, half]]) + np.array([x, y])


def place(*cameras, half: float = 10.0, arrays=(), at=(0.0, 0.0), **options) -> Scene:
    """Cameras (x, y, yaw in degrees) and arrays (x, y, yaw) in a square room about a place."""
    x0, y0 = at
    made = tuple(camera(f"c{i}", (x + x0, y + y0), yaw, **CLEAN | options) for i, (x, y, yaw) in enumerate(cameras))
    ears = tuple(
        MicrophoneArray(f"a{i}", np.array([x + x0, y + y0, 0.0]), np.radians(yaw), sigma=0.02)
        for i, (x, y, yaw) in enumerate(arrays)
    )
    return Scene(made, ears, room=square(half, x0, y0))


def record(scene: Scene, t_s, xy, *, noise=None, blind=()) -> TargetRecord:
    """What all sensors say of a target at times [s] and places (T, 2); `blind` pairs of state and sensor see nothing.

    Args:
        noise: generator of read noise and errors of directions; None: no errors.
    """
    t_s, xy = np.asarray(t_s, float), np.asarray(xy, float)
    rows = []
    for t in range(len(t_s)):
        for s, c in enumerate((*scene.cameras, *scene.arrays)):
            away = xy[t] - c.position[:2]
            angle = np.arctan2(away[1], away[0]) - c.yaw
            angle = (angle + np.pi) % (2 * np.pi) - np.pi
            is_camera = s < len(scene.cameras)
            seen = (not is_camera or abs(angle) < c.fov / 2) and np.hypot(*away) < c.range and (t, s) not in blind
            error = 0.0 if noise is None else noise.standard_normal()
            if not seen:
                rows.append((t, s, False, np.nan, np.nan, np.nan, np.nan))
            elif is_camera:
                f = c.focal_px[0]
                u = -f * np.tan(angle) + c.sigma_read_px * error
                bearing = c.yaw - np.arctan(u / f)
                rows.append((t, s, True, bearing, c.sigma_read_px / f, u, c.sigma_read_px))
            else:
                rows.append((t, s, True, c.yaw + angle + c.sigma * error, c.sigma, np.nan, np.nan))
    state, sensor, seen, *numbers = (np.array(column) for column in zip(*rows, strict=True))
    numbers[0] = (numbers[0] + np.pi) % (2 * np.pi) - np.pi
    columns = dict(zip(("bearing", "sigma", "u_px", "sigma_px"), numbers, strict=True))
    rows = Scan.of(0, sensor, target_id=np.zeros(len(state)), seen=seen, **columns)
    return TargetRecord(np.round(t_s * SECOND).astype(np.int64), state, rows)


def scans_of(made: TargetRecord) -> list[Scan]:
    """The scans of a record."""
    return [made.rows.take(made.state == k)._replace(t_ns=t_ns) for k, t_ns in enumerate(made.t_ns.tolist())]


def joined(parts: list[SmoothedTrajectory]) -> SmoothedTrajectory:
    """What was given out in blocks."""
    arrays = [np.concatenate([p[i] for p in parts]) for i in range(7)]
    return SmoothedTrajectory(
        *arrays,
        sum((p.fallback for p in parts), ()),
        sum((p.used for p in parts), ()),
        sum((p.seen_by for p in parts), ()),
        sum(p.iterations for p in parts),
        all(p.converged for p in parts),
    )
