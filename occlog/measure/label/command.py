"""The `occlog label` command."""

from __future__ import annotations

from pathlib import Path

import click

from occlog.cli import options


@click.command(name="label", short_help="Give candidates the identity of the track they agree with.")
@click.argument("bearings", type=options.PATH)
@click.option("--tracks", type=options.PATH, required=True, help="Tracks that say who is where (Parquet).")
@options.output_opt("Labelled bearings (Parquet).")
@options.scene_opt
@click.option(
    "--doa",
    type=options.PATH,
    default=None,
    help="Directions of arrival to label too: a table, or a recording that holds them.",
)
@click.option("--doa-labels", is_flag=True, help="Identities in the log of directions are those of targets.")
@click.option(
    "--gate",
    type=click.FloatRange(min=0, min_open=True),
    default=3.0,
    show_default=True,
    help="Standard deviations within which a candidate agrees with a track.",
)
@click.option(
    "--max-gap",
    "max_gap",
    type=click.FloatRange(min=0),
    default=1.0,
    show_default=True,
    metavar="SECONDS",
    help="Longest time between two rows of a track that is bridged.",
)
@click.option("--keep-rest", is_flag=True, help="Keep candidates of nobody, without a label. [default: leave them out]")
@click.option("--cameras", "only", default="", metavar="A,B,...", help="Use only these sensors.")
@click.option("--without", default="", metavar="A,B,...", help="Leave these sensors out.")
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(
    bearings: Path,
    tracks: Path,
    output: Path,
    scene: Path | None,
    doa: Path | None,
    doa_labels: bool,
    gate: float,
    max_gap: float,
    keep_rest: bool,
    only: str,
    without: str,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
) -> int:
    """Give candidates of BEARINGS (Parquet, or a recording that holds bearings) the identity of a track.

    In every frame of a sensor the candidates (target_id -1) are assigned one to one to the tracks,
    by the difference of bearings. A track without a candidate gets a row that says "not seen".
    Rows that have a label stay.

    \b
      occlog track boxes.parquet --scene hall.mcap --start 2.9,0.5,0.3 -o tracks.parquet
      occlog label boxes.parquet --scene hall.mcap --tracks tracks.parquet -o labelled.parquet
    """
    from .run import Files, run_label

    options.check_outputs([bearings, tracks, scene, doa], [output], overwrite)
    values = {"gate": gate, "max_gap_s": max_gap, "keep_rest": keep_rest}
    files = Files(bearings, tracks, scene, doa, doa_labels, output, overwrite)
    summary, losses = run_label(files, values, only, without, quiet)
    return options.finish(summary, losses, as_json)
