"""`calibrate` against OpenCV's stereo calibration and caliscope's bundle adjustment, of two cameras in simulated rooms.

    python -m benchmarks.peers.calibrate_peer [--rooms N] [--seed N]

All have exact intrinsics and the same rooms.  `occlog calibrate` has boxes without identities, with clocks off by
up to 0.8 s.  caliscope has what that must find: the boxes of one person at one time.  It takes the middles of the upper
and lower edges as two points in space each, from nothing (epipolar geometry, then bundle adjustment).
`cv2.stereoCalibrate` needs the points in space, too: the true feet and heads.  As a bound, caliscope also gets images
of the true feet and heads, with the errors of edges, which no detector of boxes gives.  Neither is robust, models
bodies, or states standard deviations.  Boxes at the border of an image are left out of the matches, and no match is
wrong.

Errors are those of the pose of the second camera in the frame of the first: rotation and direction of the baseline
[deg].  caliscope runs in an environment of its own: that of OCCLOG_CALISCOPE (its Python), or one that is made.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.peers._environments import environment, output_of
from benchmarks.setups import _rigs
from benchmarks.track.calibrate import room
from occlog.array_types import Floats
from occlog.calibrate.config import CalibrateConfig
from occlog.calibrate.stage import calibrate
from occlog.errors import InputError
from occlog.records.scene import Camera, Scene

NAME = "calibrate-peer"
SUMMARY = "rotation between 2 cameras, median error of calibrate without matches to that of caliscope with true ones"
LIMIT = 1.0
PACKAGE = "caliscope==0.11.8"
BOUND = "caliscope, true heads and feet"
BORDER_PX = 8.0
"""Boxes nearer to the border of the image may be truncated."""
SECONDS, SEED = 30.0, 700_600


def pose_errors(rotation: Floats, away: Floats, true: list[Camera]) -> Floats:
    """(2,) errors [deg] of the rotation (3, 3) from the second camera to the first and of the direction (3,) to it.

    Both are in the frame of the first camera.
    """
    first, second = true
    real = first.rotation.T @ second.rotation
    to = first.rotation.T @ (second.position - first.position)
    cosine = away @ to / np.linalg.norm(away) / np.linalg.norm(to)
    turned = float(np.linalg.norm(cv2.Rodrigues(rotation @ real.T)[0]))
    return np.degrees([turned, np.arccos(np.clip(cosine, -1.0, 1.0))])


def matched_boxes(rig: _rigs.Rig) -> tuple[Floats, Floats]:
    """Boxes (n, 2, 4) of one person in both cameras at a time, with errors and misses, and frame and person (n, 2)."""
    size = np.array([np.tile(c.image_size or (0, 0), 2) for c in rig.cameras.values()], dtype=np.float64)
    boxes = np.full((2, rig.frames, len(rig.bodies), 4), np.nan)
    rng = np.random.default_rng((rig.seed, 23))
    for c, name in enumerate(rig.names):
        for person in range(len(rig.bodies)):
            rows = rig.boxes_of(name, person)
            exact = rows[:, 1:]
            inside = (exact[:, :2] > BORDER_PX).all(axis=1) & (exact[:, 2:] < size[c, 2:] - BORDER_PX).all(axis=1)
            found = inside & (rng.random(len(rows)) > rig.detector.miss)
            sigma = rig.detector.edge_px + rig.detector.edge_share * (exact[:, 3] - exact[:, 1])
            noisy = exact + rng.normal(0.0, 1.0, exact.shape) * sigma[:, None]
            boxes[c, rows[found, 0].astype(np.int64), person] = noisy[found]
    both = np.argwhere(np.isfinite(boxes).all(axis=(0, 3)))
    return boxes[:, both[:, 0], both[:, 1]].swapaxes(0, 1), both.astype(np.float64)


def heads_and_feet(boxes: Floats) -> Floats:
    """(n, 2, 2, 2) middles of upper and lower edges (part of the body, u and v) of boxes (n, 2, 4) of two cameras."""
    middle = 0.5 * (boxes[..., 0] + boxes[..., 2])
    return np.stack([np.stack([middle, boxes[..., 1]], -1), np.stack([middle, boxes[..., 3]], -1)], axis=2)


def intrinsics(camera: Camera) -> Floats:
    """(3, 3) camera matrix."""
    (fx, fy), (cx, cy) = camera.focal_px, camera.principal_px
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def true_points(both: Floats, rig: _rigs.Rig) -> Floats:
    """(n, 2, 3) true heads and feet in space, of frames and people (n, 2)."""
    at = rig.paths[np.round((_rigs.MARGIN_S + both[:, 0] / rig.fps) * _rigs.FINE_HZ).astype(np.int64)]
    person = both[:, 1].astype(np.int64)
    ground, tall = at[np.arange(len(both)), person], rig.bodies[person, 0]
    return np.stack([np.column_stack([ground, tall]), np.column_stack([ground, np.zeros(len(both))])], axis=1)


def images_of(space: Floats, boxes: Floats, rig: _rigs.Rig, true: list[Camera]) -> Floats:
    """Images (n, 2, 2, 2) of heads and feet (n, 2, 3) in two cameras, with errors as of boxes (n, 2, 4)."""
    out = np.stack([camera.project(space.reshape(-1, 3)).reshape(-1, 2, 2) for camera in true], axis=1)
    sigma = rig.detector.edge_px + rig.detector.edge_share * (boxes[..., 3] - boxes[..., 1])
    noise = np.random.default_rng((rig.seed, 29)).normal(0.0, 1.0, out.shape) * sigma[..., None, None]
    return np.asarray(out + noise * [np.sqrt(0.5), 1.0])


def by_opencv(points: Floats, space: Floats, true: list[Camera]) -> Floats:
    """Errors of `cv2.stereoCalibrate` of matched heads and feet (n, 2, 2, 2), with their positions (n, 2, 3)."""
    pixels = [points[:, c].reshape(-1, 1, 2).astype(np.float32) for c in range(2)]
    lens = [part for camera in true for part in (intrinsics(camera), camera.distortion[:5])]
    flat = space.reshape(-1, 1, 3).astype(np.float32)
    found = cv2.stereoCalibrate([flat], [pixels[0]], [pixels[1]], *lens, (0, 0), flags=cv2.CALIB_FIX_INTRINSIC)
    rotation, shift = np.asarray(found[5]), np.asarray(found[6]).ravel()
    return pose_errors(rotation.T, -rotation.T @ shift, true)


def by_caliscope(points: Floats, both: Floats, true: list[Camera], python: Path, folder: Path) -> Floats:
    """Errors of caliscope, by matched heads and feet (n, 2, 2, 2)."""
    rows = [
        (frame, c, person, part, *points[k, c, part])
        for k, (frame, person) in enumerate(both)
        for c in range(2)
        for part in range(2)
    ]
    np.savez(
        folder / "given.npz", matrix=[intrinsics(c) for c in true], distortion=[c.distortion[:5] for c in true],
        size=[c.image_size for c in true], points=rows,
    )  # fmt: skip
    found = output_of(python, "_caliscope_peer.py", folder / "given.npz")
    first, second = np.array(found["rotation"])
    centre = [-r.T @ t for r, t in zip((first, second), np.array(found["translation"]), strict=True)]
    return pose_errors(first @ second.T, first @ (centre[1] - centre[0]), true)


def compare(seeds: range, python: Path, *, show: bool) -> dict[str, Floats]:
    """Errors (n, 2) [deg] of rotation and direction in each room, by program; NaN where it refuses."""
    out: dict[str, list[Floats]] = {"calibrate": [], "caliscope": [], "stereoCalibrate": [], BOUND: []}
    for seed in seeds:
        frames, true, start, _ = room(seed, 2, poses=True)
        try:
            found = calibrate(frames, Scene(tuple(start)), start, CalibrateConfig()).cameras
            first, second = (each.camera for each in found)
            away = first.rotation.T @ (second.position - first.position)
            out["calibrate"].append(pose_errors(first.rotation.T @ second.rotation, away, true))
        except InputError:
            out["calibrate"].append(np.full(2, np.nan))
        rig = _rigs.rig(seed, 2)
        boxes, both = matched_boxes(rig)
        points, space = heads_and_feet(boxes), true_points(both, rig)
        with tempfile.TemporaryDirectory() as folder:
            out["caliscope"].append(by_caliscope(points, both, true, python, Path(folder)))
            exact = images_of(space, boxes, rig, true)
            out[BOUND].append(by_caliscope(exact, both, true, python, Path(folder)))
        out["stereoCalibrate"].append(by_opencv(points, space, true))
        if show:
            print(seed, {name: np.round(rows[-1], 3).tolist() for name, rows in out.items()}, flush=True)
    return {name: np.array(rows) for name, rows in out.items()}


def run(repeats: int = 5, seed: int = SEED, *, show: bool = False) -> dict[str, Any]:
    """Medians of the errors over rooms."""
    _rigs.SECONDS = SECONDS
    with tempfile.TemporaryDirectory() as folder:
        given = os.environ.get("OCCLOG_CALISCOPE")
        python = Path(given) if given else environment(Path(folder) / "caliscope", PACKAGE)
        found = compare(range(seed, seed + repeats), python, show=show)
    parts = {
        f"{name}, {what} [deg]": float(np.nanmedian(rows[:, k]))
        for name, rows in found.items()
        for k, what in enumerate(("rotation", "baseline"))
    }
    ratio = parts["calibrate, rotation [deg]"] / parts["caliscope, rotation [deg]"]
    return {"ratio": ratio, "limit": LIMIT, "parts": parts}


def main() -> None:
    """Compare, and print the errors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", type=int, default=10)
    parser.add_argument("--seed", type=int, default=SEED)
    given = parser.parse_args()
    for name, value in run(given.rooms, given.seed, show=True)["parts"].items():
        print(f"{name}: {value:.3f}")


if __name__ == "__main__":
    main()
