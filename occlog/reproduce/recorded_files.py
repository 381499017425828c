"""The recording cmc_detections as it is shipped: boxes of a person detector in four views, and their calibration."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..io.boxes import BoxFile, BoxOptions, read_boxes, survey_boxes
from ..io.calibration import CalibrationOptions, read_calibration
from ..io.frame_times import FrameTimes, as_rate
from ..records import Bearings, Boxes
from ..scene import Scene
from ..stages.detect_boxes import detect_boxes

TABLE = "CMC1_detections.csv"
"""Somebody walks about; in CMC2 too many people for one to be told from the others, in CMC4 a short path."""
CALIBRATION = "calibration"
IMAGE = (1920, 1024)
RATE = "6.5"
"""Frames a second, which the recording does not state: at this rate its target walks at 1.2 m/s."""
ROOM = ((0.0, 0.0), (7.67, 0.0), (7.67, 3.41), (0.0, 3.41))
"""[m], from the recording's description."""


def read_cmc(folder: Path) -> tuple[Scene, Bearings]:
    """Scene and unlabelled bearings, as `ingest` and `detect` make them of CMC1; InputError if files are missing."""
    table, calibration = folder / TABLE, folder / CALIBRATION
    for path, there in ((table, table.is_file()), (calibration, calibration.is_dir())):
        if not there:
            raise InputError(f"{path}: not found; give the folder of cmc_detections")
    cameras = read_calibration([calibration], "projection", CalibrationOptions(None, IMAGE)).cameras
    scene = replace(Scene(), cameras=cameras, room=np.array(ROOM))
    files, known, options = [BoxFile(table, None)], [c.name for c in cameras], BoxOptions()
    survey = survey_boxes(files, known, options)
    times = dict.fromkeys(survey.cameras, FrameTimes("assumed frame rate", rate=as_rate(RATE)))
    boxes = read_boxes(files, survey, times, known, options, Boxes)
    return scene, Bearings.concat([found.bearings for found in detect_boxes(boxes, scene)])
