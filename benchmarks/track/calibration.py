"""Errors of camera poses that stay the same: estimated along with the track, at first, or taken for white noise."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from benchmarks.track.simulated import follow, nees, record, rmse, room100
from occlog.array_types import Floats
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.records.scene import Scene
from occlog.simulate.config import ObserveConfig, WorldConfig
from occlog.track.methods.apf.config import CALIBRATE, ApfConfig

NAME = "calibration"
SUMMARY = "fixed errors of camera poses: RMSE with calibrate=joint to that with white noise, 4 cameras"
LIMIT = 1.0
STEPS = 1000
SKIP = 100  # steps at the start that do not count; also the length of the initial phase


def true_errors(scene: Scene, seed: int) -> Floats:
    """(S, 3) dx, dy, dyaw that `ObserveConfig(noise="calibration")` draws."""
    sigma = np.array([(c.sigma_position, c.sigma_position, c.sigma_yaw) for c in scene.cameras])
    draws = [generator(seed, RandomStream.CAMERA_CALIBRATION, i).standard_normal(3) for i in range(len(sigma))]
    return np.asarray(sigma * draws)


def one(cameras: int, noise: Any, seed: int) -> dict[str, float]:
    """Track one recording in the three modes."""
    scene = room100(cameras)
    recording = record(scene, WorldConfig(steps=STEPS), ObserveConfig(pose_noise=noise), seed)
    errors = true_errors(scene, seed) if noise == "calibration" else np.zeros((cameras, 3))
    out = {}
    for mode in CALIBRATE:
        state, found = follow(scene, recording, ApfConfig(particles=1000, calibrate=mode), seed)
        out[f"{mode} RMSE"] = rmse(found, recording.xy, SKIP)
        out[f"{mode} NEES"] = nees(found, recording.xy, SKIP)
        if state.calibration is not None:
            belief = state.calibration.belief
            miss = belief.mean - errors
            out[f"{mode} error of position"] = math.sqrt(np.mean(miss[:, :2] ** 2))
            out[f"{mode} error of yaw"] = math.sqrt(np.mean(miss[:, 2] ** 2))
            out[f"{mode} NEES of errors"] = float(
                miss.ravel() @ np.linalg.solve(belief.covariance, miss.ravel()) / miss.size
            )
            out[f"{mode} corrected"] = float(state.calibration.converged)
    return out


def run(repeats: int = 3) -> dict[str, Any]:
    """Means over as many seeds as repeats, for 4 and 8 cameras, errors that stay and errors that do not."""
    parts: dict[str, Any] = {}
    ratio = math.nan
    for noise, what in (("calibration", "fixed"), ("white", "white")):
        for cameras in (4, 8):
            runs = [one(cameras, noise, seed) for seed in range(repeats)]
            table = {name: np.array([r[name] for r in runs]) for name in runs[0]}
            head = f"{what}, {cameras} cameras:"
            for mode in CALIBRATE[1:]:
                ratios = table[f"{mode} RMSE"] / table["none RMSE"]
                error = float(np.std(ratios, ddof=1) / math.sqrt(repeats)) if repeats > 1 else math.nan
                parts[f"{head} {mode} / none"] = f"{ratios.mean():.3f} +- {error:.3f}"
                if (noise, cameras, mode) == ("calibration", 4, "joint"):
                    ratio = float(ratios.mean())
            parts |= {f"{head} {name}": float(values.mean()) for name, values in table.items()}
    return {"ratio": ratio, "limit": LIMIT, "parts": parts}
