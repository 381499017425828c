"""The `occlog export` command."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import click

from occlog import console
from occlog.cli import options
from occlog.cli.common import ORIGIN_FORM, ORIGIN_HELP, state_origin
from occlog.cli.setting_options import PluggedCommand, chosen_in
from occlog.errors import UsageError
from occlog.examine.viewers.command import every_opt
from occlog.plugins.loading import EXPORTER

from .formats import FORMATS, FOXGLOVE, RERUN, VIEWERS, format_of

if TYPE_CHECKING:
    from occlog.io.files.geodetic import Origin

LIST = "\n".join(f"      {name:<15}{'/'.join(f.endings) or '(--to)':<19}{f.doc}" for name, f in FORMATS.items())


@click.command(
    name="export",
    cls=PluggedCommand,
    flag="--to",
    kind=EXPORTER,
    ours=tuple(FORMATS),
    short_help="Export a table or cameras to the format of another program.",
    help=f"""Export a table from FILE (a table or a recording) to an external format, or all of it for a viewer.

    A run folder can be exported for a viewer too, and the cameras of a scene (a file, or that of a recording) to
    calibrations of other programs, with positions in metres.

    The ending of the output determines the format, or --to:

    \b
{LIST}

    \b
      occlog export tracks.parquet -o tracks.csv
      occlog export tracks.parquet --target 3 -o three.tum
      occlog export view_tracks.parquet --camera cam1 --to mot -o cam1.txt
      occlog export tracks.parquet --origin 52.5163,13.3777 -o tracks.geojson
      occlog export run/ -o run.mcap --layout run.json
      occlog export scene.yaml -o calibration/colmap
    """,
)
@click.argument("file", type=options.INPUT)
@click.option("-o", "--output", type=options.PATH, required=True, help="Output file; - is standard output.")
@click.option(
    "--to",
    default=None,
    metavar="NAME",
    shell_complete=lambda ctx, param, begun: [name for name in FORMATS if name.startswith(begun)],  # noqa: ARG005
    help="Format: one of the names above, or the exporter of a plug-in. [default: by the ending of the output]",
)
@click.option(
    "--table",
    default=None,
    metavar="NAME",
    help="Name of the table of a recording to export. [default: the first one that the format can hold]",
)
@click.option(
    "--target",
    "targets",
    type=int,
    multiple=True,
    help="Only this target (target_id), for formats of trajectories; may be repeated.",
)
@click.option(
    "--camera",
    default=None,
    metavar="NAME",
    help="Camera of which boxes are written, for text formats of a single camera (mot, kitti).",
)
@click.option(
    "--origin",
    default=None,
    metavar=ORIGIN_FORM,
    callback=state_origin,
    help=f"GeoJSON, and inputs of latitude and longitude: {ORIGIN_HELP}.",
)
@click.option("--scene", type=options.INPUT, default=None, help="Scene file, for image sizes (coco) and viewers.")
@click.option(
    "--recording",
    type=options.INPUT,
    default=None,
    help="Viewers: recording with images and scene, if the run folder has none.",
)
@click.option(
    "--layout",
    type=options.PATH,
    default=None,
    help="For viewers other than rerun: also write a layout file, which the viewer can import.",
)
@click.option(
    "--quality",
    type=click.IntRange(1, 100),
    default=None,
    help="JPEG quality of images from videos, or downscaled ones, in exports for viewers. [default: 90]",
)
@click.option(
    "--height",
    type=click.IntRange(16, 8192),
    default=None,
    metavar="PX",
    help="Viewers: images higher than this are downscaled. [default: 720 px]",
)
@every_opt
@options.quiet_opt
@options.overwrite_opt
@options.json_opt
def command(
    file: Path,
    output: Path,
    to: str | None,
    table: str | None,
    targets: tuple[int, ...],
    camera: str | None,
    origin: Origin | None,
    scene: Path | None,
    recording: Path | None,
    layout: Path | None,
    quality: int | None,
    height: int | None,
    every: float | None,
    quiet: bool,
    overwrite: bool,
    as_json: bool,
    **values: object,
) -> int:
    """Run the export and print a summary (nothing if the table itself goes to standard output).

    Return the exit code.
    """
    name = to or format_of(output.name)
    if name is not None and name in FORMATS and FORMATS[name].viewer:
        named = {"--table": table, "--target": targets, "--camera": camera, "--origin": origin}
        _refuse(named, f"format {name} shows everything; leave it out")
        if name == RERUN:
            _refuse({"--layout": layout}, f"format {name} takes none; {VIEWERS} and {FOXGLOVE} do")
        from occlog.examine.viewers.run import HEIGHT, QUALITY, ViewerTask, run_viewers

        sizes = (quality or QUALITY, height or HEIGHT)
        show = ViewerTask(file, output, name, recording, scene, layout, *sizes, overwrite, every)
        return console.finish(*run_viewers(show, quiet=quiet), as_json)
    _refuse(
        {"--recording": recording, "--layout": layout, "--quality": quality, "--height": height, "--every": every},
        "is for viewers' formats only",
    )
    if name is not None and name in FORMATS and FORMATS[name].cameras:
        stated = {"--table": table, "--target": targets, "--camera": camera, "--origin": origin, "--scene": scene}
        _refuse(stated, f"format {name} has all cameras of a scene; leave it out")
        from .cameras import run_export_cameras

        return console.finish(*run_export_cameras(file, output, name, overwrite=overwrite, quiet=quiet), as_json)
    from .run import STANDARD, ExportRequest, run_export

    request = ExportRequest(
        input=file,
        output=output,
        to=to,
        table=table,
        targets=targets,
        camera=camera,
        origin=origin,
        scene=scene,
        overwrite=overwrite,
        exporter=next(iter(chosen_in(click.get_current_context(), values)), None),
        quiet=quiet,
    )
    summary, losses = run_export(request)
    return console.finish({} if output == STANDARD else summary, losses, as_json and output != STANDARD)


def _refuse(named: Mapping[str, object], why: str) -> None:
    """Raise UsageError for the first option in `named` (value by option) that is given; `why`: end of the message."""
    for option, value in named.items():
        if value not in (None, ()):
            raise UsageError(f"{option}: {why}")
