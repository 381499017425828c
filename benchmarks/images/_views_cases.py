"""Recordings with true boxes for trackers in images, and the regions that all trackers are given."""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.images._views_score import LabelledBoxes
from occlog.array_types import Floats, Strings
from occlog.errors import ExitCode
from occlog.io.files.tables.parquet import read_table
from occlog.io.recording.reader import open_recording
from occlog.records.tables import TruthBoxes, Views

PETS = "View_001"
PETS_LAST = 400  # frames with true boxes
PETS_FPS = 7.0
ROOM_FPS = 25.0
ROOM = ("--scene", "people", "--frames", "200", "--size", "480x360", "--store", "ffv1")
"""The simulated room."""


class Case(NamedTuple):
    """A recording that every tracker gets."""

    recording: Path
    detections: Path
    fps: float
    views: tuple[str, ...]
    sizes: tuple[tuple[int, int], ...]  # width, height of each view's images
    frames: tuple[int, ...]  # of each view
    last: int  # frames that are scored
    truth: LabelledBoxes


def occlog(*args: str | Path) -> float:
    """Processor time [s] of a command, that of all its threads; what it lists as lost is no error."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run([sys.executable, "-m", "occlog", *args], capture_output=True, text=True, check=False)
    if done.returncode not in (ExitCode.DONE, ExitCode.LOSSY):
        raise SystemExit(f"occlog {' '.join(map(str, args))}: exit code {done.returncode}\n{done.stderr}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def pets(folder: Path, work: Path) -> Case:
    """PETS 2009 S2.L1, view 1: FOLDER holds `vtest.avi`, `calibration/View_001.xml` and the annotations."""
    recording = work / "pets.mcap"
    if not recording.exists():
        annotations = next((folder / "annotations").glob("*.xml"))
        occlog(
            "ingest",
            "-o",
            recording,
            "--calibration",
            folder / "calibration" / f"{PETS}.xml",
            "--video",
            f"{PETS}={folder / 'vtest.avi'}",
            "--truth",
            f"{PETS}={annotations}",
            "--fps",
            f"{PETS_FPS:g}",
            "--store",
            "link",
            "-q",
        )
    return detected(recording, PETS_FPS, PETS_LAST)


def room(seed: int, work: Path) -> Case:
    """A room with people who look alike, seen by three cameras."""
    recording = work / f"people_{seed}.mcap"
    if not recording.exists():
        occlog("simulate", *ROOM, "-o", recording, "--seed", str(seed), "-q")
    return detected(recording, ROOM_FPS, sys.maxsize)


def detected(recording: Path, fps: float, last: int) -> Case:
    """The case of a recording, with the regions of `occlog detect`."""
    detections = recording.with_suffix(".views.parquet")
    if not detections.exists():
        bearings = recording.with_suffix(".bearings.parquet")
        occlog("detect", recording, "-o", bearings, "--views", detections, "--overwrite", "-q")
    held = open_recording(recording)
    if held.scene is None:
        raise SystemExit(f"{recording}: holds no scene")
    views = tuple(sorted(held.cameras))
    sizes = tuple(held.scene.camera(name).image_size or (0, 0) for name in views)
    regions, boxes = read_table(detections, Views), held.read(TruthBoxes)
    frames = tuple(1 + max(_last(regions, name), _last(boxes, name)) for name in views)
    boxes = boxes.take((boxes.box >= 0) & (boxes.frame < last))
    placed = LabelledBoxes(places(boxes.sensor, views), boxes.frame, boxes.target_id.astype(np.int64), columns(boxes))
    return Case(recording, detections, fps, views, sizes, frames, last, placed)


def places(sensor: Strings, views: tuple[str, ...]) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Number of each row's view."""
    return np.searchsorted(np.array(views), sensor).astype(np.int64)


def columns(table: Views | TruthBoxes) -> Floats:
    """(n, 4) boxes."""
    return np.column_stack([table.left_px, table.top_px, table.width_px, table.height_px])


def _last(table: Views | TruthBoxes, name: str) -> int:
    return int(table.frame[table.sensor == name].max(initial=-1))
