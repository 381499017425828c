"""The `occlog detect` command."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from occlog.cli import options
from occlog.errors import InputError, UsageError
from occlog.measure.fuse import options as fuse_options
from occlog.measure.fuse.options import FuseTally

if TYPE_CHECKING:
    from occlog.io.files.provenance import Provenance
    from occlog.io.recording.reader import Recording
    from occlog.measure.detections import Detections
    from occlog.records.losses import Loss
    from occlog.records.scene import Scene
    from occlog.records.tables import Bearings

    from .config import DetectConfig, Target
    from .learning import TargetBox

POSITIVE = click.FloatRange(min=0, min_open=True)
SHARE = click.FloatRange(min=0, max=1)

# Every option of this list is a field of DetectConfig, where its default stands.
SETTINGS = (
    click.option(
        "--method",
        type=click.Choice(["em", "components"]),
        default=None,
        help="Foreground to regions: mixture of person-shaped Gaussians, or connected blobs. [default: em]",
    ),
    click.option(
        "--background", type=click.Choice(["mog2", "knn"]), default=None, help="Background model. [default: mog2]"
    ),
    click.option(
        "--history",
        type=click.IntRange(min=1),
        default=None,
        metavar="FRAMES",
        help="Frames that the background model remembers. [default: 500]",
    ),
    click.option("--threshold", type=POSITIVE, default=None, help="Of foreground. [default: the model's own]"),
    click.option("--shadows/--no-shadows", default=None, help="Tell shadows from foreground. [default: shadows]"),
    click.option(
        "--warmup",
        type=click.IntRange(min=0),
        default=None,
        metavar="FRAMES",
        help="With --no-learn: frames that only teach the background. [default: 50]",
    ),
    click.option(
        "--person-height", type=POSITIVE, default=None, metavar="LENGTH", help="Of a person. [default: 1.7 m]"
    ),
    click.option(
        "--person-height-px",
        type=POSITIVE,
        default=None,
        metavar="PX",
        help="The same everywhere in every image, instead of what the cameras' poses say.",
    ),
    click.option("--likeness", type=SHARE, default=None, help="Least likeness to the target. [default: 0.65]"),
    click.option("--min-confidence", type=SHARE, default=None, help="Of a detector's box. [default: 0.3]"),
    click.option(
        "--shrink",
        type=click.IntRange(1, 16),
        default=None,
        metavar="FACTOR",
        help="Shrink images first. [default: as far as people stay 100 px wide]",
    ),
    click.option("--bits", type=click.IntRange(8, 16), default=None, help="Significant bits of 16-bit images."),
)
NAMES = (
    "method",
    "background",
    "history",
    "threshold",
    "shadows",
    "warmup",
    "person_height",
    "person_height_px",
    "likeness",
    "min_confidence",
    "shrink",
    "bits",
)


def settings(command: Any) -> Any:
    """All options of `SETTINGS`."""
    for option in reversed(SETTINGS):
        command = option(command)
    return command


@click.command(name="detect", short_help="Reduce the frames of a recording to bearings.")
@click.argument("recording", type=options.PATH)
@options.output_opt("Bearings of the targets (Parquet).")
@click.option("--views", type=options.PATH, default=None, help="Every people-sized region of every frame (Parquet).")
@options.scene_opt
@click.option("--cameras", "only", default="", metavar="A,B,...", help="Only these cameras.")
@click.option(
    "--target",
    "references",
    type=options.PATH,
    default=None,
    metavar="JSON",
    help="Appearances of the targets, as `occlog simulate --render` attaches them. [default: the attached]",
)
@click.option(
    "--target-box",
    "boxes",
    multiple=True,
    metavar="[ID:]CAM:FRAME:X,Y,W,H",
    help="A box [px] around a target in one frame, from which its appearance is learnt; may be repeated.",
)
@click.option(
    "--learn/--no-learn",
    default=True,
    show_default=True,
    help="Look through the recording first, for what it shows when nobody is there.",
)
@settings
@fuse_options.of_detect
@options.workers_opt
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(
    recording: Path,
    output: Path,
    views: Path | None,
    scene: Path | None,
    only: str,
    references: Path | None,
    boxes: tuple[str, ...],
    learn: bool,
    fuse: bool,
    workers: int | None,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    **values: Any,
) -> int:
    """Reduce the frames of RECORDING to bearings of its targets.

    Each camera's foreground is split into people-sized regions, and the target told from the others by
    its appearance; without one, it is the largest region. A frame without the target gives a row
    "looked, not seen". A recording with detector boxes instead of video gives one candidate bearing a box
    (target_id -1); one with simulated bearings gives these.

    \b
      occlog detect walk.mcap -o bearings.parquet --views views.parquet
      occlog detect walk.mcap -o bearings.parquet --views views.parquet --fuse
      occlog detect hall.mcap -o bearings.parquet --target-box cam1:120:310,95,40,110 --background knn
    """
    options.check_outputs([recording, scene, references], [output, views], overwrite)
    chosen = {name: values[name] for name in NAMES if values[name] is not None}
    names = tuple(part.strip() for part in only.split(",") if part.strip())
    fusion = _fusion(fuse, values)
    request = Request(recording, scene, names, references, boxes, learn, chosen, workers or os.cpu_count() or 1, fusion)
    summary, losses = run_detect(request, output, views, overwrite, quiet)
    return options.finish(summary, losses, as_json)


@dataclass(frozen=True)
class Request:
    """What to detect and how."""

    recording: Path
    scene: Path | None
    only: tuple[str, ...]
    references: Path | None
    boxes: tuple[str, ...]
    learn: bool
    settings: dict[str, Any]
    workers: int
    fusion: dict[str, Any] | None = None  # options of the fusion; None: none


def run_detect(
    request: Request, output: Path, views: Path | None, overwrite: bool, quiet: bool
) -> tuple[dict[str, Any], list[Loss]]:
    """Detect and write; the summary, and the input that was lost."""
    from occlog.io.files.parquet import TableWriter
    from occlog.io.files.provenance import hash_inputs
    from occlog.io.recording.reader import open_recording
    from occlog.records.tables import Bearings, Views

    opened = open_recording(request.recording)
    scene = options.load_scene(request.scene, opened.scene, request.recording)
    detections, parameters = _detections(request, opened, scene, quiet)
    fused = FuseTally()
    if request.fusion is not None:
        detections, parameters = _fused(detections, parameters, request, scene, fused)
    paths = [p for p in (request.recording, request.scene, request.references) if p is not None]
    provenance = _provenance(request, parameters, hash_inputs(paths))
    losses = list(opened.losses)
    tally = {"frames": 0, "warmup_frames": 0, "regions": 0, "bearings": 0, "seen": 0}
    with ExitStack() as stack:
        unit = scene.length_unit
        rows = stack.enter_context(TableWriter(output, Bearings, provenance, overwrite=overwrite, length_unit=unit))
        regions = None
        if views is not None:
            regions = stack.enter_context(TableWriter(views, Views, provenance, overwrite=overwrite, length_unit=unit))
        for part in detections:
            rows.write(part.bearings)
            if regions is not None:
                regions.write(part.views)
            losses += part.losses
            _count(tally, part)
        final = replace(provenance, losses=tuple(losses))
        for writer in (rows, regions):
            if writer is not None:
                writer.annotate(final)
    if request.fusion is None:
        return {"bearings": str(output), **_shown(tally)}, losses
    fused.warn(quiet)
    return {"bearings": str(output), **_shown(tally), "fusion": fused.summary()}, losses


def _fusion(wanted: bool, values: dict[str, Any]) -> dict[str, Any] | None:
    """Options of the fusion that were given; UsageError where there is to be none."""
    named = {"fuse_sigma": "sigma", "fuse_window": "window_s", "p_miss": "p_miss", "p_false": "p_false"}
    given = {name: values[option] for option, name in named.items() if values[option] is not None}
    if given and not wanted:
        option = next(o for o, name in named.items() if name in given)
        raise UsageError(f"--{option.replace('_', '-')} is an option of the fusion; add --fuse")
    if wanted and values["person_height"] is not None:
        given["person_height"] = values["person_height"]
    return given if wanted else None


def _fused(
    detections: Iterator[Detections], parameters: dict[str, Any], request: Request, scene: Scene, tally: FuseTally
) -> tuple[Iterator[Detections], dict[str, Any]]:
    """The parts after the fusion, counted, and the options with those of the fusion."""
    from occlog.measure.detections import Detections
    from occlog.measure.fuse.cameras import open_eyes
    from occlog.measure.fuse.config import FuseConfig, in_scene
    from occlog.measure.fuse.stage import fuse

    config = in_scene(FuseConfig(**(request.fusion or {})), scene)
    open_eyes(scene, config)  # refuses a scene in which nothing can be fused before any image is looked at

    def parts() -> Iterator[Detections]:
        for part in fuse(detections, scene, config):
            tally.add(part)
            yield Detections(*part[:5])

    return parts(), parameters | {"fusion": asdict(config)}


def _shown(tally: dict[str, int]) -> dict[str, Any]:
    return {("rows" if k == "bearings" else k): v for k, v in tally.items() if v or k != "warmup_frames"}


def _count(tally: dict[str, int], part: Detections) -> None:
    tally["frames"] += part.frames
    tally["warmup_frames"] += part.warmup
    tally["regions"] += len(part.views)
    tally["bearings"] += len(part.bearings)
    tally["seen"] += int(part.bearings.seen.sum())


def _provenance(request: Request, parameters: dict[str, Any], inputs: tuple[tuple[str, str], ...]) -> Provenance:
    from occlog.io.files.provenance import Provenance

    return Provenance("detect", {"cameras": list(request.only), **parameters}, None, inputs)


def _detections(
    request: Request, recording: Recording, scene: Scene, quiet: bool
) -> tuple[Iterator[Detections], dict[str, Any]]:
    """The parts in order, and the options that made them."""
    from occlog.records.tables import Bearings, Boxes

    from .config import DetectConfig
    from .from_boxes import detect_boxes

    config = DetectConfig(**request.settings)
    if recording.cameras:
        return _from_images(request, recording, scene, config, quiet)
    if recording.has(Boxes):
        chunks = options.progress(recording.tables(Boxes), "detect", quiet=quiet)
        return detect_boxes(chunks, scene, config), {"input": "boxes", "min_confidence": config.min_confidence}
    if recording.has(Bearings):
        return _pass_on(recording.tables(Bearings)), {"input": "bearings"}
    raise InputError(f"{recording.path}: holds neither images, nor boxes, nor bearings; there is nothing to detect in")


def _pass_on(chunks: Iterator[Bearings]) -> Iterator[Detections]:
    """Simulated measurements are the detections."""
    from occlog.measure.detections import Detections
    from occlog.records.tables import Views

    for chunk in chunks:
        yield Detections(Views.empty(), chunk, (), len(chunk), 0)


def _from_images(
    request: Request, recording: Recording, scene: Scene, config: DetectConfig, quiet: bool
) -> tuple[Iterator[Detections], dict[str, Any]]:
    from .learning import learn
    from .stage import Learned, detect

    sensors = _cameras(request, recording)
    boxes = [_box(text) for text in request.boxes]
    targets = _references(request, recording)
    learned = Learned()
    if request.learn or boxes:
        first = options.progress(recording.frames(sensors), "first look", _frames(recording, sensors), quiet=quiet)
        learned, boxed = learn(first, scene, config, boxes, request.workers)
        targets = boxed or targets
        learned = learned if request.learn else Learned()
    config = replace(config, targets=targets)
    parameters = {k: v for k, v in asdict(replace(config, targets=())).items() if k != "targets"}
    parameters |= {
        "input": "images",
        "learn": request.learn,
        "boxes": list(request.boxes),
        "targets": [t.target_id for t in targets],
    }
    frames = options.progress(recording.frames(sensors), "detect", _frames(recording, sensors), quiet=quiet)
    return detect(frames, scene, config, request.workers, learned), parameters


def _cameras(request: Request, recording: Recording) -> tuple[str, ...]:
    for name in request.only:
        if name not in recording.cameras:
            known = ", ".join(recording.cameras)
            raise UsageError(f"{recording.path}: no images of camera {name!r}; there are images of {known}")
    return request.only or recording.cameras


def _frames(recording: Recording, sensors: tuple[str, ...]) -> int:
    wanted = {f"/camera/{name}/{kind}" for name in sensors for kind in ("image", "video")}
    return sum(t.messages for t in recording.topics if t.name in wanted)


def _references(request: Request, recording: Recording) -> tuple[Target, ...]:
    """Appearances of the targets, from a file or attached to the recording."""
    import json

    import numpy as np

    from .config import Target

    where = f"{request.references}" if request.references else f"{recording.path}: appearance.json"
    raw = _read(request.references) if request.references else recording.attachment("appearance.json")
    if raw is None:
        return ()
    try:
        listed = json.loads(raw)
        found: dict[int, list[Any]] = {}
        for entry in listed:
            found.setdefault(int(entry["target_id"]), []).append(entry["appearance"])
        return tuple(Target(i, np.array(rows, dtype=np.float64)) for i, rows in sorted(found.items()))
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{where}: want [{{'target_id': 0, 'appearance': [72 numbers]}}, ...] ({error})") from error


def _read(path: Path) -> bytes:
    from occlog.io.files.inputs import check_input

    return check_input(path, "appearances of targets (JSON)").read_bytes()


def _box(text: str) -> TargetBox:
    from .learning import TargetBox

    parts = text.split(":")
    try:
        *head, frame, place = parts
        target, sensor = (int(head[0]), head[1]) if len(head) == 2 else (0, head[0])
        left, top, width, height = (float(v) for v in place.split(","))
        return TargetBox(target, sensor, int(frame), left, top, width, height)
    except (ValueError, IndexError):
        raise UsageError(f"--target-box {text}: want CAM:FRAME:X,Y,W,H or ID:CAM:FRAME:X,Y,W,H") from None
