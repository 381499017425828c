"""The `occlog label` command, by the places of tracks or by a gallery."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from occlog import console
from occlog.cli import options
from occlog.cli.setting_options import Variant, VariantCommand, given, options_of, value_after
from occlog.io.files.atomic import check_outputs
from occlog.measure.appearance.config import MatchConfig

from .config import LabelConfig, NamingConfig


def _place_params() -> list[click.Parameter]:
    """Options of labels by the places of tracks."""
    return [
        click.Option(["--tracks"], type=options.INPUT, required=True, help="Tracks that say who is where (Parquet)."),
        click.Option(
            ["--doa"],
            type=options.INPUT,
            default=None,
            help="Directions of arrival to label too: a table, or a recording that holds them.",
        ),
        click.Option(["--doa-labels"], is_flag=True, help="Identities in the log of directions are those of targets."),
        *options_of(LabelConfig),
        click.Option(["--cameras", "only"], default="", metavar="A,B,...", help="Use only these sensors."),
        click.Option(["--without"], default="", metavar="A,B,...", help="Leave these sensors out."),
    ]


def _gallery_params() -> list[click.Parameter]:
    """Options of labels by appearance."""
    return [
        click.Option(
            ["--images"],
            type=options.INPUT,
            default=None,
            help="The recording with the images. [default: BEARINGS; views need none]",
        ),
        click.Option(
            ["--tracks"],
            type=options.INPUT,
            default=None,
            help="Tracks or truth: where people are and head. [default: the truth of the recording, or the floor below "
            "boxes that have an identity]",
        ),
        click.Option(["--labelled"], is_flag=True, help="The identities of boxes are those of the tracks."),
        click.Option(
            ["--named"],
            type=options.PATH,
            default=None,
            help="The tracks, under the identities of the gallery (Parquet).",
        ),
        *options_of(MatchConfig),
        *options_of(NamingConfig),
    ]


KINDS = {
    "tracks": Variant(
        "candidates get the identity of the track at their bearing", _place_params, called="--tracks FILE"
    ),
    "gallery": Variant(
        "boxes get the identity of the person whom they look like", _gallery_params, called="--gallery FILE"
    ),
}
"""By what the identity is found."""


def chosen_kind(args: Sequence[str]) -> str | None:
    """The kind of labels that the arguments choose."""
    return None if value_after(args, "--gallery") is None else "gallery"


@click.command(
    name="label",
    cls=VariantCommand,
    variants=KINDS,
    choose=chosen_kind,
    default="tracks",
    shows_default=True,
    what="kind",
    chosen_by="{}",
    short_help="Give candidates the identity of the track they agree with.",
)
@click.argument("bearings", type=options.INPUT)
@options.output_opt("Labelled bearings; with --gallery a table of matches (Parquet).")
@click.option(
    "--gallery",
    type=options.INPUT,
    default=None,
    help="Match boxes with how people look (Parquet, of `occlog appearance learn`), instead of bearings with tracks.",
)
@options.scene_opt
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(
    bearings: Path,
    output: Path,
    gallery: Path | None,
    scene: Path | None,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    **own: Any,
) -> int:
    """Give candidates of BEARINGS (Parquet, or a recording that holds bearings) the identity of a track.

    In every frame of a sensor the candidates (target_id -1) are assigned one to one to the tracks,
    by the difference of bearings. A track without a candidate gets a row that says "not seen".
    Rows that have a label stay.

    With --gallery BEARINGS holds boxes or views, and each is compared with the people of the gallery as they
    look from the side that the camera sees ([Lee] Sec. 5.2.1). What the gallery does not have is suspended.

    \b
      occlog track boxes.parquet --scene hall.mcap --start 2.9,0.5,0.3 -o tracks.parquet
      occlog label boxes.parquet --scene hall.mcap --tracks tracks.parquet -o labelled.parquet
      occlog label hall.mcap --gallery gallery.parquet --tracks tracks.parquet -o matches.parquet
    """
    if gallery is not None:
        from occlog.measure.appearance.inputs import SightingFiles

        from .by_appearance import MatchFiles, run_match

        images, named, tracks = own["images"], own["named"], own["tracks"]
        check_outputs([bearings, gallery, images, tracks, scene], [output, named], overwrite)
        matched = MatchFiles(
            seen=SightingFiles(boxes=bearings, images=images, tracks=tracks, scene=scene),
            gallery=gallery,
            labelled=own["labelled"],
            output=output,
            named=named,
            overwrite=overwrite,
        )
        naming = NamingConfig(**given(NamingConfig, own))
        return console.finish(*run_match(matched, given(MatchConfig, own), naming, quiet), as_json)

    from occlog.cli.values import parse_names

    from .run import LabelFiles, Sensors, run_label

    tracks, doa = own["tracks"], own["doa"]
    check_outputs([bearings, tracks, scene, doa], [output], overwrite)
    files = LabelFiles(
        bearings=bearings,
        tracks=tracks,
        scene=scene,
        doa=doa,
        doa_labels=own["doa_labels"],
        output=output,
        overwrite=overwrite,
    )
    sensors = Sensors(only=parse_names(own["only"]), without=parse_names(own["without"]))
    config = LabelConfig(**given(LabelConfig, own))
    summary, losses = run_label(files, sensors, config, quiet)
    return console.finish(summary, losses, as_json)
