"""What `occlog detect --onnx` does: open a recording and networks, detect in its images, write views and bearings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from occlog import console
from occlog.errors import InputError, UsageError, option
from occlog.io.files.inputs import hash_inputs
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import TableWriter
from occlog.io.open import load_scene
from occlog.io.recording.reader import open_recording
from occlog.measure.detections import Detections
from occlog.measure.networks.config import NetworkConfig
from occlog.measure.networks.detector import Detector, open_detector
from occlog.measure.networks.embedder import open_embedder
from occlog.measure.networks.running.runtimes import opencv_threads
from occlog.records.losses import Loss
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Views
from occlog.settings import configure

from .by_network import detect_by_network
from .config import DetectConfig
from .left_out import LeftOut
from .run import cameras_of, frames_of


@dataclass(frozen=True)
class NetworkRequest:
    """In what to detect, with which networks, and how."""

    recording: Path
    scene: Path | None
    only: tuple[str, ...]  # names of cameras; empty: all
    model: Path
    classes: tuple[str, ...]  # names or numbers; empty: people, or the only class
    names: Path | None  # of its classes
    embed: Path | None  # network for re-identification
    settings: dict[str, object]  # of `DetectConfig`, as far as they were given
    network: dict[str, object]  # of `NetworkConfig`, as far as they were given
    threads: int


def run_network(
    request: NetworkRequest, views: Path, bearings: Path | None, overwrite: bool, quiet: bool
) -> tuple[dict[str, object], list[Loss]]:
    """Detect and write; the summary, and the input that was lost."""
    opened = open_recording(request.recording)
    scene = load_scene(request.scene, opened.scene, request.recording)
    if not opened.cameras:
        raise InputError(f"{request.recording}: holds no images; a network detects in images")
    sensors = cameras_of(request.only, opened)
    config, of_networks = configure(DetectConfig(), request.settings), configure(NetworkConfig(), request.network)
    if request.embed is None and {"embed_pixels", "embed_size"} & set(request.network):
        raise UsageError(f"{option('embed_pixels')} and {option('embed_size')} go with {option('embed')}; add it")
    check_placed(request.recording, scene, sensors, bearings)
    with opencv_threads(request.threads):
        detector = open_detector(
            request.model, of_networks, request.classes, request.names, config.min_confidence, request.threads
        )
        embedder = open_embedder(request.embed, of_networks, request.threads) if request.embed is not None else None
        _note_assumed(detector, quiet)
        models = [detector.network.file.files, embedder.network.file.files if embedder is not None else ()]
        beside = [path for path in (request.scene, request.names) if path is not None]
        parameters = {
            "cameras": list(request.only),
            "input": "images",
            **detector.parameters(),
            **(embedder.parameters() if embedder is not None else {}),
            **of_boxes(config),
        }
        files = [request.recording, *(path for each in models for path in each), *beside]
        provenance = Provenance("detect", parameters, None, hash_inputs(files))
        total = frames_of(opened, sensors)
        frames = console.progress(opened.frames(sensors), "detect", total, quiet=quiet)
        left = LeftOut()
        parts = detect_by_network(left.watch(frames), scene, detector, embedder, config)
        losses, tally = write_detections(
            parts, views, bearings, provenance, opened.losses, left, scene.length_unit, overwrite=overwrite
        )
    return _summary(detector, views, bearings, tally), losses


def check_placed(recording: Path, scene: Scene, sensors: Sequence[str], bearings: Path | None) -> None:
    """UsageError where bearings are wanted and no camera has a pose."""
    if bearings is not None and not any(scene.camera(name).placed for name in sensors):
        raise UsageError(
            f"{recording}: no camera has a pose, so that there are no bearings; leave {option('bearings')} out"
        )


def of_boxes(config: DetectConfig) -> dict[str, object]:
    """Settings of detection that boxes of others take, as far as they are not the defaults, for the provenance."""
    known = {name: getattr(config, name) for name in ("bits", "sigma_px") if getattr(config, name) is not None}
    return known | ({"sigma_scale": config.sigma_scale} if config.sigma_scale != 1.0 else {})


def write_detections(
    parts: Iterable[Detections],
    views: Path,
    bearings: Path | None,
    provenance: Provenance,
    lost: Sequence[Loss],
    left: LeftOut,
    length_unit: str,
    *,
    overwrite: bool,
) -> tuple[list[Loss], Counter[str]]:
    """Write views, and bearings if they are wanted; all losses, and counts of frames, boxes and rows."""
    losses, tally = list(lost), Counter[str]()
    table = partial(TableWriter, provenance=provenance, overwrite=overwrite, length_unit=length_unit)
    with ExitStack() as stack:
        boxes = stack.enter_context(table(views, Views))
        rows = stack.enter_context(table(bearings, Bearings)) if bearings is not None else None
        for part in parts:
            boxes.write(part.views)
            if rows is not None:
                rows.write(part.bearings)
            losses += part.losses
            left.lost(part.losses)
            tally.update(frames=part.frames, boxes=len(part.views), rows=len(part.bearings))
        told = {**provenance.parameters, **left.parameters()}
        final = replace(provenance, losses=tuple(losses), parameters=told)
        for writer in (boxes, rows):
            if writer is not None:
                writer.annotate(final)
    return losses, tally


def _note_assumed(detector: Detector, quiet: bool) -> None:
    """Say that names of classes are not the network's own."""
    if detector.names.source.endswith("assumed"):
        shown = ", ".join(f"{k} is {detector.names.names.get(k, 'unknown')}" for k in detector.wanted.tolist())
        console.note(
            f"{detector.network.file.path}: does not say what its classes are called; those of COCO are assumed: "
            f"{shown} ({option('names')} says otherwise)",
            quiet,
        )


def _summary(detector: Detector, views: Path, bearings: Path | None, tally: Counter[str]) -> dict[str, object]:
    parameters = detector.parameters()
    out: dict[str, object] = {
        "views": str(views),
        **({"bearings": str(bearings)} if bearings is not None else {}),
        "head": detector.reading.head,
        "runtime": parameters["runtime"],
        "classes": [detector.names.names.get(k, str(k)) for k in detector.wanted.tolist()],
        "frames": tally["frames"],
        "boxes": tally["boxes"],
    }
    return out | ({"rows": tally["rows"]} if bearings is not None else {})
