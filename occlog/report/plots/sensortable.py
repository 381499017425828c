"""Table of sensors: position, detections and bearing residuals of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from occlog.array_types import Floats
from occlog.report.content.metrics_in_words import number
from occlog.report.content.model import ReportInput
from occlog.report.drawing import label

from .over_time import sensors


@dataclass(frozen=True)
class SensorRow:
    """Row of the table of sensors as text: name, kind, position, yaw and field of view [deg], counts, residuals.

    `frames`, `seen`, `share`: numbers of observations and detections, and their ratio [%]; `residual`, `fit`: RMS
    residual of bearings [deg], and in standard deviations.
    """

    name: str
    kind: str
    position: str
    heading: str
    fov: str
    frames: str
    seen: str
    share: str
    residual: str
    fit: str


def sensor_rows(data: ReportInput) -> list[SensorRow]:
    """Return the rows of the table of sensors, over all targets."""
    fits = _fits(data)
    names = sensors(data)
    return [SensorRow(label(n, 60), *_pose(data, n), *_counts(data, n), *fits.get(n, ("–", "–"))) for n in names]


def sensor_columns(rows: Sequence[SensorRow], unit: str) -> list[tuple[str, str]]:
    """Return (field, heading) of the columns of the table of sensors that have a value.

    Columns of observations are omitted if all of them are detections.
    """
    heads = {
        "kind": "Kind",
        "position": f"Position [{unit}]",
        "heading": "Heading [°]",
        "fov": "Field of view [°]",
        "frames": "Observations",
        "seen": "Detected",
        "share": "Detected [%]",
        "residual": "Bearing residual [°]",
        "fit": "Residual [σ]",
    }
    empty = {key for key in heads if all(getattr(row, key) == "–" for row in rows)}
    if all(row.frames == row.seen for row in rows):
        empty |= {"frames", "share"}
    return [(key, head) for key, head in heads.items() if key not in empty]


def _pose(data: ReportInput, name: str) -> tuple[str, str, str, str]:
    """Return kind, position, yaw [deg] and field of view [deg] of the sensor `name`, as text."""
    if data.scene is not None:
        for camera in data.scene.cameras:
            if camera.name == name and not camera.placed:
                return "camera", "not known", "–", "–"
            if camera.name == name:
                fov = number(round(float(np.degrees(camera.fov)), 1))
                return "camera", _point(camera.position), number(round(float(np.degrees(camera.yaw)), 1)), fov
        for array in data.scene.arrays:
            if array.name == name:
                return "array", _point(array.position), number(round(float(np.degrees(array.yaw)), 1)), "–"
    return "not in the scene", "–", "–", "–"


def _point(position: Floats) -> str:
    return ", ".join(number(round(float(v), 3)) for v in position)


def _counts(data: ReportInput, name: str) -> tuple[str, str, str]:
    """Return numbers of observations and detections of the sensor `name`, and their ratio [%], as text."""
    if data.coverage is None:
        return "–", "–", "–"
    observed, seen = data.coverage.sensors.get(name, (0, 0))
    return number(observed), number(seen), number(round(100.0 * seen / observed, 1)) if observed else "–"


def _fits(data: ReportInput) -> dict[str, tuple[str, str]]:
    """Return the RMS residual of each sensor's bearings as text: in degrees, and in standard deviations."""
    every, out = list(data.residuals.values()), {}
    for name in dict.fromkeys(name for found in every for name in found.rows):
        rows = sum(found.rows[name] for found in every)
        if rows:
            degrees, ratio = np.sqrt(np.sum([found.squares[name] for found in every], axis=0) / rows)
            out[name] = (number(float(f"{np.degrees(degrees):.3g}")), number(float(f"{ratio:.3g}")))
    return out
