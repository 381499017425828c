"""Calibration formats that can be written, by suffix or name of the output; imports nothing heavy."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple


class CalibrationOutput(NamedTuple):
    """A calibration format that can be written.

    Attributes:
        endings: endings of the names of its outputs; those without a dot are folders.
        doc: one line on what it is.
    """

    endings: tuple[str, ...]
    doc: str


OUTPUTS = {
    "opencv-storage": CalibrationOutput(("opencv", "opencv.yml"), "folder of OpenCV's YAML, or .yml of one camera"),
    "kalibr": CalibrationOutput(("camchain.yaml",), "Kalibr's camera chain, with offsets of clocks"),
    "colmap": CalibrationOutput(("colmap",), "COLMAP's text model, a folder"),
    "ros": CalibrationOutput(("camera_info",), "ROS camera_info and static transforms, a folder"),
}
"""Every format that is written, by its name in `occlog.io.formats.calibration.reader.IMPORTERS`."""


def format_of(path: Path) -> str | None:
    """Calibration format, a key of `OUTPUTS`, by the ending of an output's name; None if it states none."""
    low = path.name.lower()
    return next((name for name, of in OUTPUTS.items() if low.endswith(of.endings)), None)


def is_folder(path: Path, format: str) -> bool:
    """Whether the output `path` of a calibration format is a folder rather than a file."""
    return format != "kalibr" and path.suffix.lower() not in (".yml", ".yaml")
