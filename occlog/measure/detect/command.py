"""The `occlog detect` command."""

from __future__ import annotations

from pathlib import Path

import click

from occlog import console
from occlog.cli import options
from occlog.cli.plugged import PluggedCommand, chosen_in
from occlog.cli.setting_options import add_options, given, options_of, with_options
from occlog.console.details import threads_by_default
from occlog.io.files.atomic import check_outputs
from occlog.measure.fuse.config import FuseConfig
from occlog.measure.networks.config import NetworkConfig
from occlog.plugins.loading import DETECTOR
from occlog.settings import declaration, declared

from .config import DetectConfig

OF_FUSION = [
    *options_of(FuseConfig, only=("sigma", "window_s"), under="fuse"),
    *options_of(FuseConfig, only=("p_miss", "p_false")),
]
"""Options that only the fusion takes."""
OF_NETWORKS = options_of(NetworkConfig)
"""Options that only detection by a network takes, beside `--onnx` and what names files and classes."""
METHOD = next(declaration(f) for f in declared(DetectConfig) if f.name == "method")
METHODS = METHOD.choices
"""Ways of our own to find regions."""
WITH_NETWORKS = ("bits", "sigma_px", "sigma_scale", "min_confidence")
"""Settings of detection that a network takes, too."""


@click.command(
    name="detect",
    cls=PluggedCommand,
    flag="--method",
    kind=DETECTOR,
    ours=METHODS,
    short_help="Reduce the frames of a recording to bearings, or to the boxes of a network.",
)
@click.argument("recording", type=options.INPUT)
@options.output_opt("Bearings of the targets (Parquet); with --onnx or a plug-in the boxes, a table of views.")
@click.option("--views", type=options.PATH, default=None, help="Every people-sized region of every frame (Parquet).")
@click.option("--onnx", type=options.PATH, default=None, metavar="MODEL", help="Detect with this network (ONNX).")
@click.option(
    "--class",
    "classes",
    multiple=True,
    metavar="NAME",
    help="With --onnx: class to look for, by name or number; may be repeated. [default: person, or the only one]",
)
@click.option(
    "--names", type=options.PATH, default=None, metavar="TEXT", help="With --onnx: names of its classes, one a line."
)
@click.option(
    "--embed",
    type=options.PATH,
    default=None,
    metavar="REID",
    help="With --onnx: describe who is in each box with this network (ONNX) for re-identification.",
)
@click.option(
    "--bearings",
    type=options.PATH,
    default=None,
    help="With --onnx or a plug-in: a candidate bearing for each box (Parquet).",
)
@options.scene_opt
@click.option("--cameras", "only", default="", metavar="A,B,...", help="Only these cameras.")
@click.option(
    "--target",
    "references",
    type=options.INPUT,
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
    "--near",
    type=options.INPUT,
    default=None,
    metavar="TRACKS",
    help="Look for each target only around where its track says that it is, by the time before the frame.",
)
@click.option(
    "--learn/--no-learn",
    default=True,
    show_default=True,
    help="Look through the recording first, for what it shows when nobody is there.",
)
@click.option(
    "--method",
    default=None,
    metavar="|".join((*METHODS, "NAME")),
    help=f"{METHOD.help} Or a detector of a plug-in, by name. [default: {METHODS[0]}]",
)
@with_options(DetectConfig, without=("method",))
@add_options(OF_NETWORKS)
@click.option("--fuse", is_flag=True, help="Fuse the detections of the cameras: remove false, recover missed.")
@add_options(OF_FUSION)
@options.workers_opt
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(
    recording: Path,
    output: Path,
    views: Path | None,
    onnx: Path | None,
    method: str | None,
    classes: tuple[str, ...],
    names: Path | None,
    embed: Path | None,
    bearings: Path | None,
    scene: Path | None,
    only: str,
    references: Path | None,
    boxes: tuple[str, ...],
    near: Path | None,
    learn: bool,
    fuse: bool,
    workers: int | None,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    **values: object,
) -> int:
    """Reduce the frames of RECORDING to bearings of its targets.

    Each camera's foreground is split into people-sized regions, and the target told from the others by
    its appearance; without one, it is the largest region. A frame without the target gives a row
    "looked, not seen". A recording with detector boxes instead of video gives one candidate bearing a box
    (target_id -1); one with simulated bearings gives these.

    With --onnx a network of yours finds the boxes: YOLO, RT-DETR, RF-DETR or RTMDet. With --method NAME a
    detector of a plug-in does, see docs/how-to/plugins.md.

    \b
      occlog detect walk.mcap -o bearings.parquet --views views.parquet
      occlog detect walk.mcap -o bearings.parquet --views views.parquet --fuse
      occlog detect hall.mcap -o bearings.parquet --target-box cam1:120:310,95,40,110 --background knn
      occlog detect hall.mcap --onnx yolo11n.onnx --embed osnet.onnx -o views.parquet
    """
    from occlog.cli.values import parse_names

    from .run import DetectRequest, run_detect
    from .run_network import NetworkRequest, run_network
    from .run_plugin import PluginRequest, run_plugin

    context = click.get_current_context()
    plugged = chosen_in(context, values)
    _refuse_what_does_not_go_together(context, by="--onnx" if onnx is not None else "--method" if plugged else "")
    check_outputs([recording, scene, references, near, onnx, names, embed], [output, views, bearings], overwrite)
    settings, threads = given(DetectConfig, values), workers or threads_by_default()
    if onnx is not None:
        networks = NetworkRequest(
            recording=recording,
            scene=scene,
            only=parse_names(only),
            model=onnx,
            classes=classes,
            names=names,
            embed=embed,
            settings=settings,
            network=given(NetworkConfig, values),
            threads=threads,
        )
        return console.finish(*run_network(networks, output, bearings, overwrite, quiet), as_json)
    if plugged:
        by_plugin = PluginRequest(recording, scene, parse_names(only), plugged[0], settings)
        return console.finish(*run_plugin(by_plugin, output, bearings, overwrite, quiet), as_json)
    settings |= {} if method is None else {"method": method}
    request = DetectRequest(
        recording=recording,
        scene=scene,
        only=parse_names(only),
        references=references,
        boxes=boxes,
        learn=learn,
        near=near,
        settings=settings,
        workers=threads,
        fusion=given(FuseConfig, values) if fuse else None,
    )
    if not fuse:
        _refuse_options_of_fusion(values)
    summary, losses = run_detect(request, output, views, overwrite, quiet)
    return console.finish(summary, losses, as_json)


def _refuse_what_does_not_go_together(context: click.Context, by: str) -> None:
    """Usage error for an option of detection by the background where something else detects, or the other way round.

    Args:
        context: of the call.
        by: `--onnx`, or `--method` of a plug-in; empty: the background.
    """
    of_network = {"onnx", "classes", "names", "embed", *(str(option.name) for option in OF_NETWORKS)}
    leaves = {"views", "references", "boxes", "near", "learn", "fuse"}
    leaves |= {str(option.name) for option in [*options_of(DetectConfig, without=WITH_NETWORKS), *OF_FUSION]}
    leaves -= {"method"} if by == "--method" else set()
    for param in context.command.params:
        source = context.get_parameter_source(str(param.name))
        if source is not click.core.ParameterSource.COMMANDLINE:
            continue
        if by and param.name == "views":
            raise click.UsageError(f"--views: with {by}, -o is the table of views; leave it out")
        if by and param.name in leaves:
            what = "with a network" if by == "--onnx" else "by a plug-in"
            raise click.UsageError(f"{param.opts[0]} is not for detection {what}; leave it or {by} out")
        if by != "--onnx" and param.name in of_network:
            raise click.UsageError(f"{param.opts[0]} is for detection with a network; add --onnx MODEL")
        if not by and param.name == "bearings":
            raise click.UsageError("--bearings is for detection with a network; add --onnx MODEL, or --method NAME")


def _refuse_options_of_fusion(values: dict[str, object]) -> None:
    """Usage error for an option that only the fusion takes; the height of a person is an option of detection, too."""
    for option in OF_FUSION:
        if values[str(option.name)] is not None:
            raise click.UsageError(f"{option.opts[0]} is an option of the fusion; add --fuse")
