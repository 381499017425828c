"""Crowds with known places: annotated people of WILDTRACK with boxes made worse, and simulated rooms.

WILDTRACK is not shipped; `OCCLOG_SHARED_DATA` names the folder that holds `wildtrack_annotations`, beside which
`tools/crowd/degrade_boxes.py` makes boxes as a detector could have reported them.
"""

from __future__ import annotations

import csv
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.references import scene
from benchmarks.track._single_people import annotations
from occlog.array_types import Floats

DEGREES = {
    "A": ("--miss", "0.2", "--false", "1", "--px", "5"),
    "B": ("--miss", "0.4", "--false", "2", "--px", "8"),
    "C": ("--miss", "0.2", "--false", "1", "--px", "5", "--hide", "0.6"),
    "D": ("--miss", "0.2", "--false", "1", "--px", "5", "--hide", "0.6", "--cut", "--loose", "0.1"),
}
"""Settings of `degrade_boxes.py`: few misses, many, hidden people left out, cut and loose as of a detector."""
AREA = (-3.0, 9.0, -9.0, 27.0)
"""The annotated ground of WILDTRACK [m]."""


class Case(NamedTuple):
    """Boxes of calibrated cameras of everybody, and where everybody is; lengths in metres."""

    name: str
    fps: float
    size: tuple[int, int]  # of the images
    matrices: Floats  # (C, 3, 4) from the world to the image
    boxes: Floats  # (N, 6) frame, camera from 0, left, top, right, bottom
    truth: Floats  # (M, 4) frame, identity, x, y
    area: tuple[float, float, float, float]  # lowest and highest x, lowest and highest y of the ground
    frames: int


def wildtrack(setting: str, seed: int, work: Path) -> Case | None:
    """WILDTRACK, frames 0 to 199, at one of the settings of `DEGREES`; None where the data or the tool is missing."""
    folder = annotations()
    if folder is None:
        return None
    tool = folder.parents[1] / "tools" / "crowd" / "degrade_boxes.py"
    if not tool.is_file():
        return None
    made = work / f"wildtrack_{setting}{seed}.csv"
    if not made.exists():
        given = [sys.executable, tool, folder / "boxes_true.csv", "-o", made, *DEGREES[setting], "--seed", str(seed)]
        subprocess.run(given, check=True, capture_output=True)
    boxes = columns(made, "frame", "camera", "left", "top", "right", "bottom")
    boxes[:, 1] -= 1
    truth = columns(folder / "truth.csv", "frame", "id", "x", "y")
    matrices = np.array([np.loadtxt(folder / "calibration" / f"cam{n}_P.txt") for n in range(1, 8)])
    frames = int(truth[:, 0].max()) + 1
    return Case(f"wildtrack-{setting}", 2.0, (1920, 1080), matrices, boxes, truth, AREA, frames)


def room(people: int, cameras: int, seed: int, frames: int, hz: float, size: tuple[float, float] = (10.0, 8.0)) -> Case:
    """People who walk about in a room, all of them all the time; cameras of 1280 x 720 around it."""
    made = scene("crowds").crowd(people, cameras, frames, hz, size, seed=seed)
    rows = [
        np.column_stack(
            [
                np.full(len(frame_detections.boxes), t),
                np.full(len(frame_detections.boxes), frame_detections.camera),
                frame_detections.boxes,
            ]
        )
        for t, frames_of_step in enumerate(made.moments)
        for frame_detections in frames_of_step
    ]
    frame, person = (a.ravel() for a in np.meshgrid(range(frames), range(people), indexing="ij"))
    truth = np.column_stack([frame, person, made.truth.reshape(-1, 2)])
    area = (0.0, size[0], 0.0, size[1])
    name = f"room-{people}x{cameras}"
    return Case(name, hz, (1280, 720), _matrices(made.scene.cameras), np.concatenate(rows), truth, area, frames)


def _matrices(cameras: tuple[object, ...]) -> Floats:
    """(C, 3, 4) of cameras without distortion."""
    out = []
    for camera in cameras:
        turn = camera.rotation.T  # type: ignore[attr-defined]
        (fx, fy), (cx, cy) = camera.focal_px, camera.principal_px  # type: ignore[attr-defined]
        inner = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        out.append(inner @ np.column_stack([turn, -turn @ camera.position]))  # type: ignore[attr-defined]
    return np.array(out)


def columns(path: Path, *names: str) -> Floats:
    with path.open(newline="") as file:
        return np.array([[float(row[name]) for name in names] for row in csv.DictReader(file)])


def write(case: Case, folder: Path) -> None:
    """Write boxes, true positions and projection matrices as files that `occlog ingest` reads."""
    shutil.rmtree(folder / "calibration", ignore_errors=True)
    (folder / "calibration").mkdir(parents=True)
    for n, matrix in enumerate(case.matrices, start=1):
        np.savetxt(folder / "calibration" / f"cam{n}_P.txt", matrix, fmt="%.17g")
    with (folder / "boxes.csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["frame", "camera", "left", "top", "right", "bottom"])
        for frame, camera, *edges in case.boxes[np.lexsort((case.boxes[:, 1], case.boxes[:, 0]))]:
            writer.writerow([int(frame), f"cam{int(camera) + 1}", *(f"{edge:.3f}" for edge in edges)])
    with (folder / "truth.csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["time", "id", "x", "y"])
        for frame, person, x, y in case.truth:
            writer.writerow([f"{frame / case.fps:.9f}", int(person), f"{x:.6f}", f"{y:.6f}"])
