"""The `occlog track` command."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import click

from occlog import console
from occlog.cli import options
from occlog.cli.setting_options import Variant, VariantCommand, given, value_after
from occlog.io.files.atomic import check_outputs
from occlog.settings import Settings

from .catalogue import BOXES, METHODS, OURS, READS, VIEW, settings_of
from .options import method_params


def _variant(name: str) -> Variant:
    """What --method NAME takes; its settings are loaded when they are asked for."""
    return Variant(METHODS[name].summary, partial(method_params, name), partial(_settings, name))


def _settings(name: str) -> list[type[Settings]]:
    """The classes of the settings of a method, and of what is around the trackers in images."""
    if not METHODS[name].images:
        return [settings_of(name)]
    from .images.births.config import ViewsConfig

    return [settings_of(name), ViewsConfig]


def _plugged() -> dict[str, Variant]:
    """The methods of installed plug-ins; what cannot be loaded says why."""
    from occlog.errors import PluginError
    from occlog.plugins.loading import METHOD, VIEW_TRACKER, installed

    found = {}
    for plugin in (*installed(METHOD), *installed(VIEW_TRACKER)):
        if plugin.name not in OURS:
            try:
                found[plugin.name] = _variant(plugin.name)
            except PluginError as error:
                found[plugin.name] = Variant(str(error), lambda: ())
    return found


def chosen_method(args: Sequence[str]) -> str | None:
    """The method that the arguments name."""
    return value_after(args, "--method")


def complete_method(ctx: click.Context, param: click.Parameter, begun: str) -> list[str]:  # noqa: ARG001
    """The methods whose names begin so, for the shell."""
    return [name for name in METHODS if name.startswith(begun)]


@click.command(
    name="track",
    cls=VariantCommand,
    variants={name: _variant(name) for name in METHODS},
    choose=chosen_method,
    default="apf",
    more=_plugged,
    what="method",
    chosen_by="--method {}",
    short_help="Estimate target tracks from bearings or video.",
)
@click.argument("bearings", type=options.INPUT)
@options.output_opt("Tracks (Parquet).")
@options.scene_opt
@click.option(
    "--method",
    default="apf",
    show_default=True,
    metavar="NAME",
    shell_complete=complete_method,
    help="Tracking method.",
)
@click.option("--cameras", "only", default="", metavar="A,B,...", help="Use only these sensors.")
@click.option("--without", default="", metavar="A,B,...", help="Leave these sensors out.")
@click.option(
    "--window",
    type=click.FloatRange(min=0),
    default=None,
    metavar="SECONDS",
    help="Measurements this close together in time make one scan. [default: equal times; frames: below half the "
    "shortest frame period; reads: 1]",
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
def command(
    bearings: Path,
    output: Path,
    scene: Path | None,
    method: str,
    only: str,
    without: str,
    window: float | None,
    settings: tuple[str, ...],
    seed: int,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    **own: Any,
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

    --method jipda follows everybody on the floor by the boxes of all calibrated cameras: BEARINGS is then a
    recording with boxes, or a table of views or boxes. Nobody need be labelled, and nothing be known of the start.

    --method virtual and rssi locate radio tags: BEARINGS is then a recording (or a table) with the reads of fixed
    readers. A tag's track has the tag's identity, which `occlog label` gives to bearings.

    --method apf, ekf, fix, map and ukf also take ranges, signal strengths and time differences of stations: in
    --measurements beside bearings, or in the place of BEARINGS.

    \b
      occlog track bearings.parquet --scene scene.yaml -o tracks.parquet --diagnostics diagnostics.parquet
      occlog track bearings.parquet --scene hall.mcap --without cam4 --start 4,1.5,0.5 -o without4.parquet
      occlog track bearings.parquet --scene scene.yaml --occluders occluders.parquet --select greedy --count 3 \
        -o selected.parquet --diagnostics selected_diagnostics.parquet
      occlog track directions.mcap --method imm --cooperate spread --set spread=0.5 -o heard.parquet \
        --cooperation asked.parquet
      occlog track balls.mcap --method bmct --initial balls.mcap -o view_tracks.parquet
      occlog track views.parquet --scene hall.mcap --method jipda -o tracks.parquet --view-tracks in_images.parquet
      occlog track labelled.parquet --scene scene.yaml --method map --set loss=huber -o map.parquet
      occlog track tags.mcap --method rssi --path-loss readers.json -o tags.parquet
      occlog track ranges.csv --scene stations.csv --method fix -o tracks.parquet
    """
    from occlog.cli.values import parse_names, parse_setting, parse_window
    from occlog.scans.config import MeasuredConfig

    from .apf.selection_config import SelectConfig

    values = dict(parse_setting(text) for text in settings) | given(settings_of(method), own)
    if METHODS[method].images:
        from .images.run.inputs import ViewsRequest
        from .images.run.run import ViewsOutputs, run_track_views

        video = ViewsRequest(
            recording=bearings,
            scene=scene,
            method=method,
            settings=values,
            initial=own["initial"],
            detections=own["detections"],
            fundamental=own["fundamental"],
            only=parse_names(only),
            without=parse_names(without),
            window_ns=None if window is None else parse_window(window),
            seed=seed,
        )
        tracks = ViewsOutputs(output, own["world"])
        check_outputs(video.paths, [tracks.tracks, tracks.world], overwrite)
        return console.finish(*run_track_views(video, tracks, overwrite, quiet), as_json)
    if METHODS[method].takes_in == VIEW:
        from .single_view.run import SingleViewRequest, run_track_single_view

        if window is not None:
            raise click.UsageError(f"--window: method {method} takes each frame of a camera by itself; leave it out")
        looks = SingleViewRequest(
            boxes=bearings,
            scene=scene,
            method=method,
            settings=values,
            only=parse_names(only),
            without=parse_names(without),
            seed=seed,
        )
        check_outputs(looks.paths, [output], overwrite)
        return console.finish(*run_track_single_view(looks, output, overwrite, quiet), as_json)
    if METHODS[method].takes_in == BOXES:
        from .people.inputs import PeopleRequest
        from .people.run import PeopleFiles, run_track_people

        crowd = PeopleRequest(
            boxes=bearings,
            scene=scene,
            doa=own["doa"],
            method=method,
            settings=values,
            only=parse_names(only),
            without=parse_names(without),
            window_ns=None if window is None else parse_window(window),
            seed=seed,
            gallery=own["gallery"],
        )
        people = PeopleFiles(output, own["support"], own["events"], own["view_tracks"])
        check_outputs(crowd.paths, people.paths, overwrite)
        found, lost = run_track_people(crowd, people, overwrite, quiet)
        return console.strict_code(console.finish(found, lost, as_json), found["plausible"], own["strict"])
    if METHODS[method].takes_in == READS:
        from .readers.inputs import ReadsRequest
        from .readers.run import ReadsFiles, run_track_reads

        reads = ReadsRequest(
            reads=bearings,
            scene=scene,
            method=method,
            settings=values,
            targets=own["targets"],
            only=parse_names(only),
            without=parse_names(without),
            window_ns=None if window is None else parse_window(window),
            seed=seed,
            path_loss=own["path_loss"],
            sights=own["sights"],
        )
        tags = ReadsFiles(output, own.get("virtual_sensors"))
        check_outputs(reads.paths, tags.paths, overwrite)
        located, lost = run_track_reads(reads, tags, overwrite, quiet)
        return console.strict_code(console.finish(located, lost, as_json), located["plausible"], own["strict"])
    from .run import TrackFiles, TrackRequest, run_track

    request = TrackRequest(
        bearings=bearings,
        scene=scene,
        doa=own["doa"],
        method=method,
        settings=values,
        starts=own.get("starts", ()),
        targets=own["targets"],
        unlabelled=not own["labelled_only"],
        only=parse_names(only),
        without=parse_names(without),
        window_ns=parse_window(window or 0.0),
        seed=seed,
        occluders=own.get("occluders"),
        selection=given(SelectConfig, own),
        doa_labels=own["doa_labels"],
        turn_s=own["turn"],
        motion=own.get("motion"),
        use_recovered=own["use_recovered"],
        answer_delay=own.get("answer_delay"),
        measurements=own.get("measurements"),
        measured=given(MeasuredConfig, own),
        path_loss=own.get("path_loss"),
    )
    outputs = TrackFiles(
        tracks=output,
        diagnostics=own["diagnostics"],
        calibration=own.get("calibration"),
        cooperation=own.get("cooperation"),
        residuals=own["residuals"],
        cloud=own.get("cloud"),
    )
    check_outputs(request.paths, outputs.paths, overwrite)
    summary, losses = run_track(request, outputs, overwrite, quiet)
    code = console.finish(summary, losses, as_json)
    return console.strict_code(code, summary["plausible"], own["strict"])
