"""People in rooms, the boxes that detectors of calibrated cameras make of them, and the files that a user would have.

Bodies are stacks of rings, which are projected point by point through the camera's true lens; a body of which nearer
ones cover most is not detected.  Everything follows from a seed.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.references import scene
from occlog.array_types import Floats
from occlog.records.scene import Camera, camera_fov, camera_rotation

SECONDS, FINE_HZ = 20.0, 100.0
"""Duration of a set-up, and rate at which paths are known."""
MARGIN_S = 3.0
"""Paths begin before the first frame and end after the last one by this time, for cameras that are late."""
SIZES = ((1280, 720), (1920, 1080), (640, 480), (1280, 960))
COVERED = 0.6
"""Covered share above which a body is not detected."""
COLUMNS = ("frame", "left", "top", "width", "height", "confidence")


@dataclass(frozen=True)
class Detector:
    """Errors of a detector: of edges [px, and share of the height], misses, and false boxes per frame."""

    edge_px: float
    edge_share: float
    miss: float
    false: float


@dataclass
class Rig:
    """A room with people, its cameras as they are, and what a user has of them.

    Attributes:
        seed: of all random numbers.
        size: of the room [m].
        fps: frame rate of the cameras.
        detector: errors of boxes.
        paths: (T, n, 2) positions at `FINE_HZ` [m]; the first frame is at `MARGIN_S`.
        bodies: (n, 2) height and width [m].
        cameras: as they are.
        calibration: as a user states them.
        boxes: (N, 5) frame, left, top, right, bottom of each camera [px].
        truth: (M, 4) frame, identity, x, y as a user states it.
        time_factor: of the seconds in a column `time` of the files of boxes; None: they have none.
        options: of `ingest`, beside the files.
        seconds: duration.
        world_to_camera: R and T of the calibration are written as OpenCV has them.
    """

    seed: int
    size: tuple[float, float]
    fps: float
    detector: Detector
    paths: Floats
    bodies: Floats
    cameras: dict[str, Camera]
    calibration: dict[str, Camera] = field(default_factory=dict)
    boxes: dict[str, Floats] = field(default_factory=dict)
    truth: Floats = field(default_factory=lambda: np.zeros((0, 4)))
    time_factor: float | None = None
    options: dict[str, Any] = field(default_factory=dict)
    seconds: float = SECONDS
    world_to_camera: bool = True
    rotation_vectors: Callable[[Floats], Floats] | None = None

    @property
    def frames(self) -> int:
        """Number of frames of each camera."""
        return round(self.seconds * self.fps)

    @property
    def names(self) -> list[str]:
        """Names of the cameras."""
        return list(self.cameras)

    def shoot(self, name: str, camera: Camera | None = None, late_s: float = 0.0, start: int = 0) -> Floats:
        """Boxes (N, 5) of a camera of the frames from `start` on; `late_s`: shown is what was so long before."""
        camera = self.cameras[name] if camera is None else camera
        numbers = np.arange(start, self.frames)
        rows = np.round((MARGIN_S + numbers / self.fps - late_s) * FINE_HZ).astype(np.int64)
        rng = np.random.default_rng((self.seed, 7, self.names.index(name)))
        return _boxes(camera, numbers, self.paths[rows], self.bodies, self.detector, rng)

    def lengthen(self, seconds: float) -> None:
        """Let people walk on, so that the recording is longer."""
        self.seconds += seconds
        steps = round((self.seconds + 2.0 * MARGIN_S) * FINE_HZ)
        rng = np.random.default_rng((self.seed, 13))
        self.paths = scene("crowds").walk(len(self.bodies), steps, FINE_HZ, *self.size, rng)
        self.boxes = {name: self.shoot(name) for name in self.names}
        self.truth = self.true_positions()

    def true_positions(self) -> Floats:
        """(M, 4) frame, identity, x and y of all people."""
        numbers = np.arange(self.frames)
        at = self.paths[np.round((MARGIN_S + numbers / self.fps) * FINE_HZ).astype(np.int64)]
        frame, person = (a.ravel() for a in np.meshgrid(numbers, range(len(self.bodies)), indexing="ij"))
        return np.column_stack([frame, person, at.reshape(-1, 2)])

    def boxes_of(self, name: str, person: int) -> Floats:
        """Boxes (N, 5) without errors of a person whom nothing hides, in one camera."""
        numbers = np.arange(self.frames)
        rows = np.round((MARGIN_S + numbers / self.fps) * FINE_HZ).astype(np.int64)
        alone, exact = slice(person, person + 1), Detector(0.0, 0.0, 0.0, 0.0)
        camera, rng = self.cameras[name], np.random.default_rng(0)
        return _boxes(camera, numbers, self.paths[rows, alone], self.bodies[alone], exact, rng)


def rig(seed: int, cameras: int | None = None) -> Rig:
    """A sound rig: room, people, cameras and detector drawn from a seed."""
    rng = np.random.default_rng((seed, 2611))
    count = int(rng.integers(2, 7)) if cameras is None else cameras
    width, depth = rng.uniform(6.0, 13.0), rng.uniform(5.0, 10.0)
    people, fps = int(rng.integers(2, 8)), float(rng.choice([5.0, 8.0, 10.0, 12.5]))
    detector = Detector(rng.uniform(1.0, 3.0), rng.uniform(0.005, 0.025), rng.uniform(0.02, 0.2), rng.uniform(0.0, 0.6))
    steps = round((SECONDS + 2.0 * MARGIN_S) * FINE_HZ)
    paths = scene("crowds").walk(people, steps, FINE_HZ, width, depth, rng)
    bodies = np.column_stack([rng.normal(1.7, 0.09, people), rng.normal(0.52, 0.05, people)])
    placed = {c.name: c for c in _cameras(count, width, depth, rng)}
    made = Rig(seed, (width, depth), fps, detector, paths, bodies, placed, seconds=SECONDS)
    made.calibration = {name: _calibrated(c, rng) for name, c in placed.items()}
    made.boxes = {name: made.shoot(name) for name in placed}
    made.truth = made.true_positions()
    made.options = {"fps": fps}
    return made


def _cameras(count: int, width: float, depth: float, rng: np.random.Generator) -> list[Camera]:
    """Cameras about the walls, 2.3 to 4 m high, of one type with a lens of its own each."""
    size = SIZES[int(rng.integers(len(SIZES)))]
    focal = size[0] * rng.uniform(0.55, 0.85)
    barrel = rng.uniform(-0.22, 0.02)
    turn, out = rng.uniform(0.0, 2.0 * np.pi), []
    for k in range(count):
        angle = turn + 2.0 * np.pi * (k + rng.uniform(0.3, 0.7)) / count
        edge = min(0.5 * width / max(abs(np.cos(angle)), 1e-9), 0.5 * depth / max(abs(np.sin(angle)), 1e-9))
        middle, away = 0.5 * np.array([width, depth]), edge + rng.uniform(0.2, 1.5)
        ground = middle + away * np.array([np.cos(angle), np.sin(angle)])
        aim, height = np.array([width, depth]) * rng.uniform(0.35, 0.65, 2), rng.uniform(2.3, 4.0)
        yaw = np.arctan2(*(aim - ground)[::-1])
        pitch = -np.arctan2(height - 0.9, np.hypot(*(aim - ground)))
        rotation = camera_rotation(float(yaw), float(pitch), float(np.radians(rng.normal(0.0, 1.0))))
        lens = np.array([barrel + rng.normal(0.0, 0.01), 0.4 * abs(barrel), *rng.normal(0.0, 3e-4, 2), 0.0])
        f, c = focal * rng.normal(1.0, 0.01) * np.ones(2), 0.5 * np.array(size) + rng.normal(0.0, 6.0, 2)
        out.append(of_lens(Camera(f"cam{k + 1}", np.array([*ground, height]), rotation, f, c, size), lens, "brown"))
    return out


def of_lens(camera: Camera, lens: Floats, model: str) -> Camera:
    """The camera with another lens."""
    size = camera.image_size or (1280, 720)
    fov = camera_fov(size, camera.focal_px, camera.principal_px, lens, model, camera.rotation)
    return replace(camera, distortion=lens, distortion_model=model, fov=fov)


def _calibrated(camera: Camera, rng: np.random.Generator) -> Camera:
    """The camera as a good calibration has it: 0.1 degrees and 5 mm about each axis, focal length to 0.2 %."""
    turn = cv2.Rodrigues(np.radians(rng.normal(0.0, 0.1, 3)))[0]
    moved = replace(camera, rotation=turn @ camera.rotation, position=camera.position + rng.normal(0.0, 0.005, 3))
    return replace(moved, focal_px=camera.focal_px * rng.normal(1.0, 0.002))


def vector_of(rotation: Floats) -> Floats:
    """(3,) rotation vector of a rotation matrix."""
    angle = np.arccos(np.clip(0.5 * (np.trace(rotation) - 1.0), -1.0, 1.0))
    axis = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    return np.asarray(axis * angle / max(2.0 * np.sin(angle), 1e-12))


def _boxes(
    camera: Camera, numbers: Floats, places: Floats, bodies: Floats, detector: Detector, rng: np.random.Generator
) -> Floats:
    """(N, 5) frame and box of what a detector finds; places (T, n, 2)."""
    rings, around = scene("crowds").RINGS, scene("crowds").AROUND
    angle = 2.0 * np.pi * np.arange(around) / around
    ring = np.array([[0.5 * r * np.cos(a), 0.5 * r * np.sin(a), z] for z, r in rings for a in angle])
    T, n = places.shape[:2]
    points = np.empty((T, n, len(ring), 3))
    points[..., :2] = places[:, :, None] + bodies[None, :, None, 1:] * ring[None, None, :, :2]
    points[..., 2] = bodies[None, :, None, 0] * ring[:, 2]
    pixels = camera.project(points.reshape(-1, 3)).reshape(T, n, len(ring), 2)
    size = np.array(camera.image_size, dtype=np.float64)
    with np.errstate(invalid="ignore"):
        sharp = np.concatenate([pixels.min(axis=2), pixels.max(axis=2)], axis=-1)
        middle = 0.5 * (sharp[..., :2] + sharp[..., 2:])
        shown = np.isfinite(sharp).all(axis=-1) & ((middle > 0.0) & (middle < size - 1.0)).all(axis=-1)
    sharp[~shown] = np.nan
    far = np.linalg.norm(places - camera.position[:2], axis=-1)
    found = shown & (_covered(sharp, far, rng) <= COVERED) & (rng.random((T, n)) > detector.miss)
    sigma = detector.edge_px + detector.edge_share * (sharp[..., 3] - sharp[..., 1])
    noisy = sharp + rng.normal(0.0, 1.0, sharp.shape) * sigma[..., None]
    rows = [
        np.column_stack([np.full(int(own.sum()), k), noisy[t][own]])
        for t, (k, own) in enumerate(zip(numbers, found, strict=True))
    ]
    for k in numbers:
        many = rng.poisson(detector.false)
        high, w = rng.uniform(0.1, 0.4, many) * size[1], rng.uniform(0.3, 0.45, many)
        u, v = rng.uniform(0.0, size[0], many), rng.uniform(0.1 * size[1], size[1], many)
        rows.append(np.column_stack([np.full(many, k), u - 0.5 * w * high, v - high, u + 0.5 * w * high, v]))
    out = np.concatenate(rows)
    out[:, 1:] = np.clip(out[:, 1:], 0.0, np.tile(size, 2))
    large = (out[:, 3] - out[:, 1] > 4.0) & (out[:, 4] - out[:, 2] > 8.0)
    out = out[large]
    return np.asarray(out[np.lexsort((rng.random(len(out)), out[:, 0]))])


def _covered(boxes: Floats, far: Floats, rng: np.random.Generator) -> Floats:
    """(T, n) share of each box that boxes of nearer bodies cover."""
    spots = rng.random((40, 2))
    at = boxes[..., None, :2] + spots * (boxes[..., None, 2:] - boxes[..., None, :2])  # (T, n, 40, 2)
    hidden = np.zeros(at.shape[:3], dtype=bool)
    with np.errstate(invalid="ignore"):
        for m in range(boxes.shape[1]):
            other = boxes[:, m, None, None]
            inside = ((at > other[..., :2]) & (at < other[..., 2:])).all(axis=-1)
            hidden |= inside & (far[:, m, None] < far)[..., None]
    return np.asarray(hidden.mean(axis=-1))


def write(made: Rig, folder: Path) -> dict[str, Any]:
    """Write the files of a user; arguments of `occlog.ingest`."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, rows in made.boxes.items():
        with (folder / f"{name}.csv").open("w", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            timed = made.time_factor is not None
            writer.writerow([*COLUMNS, *(["time"] if timed else [])])
            for frame, left, top, right, bottom in rows.tolist():
                edges = (f"{value:.1f}" for value in (left, top, right - left, bottom - top))
                time = [f"{frame / made.fps * (made.time_factor or 1.0):.10g}"] if timed else []
                writer.writerow([int(frame), *edges, "0.9", *time])
    for name, camera in made.calibration.items():
        (folder / f"{name}.yaml").write_text(_opencv(camera, made))
    write_truth(folder / "truth.csv", made.truth)
    files: dict[str, Any] = {
        "boxes": {name: folder / f"{name}.csv" for name in made.boxes},
        "calibration": [folder / f"{name}.yaml" for name in made.calibration],
    }
    return files | ({"truth": folder / "truth.csv"} if len(made.truth) else {}) | made.options


def write_truth(path: Path, rows: Floats) -> Path:
    """Write frame, identity, x and y of people (M, 4), and return the path."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["frame", "id", "x", "y"])
        writer.writerows([int(f), int(i), f"{x:.6g}", f"{y:.6g}"] for f, i, x, y in rows.tolist())
    return path


def _opencv(camera: Camera, made: Rig) -> str:
    """A calibration as `cv2.FileStorage` writes it."""
    rotation = camera.rotation.T if made.world_to_camera else camera.rotation
    shift = -rotation @ camera.position if made.world_to_camera else camera.position
    (fx, fy), (cx, cy), size = camera.focal_px, camera.principal_px, camera.image_size or (0, 0)
    inner = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    count = 4 if camera.distortion_model == "equidistant" else 5
    parts = [f"image_width: {size[0]}", f"image_height: {size[1]}", _matrix("camera_matrix", inner)]
    parts.append(_matrix("distortion_coefficients", camera.distortion[None, :count]))
    if camera.distortion_model == "equidistant":
        parts.append("fisheye_model: 1")
    if made.rotation_vectors is None:
        parts.append(_matrix("R", rotation))
    else:
        parts.append(_matrix("rvec", made.rotation_vectors(vector_of(rotation))[:, None]))
    return "\n".join(["%YAML:1.0", "---", *parts, _matrix("T", shift[:, None])]) + "\n"


def _matrix(name: str, values: Floats) -> str:
    rows, columns = values.shape
    data = json.dumps([float(v) for v in values.ravel()])
    return f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: {data}"


def other_camera(made: Rig, rng: np.random.Generator, but: Sequence[str] = ()) -> str:
    """A camera of the rig, at random."""
    return str(rng.choice([name for name in made.names if name not in but]))
