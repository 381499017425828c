"""`evaluate` in Python: tracks against truth, bound and bearings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from occlog import console
from occlog.errors import UsageError
from occlog.records.verdicts import texts_of

from .folders import Folder
from .keywords import Setting, settings_by_class
from .results import EvaluateResult, TrackResult, sentences, tables_in, warn
from .sources import Inputs, SceneSource, Source

if TYPE_CHECKING:
    from pathlib import Path

    from occlog.evaluate.inputs import Paths
    from occlog.plugins.chosen import Chosen

SOURCES = ("tracks", "truth", "bearings", "doa", "measurements", "views", "cooperation", "diagnostics")
TABLES = ("errors", "bound")
OF_MANY = ("failures", "counts")
"""Tables on request, of many targets."""


def evaluate(
    tracks: Source | TrackResult | None = None,
    truth: Source | None = None,
    *,
    bearings: Source | None = None,
    doa: Source | None = None,
    doa_labels: bool = False,
    truth_azimuths: Source | None = None,
    doa_gate_deg: float | None = None,
    measurements: Source | None = None,
    views: Source | None = None,
    cooperation: Source | None = None,
    diagnostics: Source | None = None,
    scene: SceneSource | None = None,
    frames: tuple[int, int] | None = None,
    also: tuple[str, ...] = (),
    metrics: Sequence[str] | Mapping[str, Mapping[str, Setting]] = (),
    **settings: Setting,
) -> EvaluateResult:
    """Compare tracks with the truth, with the Cramer-Rao bound, and with their bearings, as `occlog evaluate` does.

    What the given inputs allow is computed.

    Args:
        tracks: tracks in the world or in images; a result of `track` brings its diagnostics along.
        truth: true positions or boxes.
        bearings: for detections, bound and sight lines.
        doa: directions of arrival to use along with the bearings.
        doa_labels: identities in the log of directions are those of targets.
        truth_azimuths: true directions, to compare `doa` with and nothing else.
        doa_gate_deg: a direction further from the true one is false, and the true one missed; None: 10.
        measurements: ranges, signal strengths and time differences: for the bound.
        views: to compare with true boxes; with `held_out` views or boxes of all people.
        cooperation: what cameras were asked.
        diagnostics: how the filter fared.
        scene: where the sensors are; None: that of the recording with the truth or the bearings.
        frames: only frames first <= number < stop.
        also: more tables, of many targets: failures, counts (on the ground).
        metrics: names of metrics of plug-ins, or their settings by these names; for tracks on the ground with truth.
        **settings: by the names of the options: `match`, `held_out`, `sigma_v`, `match_distance` and the others.

    Returns:
        The figures, and the tables `errors` and `bound` where there are any.

    Raises:
        UsageError: an argument or a setting that there is not, or that these inputs do not have.
        InputError: an input is missing, damaged, or says something that cannot be.

    Warns:
        OcclogWarning: the tracks are not plausible.
    """
    from occlog.evaluate.command import command
    from occlog.evaluate.inputs import Paths, provenance_of
    from occlog.evaluate.matching.config import AZIMUTHS, GROUND, IMAGES, OTHERS, EvaluateConfig
    from occlog.evaluate.mot.config import ManyConfig
    from occlog.evaluate.mot.run import in_images, run_evaluate_many
    from occlog.evaluate.options import check_kind
    from occlog.evaluate.run import run_evaluate
    from occlog.settings import configure

    plugged = _chosen(metrics)
    if isinstance(tracks, TrackResult):
        diagnostics = tracks.tables.get("diagnostics") if diagnostics is None else diagnostics
        tracks = tracks.tracks
    sources = (tracks, truth, bearings, doa, measurements, views, cooperation, diagnostics)
    given: dict[str, Source | None] = dict(zip(SOURCES, sources, strict=True))
    classes = [("", EvaluateConfig), ("", ManyConfig)]
    chosen, many = settings_by_class("evaluate", settings, classes, (*SOURCES, "scene", "frames"))
    for name in also:
        if name not in OF_MANY:
            raise UsageError(f"also: there is no table {name!r} on request; there are: {', '.join(OF_MANY)}")
    home = Folder()
    with Inputs() as inputs, console.notes_kept() as notes:
        files: dict[str, Any] = {name: inputs.optional(value, name) for name, value in given.items()}
        paths = Paths(scene=inputs.scene(scene), doa_labels=doa_labels, **files)
        azimuths = inputs.optional(truth_azimuths, "truth_azimuths")
        pictured = azimuths is None and in_images(paths.tracks)
        on_ground = GROUND if tracks is not None and truth is not None else OTHERS
        more = {"scene": scene, "frames": frames, "truth_azimuths": azimuths, "doa_gate_deg": doa_gate_deg}
        told = [n for n, value in {**given, **more}.items() if value is not None]
        kind = AZIMUTHS if azimuths is not None else IMAGES if pictured else on_ground
        flags = [name for name, value in (("doa_labels", doa_labels), ("metrics", plugged)) if value]
        check_kind(command.params, [*told, *settings, *also, *flags], kind)
        if azimuths is not None:
            return _of_directions(paths, azimuths, doa_gate_deg, configure(EvaluateConfig(), chosen).bridge_s)
        paths = _with_outputs(paths, home, also if pictured else (*TABLES, *also))
        if pictured:
            config = configure(EvaluateConfig(), chosen)
            of_frames = {} if frames is None else {"frames": frames}
            result = run_evaluate_many(paths, config.box_overlap, {**many, **of_frames})
        else:
            result, _ = run_evaluate(paths, chosen, many, frames, plugged)
        lines = [inputs.named(text) for text in (*notes, *result.notes)]
        lines += [inputs.named(text) for text in texts_of(result.verdicts, "evaluate")]
        losses = provenance_of(paths, {}).losses
    said, rest = sentences(lines)
    warn(said, losses)
    tables = {name: table for name, table in tables_in(home, (*TABLES, *OF_MANY)).items() if len(table)}
    figures: Mapping[str, Any] = result.figures
    return EvaluateResult(
        summary=figures, tables=tables, losses=losses, warnings=said, notes=rest, metrics=dict(result.metrics)
    )


def _of_directions(paths: Paths, truth: Path, gate_deg: float | None, max_gap_s: float) -> EvaluateResult:
    """Directions of arrival against true ones."""
    from occlog.evaluate.run import run_evaluate_doa

    gate = 10.0 if gate_deg is None else gate_deg
    if not 0.0 <= gate <= 180.0:
        raise UsageError(f"doa_gate_deg: {gate}: must be from 0 to 180")
    figures, losses = run_evaluate_doa(paths, truth, gate, max_gap_s)
    warn((), losses)
    return EvaluateResult(summary=figures, losses=losses, metrics=figures)


def _chosen(metrics: Sequence[str] | Mapping[str, Mapping[str, Setting]]) -> list[Chosen]:
    """Metrics of plug-ins with their settings."""
    from occlog.cli.plugged import wanted
    from occlog.plugins.chosen import Chosen
    from occlog.plugins.loading import METRIC

    given = metrics if isinstance(metrics, Mapping) else {name: {} for name in metrics}
    found = []
    for name, values in given.items():
        plugin = wanted(name, METRIC, "metrics")
        (config,) = settings_by_class(f"metric {name}", dict(values), [("", plugin.load().settings)], ())
        found.append(Chosen(plugin, config))
    return found


def _with_outputs(paths: Paths, home: Folder, names: tuple[str, ...]) -> Paths:
    from dataclasses import replace

    written: dict[str, Any] = {name: home.file(f"{name}.parquet") for name in names}
    return replace(paths, **written)
