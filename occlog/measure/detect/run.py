"""Run of `occlog detect`: open a recording, detect in what it holds, fuse, write.

What `occlog detect --onnx` does: open a recording and networks, detect in its images, write views and bearings.

What `occlog detect --method` does: open a recording, detect in it with a plug-in, write views and bearings.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError, UsageError, option
from occlog.io.files.limits import FOREIGN_BAG, check_input
from occlog.io.files.texts.documents import parse_json
from occlog.io.open import check_unit, load_scene, open_input
from occlog.io.recording.reader import McapRecording, open_recording
from occlog.measure.detections import Detections
from occlog.measure.fuse.config import FuseConfig
from occlog.measure.fuse.run import FuseTally
from occlog.measure.fuse.stage import fuse
from occlog.measure.networks.config import NetworkConfig
from occlog.measure.networks.detector import NetworkDetector, open_detector, open_embedder
from occlog.measure.networks.running.runtimes import opencv_threads
from occlog.plugins.loading import DETECTOR, Chosen, find
from occlog.records.columns import ColumnTable
from occlog.records.losses import Loss
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Boxes, Tracks, Views
from occlog.request import Form
from occlog.runner import Job
from occlog.settings import configure

from .by_background.learning import TargetBox, learn
from .by_background.one_camera import Target, upright
from .by_background.stage import Learned, detect
from .by_network import detect_by_network
from .by_plugin import detect_by_plugin
from .checks import Checked
from .config import DetectConfig, parameters
from .from_boxes import detect_boxes, scan_labels
from .request import Detection, DetectRequest, NetworkRequest, PluginRequest
from .skipped_frames import SkippedFrames
from .track_feedback import TrackFeedback, limited, track_feedback

T = TypeVar("T", Boxes, Bearings)


def run_detect(request: DetectRequest, job: Job) -> tuple[dict[str, object], list[Loss]]:
    """Detect and write; the summary, and the input that was lost."""
    of_fusion = (e.key for e in Form(DetectRequest).entries() if e.field == "fusion" and e.of.name in request.fusion)
    if not request.fuse and (key := next(of_fusion, None)) is not None:
        raise UsageError(f"{option(key)} is an option of the fusion; add {option('fuse')}")
    opened = open_recording(request.recording)
    scene = load_scene(request.scene, opened.scene, request.recording)
    left = SkippedFrames()
    detections, used = _detections(request, opened, scene, left, job)
    if not upright(scene):
        job.note(
            "warning: the world of the scene seems not to be upright, so that bearings are unreliable; turn it "
            "upright with `occlog ingest --up auto`"
        )
    fused: FuseTally | None = None
    if request.fuse:
        heights = {name: request.settings[name] for name in ("person_height",) if name in request.settings}
        config = configure(FuseConfig.in_unit(scene.length_unit), {**heights, **request.fusion})
        fused = FuseTally(scene, config)
        detections = _fused(detections, scene, config, fused)
        used |= {"fusion": asdict(config)}
    earlier = () if request.track_feedback is None else open_input(request.track_feedback).losses
    lost = dict.fromkeys((*opened.losses, *earlier))
    whole = {"cameras": list(request.cameras), **used}
    losses, tally = write_detections(job, detections, whole, lost, left, scene, fused=fused)
    if tally["regions"] and not any(c.placed for c in scene.cameras):
        job.note(
            "warning: no camera has a pose in space, so that there are no bearings; ingest with a calibration, or "
            f"give a scene ({option('scene')})"
        )
    summary: dict[str, object] = {"bearings": str(request.output), **_figures(tally)}
    if fused is not None:
        fused.warn(job.quiet)
        summary |= {"fusion": fused.summary()}
    return summary, losses


def write_detections(
    job: Job,
    parts: Iterable[Detections],
    parameters: Mapping[str, object],
    lost: Iterable[Loss],
    left: SkippedFrames,
    scene: Scene,
    inputs: Sequence[Path] | None = None,
    fused: FuseTally | None = None,
) -> tuple[list[Loss], Counter[str]]:
    """Write the tables that were asked for.

    Args:
        job: of a request with outputs that are tables of bearings and of views.
        parts: in the order of time.
        parameters: of the provenance, to which `left` adds.
        lost: input that was lost before.
        left: has seen the frames.
        scene: of the cameras.
        inputs: files that are read; None: those of the request.
        fused: counts the rows of the fusion; None: nothing is fused.

    Returns:
        All losses, and counts of frames, regions, rows and rows that are seen.
    """
    provenance = job.provenance(parameters, inputs=inputs)
    losses, tally, checked = list(lost), Counter[str](), Checked(scene)
    fields = {job.request.table_of(name): name for name in job.request.files(output=True)}
    with job.tables(provenance, scene.length_unit) as tables:
        for part in parts:
            found: dict[str, ColumnTable] = {Bearings.NAME: part.bearings, Views.NAME: part.views}
            tables.write(**{field: found[table] for table, field in fields.items()})
            checked.add(part.views)
            losses += part.losses
            left.lost(part.losses)
            tally.update(
                frames=part.frames,
                warmup_frames=part.warmup,
                regions=len(part.views),
                rows=len(part.bearings),
                seen=int(part.bearings.seen.sum()),
            )
        final = {**parameters, **left.parameters()}
        made = replace(provenance, losses=tuple(losses), parameters=final)
        of_fusion = () if fused is None else fused.checks()
        tables.annotate(job.judged(made, (*checked.checks(left.frames), *of_fusion)))
    return losses, tally


def _figures(tally: Counter[str]) -> dict[str, int]:
    """Figures of the summary; frames that only taught the background are reported if there are any."""
    names = ("frames", "warmup_frames", "regions", "rows", "seen")
    return {name: tally[name] for name in names if tally[name] or name != "warmup_frames"}


def _fused(
    detections: Iterator[Detections], scene: Scene, config: FuseConfig, tally: FuseTally
) -> Iterator[Detections]:
    """The parts after the fusion, counted."""
    for part in fuse(detections, scene, config):
        tally.add(part)
        yield part.detections


def _detections(
    request: DetectRequest, recording: McapRecording, scene: Scene, left: SkippedFrames, job: Job
) -> tuple[Iterator[Detections], dict[str, object]]:
    """The parts in the order of time, and the parameters on which they depend.

    Images come first; a recording without images gives its boxes, and one without boxes its bearings.
    """
    config = configure(DetectConfig(), {"method": request.method, **request.settings})
    if config.label_scope is not None and (recording.cameras or not recording.has(Boxes)):
        raise UsageError(
            f"{recording.path}: {option('label_scope')} makes targets of the identities of "
            f"boxes, and nothing is detected in boxes of "
            "this recording; leave it out"
        )
    if recording.cameras:
        return _from_images(request, recording, scene, config, left, job)
    if recording.has(Boxes):
        if request.track_feedback is not None:
            raise UsageError(
                f"{recording.path}: {option('track_feedback')} limits detection in images, or labelled "
                f"bearings; boxes are candidates of "
                "any person, to which `occlog label` gives the identity of tracks"
            )
        only = _sensors_of(request, [c.name for c in scene.cameras])
        chunks = job.progress(_rows_of(recording.tables(Boxes), only), "detect")
        used: dict[str, object] = {"input": "boxes", "min_confidence": config.min_confidence}
        if config.sigma_px is not None or config.sigma_scale != 1.0:
            used |= {"sigma_px": config.sigma_px, "sigma_scale": config.sigma_scale}
        labels = None
        if config.label_scope is not None:
            labels = scan_labels(_rows_of(recording.tables(Boxes), only), config.label_scope, config)
            used |= {"label_scope": config.label_scope}
        return detect_boxes(left.watch_boxes(chunks), scene, config, labels), used
    if recording.has(Bearings):
        near, used = _near(request, config, scene.length_unit)
        positions = {c.name: c.ground for c in scene.cameras if c.placed}
        only = _sensors_of(request, [s.name for s in scene.sensors])
        return _simulated_bearings(_rows_of(recording.tables(Bearings), only), near, positions), {
            "input": "bearings",
            **used,
        }
    hint = "" if recording.ours else f"; {FOREIGN_BAG}"
    raise InputError(
        f"{recording.path}: holds neither images, nor boxes, nor bearings; there is nothing to detect in{hint}"
    )


def _sensors_of(request: DetectRequest, known: list[str]) -> tuple[str, ...]:
    """Names of the sensors with rows that are taken, empty: all; UsageError for one that the scene has not."""
    for name in request.cameras:
        if name not in known:
            raise UsageError(f"{request.recording}: no camera {name!r}; there are {', '.join(known) or 'none'}")
    return request.cameras


def _rows_of(chunks: Iterator[T], only: tuple[str, ...]) -> Iterator[T]:
    """Rows of some sensors; empty: of all."""
    for chunk in chunks:
        kept = chunk.take(np.isin(chunk.sensor, only)) if only else chunk
        if len(kept):
            yield kept


def _near(
    request: DetectRequest, config: DetectConfig, length_unit: str
) -> tuple[TrackFeedback | None, dict[str, object]]:
    """Return the track feedback that limits the search, and its parameters.

    Raises:
        UsageError: there is a gate and no tracks.
        InputError: the tracks are in another unit than the scene, have no covariance, or are missing.
    """
    if request.track_feedback is None:
        if "feedback_gate" in request.settings:
            raise UsageError(f"{option('feedback_gate')} goes with {option('track_feedback')}; add it")
        return None, {}
    opened = open_input(request.track_feedback, Tracks)
    check_unit(opened, length_unit, error=InputError)
    tracks = opened.read(Tracks).with_covariance()
    if not len(tracks):
        raise InputError(f"{request.track_feedback}: has no tracks; leave {option('track_feedback')} out")
    return track_feedback(tracks, config.feedback_gate), {"feedback_gate": config.feedback_gate}


def _simulated_bearings(
    chunks: Iterator[Bearings], near: TrackFeedback | None, positions: dict[str, Floats]
) -> Iterator[Detections]:
    """Simulated bearings as they are, or near where targets are thought to be."""
    for chunk in chunks:
        kept = chunk if near is None else limited(chunk, near, positions)
        yield Detections(Views.empty(), kept, (), len(chunk), 0)


def _from_images(
    request: DetectRequest, recording: McapRecording, scene: Scene, config: DetectConfig, left: SkippedFrames, job: Job
) -> tuple[Iterator[Detections], dict[str, object]]:
    """Learn from a first pass where that is asked for, then detect in a second."""
    sensors = cameras_of(request.cameras, recording)
    boxes = [_box(text) for text in request.target_boxes]
    targets = _references(request, recording)
    learned, total = Learned(), frames_of(recording, sensors)
    near, limits = _near(request, config, scene.length_unit)
    if request.learn_background or boxes:
        first = job.progress(recording.frames(sensors), "first pass", total)
        found, boxed = learn(first, scene, config, boxes, request.threads)
        targets = boxed or targets
        learned = found if request.learn_background else learned
    used = parameters(config) | {
        "input": "images",
        "learn_background": request.learn_background,
        "boxes": list(request.target_boxes),
        "targets": [t.target_id for t in targets],
        **limits,
    }
    frames = job.progress(recording.frames(sensors), "detect", total)
    return detect(left.watch(frames), scene, config, request.threads, learned, targets, near=near), used


def images_of(request: Detection, detector: str) -> tuple[McapRecording, Scene, tuple[str, ...]]:
    """The recording of a request, its scene, and the cameras to detect in.

    Raises:
        InputError: the recording holds no images.
        UsageError: there are no images of a camera, or bearings are requested and no camera has a pose.
    """
    opened = open_recording(request.recording)
    scene = load_scene(request.scene, opened.scene, request.recording)
    if not opened.cameras:
        raise InputError(f"{request.recording}: holds no images; {detector} detects in images")
    sensors = cameras_of(request.cameras, opened)
    if "bearings" in request.files(output=True) and not any(scene.camera(name).placed for name in sensors):
        raise UsageError(
            f"{request.recording}: no camera has a pose, so that there are no bearings; leave {option('bearings')} out"
        )
    return opened, scene, sensors


def cameras_of(only: tuple[str, ...], recording: McapRecording) -> tuple[str, ...]:
    """Names of the cameras to detect in; UsageError for one of which there are no images."""
    for name in only:
        if name not in recording.cameras:
            known = ", ".join(recording.cameras)
            raise UsageError(f"{recording.path}: no images of camera {name!r}; there are images of {known}")
    return only or recording.cameras


def frames_of(recording: McapRecording, sensors: tuple[str, ...]) -> int:
    """Number of frames of some cameras."""
    wanted = {f"/camera/{name}/{kind}" for name in sensors for kind in ("image", "video")}
    return sum(t.messages for t in recording.topics if t.name in wanted)


def _references(request: DetectRequest, recording: McapRecording) -> tuple[Target, ...]:
    """Appearances of the targets, from a file or attached to the recording; none where there is neither."""
    if request.target is not None:
        where = str(request.target)
        raw: bytes | None = check_input(request.target, "appearances of targets (JSON)").read_bytes()
    else:
        where, raw = f"{recording.path}: appearance.json", recording.attachment("appearance.json")
    if raw is None:
        return ()
    try:
        found: dict[int, list[list[float]]] = {}
        for entry in parse_json(raw, where, "appearances of targets"):
            found.setdefault(int(entry["target_id"]), []).append(entry["appearance"])
        return tuple(Target(i, np.array(rows, dtype=np.float64)) for i, rows in sorted(found.items()))
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{where}: expected [{{'target_id': 0, 'appearance': [72 numbers]}}, ...] ({error})"
        ) from error


def _box(text: str) -> TargetBox:
    """A target's box from `[ID:]CAM:FRAME:X,Y,W,H`; the target is 0 if it is not named."""
    try:
        *head, frame, location = text.split(":")
        target, sensor = (int(head[0]), head[1]) if len(head) == 2 else (0, head[0])
        left, top, width, height = (float(v) for v in location.split(","))
        return TargetBox(
            target_id=target,
            sensor=sensor,
            frame=int(frame),
            left_px=left,
            top_px=top,
            width_px=width,
            height_px=height,
        )
    except (ValueError, IndexError):
        raise UsageError(f"{option('target_box')} {text}: expected CAM:FRAME:X,Y,W,H or ID:CAM:FRAME:X,Y,W,H") from None


def run_network(request: NetworkRequest, job: Job) -> tuple[dict[str, object], list[Loss]]:
    """Detect and write; the summary, and the input that was lost."""
    opened, scene, sensors = images_of(request, "a network")
    config, of_networks = configure(DetectConfig(), request.settings), configure(NetworkConfig(), request.network)
    if request.embed is None and {"embed_pixel_scaling", "embed_size"} & set(request.network):
        raise UsageError(
            f"{option('embed_pixel_scaling')} and {option('embed_size')} go with {option('embed')}; add it"
        )
    with opencv_threads(request.threads):
        detector = open_detector(
            request.onnx, of_networks, request.classes, request.names, config.min_confidence, request.threads
        )
        embedder = open_embedder(request.embed, of_networks, request.threads) if request.embed is not None else None
        _note_assumed(detector, job)
        models = [detector.network.file.files, embedder.network.file.files if embedder is not None else ()]
        side_files = [path for path in (request.scene, request.names) if path is not None]
        parameters = {
            "cameras": list(request.cameras),
            "input": "images",
            **detector.parameters(),
            **(embedder.parameters() if embedder is not None else {}),
            **of_boxes(config),
        }
        files = [request.recording, *(path for each in models for path in each), *side_files]
        left = SkippedFrames()
        frames = left.watch(job.progress(opened.frames(sensors), "detect", frames_of(opened, sensors)))
        parts = detect_by_network(frames, scene, detector, embedder, config)
        losses, tally = write_detections(job, parts, parameters, opened.losses, left, scene, files)
    names = [detector.names.names.get(k, str(k)) for k in detector.wanted.tolist()]
    details = {"head": detector.reading.head, "runtime": detector.parameters()["runtime"], "classes": names}
    return figures(request, tally, **details), losses


def of_boxes(config: DetectConfig) -> dict[str, object]:
    """Settings of detection that external boxes use, unless they are the defaults, for the provenance."""
    known = {name: getattr(config, name) for name in ("bit_depth", "sigma_px") if getattr(config, name) is not None}
    return known | ({"sigma_scale": config.sigma_scale} if config.sigma_scale != 1.0 else {})


def figures(request: NetworkRequest | PluginRequest, tally: Counter[str], **more: object) -> dict[str, object]:
    """The summary: tables that were written, figures of the detector, and counts of frames, boxes and rows."""
    bearings = {} if request.bearings is None else {"bearings": str(request.bearings)}
    counts = {"frames": tally["frames"], "boxes": tally["regions"]} | ({"rows": tally["rows"]} if bearings else {})
    return {"views": str(request.output), **bearings, **more, **counts}


def _note_assumed(detector: NetworkDetector, job: Job) -> None:
    """Report that names of classes are not the network's own."""
    if detector.names.source.endswith("assumed"):
        shown = ", ".join(f"{k} is {detector.names.names.get(k, 'unknown')}" for k in detector.wanted.tolist())
        job.note(
            f"{detector.network.file.path}: does not state what its classes are called; those of COCO are assumed: "
            f"{shown} ({option('names')} states otherwise)"
        )


def run_plugin(request: PluginRequest, job: Job) -> tuple[dict[str, object], list[Loss]]:
    """Detect and write; the summary, and the input that was lost."""
    plugin = find(request.method, DETECTOR)
    assert plugin is not None  # its settings are those of the request
    chosen = Chosen(plugin, request.own)
    opened, scene, sensors = images_of(request, "a detector")
    config = configure(DetectConfig(), request.settings)
    parameters = {
        "cameras": list(request.cameras),
        "input": "images",
        "detector": chosen.provenance(scene.length_unit),
        **of_boxes(config),
        "min_confidence": config.min_confidence,
    }
    left = SkippedFrames()
    frames = left.watch(job.progress(opened.frames(sensors), "detect", frames_of(opened, sensors)))
    parts = detect_by_plugin(frames, scene, chosen, config)
    losses, tally = write_detections(job, parts, parameters, opened.losses, left, scene)
    return figures(request, tally, method=plugin.name, plugin=plugin.origin), losses
