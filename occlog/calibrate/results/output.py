"""Output of `occlog calibrate`: a scene, or a calibration in another program's format, by the suffix of the file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from occlog.io.files.atomic import write_bytes
from occlog.io.formats.calibration.outputs import format_of
from occlog.io.formats.calibration.writer import write_calibration
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.records.losses import Loss
from occlog.records.scene import Scene
from occlog.records.verdicts import Check
from occlog.runner import Job

CLOCK = "{}-clock"
"""Name of the clock of a sensor that is late."""


class CalibrationResult(NamedTuple):
    """Result of a calibration by people or by a board.

    Attributes:
        scene: scene with the calibrated sensors.
        comment: comment lines for the scene file.
        parameters: parameters for the provenance.
        checks: checks with their findings.
        summary: figures of the summary by name.
        losses: losses of the inputs.
        picture: PNG; None: not requested.
    """

    scene: Scene
    comment: str
    parameters: Mapping[str, object]
    checks: tuple[Check, ...]
    summary: Mapping[str, object]
    losses: tuple[Loss, ...]
    picture: bytes | None = None


def write_scene(path: Path, scene: Scene, comment: str, job: Job) -> None:
    """Write a scene with a comment to a YAML file, or its cameras in the format that the suffix of `path` selects.

    A note lists what that format cannot store.
    """
    form = format_of(path)
    if form is None:
        write_bytes(path, (comment + scene_to_yaml(scene)).encode(), job.overwrite)
    elif missed := write_calibration(path, scene, form, job.overwrite):
        job.note(f"{path}: {form} cannot store: {'; '.join(missed)}")
