"""Request of `occlog detect`, for each of the detectors."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

from occlog.console.notes import threads_by_default
from occlog.measure.fuse.config import FuseConfig
from occlog.measure.networks.config import NetworkConfig
from occlog.request import (
    Form,
    Request,
    Verb,
    VerbKind,
    group,
    number_of_threads,
    output_file,
    scene_file,
    sink,
    source,
)
from occlog.settings import declaration, declared, like, option_setting, setting

from .config import AUTO, BACKGROUND, COMPONENTS, NETWORK, OF_BOXES, OUTLINES, DetectConfig

METHOD = next(declaration(f) for f in declared(DetectConfig) if f.name == "method")
METHODS = METHOD.choices
"""Detectors of our own."""
ONNX = "onnx"
NOT_OF_BACKGROUND = ("network", "embed")
"""Fields of a request that background subtraction lacks."""
NOT_OF_NETWORK = ("target", "target_boxes", "track_feedback", "learn_background")
"""Fields of a request that detection by a network lacks."""


OF_SHIPPED = ("runtime", "nms_iou", "tiles", "embed_pixel_scaling", "embed_size")
"""Settings of networks that the network of occlog leaves open."""


def _embed() -> Any:
    """Declare the input of a re-identification network, `--embed`."""
    words = "Describe the person in each box with this network (ONNX), for re-identification."
    return source(words, metavar="REID", there=False)


@dataclass(frozen=True, kw_only=True)
class Detection(Request):
    """Detect people in RECORDING and convert the detections to bearings.

    The network of occlog finds the boxes of people; each is a candidate bearing (target_id -1). Background subtraction
    (--method background, and in simulated recordings) splits the foreground of each camera into person-sized regions,
    and identifies the target by its appearance; without an appearance it is the largest region. A frame without a box
    or without the target gives a row of a missed detection. A recording with detector boxes instead of video gives one
    candidate bearing per box; one with simulated bearings gives these.

    With --onnx a network of yours detects the boxes: YOLO, RT-DETR, RF-DETR or RTMDet. With --method NAME the
    detector of a plug-in does, see docs/how-to/plugins.md.

    \b
      occlog detect walk.mcap -o bearings.parquet --views views.parquet
      occlog detect walk.mcap -o bearings.parquet --views views.parquet --method background
      occlog detect walk.mcap -o bearings.parquet --views views.parquet --fuse
      occlog detect hall.mcap -o bearings.parquet --target-box cam1:120:310,95,40,110 --background knn
      occlog detect hall.mcap --onnx yolo11n.onnx --embed osnet.onnx -o views.parquet
    """

    OWNER: ClassVar[str] = "detect"

    recording: Path = source(
        "Recording with video, with boxes of a detector, or with simulated bearings.", argument=True
    )
    output: Path = output_file(
        "Bearings of the targets (Parquet); with --onnx or a plug-in the boxes, a table of views.", "bearings"
    )
    scene: Path | None = scene_file("the lenses and poses of the cameras")
    cameras: tuple[str, ...] = option_setting(
        (), "Use these cameras only, names separated by commas.", metavar="A,B,...", shown=""
    )
    workers: int | None = number_of_threads()

    @property
    def threads(self) -> int:
        """Number of threads: that of the option, or else the default."""
        return self.workers or threads_by_default()


@dataclass(frozen=True, kw_only=True)
class DetectRequest(Detection):
    """Request of detection by occlog's network or background subtraction, or of boxes and bearings passed on."""

    RUN: ClassVar[str] = "occlog.measure.detect.run:run_detect"

    method: str = like(
        DetectConfig,
        "method",
        f"{METHOD.help} Or a detector of a plug-in, by name.",
        metavar="|".join((*METHODS, "NAME")),
    )
    views: Path | None = sink("Write every box or person-sized region of every frame (Parquet).", "views")
    target: Path | None = source(
        "Appearance models of the targets, as attached by `occlog simulate --render`. [default: the attached]",
        metavar="JSON",
    )
    target_boxes: tuple[str, ...] = setting(
        (),
        "Box [px] around a target in one frame, from which its appearance is learnt; may be repeated.",
        option="--target-box",
        metavar="[ID:]CAM:FRAME:X,Y,W,H",
        repeat=True,
        whole=True,
        shown="",
    )
    track_feedback: Path | None = source(
        "Track feedback: search each target only near the position that its track predicts, from before the frame.",
        metavar="TRACKS",
    )
    learn_background: bool = setting(
        True,
        "First pass over the recording to learn the empty scene.",
        option="--learn-background/--no-learn-background",
    )
    settings: Mapping[str, object] = group(lambda: DetectConfig, without=("method",))
    embed: Path | None = _embed()
    network: Mapping[str, object] = group(lambda: NetworkConfig, only=OF_SHIPPED)
    fuse: bool = option_setting(
        False, "Fuse detections across cameras: remove false alarms, recover missed detections.", shown=""
    )
    fusion: Mapping[str, object] = group(
        lambda: FuseConfig,
        only=("sigma_prediction", "window_s", "miss_probability", "false_alarm_probability"),
        under="fuse",
        plain=("miss_probability", "false_alarm_probability"),
        nested=True,
    )


@dataclass(frozen=True, kw_only=True)
class _BoxRequest(Detection):
    """Options of detectors that return boxes."""

    output: Path = output_file(
        "Bearings of the targets (Parquet); with --onnx or a plug-in the boxes, a table of views.", "views"
    )
    bearings: Path | None = sink("A candidate bearing for each box (Parquet).", "bearings", asked="bearings")
    settings: Mapping[str, object] = group(lambda: DetectConfig, only=OF_BOXES)


@dataclass(frozen=True, kw_only=True)
class NetworkRequest(_BoxRequest):
    """Request of detection with a given network."""

    RUN: ClassVar[str] = "occlog.measure.detect.run:run_network"

    onnx: Path = source("Detect with this network (ONNX).", required=True, metavar="MODEL", there=False)
    classes: tuple[str, ...] = setting(
        (),
        "Class to detect, by name or number; may be repeated. [default: person, or the only one]",
        option="--class",
        metavar="NAME",
        repeat=True,
        whole=True,
        shown="",
    )
    names: Path | None = source("Names of its classes, one per line.", metavar="TEXT", there=False)
    embed: Path | None = _embed()
    network: Mapping[str, object] = group(lambda: NetworkConfig)


@dataclass(frozen=True, kw_only=True)
class PluginRequest(_BoxRequest):
    """Request of detection with a detector plug-in."""

    RUN: ClassVar[str] = "occlog.measure.detect.run:run_plugin"

    method: str = option_setting("", "Detector of a plug-in, by name.", metavar="NAME", shown="")
    own: Mapping[str, object] = group(None)


def _of_plugin(name: str) -> Form:
    """Form of a request for the installed detector plug-in `name`, with the plug-in's own settings."""
    from occlog.plugins.loading import DETECTOR, find

    plugin = find(name, DETECTOR)
    assert plugin is not None  # it is one of those installed
    return Form(PluginRequest, settings={"own": plugin.load().settings}, under={"own": name})


def _plugged() -> dict[str, VerbKind]:
    from occlog.plugins.loading import DETECTOR, installed

    return {each.name: VerbKind(each.summary, partial(_of_plugin, each.name)) for each in installed(DETECTOR)}


def _form(without: Collection[str], settings: Collection[str] = ()) -> Form:
    """Form of `DetectRequest` without the fields `without`, or with only some of its settings (`settings`)."""
    names = {f.name for f in fields(DetectRequest)} - set(without)
    return Form(DetectRequest, takes=(names - {"settings"}) | set(settings) if settings else names)


_OF_BACKGROUND = partial(_form, NOT_OF_BACKGROUND)

VERB = Verb(
    Detection,
    {
        AUTO: VerbKind("the network, or background subtraction where that fits better", lambda: Form(DetectRequest)),
        NETWORK: VerbKind("boxes of the network of occlog", partial(_form, NOT_OF_NETWORK, OF_BOXES)),
        BACKGROUND: VerbKind("background subtraction: mixture of person-shaped Gaussians", _OF_BACKGROUND),
        OUTLINES: VerbKind("as background, with outlines of people where several touch", _OF_BACKGROUND),
        COMPONENTS: VerbKind("background subtraction: connected blobs", _OF_BACKGROUND),
        ONNX: VerbKind("boxes of a network of yours", lambda: Form(NetworkRequest), "--onnx MODEL"),
    },
    default=AUTO,
    by={ONNX: lambda _: ONNX, "method": str},
    what="detector",
    chosen_by="--method {}",
    more=_plugged,
)
