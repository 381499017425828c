"""The `occlog evaluate` command."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from ..errors import ExitCode, InputError, UsageError
from . import options

if TYPE_CHECKING:
    from ..columns import Table
    from ..io.provenance import Provenance
    from ..records import Bearings, Tracks, Truth, TruthBoxes, Views
    from ..scene import Scene
    from ..stages.evaluate import EvaluateConfig, Evaluation

F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T", bound="Table")
POSITIVE = click.FloatRange(min=0, min_open=True)
AT_LEAST_0 = click.FloatRange(min=0)

# Every option of this list is a field of EvaluateConfig; its default is stated there.
SETTINGS = (
    click.option("--max-gap", "max_gap_s", type=AT_LEAST_0, default=1.0, show_default=True, metavar="SECONDS",
                 help="Interpolate between samples at most this far apart; nothing is extrapolated."),
    click.option("--match", type=click.Choice(["id", "optimal"]), default="id", show_default=True,
                 help="Tracks to true targets: by equal numbers, or so that the overall RMSE is least."),
    click.option("--skip-seconds", "skip_s", type=AT_LEAST_0, default=0.0, metavar="SECONDS",
                 help="Give `settled_` figures too, without this much after each target's first estimate."),
    click.option("--from", "from_ns", type=int, default=None, metavar="T_NS",
                 help="Give `settled_` figures too, from this time on [ns since 1970]."),
    click.option("--gate-sigma", type=POSITIVE, default=4.0, show_default=True,
                 help="A bearing this many standard deviations from the truth is still of the target."),
    click.option("--gate-px", type=POSITIVE, default=None,
                 help="The same in pixels, for cameras, instead of --gate-sigma."),
    click.option("--occluder-diameter", type=POSITIVE, default=None, metavar="LENGTH",
                 help="Moving objects of the truth hide what is behind them. [default: that of `simulate` if it "
                      "made the truth, else they hide nothing]"),
    click.option("--motion", type=click.Choice(["waypoint", "cv"]), default="waypoint", show_default=True,
                 help="Motion of the bound: a walk whose drift is known, or constant velocity with noise."),
    click.option("--sigma-v", type=AT_LEAST_0, default=None, metavar="LENGTH",
                 help="Noise of the walk, per axis, after 1 s. [default: that of `simulate` if it made the truth, "
                      "else 0.05 m, or 0.33 in units of its own]"),
    click.option("--acceleration-density", type=AT_LEAST_0, default=1.0, show_default=True,
                 help="Of --motion cv [length^2 / s^3]."),
    click.option("--sigma-speed", type=POSITIVE, default=1.5, show_default=True,
                 help="Prior of each velocity component, --motion cv [length / s]."),
    click.option("--prior", "prior_cov", type=(float, float, float), default=None, metavar="XX XY YY",
                 help="Covariance of the position at the first look. [default: anywhere in the room]"),
    click.option("--held-out", multiple=True, metavar="SENSOR",
                 help="Predict this sensor from tracks made without it; may be repeated."),
    click.option("--held-out-gate-mrad", "held_out_gate", type=POSITIVE, default=50.0, show_default=True,
                 help="A bearing this near to the prediction counts as predicted."),
    click.option("--lines-min-sensors", type=click.IntRange(min=2), default=2, show_default=True,
                 help="Sight lines that must meet for a scan to be compared with the track."),
    click.option("--lines-window", "lines_window_s", type=AT_LEAST_0, default=0.0, metavar="SECONDS",
                 help="Looks this close together in time make one scan. [default: equal times]"),
    click.option("--lines-loss", type=click.Choice(["gauss", "huber", "cauchy"]), default="huber", show_default=True,
                 help="How lines that miss the others count."),
    click.option("--lines-limit", type=POSITIVE, default=None, metavar="LENGTH",
                 help="Give the share of scans in which the track is this near to the meeting point."),
    click.option("--lines-crossing-deg", "lines_min_crossing", type=AT_LEAST_0, default=5.0, show_default=True,
                 help="Refuse scans whose lines cross at smaller angles."),
    click.option("--box-overlap", type=click.FloatRange(0, 1, min_open=True), default=0.5, show_default=True,
                 help="Intersection over union from which a view is of a true box."),
)  # fmt: skip


def settings(command: F) -> F:
    """Add all of SETTINGS, in order."""
    for option in reversed(SETTINGS):
        command = option(command)
    return command


@click.command(name="evaluate", short_help="Compare tracks with the truth and with the Cramer-Rao bound.")
@click.argument("tracks", type=options.PATH, required=False)
@click.option("--truth", type=options.PATH, default=None, help="True positions or boxes: a recording or a table.")
@click.option("--bearings", type=options.PATH, default=None, help="Bearings: for detections, bound, sight lines.")
@click.option("--views", type=options.PATH, default=None, help="Views to compare with the true boxes of --truth.")
@options.scene_opt
@options.output_opt("All figures as one JSON object.", required=False)
@click.option("--errors", type=options.PATH, default=None, help="Write the error of every estimate (Parquet).")
@click.option("--bound", type=options.PATH, default=None, help="Write the posterior Cramer-Rao bound (Parquet).")
@click.option("--fail-if", multiple=True, metavar="CONDITION",
              help="Exit code 6 if this holds or cannot be told, e.g. 'rmse>0.5'; may be repeated.")  # fmt: skip
@settings
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(**given: Any) -> int:
    """Compare TRACKS with the truth, with the bound, and with the bearings that they were made from.

    Whatever the given files allow is computed: errors (tracks and truth), detections and the
    posterior Cramer-Rao bound (bearings and truth), distance of the tracks from where sight
    lines meet and prediction of held-out sensors (no truth needed), recall of views (true boxes).

    \b
      occlog evaluate tracks.parquet --truth recording.mcap --bearings bearings.parquet \\
          -o metrics.json --errors errors.parquet --bound bound.parquet --fail-if 'rmse>0.5'
      occlog evaluate without_cam4.parquet --bearings all.parquet --scene scene.yaml --held-out cam4
      occlog evaluate --views views.parquet --truth recording.mcap --json | jq .views_recall
    """
    from ..stages.evaluate import failures, parse_threshold

    thresholds = [parse_threshold(text) for text in given.pop("fail_if")]
    as_json, quiet = given.pop("as_json"), given.pop("quiet")
    paths = Paths(**{name: given.pop(name) for name in Paths.__annotations__})
    result, unit = run_evaluate(paths, given)
    if as_json:
        options.echo_summary(result.metrics, True)
    else:
        from .evaluate_text import summary_lines

        click.echo("\n".join(summary_lines(result.metrics, unit)))
    broken = failures(result.metrics, thresholds)
    for line in broken:
        click.echo(f"occlog: {line}", err=True)
    for path in (paths.output, paths.errors, paths.bound):
        if path is not None:
            options.note(f"wrote {path}", quiet)
    return ExitCode.THRESHOLD if broken else ExitCode.DONE


@dataclass(frozen=True)
class Paths:
    """Files to read and to write; None where not given."""

    tracks: Path | None = None
    truth: Path | None = None
    bearings: Path | None = None
    views: Path | None = None
    scene: Path | None = None
    output: Path | None = None
    errors: Path | None = None
    bound: Path | None = None
    overwrite: bool = False

    @property
    def inputs(self) -> tuple[Path, ...]:
        """Every file that is read."""
        given = (self.tracks, self.truth, self.bearings, self.views, self.scene)
        return tuple(dict.fromkeys(p for p in given if p is not None))


@dataclass(frozen=True)
class Tables:
    """What was read."""

    scene: Scene
    tracks: Tracks | None
    truth: Truth | None
    truth_boxes: TruthBoxes | None
    bearings: Bearings | None
    views: Views | None


def run_evaluate(paths: Paths, values: Mapping[str, Any]) -> tuple[Evaluation, str]:
    """Read, evaluate, write; the evaluation and the scene's length unit.

    Args:
        paths: inputs and outputs; outputs are written whole or not at all.
        values: fields of EvaluateConfig as the options give them (degrees, milliradians).
    """
    from ..stages.evaluate import evaluate

    _check_request(paths, values)
    options.check_outputs(paths.inputs, (paths.output, paths.errors, paths.bound), paths.overwrite)
    t = read_tables(paths)
    config = make_config(with_defaults(values, paths.truth, t.scene.length_unit))
    _check_held_out(paths.tracks, config.held_out)
    result = evaluate(
        t.tracks, t.truth, t.bearings, t.scene, config, views=t.views, truth_boxes=t.truth_boxes
    )  # fmt: skip
    if not result.metrics:
        raise UsageError("nothing to compare: the files hold no rows that belong together")
    _write(paths, result, t.scene.length_unit, config)
    return result, t.scene.length_unit


def _check_request(paths: Paths, values: Mapping[str, Any]) -> None:
    if paths.views is not None and paths.truth is None:
        raise UsageError("--views needs --truth with true boxes")
    if paths.tracks is None and paths.views is None and (paths.bearings is None or paths.truth is None):
        raise UsageError("nothing to compare: give TRACKS with --truth or --bearings, or --bearings with --truth")
    if paths.tracks is not None and paths.truth is None and paths.bearings is None:
        raise UsageError("TRACKS alone cannot be evaluated; give --truth, --bearings or both")
    if values.get("held_out") and (paths.tracks is None or paths.bearings is None):
        raise UsageError("--held-out needs TRACKS made without that sensor and --bearings that include it")


def with_defaults(values: Mapping[str, Any], truth: Path | None, unit: str) -> dict[str, Any]:
    """The values, with noise of the walk and diameter of the simulation that made the truth where none are given."""
    from ..io.recording import open_recording
    from ..stages.evaluate_config import default_sigma_v

    out = dict(values)
    if truth is not None and truth.suffix.lower() == ".mcap":
        made = open_recording(truth).provenance
        world = made.parameters.get("world") if made.command == "simulate" else None
        for name, known in (("sigma_v", "sigma"), ("occluder_diameter", "diameter")):
            value = world.get(known) if isinstance(world, dict) else None
            if out[name] is None and isinstance(value, int | float):
                out[name] = float(value)
    if out["sigma_v"] is None:
        out["sigma_v"] = default_sigma_v(unit)
    return out


def make_config(values: Mapping[str, Any]) -> EvaluateConfig:
    """Configuration from option values: degrees and milliradians become radians, names may have commas."""
    from ..stages.evaluate import EvaluateConfig

    fields = dict(values)
    fields["lines_min_crossing"] = math.radians(fields["lines_min_crossing"])
    fields["held_out_gate"] = 1e-3 * fields["held_out_gate"]
    fields["held_out"] = tuple(name for text in fields["held_out"] for name in text.split(",") if name)
    return EvaluateConfig(**fields)


def read_tables(paths: Paths) -> Tables:
    """Everything that was named, with the scene of `--scene` or of the recording with the truth."""
    from ..records import Bearings, Tracks, Views

    truth, boxes, recorded = _read_truth(paths.truth) if paths.truth is not None else (None, None, None)
    scene = _scene(paths, recorded)
    for path in (paths.tracks, paths.truth):
        _check_unit(path, scene)
    if paths.views is not None and boxes is None:
        raise InputError(f"{paths.truth}: holds no true boxes; --views needs a recording or a table that has them")
    return Tables(
        scene,
        _read_rows(paths.tracks, Tracks),
        truth,
        boxes,
        _read_rows(paths.bearings, Bearings),
        _read_rows(paths.views, Views),
    )


def _scene(paths: Paths, recorded: Scene | None) -> Scene:
    """The scene of `--scene` or of the recording; views are compared without one."""
    from ..scene import Scene

    if paths.tracks is None and paths.bearings is None and paths.scene is None:
        return recorded or Scene()
    if recorded is None and paths.scene is None and paths.bearings and paths.bearings.suffix.lower() == ".mcap":
        recorded = options.read_scene_of(paths.bearings)
    return options.load_scene(paths.scene, recorded, paths.truth or paths.inputs[0])


def _read_rows(path: Path | None, table: type[T]) -> T | None:
    """All rows of a table in a Parquet file or a recording."""
    from ..io.parquet import read_table
    from ..io.recording import open_recording

    if path is None:
        return None
    if path.suffix.lower() != ".mcap":
        return read_table(path, table)
    recording = open_recording(path)
    if not recording.has(table):
        raise InputError(f"{path}: holds no {table.NAME}; give a recording or a table that has them")
    return recording.read(table)


def _read_truth(path: Path) -> tuple[Truth | None, TruthBoxes | None, Scene | None]:
    """True positions and boxes, None where there are none, and the scene of a recording."""
    from ..io.parquet import read_table, schema_name
    from ..io.recording import open_recording
    from ..records import Truth, TruthBoxes

    if path.suffix.lower() == ".mcap":
        recording = open_recording(path)
        truth = recording.read(Truth) if recording.has(Truth) else None
        boxes = recording.read(TruthBoxes) if recording.has(TruthBoxes) else None
        if truth is None and boxes is None:
            raise InputError(f"{path}: holds no truth; leave out --truth, or ingest the recording with its truth")
        return truth, boxes, recording.scene
    if schema_name(path) == TruthBoxes.NAME:
        return None, read_table(path, TruthBoxes), None
    return read_table(path, Truth), None, None


def _check_unit(path: Path | None, scene: Scene) -> None:
    """InputError if a table or a recording is in another unit than the scene."""
    from ..io.parquet import describe

    if path is None:
        return
    if path.suffix.lower() == ".mcap":
        other = options.read_scene_of(path)
        unit = scene.length_unit if other is None else other.length_unit
    else:
        unit = describe(path)["length_unit"]
    if unit != scene.length_unit:
        raise InputError(
            f"{path}: lengths are in {unit}, but in {scene.length_unit} in the scene; use one scene for both"
        )


def _check_held_out(tracks: Path | None, held_out: tuple[str, ...]) -> None:
    """InputError if the tracks say that they were made with a sensor that is held out."""
    from ..io.parquet import read_provenance

    if tracks is None or not held_out or tracks.suffix.lower() == ".mcap":
        return
    used = read_provenance(tracks).parameters.get("sensors")
    both = [name for name in held_out if isinstance(used, list) and name in used]
    if both:
        names = ",".join(both)
        raise InputError(f"{tracks}: was made with {names}; make it again with `occlog track --without {names}`")


def _write(paths: Paths, result: Evaluation, unit: str, config: EvaluateConfig) -> None:
    from ..io.json_file import write_json
    from ..io.parquet import write_table

    provenance = _provenance(paths, config)
    for path, table in ((paths.errors, result.errors), (paths.bound, result.bound)):
        if path is not None:
            write_table(path, table, provenance, overwrite=paths.overwrite, length_unit=unit)
    if paths.output is not None:
        values = {**result.metrics, "_provenance": provenance.as_dict()}
        write_json(paths.output, values, overwrite=paths.overwrite)


def _provenance(paths: Paths, config: EvaluateConfig) -> Provenance:
    from dataclasses import asdict

    from ..io.parquet import read_provenance
    from ..io.provenance import Provenance, hash_inputs
    from ..io.recording import open_recording

    losses: dict[Any, None] = {}  # of all inputs, each once, in order
    for path in paths.inputs:
        kind = path.suffix.lower()
        if kind == ".mcap":
            losses |= dict.fromkeys(open_recording(path).losses)
        elif kind == ".parquet":
            losses |= dict.fromkeys(read_provenance(path).losses)
    return Provenance("evaluate", asdict(config), None, hash_inputs(paths.inputs), tuple(losses))
