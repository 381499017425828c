"""What `occlog detect --method` does: open a recording, detect in it with a plug-in, write views and bearings."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from occlog import console
from occlog.errors import InputError
from occlog.io.files.inputs import hash_inputs
from occlog.io.files.provenance import Provenance
from occlog.io.open import load_scene
from occlog.io.recording.reader import open_recording
from occlog.plugins.chosen import Chosen
from occlog.records.losses import Loss
from occlog.settings import configure

from .by_plugin import detect_by_plugin
from .config import DetectConfig
from .left_out import LeftOut
from .run import cameras_of, frames_of
from .run_network import check_placed, of_boxes, write_detections


@dataclass(frozen=True)
class PluginRequest:
    """In what to detect, with which plug-in, and how."""

    recording: Path
    scene: Path | None
    only: tuple[str, ...]  # names of cameras; empty: all
    chosen: Chosen
    settings: dict[str, object]  # of `DetectConfig`, as far as they were given


def run_plugin(
    request: PluginRequest, views: Path, bearings: Path | None, overwrite: bool, quiet: bool
) -> tuple[dict[str, object], list[Loss]]:
    """Detect and write; the summary, and the input that was lost."""
    opened = open_recording(request.recording)
    scene = load_scene(request.scene, opened.scene, request.recording)
    if not opened.cameras:
        raise InputError(f"{request.recording}: holds no images; a detector looks at images")
    sensors = cameras_of(request.only, opened)
    config = configure(DetectConfig(), request.settings)
    check_placed(request.recording, scene, sensors, bearings)
    told = request.chosen.provenance(scene.length_unit)
    parameters = {"cameras": list(request.only), "input": "images", "detector": told, **of_boxes(config)}
    parameters["min_confidence"] = config.min_confidence
    files = [path for path in (request.recording, request.scene) if path is not None]
    provenance = Provenance("detect", parameters, None, hash_inputs(files))
    frames = console.progress(opened.frames(sensors), "detect", frames_of(opened, sensors), quiet=quiet)
    left = LeftOut()
    parts = detect_by_plugin(left.watch(frames), scene, request.chosen, config)
    losses, tally = write_detections(
        parts, views, bearings, provenance, opened.losses, left, scene.length_unit, overwrite=overwrite
    )
    summary: dict[str, object] = {"views": str(views), **({"bearings": str(bearings)} if bearings is not None else {})}
    summary |= {"method": request.chosen.plugin.name, "plugin": request.chosen.plugin.origin}
    summary |= {name: tally[name] for name in ("frames", "boxes", *(("rows",) if bearings is not None else ()))}
    return summary, losses
