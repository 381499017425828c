"""Scene and bearings of a recording from its files.

The data set cmc_detections is read as it is shipped: boxes of a person detector in four views, and
their calibration.  Other recordings come as a table of bearings and a scene.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.errors import InputError, UsageError
from occlog.io.boxes.reader import BoxFile, BoxOptions, read_boxes, survey_boxes
from occlog.io.calibration.common import CalibrationOptions
from occlog.io.calibration.reader import read_calibration
from occlog.io.files.frame_times import FrameTimes, as_rate
from occlog.io.files.parquet import read_table
from occlog.io.files.provenance import hash_file
from occlog.io.open import scene_in
from occlog.measure.detect.from_boxes import detect_boxes
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Boxes

TABLE = "CMC1_detections.csv"
"""CMC1 has one walking target; in CMC2 people cannot be told apart, and CMC4 has a short path only."""
CALIBRATION = "calibration"
IMAGE = (1920, 1024)
RATE = "6.5"
"""Frames a second.  The recording does not state it; at this rate its target walks at 1.2 m/s."""
ROOM = ((0.0, 0.0), (7.67, 0.0), (7.67, 3.41), (0.0, 3.41))
"""Corners of the room [m], from the recording's description."""


class Source(NamedTuple):
    """Files of a recording by absolute paths, and hashes of their content."""

    data: str  # folder of cmc_detections; empty: `bearings` and `scene` are given
    bearings: str
    scene: str
    content: tuple[str, ...]  # SHA-256 of each file


def cmc_files(data: Path) -> Source:
    """Name the files of a folder of cmc_detections; InputError for missing ones."""
    return Source(str(data.resolve()), "", "", tuple(hash_file(p) for p in _files(data)))


def files_of(bearings: Path, scene: Path) -> Source:
    """Name the files of a recording given as bearings and a scene; InputError for missing ones."""
    return Source("", str(bearings.resolve()), str(scene.resolve()), (hash_file(bearings), hash_file(scene)))


def read_source(source: Source) -> tuple[Scene, Bearings]:
    """Read scene and bearings of a recording; UsageError if its scene is a recording without one."""
    if source.data:
        return read_cmc(Path(source.data))
    path = Path(source.scene)
    scene = scene_in(path)
    if scene is None:
        raise UsageError(f"{path}: this recording holds no scene; give a scene file instead")
    return scene, read_table(Path(source.bearings), Bearings)


def read_cmc(folder: Path) -> tuple[Scene, Bearings]:
    """Read CMC1 as `ingest` and `detect` do: scene and unlabelled bearings; InputError for missing files."""
    table, *calibration = _files(folder)
    cameras = read_calibration(calibration, "projection", CalibrationOptions(None, IMAGE)).cameras
    scene = replace(Scene(), cameras=cameras, room=np.array(ROOM))
    files, known, options = [BoxFile(table, None)], [c.name for c in cameras], BoxOptions()
    survey = survey_boxes(files, known, options)
    times = dict.fromkeys(survey.cameras, FrameTimes("assumed frame rate", rate=as_rate(RATE)))
    boxes = read_boxes(files, survey, times, known, options, Boxes)
    return scene, Bearings.concat([found.bearings for found in detect_boxes(boxes, scene)])


def _files(folder: Path) -> list[Path]:
    """Return the table and the calibration files of cmc_detections; InputError if one of them is missing."""
    table, calibration = folder / TABLE, folder / CALIBRATION
    for path, there in ((table, table.is_file()), (calibration, calibration.is_dir())):
        if not there:
            raise InputError(f"{path}: not found; give the folder of cmc_detections")
    return [table, *sorted(p for p in calibration.iterdir() if p.is_file() and not p.name.startswith("."))]
