"""Calibration by people who walk, against the true cameras: simulated rooms with rough poses and late clocks.

    python -m benchmarks.track.calibrate [--rigs N] [--seed N] [--cameras N] [--seconds S] [--without-poses]

Rooms, lenses, detectors and people are those of `benchmarks.setups`; bodies are not the ellipsoids of the estimator.
Stated poses are off by 3 degrees and 0.5 m per axis, clocks by up to 0.8 s.  Errors are relative to all cameras
together, after a similarity in the plane.  NEES is that of each parameter: 1 if standard deviations are right.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.setups import _rigs
from occlog.array_types import NS, Floats
from occlog.calibrate.config import CalibrateConfig
from occlog.calibrate.stage import CameraResult, calibrate
from occlog.core.geometry.camera import angles_from_rotation, rotation_from_angles
from occlog.errors import InputError
from occlog.records.scene import Camera, Scene
from occlog.track.methods.jipda.interface import FrameDetections
from occlog.track.people.frame_detections import FrameDetectionsWithIds

NAME = "calibrate"
SUMMARY = "error of positions of calibrated cameras over the limit: median of simulated rooms, 4 cameras, 30 s [m]"
LIMIT = 0.05
MAX_LATE_S, SIGMA_POSITION, SIGMA_ANGLE = 0.8, 0.5, np.radians(3.0)


def frames_of(rig: _rigs.Rig, late: Floats) -> list[FrameDetectionsWithIds]:
    """Boxes of a rig as frames, stamped by clocks that are late [s]."""
    out, row = [], 0
    for c, name in enumerate(rig.names):
        boxes = rig.boxes[name]
        for k in range(rig.frames):
            own = boxes[boxes[:, 0] == k, 1:]
            n = len(own)
            none = np.full(n, np.nan), np.full(n, -1), np.zeros((n, 0)), np.arange(row, row + n)
            stamp = round((k / rig.fps + late[c]) * NS)
            out.append(FrameDetectionsWithIds(FrameDetections(stamp, c, own, *none), k, np.arange(n)))
            row += n
    return sorted(out, key=lambda each: each.detections.t_ns)


def stated(cameras: list[Camera], rng: np.random.Generator, *, poses: bool) -> list[Camera]:
    """Cameras with rough poses, or without."""
    out = []
    for camera in cameras:
        angles = np.array(angles_from_rotation(camera.rotation)) + rng.normal(0.0, SIGMA_ANGLE, 3)
        position = camera.position + rng.normal(0.0, SIGMA_POSITION, 3)
        out.append(replace(camera, position=position, rotation=rotation_from_angles(*angles.tolist()), placed=poses))
    return out


def errors(found: list[CameraResult], true: list[Camera], late: Floats) -> dict[str, Floats]:
    """Errors of positions [m], yaw [deg] and clocks [s] of the calibrated cameras, and their NEES."""
    own = [c for c, each in enumerate(found) if each.estimated]
    ours = np.array([complex(*found[c].camera.position[:2].tolist()) for c in own])
    real = np.array([complex(*true[c].position[:2].tolist()) for c in own])
    m = ((real - real.mean()) * np.conj(ours - ours.mean())).sum() / (np.abs(ours - ours.mean()) ** 2).sum()
    off = m * (ours - ours.mean()) - (real - real.mean())
    z = np.array([abs(m) * found[c].camera.position[2] - true[c].position[2] for c in own])
    yaw = [angles_from_rotation(found[c].camera.rotation)[0] - angles_from_rotation(true[c].rotation)[0] for c in own]
    turned = np.angle(np.exp(1j * (np.array(yaw) + np.angle(m))))
    sigma_yaw = [np.linalg.norm(found[c].camera.rotation[2] * found[c].sigma[:3]) for c in own]
    clock = np.array([found[c].late_s - late[c] for c in own]) + np.sort(late[own])[(len(own) - 1) // 2]
    sigma = np.array([found[c].sigma for c in own])
    # Without the direction of a similarity, errors of x and y are those along other axes
    with np.errstate(divide="ignore", invalid="ignore"):
        nees = [
            np.abs(off) ** 2 / (sigma[:, 3] ** 2 + sigma[:, 4] ** 2),
            (z / sigma[:, 5]) ** 2,
            (clock / sigma[:, 8]) ** 2,
            (turned / np.array(sigma_yaw)) ** 2,
        ]
    return {
        "position": np.abs(off), "height": np.abs(z), "yaw": np.degrees(np.abs(turned)), "clock": np.abs(clock),
        "nees": np.column_stack(nees),
    }  # fmt: skip


Case = tuple[list[FrameDetectionsWithIds], list[Camera], list[Camera], Floats]
"""Frames, true and stated cameras, and by how much clocks are late [s]."""


def room(seed: int, cameras: int, *, poses: bool) -> Case:
    """A room with cameras about its walls."""
    rig, rng = _rigs.rig(seed, cameras), np.random.default_rng((seed, 11))
    true, late = [rig.cameras[name] for name in rig.names], rng.uniform(-MAX_LATE_S, MAX_LATE_S, cameras)
    return frames_of(rig, late), true, stated(true, rng, poses=poses), late


def measured(cases: Iterable[tuple[int, Case]], config: CalibrateConfig, *, show: bool) -> dict[str, Any]:
    """Medians and largest values over simulated rooms."""
    every: list[dict[str, Floats]] = []
    refused = left = count = 0
    for k, (frames, true, start, late) in cases:
        count += 1
        try:
            found = calibrate(frames, Scene(tuple(start)), start, config)
        except InputError as error:
            refused += 1
            print(f"{k}: refused: {error}") if show else None
            continue
        left += sum(not each.estimated for each in found.cameras)
        every.append(errors(found.cameras, true, late))
        if show:
            worst = {name: float(np.max(values)) for name, values in every[-1].items() if name != "nees"}
            print(f"{k}: " + ", ".join(f"{name} {value:.3f}" for name, value in worst.items()), flush=True)
    out: dict[str, Any] = {"rigs": count, "refused": refused, "cameras left": left}
    for name in ("position", "height", "yaw", "clock"):
        values = np.concatenate([each[name] for each in every])
        out |= {f"{name}, median": float(np.median(values)), f"{name}, 95 %": float(np.percentile(values, 95))}
    nees = np.concatenate([each["nees"] for each in every])
    for name, column in zip(("position", "height", "clock", "yaw"), nees.T, strict=True):
        finite = column[np.isfinite(column)]
        if not len(finite):
            continue
        out |= {f"NEES of {name}, mean": float(finite.mean()), f"NEES of {name}, median": float(np.median(finite))}
    return out


def run(repeats: int = 5) -> dict[str, Any]:
    """Median error of positions; `repeats` rooms."""
    _rigs.SECONDS = 30.0
    rooms = ((k, room(k, 4, poses=True)) for k in range(91_000, 91_000 + repeats))
    found = measured(rooms, CalibrateConfig(), show=False)
    return {"ratio": found["position, median"], "limit": LIMIT, "parts": found}


def main() -> None:
    """Calibrate, and print the errors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", type=int, default=10)
    parser.add_argument("--seed", type=int, default=91_000)
    parser.add_argument("--cameras", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--without-poses", action="store_true")
    given = parser.parse_args()
    _rigs.SECONDS = given.seconds
    seeds, poses = range(given.seed, given.seed + given.rigs), not given.without_poses
    rooms = ((k, room(k, given.cameras, poses=poses)) for k in seeds)
    found = measured(rooms, CalibrateConfig(), show=True)
    print("\n".join(f"{name}: {value:.4g}" for name, value in found.items()))


if __name__ == "__main__":
    main()
