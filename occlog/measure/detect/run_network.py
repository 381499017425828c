"""What `occlog detect --onnx` does: open a recording and networks, detect in its images, write views and bearings."""

from __future__ import annotations

from collections import Counter

from occlog.errors import UsageError, option
from occlog.measure.networks.config import NetworkConfig
from occlog.measure.networks.detector import Detector, open_detector
from occlog.measure.networks.embedder import open_embedder
from occlog.measure.networks.running.runtimes import opencv_threads
from occlog.records.losses import Loss
from occlog.runner import Job
from occlog.settings import configure

from .by_network import detect_by_network
from .config import DetectConfig
from .left_out import LeftOut
from .request import NetworkRequest, PluginRequest
from .run import frames_of, images_of, write_detections


def run_network(request: NetworkRequest, job: Job) -> tuple[dict[str, object], list[Loss]]:
    """Detect and write; the summary, and the input that was lost."""
    opened, scene, sensors = images_of(request, "a network")
    config, of_networks = configure(DetectConfig(), request.settings), configure(NetworkConfig(), request.network)
    if request.embed is None and {"embed_pixels", "embed_size"} & set(request.network):
        raise UsageError(f"{option('embed_pixels')} and {option('embed_size')} go with {option('embed')}; add it")
    with opencv_threads(request.threads):
        detector = open_detector(
            request.onnx, of_networks, request.classes, request.names, config.min_confidence, request.threads
        )
        embedder = open_embedder(request.embed, of_networks, request.threads) if request.embed is not None else None
        _note_assumed(detector, job)
        models = [detector.network.file.files, embedder.network.file.files if embedder is not None else ()]
        beside = [path for path in (request.scene, request.names) if path is not None]
        parameters = {
            "cameras": list(request.cameras),
            "input": "images",
            **detector.parameters(),
            **(embedder.parameters() if embedder is not None else {}),
            **of_boxes(config),
        }
        files = [request.recording, *(path for each in models for path in each), *beside]
        left = LeftOut()
        frames = left.watch(job.progress(opened.frames(sensors), "detect", frames_of(opened, sensors)))
        parts = detect_by_network(frames, scene, detector, embedder, config)
        losses, tally = write_detections(job, parts, parameters, opened.losses, left, scene, files)
    names = [detector.names.names.get(k, str(k)) for k in detector.wanted.tolist()]
    told = {"head": detector.reading.head, "runtime": detector.parameters()["runtime"], "classes": names}
    return figures(request, tally, **told), losses


def of_boxes(config: DetectConfig) -> dict[str, object]:
    """Settings of detection that boxes of others take, as far as they are not the defaults, for the provenance."""
    known = {name: getattr(config, name) for name in ("bits", "sigma_px") if getattr(config, name) is not None}
    return known | ({"sigma_scale": config.sigma_scale} if config.sigma_scale != 1.0 else {})


def figures(request: NetworkRequest | PluginRequest, tally: Counter[str], **more: object) -> dict[str, object]:
    """The summary: tables that were written, figures of the detector, and counts of frames, boxes and rows."""
    bearings = {} if request.bearings is None else {"bearings": str(request.bearings)}
    counts = {"frames": tally["frames"], "boxes": tally["regions"]} | ({"rows": tally["rows"]} if bearings else {})
    return {"views": str(request.output), **bearings, **more, **counts}


def _note_assumed(detector: Detector, job: Job) -> None:
    """Say that names of classes are not the network's own."""
    if detector.names.source.endswith("assumed"):
        shown = ", ".join(f"{k} is {detector.names.names.get(k, 'unknown')}" for k in detector.wanted.tolist())
        job.note(
            f"{detector.network.file.path}: does not say what its classes are called; those of COCO are assumed: "
            f"{shown} ({option('names')} says otherwise)"
        )
