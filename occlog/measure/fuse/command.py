"""The `occlog fuse` command."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from occlog import console
from occlog.cli import options
from occlog.cli.setting_options import Variant, VariantCommand, given, options_of, value_after
from occlog.io.files.atomic import check_outputs

from .config import FuseConfig
from .tracks.config import TrackFusionConfig

DETECTIONS, TRACKS = "detections", "tracks"
JOINING = "--with"
"""Option that names more tracks."""


def _detection_options() -> list[click.Option]:
    """Options of the fusion of detections."""

    def path(name: str, help: str) -> click.Option:
        return click.Option([name], type=options.INPUT, default=None, help=help)

    return [
        path("--views", "The views that the bearings are of (Parquet)."),
        click.Option(
            ["--fused-views"], type=options.PATH, default=None, help="Write the views after the fusion (Parquet)."
        ),
        path("--scene", options.SCENE_HELP),
        *options_of(FuseConfig),
    ]


def _track_options() -> list[click.Option]:
    """Options of the fusion of tracks."""
    return [
        click.Option(
            [JOINING, "others"],
            type=options.INPUT,
            multiple=True,
            required=True,
            metavar="TRACKS",
            help="Tracks of another group of cameras (Parquet); may be repeated.",
        ),
        click.Option(
            ["--events"],
            type=options.PATH,
            default=None,
            help="Write births, deaths and doubtful identities (Parquet).",
        ),
        *options_of(TrackFusionConfig),
    ]


def _chosen(args: Sequence[str]) -> str | None:
    """What the arguments fuse; None: they do not say."""
    return None if value_after(args, JOINING) is None else TRACKS


@click.command(
    name="fuse",
    cls=VariantCommand,
    variants={
        DETECTIONS: Variant(
            "Detections of several cameras.", _detection_options, (lambda: FuseConfig,), called="fuse BEARINGS"
        ),
        TRACKS: Variant(
            "Tracks of several groups of cameras.",
            _track_options,
            (lambda: TrackFusionConfig,),
            called=f"fuse TRACKS {JOINING} TRACKS",
        ),
    },
    choose=_chosen,
    default=DETECTIONS,
    shows_default=True,
    what="kind",
    chosen_by=f"fuse [{JOINING} TRACKS]",
    short_help="Fuse detections of several cameras, or tracks of several groups of cameras.",
)
@click.argument("bearings", type=options.INPUT)
@options.output_opt("Fused bearings, or tracks (Parquet).")
@options.set_opt("reach=3")
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(
    bearings: Path,
    output: Path,
    settings: tuple[str, ...],
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    **values: Any,
) -> int:
    """Fuse the detections of several cameras in BEARINGS (Parquet, or a recording that holds bearings).

    Detections of one target are brought together on the ground. Where enough cameras agree, a camera
    that missed the target gets its detection back (cause `recovered`); a detection that the others
    contradict becomes "looked, not seen" (cause `removed`). Candidates (target_id -1) are grouped first.
    `occlog detect --fuse` does the same while it detects.

    With --with, BEARINGS and the files named there are tracks of several groups of cameras in one world:
    those of one person become one track, with one identity, by covariance intersection.

    \b
      occlog fuse bearings.parquet --views views.parquet --scene walk.mcap -o fused.parquet --fused-views both.parquet
      occlog fuse labelled.parquet --scene hall.mcap -o fused.parquet --p-miss 0.3 --p-false 0.05
      occlog fuse east.parquet --with west.parquet -o hall.parquet --events hall_events.parquet
    """
    from occlog.cli.values import parse_setting

    chosen: dict[str, object] = dict(parse_setting(text) for text in settings)
    if "others" in values:
        from .tracks.run import TrackFiles, run_fuse_tracks

        tracks, events = (bearings, *values["others"]), values["events"]
        check_outputs(tracks, [output, events], overwrite)
        wanted = TrackFiles(tracks=tracks, output=output, events=events, overwrite=overwrite)
        summary, losses = run_fuse_tracks(wanted, chosen | given(TrackFusionConfig, values), quiet)
        return console.finish(summary, losses, as_json)

    from .run import FuseFiles, run_fuse

    views, scene, fused_views = values["views"], values["scene"], values["fused_views"]
    check_outputs([bearings, views, scene], [output, fused_views], overwrite)
    files = FuseFiles(
        bearings=bearings, views=views, scene=scene, output=output, fused_views=fused_views, overwrite=overwrite
    )
    summary, losses = run_fuse(files, chosen | given(FuseConfig, values), quiet)
    return console.finish(summary, losses, as_json)
