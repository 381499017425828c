"""`occlog detect`: open a recording, detect people in its content, fuse, and write views and bearings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError, UsageError, abridged, option
from occlog.io.files.limits import ROS_BAG, check_input
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
from occlog.measure.networks.shipped import MIN_CONFIDENCE, shipped_config, shipped_network
from occlog.plugins.loading import DETECTOR as DETECTOR_PLUGIN
from occlog.plugins.loading import Chosen, find
from occlog.records.columns import ColumnTable
from occlog.records.losses import Loss
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Boxes, Tracks, Views
from occlog.records.verdicts import Check, finding
from occlog.request import Form
from occlog.runner import Job
from occlog.scans.clocks import stated_clocks
from occlog.settings import configure

from .by_background.learning import TargetBox, learn_from, sample_frames
from .by_background.one_camera import Target, joined
from .by_background.stage import Learned, detect
from .by_network import detect_by_network
from .by_person_network import PersonDetector, Work, check_of, described, of_boxes
from .by_plugin import detect_by_plugin
from .checks import DETECTOR, Checked, with_figures
from .choice import DetectionProbe, probe
from .config import AUTO, BACKGROUND, NETWORK, OF_BACKGROUND, DetectConfig, parameters
from .from_boxes import detect_boxes, scan_labels
from .request import Detection, DetectRequest, NetworkRequest, PluginRequest
from .skipped_frames import SkippedFrames
from .track_feedback import TrackFeedback, limited, track_feedback

T = TypeVar("T", Boxes, Bearings)


def run_detect(request: DetectRequest, job: Job) -> tuple[dict[str, object], list[Loss]]:
    """Detect in a recording and write the tables; return the summary and all losses.

    UsageError for settings of the fusion without fusion.
    """
    of_fusion = (e.key for e in Form(DetectRequest).entries() if e.field == "fusion" and e.of.name in request.fusion)
    if not request.fuse and (key := next(of_fusion, None)) is not None:
        raise UsageError(f"{option(key)} is an option of the fusion; add {option('fuse')}", id="missing-option")
    opened = open_recording(request.recording)
    scene = load_scene(request.scene, opened.scene, request.recording)
    left = SkippedFrames()
    work = _detections(request, opened, scene, left, job)
    detections = work.parts
    fused: FuseTally | None = None
    if request.fuse:
        heights = {name: request.settings[name] for name in ("person_height",) if name in request.settings}
        config = configure(FuseConfig.in_unit(scene.length_unit), {**heights, **request.fusion})
        fused = FuseTally(scene, config)
        detections = _fused(detections, scene, config, fused)
        work.parameters |= {"fusion": asdict(config)}
    earlier = () if request.track_feedback is None else open_input(request.track_feedback).losses
    lost = dict.fromkeys((*opened.losses, *earlier))
    applied = {} if opened.scene is None else stated_clocks(opened.scene)
    whole = {"cameras": list(request.cameras), **work.parameters, **applied}
    files = list(dict.fromkeys((*request.inputs, *work.files)))
    losses, tally = write_detections(job, detections, whole, lost, left, scene, files, fused, work.checks)
    summary: dict[str, object] = {"bearings": str(request.output), **work.summary, **_figures(tally)}
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
    checks: Sequence[Check] = (),
) -> tuple[list[Loss], Counter[str]]:
    """Write the requested tables of bearings and views.

    Args:
        job: job of a request with outputs that are tables of bearings or views.
        parts: detections in the order of time.
        parameters: parameters for the provenance; skipped frames are added.
        lost: losses of the inputs.
        left: counter that the frames have passed; losses of frames are added.
        scene: scene with the cameras.
        inputs: files that are read; None: those of the request.
        fused: counts of the fusion, for its checks; None: nothing is fused.
        checks: checks of the choice of the detector; numbers of frames and detections are added to that of `DETECTOR`.

    Returns:
        All losses, and counts: frames, warmup_frames, regions, rows of bearings, and seen (rows with a detection).
    """
    provenance = job.provenance(parameters, inputs=inputs)
    losses, tally, checked = list(lost), Counter[str](), Checked(scene)
    fields = {job.request.file_field(name).table: name for name in job.request.files(output=True)}
    with job.tables(provenance, scene.length_unit) as tables:
        for part in parts:
            found: dict[str, ColumnTable] = {Bearings.NAME: part.bearings, Views.NAME: part.views}
            tables.write(**{field: found[table] for table, field in fields.items()})
            checked.add(part.views)
            checked.add_bearings(part.bearings)
            losses += part.losses
            left.lost(part.losses)
            tally.update(
                frames=part.frames,
                warmup_frames=part.warmup,
                regions=len(part.views),
                rows=len(part.bearings),
                seen=int(part.bearings.seen.sum()),
            )
        losses = joined(losses)
        final = {**parameters, **left.parameters()}
        made = replace(provenance, losses=tuple(losses), parameters=final)
        of_fusion = () if fused is None else fused.checks()
        of_detector = (with_figures(check, tally["frames"], tally["regions"]) for check in checks)
        tables.annotate(job.judged(made, (*of_detector, *checked.checks(left.frames), *of_fusion)))
    return losses, tally


def _figures(tally: Counter[str]) -> dict[str, int]:
    """Return the figures of the summary by name; `warmup_frames` only if there are any.

    `tally` has the counts of `write_detections`.
    """
    names = ("frames", "warmup_frames", "regions", "rows", "seen")
    return {name: tally[name] for name in names if tally[name] or name != "warmup_frames"}


def _fused(
    detections: Iterator[Detections], scene: Scene, config: FuseConfig, tally: FuseTally
) -> Iterator[Detections]:
    """Fuse the detections of several cameras part by part, generate them, and count their rows in `tally`."""
    for part in fuse(detections, scene, config):
        tally.add(part)
        yield part.detections


def _detections(request: DetectRequest, recording: McapRecording, scene: Scene, left: SkippedFrames, job: Job) -> Work:
    """Set up the detection in a recording, lazily.

    Images have priority; without images its boxes are used, and without boxes its bearings. `left` records the
    numbers of the frames read. InputError if the recording holds none of these; UsageError for options that do not
    apply to its content.
    """
    config = configure(DetectConfig(), {"method": request.method, **request.settings})
    if config.label_scope is not None and (recording.cameras or not recording.has(Boxes)):
        raise UsageError(
            f"{recording.path}: {option('label_scope')} makes targets of the identities of boxes, "
            f"but this recording's {'images' if recording.cameras else 'bearings'} are used; leave it out",
            id="wrong-content",
        )
    if recording.cameras:
        return _from_images(request, recording, scene, config, left, job)
    if request.method == NETWORK:
        raise InputError(
            f"{recording.path}: holds no images, which a network needs; give a recording with video", id="wrong-content"
        )
    if recording.has(Boxes):
        if request.track_feedback is not None:
            raise UsageError(
                f"{recording.path}: {option('track_feedback')} is for images or labelled bearings, not for boxes; "
                "leave it out, and give the boxes the tracks' identities by `occlog label`",
                id="not-applicable",
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
        return Work(detect_boxes(left.watch_boxes(chunks), scene, config, labels), used)
    if recording.has(Bearings):
        near, used = _near(request, config, scene.length_unit)
        positions = {c.name: c.ground for c in scene.cameras if c.placed}
        only = _sensors_of(request, [s.name for s in scene.sensors])
        rows = _rows_of(recording.tables(Bearings), only)
        return Work(_simulated_bearings(rows, near, positions), {"input": "bearings", **used})
    hint = "" if recording.ours else f"; {ROS_BAG}"
    raise InputError(
        f"{recording.path}: nothing to detect in: it holds neither images, nor boxes, nor bearings{hint}",
        id="wrong-content",
    )


def _sensors_of(request: DetectRequest, known: list[str]) -> tuple[str, ...]:
    """Names of the requested cameras; empty: all. UsageError for one that is not among `known`."""
    for name in request.cameras:
        if name not in known:
            raise UsageError(
                f"{request.recording}: no camera {name!r}; there are {abridged(known)}", id="unknown-sensor"
            )
    return request.cameras


def _rows_of(chunks: Iterator[T], only: tuple[str, ...]) -> Iterator[T]:
    """Generate the rows of the sensors `only` (empty: all), without empty chunks."""
    for chunk in chunks:
        kept = chunk.take(np.isin(chunk.sensor, only)) if only else chunk
        if len(kept):
            yield kept


def _near(
    request: DetectRequest, config: DetectConfig, length_unit: str
) -> tuple[TrackFeedback | None, dict[str, object]]:
    """Track feedback that limits the search, and its parameters for the provenance; (None, {}) if not requested.

    Raises:
        UsageError: a gate is given without tracks.
        InputError: the tracks are in another unit than `length_unit`, have no covariance, or are missing.
    """
    if request.track_feedback is None:
        if "feedback_gate" in request.settings:
            raise UsageError(
                f"{option('feedback_gate')} goes with {option('track_feedback')}; add it", id="missing-option"
            )
        return None, {}
    opened = open_input(request.track_feedback, Tracks)
    check_unit(opened, length_unit, error=InputError)
    tracks = opened.read(Tracks).with_covariance()
    if not len(tracks):
        raise InputError(
            f"{request.track_feedback}: has no tracks; leave {option('track_feedback')} out", id="not-applicable"
        )
    return track_feedback(tracks, config.feedback_gate), {"feedback_gate": config.feedback_gate}


def _simulated_bearings(
    chunks: Iterator[Bearings], near: TrackFeedback | None, positions: dict[str, Floats]
) -> Iterator[Detections]:
    """Generate simulated bearings as parts; with track feedback (`near`), those outside a gate become missed.

    `positions` has the ground position (2,) of each camera with a pose, by name.
    """
    for chunk in chunks:
        kept = chunk if near is None else limited(chunk, near, positions)
        yield Detections(Views.empty(), kept, (), len(chunk), 0)


def _from_images(
    request: DetectRequest, recording: McapRecording, scene: Scene, config: DetectConfig, left: SkippedFrames, job: Job
) -> Work:
    """Choose a detector for each camera, learn in a first pass if required, and set up the detection, lazily.

    `left` records the numbers of the frames read. UsageError if a re-identification network is given, and background
    subtraction is used.
    """
    sensors = cameras_of(request.cameras, recording)
    boxes = [_box(text) for text in request.target_boxes]
    targets = _references(request, recording)
    reason = _background_because(request, recording, targets) if config.method == AUTO else ""
    if reason:
        config = replace(config, method=BACKGROUND)
    if config.method in (AUTO, NETWORK):
        detector = _person_detector(request, config)
    elif request.embed is not None:
        why = reason or f"{option('method')} is {config.method}"
        raise UsageError(
            f"{option('embed')} is for boxes of a network, and background subtraction is used ({why}); leave it out",
            id="not-applicable",
        )
    else:
        detector = None
    total = frames_of(recording, sensors)
    near, limits = _near(request, config, scene.length_unit)
    learned, by_network = Learned(), list(sensors) if detector is not None else []
    checks: tuple[Check, ...] = ()
    if config.method != NETWORK and (request.learn_background or boxes):
        first = job.progress(recording.frames(sensors), "first pass", total)
        samples = sample_frames(first, scene, config, boxes)
        found, boxed = learn_from(samples, scene, config, boxes, request.threads)
        targets = boxed or targets
        learned = found if request.learn_background else learned
        if detector is not None:
            by_network, checks = _chosen(sensors, probe(samples, found, scene, config, detector.network))
    frames = left.watch(job.progress(recording.frames(sensors), "detect", total))
    if detector is not None and len(by_network) == len(sensors):
        return detector.work(frames, scene, checks)
    config = replace(config, method=BACKGROUND) if config.method == AUTO else config
    used = parameters(config) | {
        "input": "images",
        "learn_background": request.learn_background,
        "boxes": list(request.target_boxes),
        "targets": [t.target_id for t in targets],
        **limits,
    }
    summary: dict[str, object] = {"method": config.method, **({"reason": reason} if reason else {})}
    if detector is None or not by_network:
        parts = detect(frames, scene, config, request.threads, learned, targets, near=near)
        return Work(parts, used, summary=summary, checks=checks)
    return detector.work_with(
        frames, scene, checks, by_network, partial(detect, scene=scene, config=config, workers=request.threads,
                                                   learned=learned, targets=targets, near=near, states={}), used
    )  # fmt: skip


def _background_because(request: DetectRequest, recording: McapRecording, targets: Sequence[Target]) -> str:
    """Reason to use background subtraction without trying the network; empty text if there is none.

    `targets` are those with a given appearance.
    """
    if recording.provenance.command == "simulate":
        return "the recording is simulated"
    if targets or request.target_boxes or request.track_feedback is not None:
        return "targets are given"
    if not request.learn_background or any(name in OF_BACKGROUND for name in request.settings):
        return "an option of it is given"
    return ""


def _chosen(sensors: Sequence[str], probes: Mapping[str, DetectionProbe]) -> tuple[list[str], tuple[Check, ...]]:
    """Names of the cameras in which the network detects, and findings about those with background subtraction.

    `probes` has the result of the comparison by camera; cameras without one are the network's.
    """
    others = {name: probes[name] for name in sensors if name in probes and probes[name].background}
    checks = tuple(
        finding(DETECTOR, "background-used", sensors=[name], found=each.found, frames=each.frames, moving=each.moving)
        for name, each in others.items()
    )
    return [name for name in sensors if name not in others], checks


def _person_detector(request: DetectRequest, config: DetectConfig) -> PersonDetector:
    """Load occlog's person network, and the re-identification network if given.

    Its minimum confidence is `MIN_CONFIDENCE` unless the request states one.
    """
    _check_embed(request)
    if "min_confidence" not in request.settings:
        config = replace(config, min_confidence=MIN_CONFIDENCE)
    settings = shipped_config(request.network)
    network = open_detector(shipped_network(), settings, (), None, config.min_confidence, request.threads)
    embedder = open_embedder(request.embed, settings, request.threads) if request.embed is not None else None
    return PersonDetector(network, embedder, config, request.threads)


def _check_embed(request: DetectRequest | NetworkRequest) -> None:
    """UsageError for settings of a re-identification network without one."""
    if request.embed is None and {"embed_pixel_scaling", "embed_size"} & set(request.network):
        raise UsageError(
            f"{option('embed_pixel_scaling')} and {option('embed_size')} go with {option('embed')}; add it",
            id="missing-option",
        )


def images_of(request: Detection, detector: str) -> tuple[McapRecording, Scene, tuple[str, ...]]:
    """Open the recording of a request, with its scene and the names of the cameras to detect in.

    `detector` names what detects, in messages.

    Raises:
        InputError: the recording holds no images, or those of a camera that is not in the scene.
        UsageError: there are no images of a camera, or bearings are requested and no camera has a pose.
    """
    opened = open_recording(request.recording)
    scene = load_scene(request.scene, opened.scene, request.recording)
    if not opened.cameras:
        raise InputError(
            f"{request.recording}: holds no images, which {detector} needs; give a recording with video",
            id="wrong-content",
        )
    sensors = cameras_of(request.cameras, opened)
    known = [camera.name for camera in scene.cameras]
    if unknown := [name for name in sensors if name not in known]:
        raise InputError(
            f"{request.recording}: images of camera {unknown[0]!r}, which is not in the scene "
            f"({abridged(known)}); give the scene with it ({option('scene')})",
            id="unknown-sensor",
        )
    if "bearings" in request.files(output=True) and not any(scene.camera(name).placed for name in sensors):
        raise UsageError(
            f"{request.recording}: no camera has a pose, so that there are no bearings; leave {option('bearings')} out",
            id="missing-pose",
        )
    return opened, scene, sensors


def cameras_of(only: tuple[str, ...], recording: McapRecording) -> tuple[str, ...]:
    """Names of the cameras to detect in, `only` or else all with images; UsageError for one without images."""
    for name in only:
        if name not in recording.cameras:
            known = ", ".join(recording.cameras)
            raise UsageError(
                f"{recording.path}: no images of camera {name!r}; there are images of {known}", id="unknown-sensor"
            )
    return only or recording.cameras


def frames_of(recording: McapRecording, sensors: tuple[str, ...]) -> int:
    """Number of frames that a recording has of the cameras `sensors`."""
    wanted = {f"/camera/{name}/{kind}" for name in sensors for kind in ("image", "video")}
    return sum(t.messages for t in recording.topics if t.name in wanted)


def _references(request: DetectRequest, recording: McapRecording) -> tuple[Target, ...]:
    """Targets with their appearances, from a file of the request or attached to the recording; empty without either.

    InputError if they are not histograms of 72 bins with a target each.
    """
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
    """Parse a target's box `[ID:]CAM:FRAME:X,Y,W,H`; the target is 0 if not given."""
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
    """Detect with a network of the user and write the tables; return the summary and all losses."""
    opened, scene, sensors = images_of(request, "a network")
    config, of_networks = configure(DetectConfig(), request.settings), configure(NetworkConfig(), request.network)
    _check_embed(request)
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
        stated = (check_of(detector),)
        losses, tally = write_detections(job, parts, parameters, opened.losses, left, scene, files, checks=stated)
    names = [detector.names.names.get(k, str(k)) for k in detector.wanted.tolist()]
    details = {"head": detector.reading.head, "runtime": detector.parameters()["runtime"], "classes": names}
    details = {**described(detector), **details}
    return figures(request, tally, **details), losses


def figures(request: NetworkRequest | PluginRequest, tally: Counter[str], **more: object) -> dict[str, object]:
    """Return the figures of the summary: paths of the written tables, `more`, and numbers of frames, boxes and rows.

    Args:
        request: request with the paths of the tables.
        tally: counts of `write_detections`.
        **more: figures that are put between the paths and the numbers.
    """
    bearings = {} if request.bearings is None else {"bearings": str(request.bearings)}
    counts = {"frames": tally["frames"], "boxes": tally["regions"]} | ({"rows": tally["rows"]} if bearings else {})
    return {"views": str(request.output), **bearings, **more, **counts}


def _note_assumed(detector: NetworkDetector, job: Job) -> None:
    """Note that class names are assumed rather than read from the network, if they are."""
    if detector.names.source.endswith("assumed"):
        shown = ", ".join(f"{k} is {detector.names.names.get(k, 'unknown')}" for k in detector.wanted.tolist())
        job.note(
            f"{detector.network.file.path}: does not state what its classes are called; those of COCO are assumed: "
            f"{shown} ({option('names')} states otherwise)"
        )


def run_plugin(request: PluginRequest, job: Job) -> tuple[dict[str, object], list[Loss]]:
    """Detect with a detector plug-in and write the tables; return the summary and all losses."""
    plugin = find(request.method, DETECTOR_PLUGIN)
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
