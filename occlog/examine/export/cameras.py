"""Export of a scene's cameras to calibrations of other programs, or to a scene file."""

from __future__ import annotations

from pathlib import Path

from occlog import console
from occlog.console.notes import begin_work
from occlog.errors import UsageError
from occlog.io.files.atomic import check_outputs, write_bytes
from occlog.io.files.inputs import previous_losses
from occlog.io.formats.calibration.writer import check_calibration, write_calibration
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.io.open import load_scene
from occlog.records.losses import Loss

from .formats import SCENE


def run_export_cameras(
    input: Path, output: Path, format: str, *, overwrite: bool, quiet: bool
) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Write the cameras of a scene; return the summary, and the data losses of the recording that has the scene.

    Args:
        input: scene file, recording with a scene, or table of stations.
        output: file or folder.
        format: name of a format for cameras, a key of `FORMATS`.
        overwrite: replace outputs that exist.
        quiet: print no notes about what the format cannot store.

    Raises:
        NoSceneError: the input has no scene.
        InputError: the format cannot store a camera.
    """
    if str(output) == "-":
        raise UsageError(f"-: format {format} is not written to standard output; name a file", id="not-applicable")
    check_outputs([input], [output] if format == SCENE else [], overwrite)
    if format != SCENE:
        check_calibration(output, format, overwrite)
    scene = load_scene(input, None, input)
    begin_work()
    missed: tuple[str, ...] = ()
    if format == SCENE:
        write_bytes(output, scene_to_yaml(scene).encode(), overwrite)
    else:
        missed = write_calibration(output, scene, format, overwrite)
    if missed:
        console.note(f"{output}: {format} cannot store: {'; '.join(missed)}", quiet)
    summary: dict[str, object] = {"output": str(output), "format": format, "cameras": [c.name for c in scene.cameras]}
    return summary | ({"not_representable": list(missed)} if missed else {}), previous_losses([input])
