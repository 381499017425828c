"""Recordings of one person tracked with filterpy's extended Kalman filter; run in an environment of its own.

`python _filterpy_filters.py RECORDINGS.npz`: prints JSON, for each strength of white acceleration the estimates'
errors, normalised squared errors and time.  The filter is told which target a reading is of and begins near the truth.
"""

from __future__ import annotations

import json
import sys
import time
from importlib.metadata import version
from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, rts_smoother

SIGMA_START, SIGMA_SPEED = 0.3, 1.2
LEAST_DEPTH = 0.05
"""Readings of cameras nearer than this [m] are left out: nothing is linear there."""


def white_acceleration(dt: float, q: float) -> tuple[Any, Any]:
    """Transition and noise of a step."""
    F, Q = np.eye(4), np.zeros((4, 4))
    F[0, 2] = F[1, 3] = dt
    for axis in range(2):
        at = np.ix_([axis, axis + 2], [axis, axis + 2])
        Q[at] = q * q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    return F, Q


def seen_from(x: Any, camera: Any) -> tuple[float, float, float]:
    """Reading [px], and coordinates across and along the optical axis."""
    x0, y0, yaw, focal = camera
    dx, dy = x[0, 0] - x0, x[1, 0] - y0
    h, d = np.cos(yaw) * dy - np.sin(yaw) * dx, np.cos(yaw) * dx + np.sin(yaw) * dy
    return focal * h / d, h, d


def jacobian(x: Any, camera: Any) -> Any:
    """(1, 4) derivatives of the reading."""
    _, h, d = seen_from(x, camera)
    yaw, focal = camera[2], camera[3]
    co, si = np.cos(yaw), np.sin(yaw)
    return focal / d * np.array([[-si - h / d * co, co - h / d * si, 0.0, 0.0]])


def follow(z: Any, cameras: Any, sigma: float, start: Any, dt: float, q: float) -> dict[str, Any]:
    """Filtered and smoothed places with covariances.

    Args:
        z: (T, S) readings [px]; NaN: not seen.
        cameras: (S, 4) x, y, yaw, focal length.
        sigma: of a reading [px].
        start: (2,) first place.
        dt: [s].
        q: of white acceleration.
    """
    kalman = ExtendedKalmanFilter(dim_x=4, dim_z=1)
    kalman.x = np.array([[start[0]], [start[1]], [0.0], [0.0]])
    kalman.P = np.diag([SIGMA_START**2] * 2 + [SIGMA_SPEED**2] * 2)
    kalman.F, kalman.Q = white_acceleration(dt, q)
    kalman.R = np.array([[sigma * sigma]])
    means, spreads, begin = [], [], time.process_time()
    for k, row in enumerate(z):
        if k:
            kalman.predict()
        for camera, value in zip(cameras, row, strict=True):
            if np.isfinite(value) and seen_from(kalman.x, camera)[2] > LEAST_DEPTH:
                kalman.update(
                    np.array([[value]]),
                    HJacobian=lambda x, c=camera: jacobian(x, c),
                    Hx=lambda x, c=camera: np.array([[seen_from(x, c)[0]]]),
                )
        means.append(kalman.x.copy())
        spreads.append(kalman.P.copy())
    filtered = time.process_time() - begin
    late, wide, *_ = rts_smoother(np.array(means), np.array(spreads), [kalman.F] * len(z), [kalman.Q] * len(z))
    both = {"filter": (np.array(means), np.array(spreads), filtered)}
    both["smoother"] = (late, wide, time.process_time() - begin)
    return {
        name: {"xy": x[:, :2, 0].tolist(), "cov": P[:, :2, :2].tolist(), "ms": 1e3 * t / len(z)}
        for name, (x, P, t) in both.items()
    }


def main() -> None:
    """Every recording with every strength."""
    given = np.load(sys.argv[1])
    found = [
        [
            follow(z, cameras, float(sigma), start, float(given["dt"]), float(q))
            for z, cameras, sigma, start in zip(
                given["z"], given["cameras"], given["sigma"], given["start"], strict=True
            )
        ]
        for q in given["q"]
    ]
    print(json.dumps({"version": version("filterpy"), "runs": found}))


if __name__ == "__main__":
    main()
