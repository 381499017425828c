"""Small scenes and tables that the tests of evaluate share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from occlog.core.geometry.camera import u_to_azimuth, wrap_angle
from occlog.records.scene import Camera, MicrophoneArray, Occluder, Scene, camera_rotation
from occlog.records.tables import Bearings, Tracks, Truth

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
FOCAL = 100.0


def camera(name: str, x: float, y: float, yaw_deg: float, **options: Any) -> Camera:
    """Level camera with focal length 100 px, 90 degrees wide, read noise 1 px only."""
    values: dict[str, Any] = {"sigma_read_px": 1.0, "fov": np.pi / 2} | options
    return Camera(
        name=name,
        position=np.array([x, y, 0.0]),
        rotation=camera_rotation(np.radians(yaw_deg), 0.0, 0.0),
        focal_px=np.array([FOCAL, FOCAL]),
        principal_px=np.zeros(2),
        **values,
    )


def box(name: str, x0: float, y0: float, x1: float, y1: float) -> Occluder:
    return Occluder(name, np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]))


def scene(*cameras: Camera, unit: str = "m", **options: Any) -> Scene:
    """Room from (0, 0) to (20, 20)."""
    room = np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 20.0], [0.0, 20.0]])
    return Scene(cameras=cameras, room=room, length_unit=unit, **options)


def array(name: str, x: float, y: float, z: float = 0.0, **options: Any) -> MicrophoneArray:
    return MicrophoneArray(name, np.array([x, y, z]), **options)


def seconds(values: Sequence[float]) -> np.ndarray:
    return START + np.rint(np.asarray(values, dtype=np.float64) * 1e9).astype(np.int64)


def truth(t: Sequence[float], xy: Any, target: int = 0, role: str = "target", z: Any = np.nan) -> Truth:
    positions = np.broadcast_to(np.asarray(xy, dtype=np.float64), (len(t), 2))
    return Truth.of(
        t_ns=seconds(t),
        target_id=np.full(len(t), target, dtype=np.int32),
        role=np.full(len(t), role),
        x=positions[:, 0],
        y=positions[:, 1],
        z=np.broadcast_to(np.asarray(z, dtype=np.float64), len(t)),
    )


def tracks(t: Sequence[float], xy: Any, target: int = 0, var: float = 1.0) -> Tracks:
    positions = np.broadcast_to(np.asarray(xy, dtype=np.float64), (len(t), 2))
    n = len(t)
    return Tracks.of(
        t_ns=seconds(t),
        target_id=np.full(n, target, dtype=np.int32),
        x=positions[:, 0],
        y=positions[:, 1],
        vx=np.full(n, np.nan),
        vy=np.full(n, np.nan),
        cov_xx=np.full(n, var),
        cov_xy=np.zeros(n),
        cov_yy=np.full(n, var),
    )


def both(*tables: Any) -> Any:
    """Tables of one kind together, in the order of their keys."""
    return type(tables[0]).merge(tables)


def pixels(cam: Camera, t: Sequence[float], u_px: Sequence[float], target: int = 0, sigma_px: float = 1.0) -> Bearings:
    """A camera's rows; NaN in u_px is `looked, not seen`."""
    u, n = np.asarray(u_px, dtype=np.float64), len(t)
    seen = np.isfinite(u)
    return Bearings.of(
        t_ns=seconds(t),
        sensor=np.full(n, cam.name),
        target_id=np.full(n, target, dtype=np.int32),
        seen=seen,
        bearing=u_to_azimuth(u, cam.yaw, FOCAL),
        sigma=np.where(seen, sigma_px * FOCAL / (FOCAL**2 + u**2), np.nan),
        u_px=u,
        sigma_px=np.where(seen, sigma_px, np.nan),
        score=np.full(n, np.nan),
    )


def directions(name: str, t: Sequence[float], bearing: Sequence[float], sigma: float, target: int = 0) -> Bearings:
    """Rows of a sensor that has no pixels; NaN is `looked, not seen`."""
    b, n = np.asarray(bearing, dtype=np.float64), len(t)
    seen, nan = np.isfinite(b), np.full(n, np.nan)
    return Bearings.of(
        t_ns=seconds(t),
        sensor=np.full(n, name),
        target_id=np.full(n, target, dtype=np.int32),
        seen=seen,
        bearing=wrap_angle(b),
        sigma=np.where(seen, sigma, np.nan),
        u_px=nan,
        sigma_px=nan,
        score=nan,
    )


def heights(ground: Tracks, z: Any, cov: Sequence[Any] = (0.0, 0.0, 1.0)) -> Tracks:
    """The same tracks in space: heights, and covariances of x and z, y and z, z and z."""
    n = len(ground)
    columns = {c.name: getattr(ground, c.name) for c in Tracks.columns() if not c.optional}
    names = ("cov_xz", "cov_yz", "cov_zz")
    columns |= {k: np.broadcast_to(np.asarray(v, dtype=np.float64), n) for k, v in zip(names, cov, strict=True)}
    return Tracks.of(**columns, z=np.broadcast_to(np.asarray(z, dtype=np.float64), n), vz=np.full(n, np.nan))


def heard(ear: MicrophoneArray, t: Sequence[float], xyz: Any, target: int = 0, sigma_up: float = 0.02) -> Bearings:
    """Exact directions from an array to (N, 3) positions, with the array's sigma and this one for elevations."""
    to = np.broadcast_to(np.asarray(xyz, dtype=np.float64), (len(t), 3)) - ear.position
    azimuth, flat = np.arctan2(to[:, 1], to[:, 0]), np.hypot(to[:, 0], to[:, 1])
    rows = directions(ear.name, t, azimuth, ear.sigma, target)
    columns = {c.name: getattr(rows, c.name) for c in Bearings.columns()}
    up = {"elevation": np.arctan2(to[:, 2], flat), "sigma_elevation": np.full(len(t), sigma_up)}
    return Bearings.of(**{**columns, **up})
