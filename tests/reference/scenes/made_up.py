"""Made-up runs to draw: targets on smooth paths, cameras that lose them now and then."""

from __future__ import annotations

from typing import Any

import numpy as np

from occlog.core.geometry.camera import rotation_from_angles, wrap_angle
from occlog.records.scene import Camera, Occluder, Scene
from occlog.records.tables import Bearings, Bound, Diagnostics, Errors, Tracks, Truth
from occlog.report.content.model import ReportInput

STEP_NS = 100_000_000


def ring_scene(cameras: int = 8, size: float = 100.0) -> Scene:
    """A square room with cameras on a ring that point at its middle, and two pillars."""
    out = []
    for i in range(cameras):
        azimuth = 2 * np.pi * i / cameras + 0.3
        ground = size * (0.5 + 0.49 * np.array([np.cos(azimuth), np.sin(azimuth)]))
        out.append(
            Camera(
                name=f"camera {i + 1}",
                position=np.array([*ground, 1.5]),
                rotation=rotation_from_angles(azimuth + np.pi, 0.0, 0.0),
                focal_px=np.full(2, 500.0),
                principal_px=np.array([320.0, 240.0]),
                fov=np.radians(80.0),
            )
        )
    room = size * np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float)
    pillar = 0.06 * size * (room / size - 0.5)
    positions = size * np.array([[0.3, 0.3], [0.7, 0.55]])
    occluders = tuple(Occluder(f"pillar {i}", pillar + place) for i, place in enumerate(positions))
    return Scene(cameras=tuple(out), occluders=occluders, room=room)


def path(steps: int, target: int, size: float) -> np.ndarray:
    """(steps, 2) Lissajous path inside the room."""
    s = np.arange(steps) * 2 * np.pi / 300.0
    return size * np.column_stack([0.5 + 0.36 * np.sin(s + target), 0.5 + 0.33 * np.sin(1.7 * s + 2 * target)])


def run(
    steps: int = 400, targets: int = 1, cameras: int = 8, size: float = 100.0, start_ns: int = 0, **more: Any
) -> ReportInput:
    """Everything that a run delivers, for a few targets; `more` replaces or adds parts of the input."""
    rng = np.random.default_rng(1)
    scene = ring_scene(cameras, size)
    t_ns = start_ns + np.arange(steps, dtype=np.int64) * STEP_NS
    parts: dict[type, list[dict[str, Any]]] = {}
    for target in range(targets):
        same = {"t_ns": t_ns, "target_id": np.full(steps, target)}
        for kind, columns in _filtered(path(steps, target, size), size, cameras, rng):
            parts.setdefault(kind, []).append(same | columns)
        for i, camera in enumerate(scene.cameras):
            parts.setdefault(Bearings, []).append(_looks(camera, i, target, t_ns, path(steps, target, size), rng))
    tables = {kind.NAME: merged(kind, columns) for kind, columns in parts.items()}
    inputs = [{"name": "x.mcap", "sha256": "ab" * 32}]
    given: dict[str, Any] = {
        "title": "A made-up run",
        "scene": scene,
        "metrics": {"rmse_m": 0.71, "rmse_x_m": 0.5, "bound_rmse_m": 0.6, "bound_ratio": 1.18, "detection_rate": 0.83},
        "provenance": {"program": "occlog", "version": "0.1", "seed": 1, "inputs": inputs},
    }
    return ReportInput(**(given | tables | more))


def _filtered(true: np.ndarray, size: float, cameras: int, rng: np.random.Generator) -> list[tuple[type, dict]]:
    """What a filter and its evaluation say of one target."""
    n, nan = len(true), np.full(len(true), np.nan)
    error = size / 300 * (rng.normal(0, 1, (n, 2)) + np.sin(np.arange(n) / 40.0)[:, None] * [2, -1])
    var = (size / 100 * (0.8 + 0.5 * np.sin(np.arange(n) / 30.0))) ** 2
    x, y = (true + error).T
    fallback = np.where(rng.random(n) < 0.03, "sir", "").astype("U8")
    fallback[n // 2] = "restart"
    return [
        (Truth, {"role": np.full(n, "target"), "x": true[:, 0], "y": true[:, 1], "z": nan}),
        (Tracks, {"x": x, "y": y, "vx": nan, "vy": nan, "cov_xx": var, "cov_xy": 0.35 * var, "cov_yy": 0.6 * var}),
        (
            Errors,
            {
                "x": x,
                "y": y,
                "truth_x": true[:, 0],
                "truth_y": true[:, 1],
                "error_x": error[:, 0],
                "error_y": error[:, 1],
                "error": np.hypot(*error.T),
                "nees": np.full(n, 2.0),
            },
        ),
        (
            Bound,
            {
                "bound_xx": 0.2 * var,
                "bound_xy": 0 * var,
                "bound_yy": 0.2 * var,
                "bound": np.sqrt(0.4 * var),
                "n_detected": np.full(n, 3),
            },
        ),
        (
            Diagnostics,
            {
                "ess": 1000.0 * rng.beta(2, 3, n),
                "log_likelihood": np.zeros(n),
                "n_observing": np.full(n, cameras),
                "n_detected": np.full(n, 3),
                "fallback": fallback,
                "cameras": np.full(n, "camera 1"),
                "n_available": np.full(n, cameras),
                "selected": np.full(n, ""),
                "predicted_mse": np.full(n, np.nan),
            },
        ),
    ]


def _looks(
    camera: Camera, i: int, target: int, t_ns: np.ndarray, true: np.ndarray, rng: np.random.Generator
) -> dict[str, Any]:
    """Bearings of one camera: frames are missing for a while, the target is hidden now and then."""
    n = len(t_ns)
    delta = true - camera.ground
    bearing = wrap_angle(np.arctan2(delta[:, 1], delta[:, 0]) + rng.normal(0, 0.01, n))
    seen = np.sin(np.arange(n) / 17.0 + 2 * i + target) > -0.4
    seen &= np.abs(wrap_angle(bearing - camera.yaw)) < camera.fov / 2
    have = np.ones(n, bool)
    have[n // 5 * (i % 4) : n // 5 * (i % 4) + n // 12] = i % 3 != 0
    columns = {
        "t_ns": t_ns,
        "sensor": np.full(n, camera.name),
        "target_id": np.full(n, target),
        "seen": seen,
        "bearing": np.where(seen, bearing, np.nan),
        "sigma": np.where(seen, 0.01, np.nan),
        **dict.fromkeys(("u_px", "sigma_px", "score"), np.full(n, np.nan)),
    }
    return {name: values[have] for name, values in columns.items()}


def merged(kind: type, parts: list[dict[str, Any]]) -> Any:
    """One table from columns in parts, in the order of its key."""
    have = [c.name for c in kind.columns() if c.name in parts[0] or not c.optional]
    columns = {name: np.concatenate([part[name] for part in parts]) for name in have}
    order = np.lexsort([columns[name] for name in reversed(kind.KEY)])
    return kind.of(**{name: values[order] for name, values in columns.items()})
