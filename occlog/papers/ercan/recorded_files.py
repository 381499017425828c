"""Recordings from their files.

cmc_detections is read as it is shipped: boxes of a person detector in four views, and
their calibration.  Of other recordings the bearings and the scene are given.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.errors import InputError, UsageError
from occlog.io.boxes.reader import BoxFile, BoxOptions, read_boxes, survey_boxes
from occlog.io.calibration import CalibrationOptions, read_calibration
from occlog.io.files.frame_times import FrameTimes, as_rate
from occlog.io.files.parquet import read_table
from occlog.io.files.provenance import hash_file
from occlog.io.recording.reader import open_recording
from occlog.io.scenes.scene import read_scene
from occlog.measure.detect.from_boxes import detect_boxes
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Boxes

TABLE = "CMC1_detections.csv"
"""Somebody walks about; in CMC2 too many people for one to be told from the others, in CMC4 a short path."""
CALIBRATION = "calibration"
IMAGE = (1920, 1024)
RATE = "6.5"
"""Frames a second, which the recording does not state: at this rate its target walks at 1.2 m/s."""
ROOM = ((0.0, 0.0), (7.67, 0.0), (7.67, 3.41), (0.0, 3.41))
"""[m], from the recording's description."""


class Source(NamedTuple):
    """Files of a recording, which other processes can read, and what their content is."""

    data: str  # folder of cmc_detections; empty: the two others
    bearings: str
    scene: str
    content: tuple[str, ...]  # SHA-256 of each file


def source_of(data: Path | None, bearings: Path | None, scene: Path | None) -> Source:
    """The files that were given: a folder, or bearings and a scene; InputError for files that are missing."""
    if data is not None:
        return Source(str(data.resolve()), "", "", tuple(hash_file(p) for p in _files(data)))
    if bearings is None or scene is None:
        raise UsageError("--scene goes with --bearings; give both")
    return Source("", str(bearings.resolve()), str(scene.resolve()), (hash_file(bearings), hash_file(scene)))


def read_source(source: Source) -> tuple[Scene, Bearings]:
    """Scene and bearings of a recording."""
    if source.data:
        return read_cmc(Path(source.data))
    path = Path(source.scene)
    scene = open_recording(path).scene if path.suffix.lower() == ".mcap" else read_scene(path)
    if scene is None:
        raise UsageError(f"{path}: this recording holds no scene; give a scene file with --scene")
    return scene, read_table(Path(source.bearings), Bearings)


def read_cmc(folder: Path) -> tuple[Scene, Bearings]:
    """Scene and unlabelled bearings, as `ingest` and `detect` make them of CMC1; InputError if files are missing."""
    table, *calibration = _files(folder)
    cameras = read_calibration(calibration, "projection", CalibrationOptions(None, IMAGE)).cameras
    scene = replace(Scene(), cameras=cameras, room=np.array(ROOM))
    files, known, options = [BoxFile(table, None)], [c.name for c in cameras], BoxOptions()
    survey = survey_boxes(files, known, options)
    times = dict.fromkeys(survey.cameras, FrameTimes("assumed frame rate", rate=as_rate(RATE)))
    boxes = read_boxes(files, survey, times, known, options, Boxes)
    return scene, Bearings.concat([found.bearings for found in detect_boxes(boxes, scene)])


def _files(folder: Path) -> list[Path]:
    """The files of cmc_detections that are read."""
    table, calibration = folder / TABLE, folder / CALIBRATION
    for path, there in ((table, table.is_file()), (calibration, calibration.is_dir())):
        if not there:
            raise InputError(f"{path}: not found; give the folder of cmc_detections")
    return [table, *sorted(p for p in calibration.iterdir() if p.is_file() and not p.name.startswith("."))]
