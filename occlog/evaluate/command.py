"""The `occlog evaluate` command."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import TYPE_CHECKING, Any

import click

from occlog import console
from occlog.cli import options
from occlog.cli.plugged import PluggedCommand, chosen_in
from occlog.cli.setting_options import given, with_options
from occlog.console.summary import plausible_in_words
from occlog.errors import ExitCode, UsageError
from occlog.plugins.loading import METRIC
from occlog.settings import configure

from .matching.config import AZIMUTHS, GROUND, IMAGES, OTHERS, WORLD, EvaluateConfig
from .mot.config import ManyConfig
from .options import COMPARED, OF_MANY, WRITTEN, KindOption, check_kind, given_in, with_all

if TYPE_CHECKING:
    from occlog.records.losses import Loss

    from .inputs import Paths
    from .results import Evaluation, Threshold


@click.command(
    cls=PluggedCommand,
    flag="--metric",
    kind=METRIC,
    name="evaluate",
    short_help="Compare tracks with the truth and with the Cramer-Rao bound.",
)
@click.argument("tracks", type=options.INPUT, required=False)
@with_all(COMPARED)
@options.output_opt("All figures as one JSON object.", required=False)
@with_all(WRITTEN)
@click.option(
    "--fail-if",
    multiple=True,
    metavar="CONDITION",
    help="Exit code 6 if this holds or cannot be told, e.g. 'rmse>0.5'; may be repeated.",
)
@click.option(
    "--metric",
    "metrics",
    cls=KindOption,
    kinds=(GROUND,),
    multiple=True,
    metavar="NAME",
    help="The figures of this plug-in too; may be repeated.",
)
@with_options(EvaluateConfig)
@with_options(ManyConfig)
@with_all(OF_MANY)
@click.option("--strict", cls=KindOption, kinds=WORLD, is_flag=True, help=options.STRICT_HELP)
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(**values: Any) -> int:
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
      occlog evaluate a.txt --truth gt_a.txt --also b.txt gt_b.txt
    """
    from occlog.evaluate.mot.run import in_images, run_evaluate_many
    from occlog.records.verdicts import all_plausible, texts_of

    from .by_plugin import names_of_figures
    from .inputs import Paths, lost_earlier
    from .run import run_evaluate, run_evaluate_doa

    context = click.get_current_context()
    plugged = chosen_in(context, values)
    thresholds = _thresholds(values["fail_if"], names_of_figures(plugged))
    as_json, quiet, azimuths = values["as_json"], values["quiet"], values["truth_azimuths"]
    paths = Paths(**{name: values[name] for name in Paths.__annotations__})
    chosen, many = given(EvaluateConfig, values), given(ManyConfig, values)
    kind = AZIMUTHS
    if azimuths is None:
        on_ground = GROUND if paths.tracks is not None and paths.truth is not None else OTHERS
        kind = IMAGES if in_images(paths.tracks) else on_ground
    check_kind(context.command.params, given_in(context), kind)
    config = configure(EvaluateConfig(), chosen)
    if azimuths is not None:
        figures, losses = run_evaluate_doa(paths, azimuths, values["doa_gate_deg"], config.bridge_s)
        _note_losses(losses, quiet)
        console.echo_summary(figures, as_json)
        return _judged(figures, thresholds)
    if values["also"]:
        return _several(paths, values, config, many, thresholds)
    if kind == IMAGES:
        frames = {} if values["frames"] is None else {"frames": values["frames"]}
        result, unit = run_evaluate_many(paths, config.box_overlap, {**many, **frames}), "px"
    else:
        result, unit = run_evaluate(paths, chosen, many, values["frames"], plugged)
    for line in result.notes:
        console.note(line, quiet)
    _note_losses(lost_earlier(paths.inputs), quiet)
    console.note_findings(texts_of(result.verdicts, "evaluate"), quiet)
    _show(result, unit, as_json)
    code = _judged(result.metrics, thresholds)
    code = console.strict_code(code, all_plausible(result.verdicts), values["strict"])
    for path in (paths.output, paths.errors, paths.bound, paths.write_scene, paths.failures, paths.counts, paths.mot):
        if path is not None:
            console.note(f"wrote {path}", quiet)
    return code


ALONE = (
    "bearings",
    "measurements",
    "doa",
    "views",
    "cooperation",
    "diagnostics",
    "errors",
    "bound",
    "failures",
    "counts",
    "mot",
)
"""Files of one recording."""


def _several(
    paths: Paths, values: dict[str, Any], config: EvaluateConfig, many: dict[str, Any], thresholds: list[Threshold]
) -> int:
    """Figures of several recordings."""
    from occlog.records.verdicts import summary_of, texts_of

    from .several import Recording, run_evaluate_several
    from .text import recording_lines

    if values["metrics"]:
        raise UsageError("--metric is of one recording; leave out --also")
    for name in ALONE:
        if getattr(paths, name) is not None:
            raise UsageError(f"--{name} is of one recording; leave out --also")
    if paths.tracks is None or paths.truth is None:
        raise UsageError("--also wants TRACKS with --truth beside it")
    recordings = [Recording(paths.tracks, paths.truth), *(Recording(*pair) for pair in values["also"])]
    found = run_evaluate_several(recordings, paths, config, many, values["frames"])
    _note_losses(found.losses, values["quiet"])
    console.note_findings(texts_of(found.verdicts, "evaluate"), values["quiet"])
    verdict = summary_of(found.verdicts)
    if values["as_json"]:
        console.echo_summary({**found.metrics, **verdict}, True)
    else:
        click.echo("\n".join(recording_lines(found.each, found.combined, found.unit)))
        if verdict:
            click.echo(f"\nplausible: {plausible_in_words(verdict)}")
    if paths.output is not None:
        console.note(f"wrote {paths.output}", values["quiet"])
    code = _judged(found.metrics, thresholds)
    return console.strict_code(code, verdict.get("plausible"), values["strict"])


def _note_losses(losses: Iterable[Loss], quiet: bool) -> None:
    for loss in losses:
        console.note(f"lost earlier: {loss}", quiet)


def _show(result: Evaluation, unit: str, as_json: bool) -> None:
    from .mot import headline
    from .text import LABEL, number, summary_lines, thinned

    own = headline.own_identities(result.metrics)
    if as_json:
        console.echo_summary(thinned(result.figures), True, headline.first_of(result.metrics) if own else ())
        return
    lines = summary_lines(result.metrics, unit)
    if result.plugged:
        lines += ["", "plug-ins", *(f"  {name:<{LABEL}}{number(result.metrics[name]):>12}" for name in result.plugged)]
    if result.verdicts:
        lines += ["", f"plausible: {plausible_in_words(result.figures)}"]
    click.echo("\n".join(lines))


def _thresholds(texts: Iterable[str], more: Collection[str]) -> list[Threshold]:
    """Conditions of --fail-if; UsageError for a text that is none, and for a metric that no evaluation gives.

    `more` are names of figures of plug-ins.
    """
    from .figures import hint_if_unknown
    from .results import parse_threshold

    found = []
    for text in texts:
        try:
            found.append(parse_threshold(text))
        except UsageError as error:
            raise UsageError(f"--fail-if {error}") from error
        hint = hint_if_unknown(found[-1].metric, more)
        if hint is not None:
            raise UsageError(f"--fail-if {text!r}: there is no metric {found[-1].metric!r}; {hint}")
    return found


def _judged(metrics: Mapping[str, float], thresholds: Iterable[Threshold]) -> int:
    """Exit code 6 if a threshold was broken, each told in a line."""
    from .results import failures

    broken = failures(metrics, thresholds)
    for line in broken:
        click.echo(f"occlog: --fail-if {line}", err=True)
    return ExitCode.THRESHOLD if broken else ExitCode.DONE
