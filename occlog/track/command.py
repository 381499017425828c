"""The `occlog track` command."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from occlog.cli import options

from .images import command as track_views

METHODS = ("apf", "map", "direct3d", "pps", "imm", "fix")
"""Names of `occlog.track.catalogue.METHODS`; a test keeps the two alike, so that --help need not load the trackers."""
POLICIES = ("greedy", "brute-force", "fixed", "random", "closest", "all")
MODELS = ("perspective", "weak")
"""The same of `occlog.track.apf.selection_policies`."""
COOPERATE = ("none", "periodic", "printed", "count", "spread")
"""The same of `occlog.track.imm.config`."""


@click.command(name="track", short_help="Estimate target tracks from bearings or video.")
@click.argument("bearings", type=options.PATH)
@options.output_opt("Tracks (Parquet).")
@click.option("--diagnostics", type=options.PATH, default=None, help="How the filter fared at each time (Parquet).")
@click.option(
    "--calibration",
    type=options.PATH,
    default=None,
    help="Errors of the cameras' poses as estimated, with --set calibrate=joint or initial (Parquet).",
)
@options.scene_opt
@click.option(
    "--doa",
    type=options.PATH,
    default=None,
    help="Directions of arrival to use too: a table, or a recording that holds them.",
)
@click.option(
    "--doa-labels",
    is_flag=True,
    help="Identities in the log of directions are those of targets. [default: directions may be of anything]",
)
@click.option(
    "--occluders",
    type=options.PATH,
    default=None,
    help="Where moving occluders may be: `occluders` or `hulls` (Parquet, see `occlog priors`), "
    "or truth (known exactly).",
)
@click.option(
    "--select",
    "policy",
    type=click.Choice(POLICIES),
    default=None,
    help="Use only some cameras, selected anew every few steps. [default: use all]",
)
@click.option("--count", type=click.IntRange(min=1), default=None, help="Cameras selected. [default: 4]")
@click.option(
    "--every",
    type=click.FloatRange(min=0, min_open=True),
    default=None,
    metavar="STEPS",
    help="Reference steps (--set reference_s, 1 s) between selections. [default: 5]",
)
@click.option(
    "--select-model",
    "model",
    type=click.Choice(MODELS),
    default=None,
    help="Camera model of the expected error. [default: perspective]",
)
@click.option("--select-order", "order", default="", metavar="A,B,...", help="Order of the cameras for --select fixed.")
@click.option(
    "--method",
    type=click.Choice((*METHODS, *track_views.VIEW_METHODS)),
    default="apf",
    show_default=True,
    help=f"Tracking method; {', '.join(track_views.VIEW_METHODS)} track in the images of a recording.",
)
@track_views.view_opts
@click.option(
    "--particles", type=click.IntRange(min=1), default=None, help="Particles a target. [default: 2000, in images 60]"
)
@click.option(
    "--start",
    "starts",
    multiple=True,
    metavar="X,Y[,SIGMA]",
    help="Where the target is at first; SIGMA is 0.5 m, or 1 in units of its own, if left out. For --method imm also "
    "X,Y,SIGMA,VX,VY,SIGMA_V; may be repeated, once a target. [default: anywhere in the room]",
)
@click.option(
    "--cooperate",
    default=None,
    metavar="POLICY",
    help=f"For --method imm: when to ask cameras where the targets are: {', '.join(COOPERATE)}; several with commas. "
    "[default: none]",
)
@click.option(
    "--cooperation", type=options.PATH, default=None, help="What cameras were asked, and what they said (Parquet)."
)
@click.option(
    "--target",
    "targets",
    multiple=True,
    type=click.IntRange(min=0),
    metavar="ID",
    help="Track only this target; may be repeated. The first also numbers a track without labels.",
)
@click.option("--labelled-only", is_flag=True, help="Do not use candidates that are not assigned to a target.")
@click.option(
    "--use-recovered",
    is_flag=True,
    help="Use what the fusion of detections recovered as if it had been measured. [default: not seen]",
)
@click.option("--cameras", "only", default="", metavar="A,B,...", help="Use only these sensors.")
@click.option("--without", default="", metavar="A,B,...", help="Leave these sensors out.")
@click.option(
    "--window",
    type=click.FloatRange(min=0),
    default=None,
    metavar="SECONDS",
    help="Measurements this close together in time make one scan. [default: equal times; frames: below half the "
    "shortest frame period]",
)
@click.option(
    "--in-turn",
    "turn",
    type=click.FloatRange(min=0, min_open=True),
    default=None,
    metavar="SECONDS",
    help="Use one sensor at a time, each for so long, in the order of the scene. [default: all at once]",
)
@click.option(
    "--motion", type=options.PATH, default=None, help="How targets move, from `occlog fit-motion`; for --method map."
)
@click.option(
    "--lag",
    type=click.FloatRange(min=0, min_open=True),
    default=None,
    metavar="SECONDS",
    help="For --method map: estimate with so much of what comes after, in bounded memory. [default: all of it]",
)
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="NAME=VALUE",
    help="A setting of the method, e.g. sigma_v=0.3; may be repeated.",
)
@options.seed_opt
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
@click.pass_context
def command(
    context: click.Context,
    /,
    bearings: Path,
    output: Path,
    diagnostics: Path | None,
    calibration: Path | None,
    scene: Path | None,
    doa: Path | None,
    occluders: Path | None,
    policy: str | None,
    count: int | None,
    every: float | None,
    model: str | None,
    order: str,
    method: str,
    particles: int | None,
    starts: tuple[str, ...],
    cooperate: str | None,
    cooperation: Path | None,
    targets: tuple[int, ...],
    labelled_only: bool,
    use_recovered: bool,
    only: str,
    without: str,
    window: float | None,
    doa_labels: bool,
    turn: float | None,
    motion: Path | None,
    lag: float | None,
    settings: tuple[str, ...],
    seed: int,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    **_views: Any,
) -> int:
    """Estimate target tracks from BEARINGS (Parquet, or a recording that holds bearings).

    Each labelled target has its own filter. Candidates without a label (target_id -1, for example
    a detector's boxes or directions of arrival) are offered to every filter; where nothing is
    labelled they make one track, of the target at --start if that is given. A recording's
    directions of arrival are used along with its bearings.
    The same inputs, options and seed give the same output.

    --method imm has one state for all targets that microphone arrays hear, labelled or not: it says
    how many there are, and asks cameras where they are when --cooperate says so.

    --method map finds the most probable trajectory of each labelled target from everything that was
    recorded, before and after; it needs no cameras that overlap, but labels (`occlog label`).

    --method mipf, idmot, cmct, bmct and mcmc follow many targets as ellipses in the images of a recording
    instead, which then stands in the place of BEARINGS; they write `view_tracks`.

    \b
      occlog track bearings.parquet --scene scene.yaml -o tracks.parquet --diagnostics diagnostics.parquet
      occlog track bearings.parquet --scene hall.mcap --without cam4 --start 4,1.5,0.5 -o without4.parquet
      occlog track bearings.parquet --scene scene.yaml --occluders occluders.parquet --select greedy --count 3 \
        -o selected.parquet --diagnostics selected_diagnostics.parquet
      occlog track directions.mcap --method imm --cooperate spread --set spread=0.5 -o heard.parquet \
        --cooperation asked.parquet
      occlog track balls.mcap --method bmct --initial balls.mcap -o view_tracks.parquet
      occlog track labelled.parquet --scene scene.yaml --method map --set loss=huber -o map.parquet
    """
    from occlog.cli.parse import parse_names, parse_seconds, parse_setting, parse_window

    from .run import Outputs, Request, run_track

    if track_views.check_options(context, method):
        return track_views.run(context, None if window is None else parse_window(window))
    outputs = Outputs(output, diagnostics, calibration, cooperation)
    options.check_outputs([bearings, scene, doa, occluders, motion], outputs.paths, overwrite)
    for option, given, wanted in (
        ("--motion", motion is not None, "map"),
        ("--lag", lag is not None, "map"),
        ("--cooperate", cooperate is not None, "imm"),
        ("--cooperation", cooperation is not None, "imm"),
    ):
        if given and method != wanted:
            raise click.UsageError(f"{option} goes with --method {wanted}, not {method}")
    values = dict(parse_setting(text) for text in settings)
    if particles is not None:
        values["particles"] = str(particles)
    if lag is not None:
        values["lag_s"] = str(parse_seconds("--lag", lag))
    if cooperate is not None:
        values["cooperate"] = cooperate
    request = Request(
        bearings,
        scene,
        doa,
        method,
        values,
        starts,
        targets,
        not labelled_only,
        parse_names(only),
        parse_names(without),
        parse_window(window or 0.0),
        seed,
        occluders,
        policy,
        {name: value for name, value in (("count", count), ("every", every), ("model", model)) if value is not None},
        parse_names(order),
        doa_labels,
        None if turn is None else parse_seconds("--in-turn", turn),
        motion,
        use_recovered,
    )
    summary, losses = run_track(request, outputs, overwrite, quiet)
    return options.finish(summary, losses, as_json)
