"""The `occlog evaluate` command."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from occlog.cli import options
from occlog.cli.numbers import AT_LEAST_0, POSITIVE, Finite
from occlog.errors import ExitCode
from occlog.evaluate.mot.options import check_ground_options, check_image_options, given_names, many_options

if TYPE_CHECKING:
    from .inputs import Paths

F = TypeVar("F", bound=Callable[..., Any])

# Every option of this list is a field of EvaluateConfig; its default is stated there.
SETTINGS = (
    click.option(
        "--max-gap",
        "max_gap_s",
        type=AT_LEAST_0,
        default=1.0,
        show_default=True,
        metavar="SECONDS",
        help="Interpolate between samples at most this far apart; nothing is extrapolated.",
    ),
    click.option(
        "--match",
        type=click.Choice(["id", "optimal"]),
        default="id",
        show_default=True,
        help="Tracks to true targets: by equal numbers, or so that the overall RMSE is least.",
    ),
    click.option(
        "--skip-seconds",
        "skip_s",
        type=AT_LEAST_0,
        default=0.0,
        metavar="SECONDS",
        help="Give `settled_` figures too, without this much after each target's first estimate.",
    ),
    click.option(
        "--from",
        "from_ns",
        type=int,
        default=None,
        metavar="T_NS",
        help="Give `settled_` figures too, from this time on [ns since 1970].",
    ),
    click.option(
        "--gate-sigma",
        type=POSITIVE,
        default=4.0,
        show_default=True,
        help="A bearing this many standard deviations from the truth is still of the target.",
    ),
    click.option(
        "--gate-px", type=POSITIVE, default=None, help="The same in pixels, for cameras, instead of --gate-sigma."
    ),
    click.option(
        "--occluder-diameter",
        type=POSITIVE,
        default=None,
        metavar="LENGTH",
        help="Moving objects of the truth hide what is behind them. [default: that of `simulate` if it "
        "made the truth, else they hide nothing]",
    ),
    click.option(
        "--motion",
        type=click.Choice(["waypoint", "cv"]),
        default="waypoint",
        show_default=True,
        help="Motion of the bound: a walk whose drift is known, or constant velocity with noise.",
    ),
    click.option(
        "--sigma-v",
        type=AT_LEAST_0,
        default=None,
        metavar="LENGTH",
        help="Noise of the walk, per axis, after 1 s. [default: that of `simulate` if it made the truth, "
        "else 0.05 m, or 0.33 in units of its own]",
    ),
    click.option(
        "--acceleration-density",
        type=AT_LEAST_0,
        default=1.0,
        show_default=True,
        help="Of --motion cv [length^2 / s^3].",
    ),
    click.option(
        "--sigma-speed",
        type=POSITIVE,
        default=1.5,
        show_default=True,
        help="Prior of each velocity component, --motion cv [length / s].",
    ),
    click.option(
        "--prior",
        "prior_cov",
        type=(float, float, float),
        default=None,
        metavar="XX XY YY",
        help="Covariance of the position at the first look. [default: anywhere in the room]",
    ),
    click.option(
        "--prior-z",
        "prior_z",
        type=POSITIVE,
        default=None,
        metavar="ZZ",
        help="Variance of the height at the first look, for a bound in space. [default: anywhere below the "
        "room's ceiling]",
    ),
    click.option(
        "--bound-in",
        type=click.Choice(["auto", "ground", "space"]),
        default="auto",
        show_default=True,
        help="Bound of (x, y) from azimuths, or of (x, y, z) from elevations too; auto: in space for "
        "targets whose track and truth have heights.",
    ),
    click.option(
        "--held-out",
        multiple=True,
        metavar="SENSOR",
        help="Predict this sensor from tracks made without it; may be repeated.",
    ),
    click.option(
        "--held-out-gate-mrad",
        "held_out_gate",
        type=POSITIVE,
        default=50.0,
        show_default=True,
        help="A bearing this near to the prediction counts as predicted.",
    ),
    click.option(
        "--lines-min-sensors",
        type=click.IntRange(min=2),
        default=2,
        show_default=True,
        help="Sight lines that must meet for a scan to be compared with the track.",
    ),
    click.option(
        "--lines-window",
        "lines_window_s",
        type=AT_LEAST_0,
        default=0.0,
        metavar="SECONDS",
        help="Looks this close together in time make one scan. [default: equal times]",
    ),
    click.option(
        "--lines-loss",
        type=click.Choice(["gauss", "huber", "cauchy"]),
        default="huber",
        show_default=True,
        help="How lines that miss the others count.",
    ),
    click.option(
        "--lines-limit",
        type=POSITIVE,
        default=None,
        metavar="LENGTH",
        help="Give the share of scans in which the track is this near to the meeting point.",
    ),
    click.option(
        "--lines-crossing-deg",
        "lines_min_crossing",
        type=AT_LEAST_0,
        default=5.0,
        show_default=True,
        help="Refuse scans whose lines cross at smaller angles.",
    ),
    click.option(
        "--box-overlap",
        type=Finite(0, 1, min_open=True),
        default=0.5,
        show_default=True,
        help="Intersection over union from which a view or a track is of a true box.",
    ),
)


def settings(command: F) -> F:
    """Add all of SETTINGS, in order."""
    for option in reversed(SETTINGS):
        command = option(command)
    return command


@click.command(name="evaluate", short_help="Compare tracks with the truth and with the Cramer-Rao bound.")
@click.argument("tracks", type=options.PATH, required=False)
@click.option(
    "--truth",
    type=options.PATH,
    default=None,
    help="True positions or boxes: a recording or a table, or MOTChallenge text.",
)
@click.option("--bearings", type=options.PATH, default=None, help="Bearings: for detections, bound, sight lines.")
@click.option(
    "--doa",
    type=options.PATH,
    default=None,
    help="Directions of arrival to use along with the bearings. [default: those of the same recording]",
)
@click.option("--doa-labels", is_flag=True, help="Identities in the log of directions are those of targets.")
@click.option(
    "--truth-azimuths",
    type=options.PATH,
    default=None,
    help="True directions to compare those of --doa with: a log (time, azimuth_deg) or a table.",
)
@click.option(
    "--doa-gate",
    "doa_gate_deg",
    type=Finite(0, 180),
    default=10.0,
    show_default=True,
    metavar="DEGREES",
    help="A direction further from the truth is a false one, and the true one missed.",
)
@click.option("--views", type=options.PATH, default=None, help="Views to compare with the true boxes of --truth.")
@click.option("--cooperation", type=options.PATH, default=None, help="What cameras were asked; gives its cost too.")
@options.scene_opt
@options.output_opt("All figures as one JSON object.", required=False)
@click.option("--errors", type=options.PATH, default=None, help="Write the error of every estimate (Parquet).")
@click.option("--bound", type=options.PATH, default=None, help="Write the posterior Cramer-Rao bound (Parquet).")
@click.option(
    "--fail-if",
    multiple=True,
    metavar="CONDITION",
    help="Exit code 6 if this holds or cannot be told, e.g. 'rmse>0.5'; may be repeated.",
)
@settings
@many_options
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(**given: Any) -> int:
    """Compare TRACKS with the truth, with the bound, and with the bearings that they were made from.

    Whatever the given files allow is computed: errors (tracks and truth), detections and the
    posterior Cramer-Rao bound (bearings and truth), distance of the tracks from where sight
    lines meet and prediction of held-out sensors (no truth needed), recall of views (true boxes).
    TRACKS of many targets, in images (view_tracks, boxes with identities, MOTChallenge text) or on
    the ground, get CLEAR-MOT, IDF1, HOTA, GOSPA, and the failure rates of [Qu] Eq. 9.

    \b
      occlog evaluate tracks.parquet --truth recording.mcap --bearings bearings.parquet \\
          -o metrics.json --errors errors.parquet --bound bound.parquet --fail-if 'rmse>0.5'
      occlog evaluate without_cam4.parquet --bearings all.parquet --scene scene.yaml --held-out cam4
      occlog evaluate --views views.parquet --truth recording.mcap --json | jq .views_recall
      occlog evaluate --doa doa.parquet --truth-azimuths azimuths.csv
      occlog evaluate view_tracks.parquet --truth recording.mcap --failures failures.parquet
      occlog evaluate test.txt --truth gt.txt --fail-if 'mota<0.5'
    """
    from occlog.evaluate.mot.run import in_images, run_evaluate_many

    from .inputs import Paths
    from .run import run_evaluate
    from .stage import parse_threshold

    thresholds = [parse_threshold(text) for text in given.pop("fail_if")]
    as_json, quiet = given.pop("as_json"), given.pop("quiet")
    azimuths, gate = given.pop("truth_azimuths"), given.pop("doa_gate_deg")
    paths = Paths(**{name: given.pop(name) for name in Paths.__annotations__})
    if azimuths is not None:
        figures = _azimuths(paths, azimuths, gate, given["max_gap_s"])
        options.echo_summary(figures, as_json)
        return _judged(figures, thresholds)
    names = given_names()
    if in_images(paths.tracks):
        check_image_options(names)
        result, unit = run_evaluate_many(paths, given), "px"
    else:
        check_ground_options(names, paths.tracks is not None and paths.truth is not None)
        result, unit = run_evaluate(paths, given)
    for line in result.notes:
        options.note(line, quiet)
    _show(result.metrics, unit, as_json)
    code = _judged(result.metrics, thresholds)
    for path in (paths.output, paths.errors, paths.bound, paths.failures, paths.mot):
        if path is not None:
            options.note(f"wrote {path}", quiet)
    return code


def _azimuths(paths: Paths, azimuths: Path, gate_deg: float, max_gap_s: float) -> dict[str, Any]:
    """Directions against true ones; UsageError where anything else is to be compared too."""
    from occlog.evaluate.bearings.command import run_evaluate_doa

    others = (paths.tracks, paths.truth, paths.bearings, paths.views, paths.errors, paths.bound, paths.failures)
    if any(path is not None for path in (*others, paths.mot)):
        raise click.UsageError("--truth-azimuths goes with --doa and nothing else to compare")
    return run_evaluate_doa(paths.doa, azimuths, paths.output, gate_deg, max_gap_s, paths.overwrite)


def _show(metrics: Mapping[str, float], unit: str, as_json: bool) -> None:
    if as_json:
        options.echo_summary(metrics, True)
        return
    from .text import summary_lines

    click.echo("\n".join(summary_lines(metrics, unit)))


def _judged(metrics: Mapping[str, Any], thresholds: list[Any]) -> int:
    """Exit code 6 if a threshold was broken, each told in a line."""
    from .stage import failures

    broken = failures(metrics, thresholds)
    for line in broken:
        click.echo(f"occlog: {line}", err=True)
    return ExitCode.THRESHOLD if broken else ExitCode.DONE
