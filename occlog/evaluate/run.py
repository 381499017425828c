"""`occlog evaluate`: files and settings to figures, and these to files.

Also `--also`: several recordings in one table, and all together. The latter are figures of one long concatenated
recording without common targets or tracks: counts are summed before rates are computed, as TrackEval's COMBINED does.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog import console
from occlog.array_types import NS
from occlog.console.notes import begin_work
from occlog.console.summary import plausible_in_words
from occlog.errors import InputError, UsageError, option
from occlog.io.files.atomic import write_bytes
from occlog.io.files.inputs import previous_losses
from occlog.io.files.texts.documents import write_json
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.io.formats.sound.csv_log import DoaOptions
from occlog.io.formats.sound.directions import read_doa
from occlog.io.open import Opened, is_external, open_if_ours, open_input
from occlog.records.columns import ColumnTable
from occlog.records.losses import Loss
from occlog.records.scene import MicrophoneArray, Scene
from occlog.records.tables import Doa, Errors, Tracks, Truth
from occlog.records.verdicts import Verdict, summary_of, texts_of
from occlog.request import Form
from occlog.runner import Job, JobResult
from occlog.settings import configure, declaration, declared
from occlog.track.methods.images.run.inputs import independent_id_note, initiated_from_detections, other_video

from .bearings.detections import doa_metrics
from .bearings.noise import MeasuredNoise, noise_comment, scene_with
from .inputs import open_sources
from .matching.config import AZIMUTHS, GROUND, IMAGES, OTHERS, EvaluateConfig
from .metric_names import unknown_metric_hint
from .mot import figures as headline
from .mot.config import MultiTargetConfig, many_config, own_targets_by
from .mot.run import compared_boxes, evaluate_in_images, in_images
from .request import EvaluateRequest
from .results import (
    LABEL,
    Evaluation,
    Threshold,
    failures,
    number,
    parse_threshold,
    recording_lines,
    summary_lines,
    without_per_target,
)
from .stage import Evaluator, names_of_figures, with_plugins

Metrics = dict[str, float]
NOT_COMBINED = ("ospa2_window",)
"""Beginnings of names of figures that are of one recording only."""


class EvaluatedRecording(NamedTuple):
    """Paths of tracks and truth of one recording."""

    tracks: Path
    truth: Path


class MultiRecordingFigures(NamedTuple):
    """Figures of several recordings.

    Attributes:
        each: value by recording, then by figure.
        combined: figures of all recordings together.
        unit: unit of lengths.
        losses, verdicts: data losses and consistency verdicts of the inputs.
    """

    each: dict[str, dict[str, float]]
    combined: dict[str, float]
    unit: str
    losses: tuple[Loss, ...]
    verdicts: tuple[Verdict, ...]

    @property
    def metrics(self) -> dict[str, float]:
        """All figures in one mapping: of all together, then of each recording with the suffix `_recording_NAME`."""
        own = {f"{name}_recording_{who}": value for who, row in self.each.items() for name, value in row.items()}
        return self.combined | own


ALONE = (
    *("metrics", "bearings", "measurements", "doa", "views", "cooperation", "diagnostics"),
    *("errors", "bound", "failures", "counts", "mot"),
)
"""Inputs of one recording."""


def evaluate_several(request: EvaluateRequest, job: Job) -> MultiRecordingFigures:
    """Evaluate several recordings, write the figures, and return those of each and of all together.

    UsageError unless all are in images or all on the ground, or for an option that applies to one recording.
    """
    for entry in Form(EvaluateRequest).entries():
        if entry.field in ALONE and getattr(request, entry.field):
            raise UsageError(
                f"{option(entry.key)} applies to one recording; omit {option('also')}", id="not-applicable"
            )
    if request.tracks is None or request.truth is None:
        raise UsageError(f"{option('also')} requires TRACKS with {option('truth')} as well", id="missing-option")
    recordings = [
        EvaluatedRecording(request.tracks, request.truth),
        *(EvaluatedRecording(*pair) for pair in request.additional),
    ]
    kinds = {in_images(recording.tracks) for recording in recordings}
    if len(kinds) > 1:
        raise UsageError(
            f"{option('also')}: tracks in images and tracks on the ground cannot be evaluated together; evaluate "
            "them separately",
            id="incompatible-inputs",
        )
    begin_work()
    chosen = configure(EvaluateConfig(), request.settings)
    sides = [replace(request, tracks=each.tracks, truth=each.truth, additional=()) for each in recordings]
    if kinds.pop():
        each, whole, unit = *_in_images(sides), "px"
    else:
        each, whole, unit = _on_ground(sides, chosen)
    combined = {n: v for n, v in whole.items() if not n.startswith(NOT_COMBINED) and "_sensor_" not in n}
    provenance = job.provenance({**asdict(chosen), **request.multi_target}, previous_losses(request.inputs))
    named = dict(zip(_names(recordings), each, strict=True))
    found = MultiRecordingFigures(named, combined, unit, provenance.losses, provenance.judged)
    if request.output is not None:
        values = {**found.metrics, **summary_of(found.verdicts), "_provenance": provenance.as_dict()}
        write_json(request.output, values, overwrite=job.overwrite)
    return found


def _in_images(sides: Sequence[EvaluateRequest]) -> tuple[list[Metrics], Metrics]:
    """Return the figures of tracks in images of each recording, and of all together.

    Cameras of different recordings are different views. `sides`: one request for each recording.
    """
    each, whole = list[Metrics](), None
    views, counts = list[int](), Counter[str]()
    for side in sides:
        compared, *_ = compared_boxes(side)
        figures = compared.figures()
        each.append(figures.result(compared.frames, compared.counts))
        views += compared.frames
        counts.update(compared.counts)
        if whole is None:
            whole = figures
        else:
            whole.merge(figures)
    assert whole is not None
    return each, whole.result(views, dict(counts))


def _on_ground(sides: Sequence[EvaluateRequest], chosen: EvaluateConfig) -> tuple[list[Metrics], Metrics, str]:
    """Return the figures of tracks on the ground of each recording and of all together, and their unit of length.

    Args:
        sides: one request for each recording.
        chosen: settings given by the user.

    Raises:
        UsageError: the units of length differ.
        InputError: a truth has no positions.
    """
    opened = [open_sources(side, held_boxes=False) for side in sides]
    units = [scene.length_unit for _, scene, _ in opened]
    if len(set(units)) > 1:
        raise UsageError(
            f"{option('also')}: lengths are in {' and '.join(sorted(set(units)))}; evaluate these "
            "recordings separately",
            id="unit-mismatch",
        )
    each, whole = list[Metrics](), None
    for side, (sources, scene, _) in zip(sides, opened, strict=True):
        initiated = initiated_from_detections(side.tracks) or is_external(side.tracks)
        own = "start" if initiated else own_targets_by(chosen, numbered_itself=False)
        config = configure(MultiTargetConfig.in_unit(scene.length_unit), {"assigned_target": own, **side.multi_target})
        figures = Evaluator(sources, scene, chosen).of_many(config)
        each.append(figures.result())
        if whole is None:
            whole = figures
        else:
            whole.merge(figures)
    assert whole is not None
    return each, whole.result(), units[0]


def _names(recordings: Sequence[EvaluatedRecording]) -> list[str]:
    """Return a name for each recording: the stem of its tracks, else of its truth, if all differ.

    Else a number from 1.
    """
    for side in ([r.tracks.stem for r in recordings], [r.truth.stem for r in recordings]):
        if len(set(side)) == len(side):
            return side
    return [f"{number}" for number in range(1, len(recordings) + 1)]


GATE_DEG = 10.0
"""Directions further from the truth are false, unless a gate is given [deg]."""


def kind_of_input(request: EvaluateRequest) -> str:
    """Return the kind of evaluation that the inputs of a request select: `azimuths`, `images`, `ground` or `others`."""
    if request.truth_azimuths is not None:
        return AZIMUTHS
    if in_images(request.tracks):
        return IMAGES
    return GROUND if request.tracks is not None and request.truth is not None else OTHERS


def run_evaluate(request: EvaluateRequest, job: Job) -> JobResult:
    """Evaluate as requested and write the outputs.

    Return summary, data losses of the inputs, and violated thresholds.
    """
    thresholds = _thresholds(request.fail_if, names_of_figures(request.metrics))
    if job.kind == AZIMUTHS:
        figures, losses = _of_directions(request, job)
        failed = failures(figures, thresholds)
        return JobResult(dict(figures), earlier=losses, failed=failed, shown=lambda as_json: _lines(figures, as_json))
    if request.additional:
        found = evaluate_several(request, job)
        _note(job, (), found.verdicts)
        verdict = summary_of(found.verdicts)
        summary: dict[str, object] = {**found.metrics, **verdict}

        def shown(as_json: bool) -> str:
            judged = ["", f"plausible: {plausible_in_words(verdict)}"] if verdict else []
            table = [*recording_lines(found.each, found.combined, found.unit), *judged]
            return _lines(summary, True) if as_json else "\n".join(table)

        failed = failures(found.metrics, thresholds)
        return JobResult(summary, earlier=found.losses, failed=failed, shown=shown)
    result, unit = (evaluate_in_images(request, job), "px") if job.kind == IMAGES else _in_world(request, job)
    _note(job, result.notes, result.verdicts)
    earlier, failed = previous_losses(request.inputs), failures(result.metrics, thresholds)
    return JobResult(
        result.figures, earlier=earlier, failed=failed, shown=lambda as_json: _shown(result, unit, as_json)
    )


def _note(job: Job, notes: Iterable[str], verdicts: Sequence[Verdict]) -> None:
    for line in (*notes, *texts_of(verdicts, "evaluate")):
        job.note(line)


def _lines(summary: Mapping[str, object], as_json: bool, first: Iterable[str] = ()) -> str:
    return "\n".join(console.lines_of(summary, as_json, first))


def _shown(result: Evaluation, unit: str, as_json: bool) -> str:
    """Return the figures as text, or as one JSON object if `as_json`; `unit`: unit of lengths."""
    if as_json:
        first = headline.first_of(result.metrics) if headline.independent_ids(result.metrics) else ()
        return _lines(without_per_target(result.figures), True, first)
    lines = summary_lines(result.metrics, unit)
    if result.plugged:
        lines += ["", "plug-ins", *(f"  {name:<{LABEL}}{number(result.metrics[name]):>12}" for name in result.plugged)]
    if result.verdicts:
        lines += ["", f"plausible: {plausible_in_words(result.figures)}"]
    return "\n".join(lines)


def _thresholds(texts: Iterable[str], more: Collection[str]) -> list[Threshold]:
    """Parse the conditions of `--fail-if`; UsageError for invalid texts and unknown metrics.

    `more`: names of the figures of plug-ins.
    """
    found = []
    for text in texts:
        try:
            found.append(parse_threshold(text))
        except UsageError as error:
            raise UsageError(f"{option('fail_if')} {error}") from error
        hint = unknown_metric_hint(found[-1].metric, more)
        if hint is not None:
            raise UsageError(
                f"{option('fail_if')} {text!r}: there is no metric {found[-1].metric!r}; {hint}", id="unknown-name"
            )
    return found


def _in_world(request: EvaluateRequest, job: Job) -> tuple[Evaluation, str]:
    """Evaluate tracks on the ground, bearings and views, and write the outputs.

    Return the evaluation and the length unit.
    """
    given, many_given = request.settings, request.multi_target
    _check_request(request, given)
    held_boxes = bool(given.get("held_out")) and request.views is not None
    sources, scene, tracks = open_sources(request, held_boxes=held_boxes)
    unit = scene.length_unit
    # A tracker that numbers its tracks itself gives them numbers of targets by chance only
    numbered_itself = initiated_from_detections(request.tracks) or is_external(request.tracks)
    own_numbers = "match" not in given and numbered_itself
    paired = {"match": "optimal"} if own_numbers else {}
    config = configure(EvaluateConfig.in_unit(unit), {**simulated(request.truth), **paired, **given})
    _check_held_out(tracks, config.held_out)
    begin_work()
    evaluator = Evaluator(sources, scene, config)
    many, unknown = None, None
    asked_for = bool(many_given) or request.failures is not None or request.counts is not None
    if sources.tracks is not None and sources.truth is not None and (evaluator.several or asked_for):
        many, unknown = many_config(unit, own_targets_by(config, numbered_itself=numbered_itself), many_given)
    asked = None if many_given.get("assigned_target") is None else str(many_given["assigned_target"])
    numbers = () if many is None else independent_id_note(request.tracks, many.assigned_target, asked)
    provenance = job.provenance(_parameters(request, config, many, unit), previous_losses(request.inputs))
    kept: list[Errors] = []
    with job.tables(provenance, unit) as tables:

        def take(rows: ColumnTable) -> None:
            tables.write(**{rows.NAME: rows})
            if request.metrics and isinstance(rows, Errors):
                kept.append(rows)

        result = evaluator.run(take, many, with_positions=request.write_scene is not None, numbers=numbers)
        if result.checks is not None:
            provenance = provenance.with_checks(result.checks)
            tables.annotate(provenance)
        if request.metrics and sources.tracks is not None and sources.truth is not None:
            whole = Tracks.concat(sources.tracks()), Truth.concat(sources.truth())
            result = with_plugins(replace(result, errors=Errors.concat(kept)), request.metrics, *whole, unit)
    how = f"{option('match')} optimal"
    note = f"{request.tracks}: track IDs are not those of the truth; matching by distance ({how})"
    more = () if unknown is None else (unknown,)
    other = other_video(request.tracks, [request.truth])
    notes = (*((note,) if own_numbers else ()), *result.notes, *more, *other)
    result = replace(result, notes=notes, verdicts=provenance.judged)
    if request.write_scene is not None:
        _write_scene(request.write_scene, scene, evaluator.noise, overwrite=job.overwrite)
    if request.output is not None:
        values = {**result.figures, "_provenance": provenance.as_dict()}
        write_json(request.output, values, overwrite=job.overwrite)
    return result, unit


def _parameters(
    request: EvaluateRequest, config: EvaluateConfig, many: MultiTargetConfig | None, unit: str
) -> dict[str, object]:
    """Return the parameters of the evaluation, for its provenance.

    Args:
        request: labels and plug-ins.
        config: settings of the evaluation.
        many: settings of the multi-target figures; None: there are none.
        unit: unit of lengths.
    """
    out = asdict(config) | ({"doa_labels": True} if request.doa_labels else {})
    out |= {} if many is None else {"multi_target": asdict(many)}
    return out | ({"metrics": [each.provenance(unit) for each in request.metrics]} if request.metrics else {})


def _write_scene(path: Path, scene: Scene, noise: Mapping[str, MeasuredNoise], *, overwrite: bool) -> None:
    """Write the scene, with the noise measured at known positions in place of the stated noise, as YAML.

    `noise`: by camera; `overwrite`: replace an existing file.
    """
    text = noise_comment(noise) + scene_to_yaml(scene_with(scene, noise))
    write_bytes(path, text.encode(), overwrite)


def _check_request(request: EvaluateRequest, given: Mapping[str, object]) -> None:
    held_boxes = bool(given.get("held_out")) and request.tracks is not None and request.views is not None
    if request.views is not None and request.truth is None and not held_boxes:
        raise UsageError(
            f"{option('views')} needs {option('truth')} with true boxes, or TRACKS and {option('held_out')}",
            id="missing-option",
        )
    if request.tracks is None and request.views is None and (request.directions is None or request.truth is None):
        raise UsageError(
            f"nothing to compare: give TRACKS with {option('truth')} or "
            f"{option('bearings')}, or {option('bearings')} with {option('truth')}",
            id="missing-option",
        )
    if request.write_scene is not None and (request.truth is None or request.directions is None):
        raise UsageError(
            f"{option('write_scene')} measures noise at true positions; add {option('bearings')} and {option('truth')}",
            id="missing-option",
        )
    if request.tracks is not None and request.truth is None and request.directions is None and not held_boxes:
        raise UsageError(
            f"TRACKS alone cannot be evaluated; give {option('truth')}, {option('bearings')} or both",
            id="missing-option",
        )
    if request.measurements is not None and (request.tracks is None or request.truth is None):
        raise UsageError(
            f"{option('measurements')} are for the bound; give TRACKS and {option('truth')} as well",
            id="missing-option",
        )
    if given.get("held_out") and (request.tracks is None or (request.directions is None and not held_boxes)):
        raise UsageError(
            f"{option('held_out')} needs TRACKS made without that sensor, and "
            f"{option('bearings')} or {option('views')} that include it",
            id="missing-option",
        )
    _check_used(request, given)


LOOKS = "bearings against the truth", f"{option('bearings')} (or {option('doa')}) and {option('truth')}"
BOUND = "the bound", "--bearings (or --doa, --measurements) and --truth"
LINES = "lines of sight", f"{option('bearings')} (or {option('doa')})"
TRIANGULATION = ("min_sensors", "window_s", "loss", "tolerance", "min_angle")
OF_WHAT = {
    **dict.fromkeys(("gate_sigma", "gate_px", "occluder_diameter"), LOOKS),
    **dict.fromkeys(
        ("motion", "process_noise_position", "prior_covariance", "prior_variance_z", "bound_dimension"), BOUND
    ),
    **dict.fromkeys(("process_noise_density", "sigma_initial_velocity"), ("the bound", f"{BOUND[1]}, and --motion cv")),
    **{f"triangulation_{name}": LINES for name in TRIANGULATION},
    "held_out_gate": ("held-out bearings", "--held-out and --bearings (or --doa)"),
    "held_out_gate_px": ("held-out boxes", "--held-out and --views"),
    "iou_threshold": ("views against true boxes", "--views and --truth"),
}
"""Groups of settings that need certain inputs, and these inputs."""


def _check_used(request: EvaluateRequest, given: Mapping[str, object]) -> None:
    """Raise UsageError for a given setting that has no effect because its inputs are missing.

    `given`: settings of the user by name.
    """
    with_bearings, truth, held = request.directions is not None, request.truth is not None, bool(given.get("held_out"))
    bound = truth and (with_bearings or request.measurements is not None)
    there = {LOOKS: with_bearings and truth, BOUND: bound, LINES: with_bearings}
    used = {name: there.get(of, False) for name, of in OF_WHAT.items()}
    used["process_noise_density"] = used["sigma_initial_velocity"] = bound and given.get("motion") == "cv"
    used |= {"held_out_gate": held and with_bearings, "held_out_gate_px": held and request.views is not None}
    used["iou_threshold"] = truth and request.views is not None
    options_of = {f.name: declaration(f).option for f in declared(EvaluateConfig)}
    for name in given:
        if not used.get(name, True):
            raise UsageError(
                f"{options_of[name]} applies to {OF_WHAT[name][0]} and has no effect here; give {OF_WHAT[name][1]}",
                id="missing-option",
            )


def simulated(truth: Path | None) -> dict[str, float]:
    """Return the process noise and the diameter of moving objects that `occlog simulate` used, by name of the setting.

    Empty if the truth is not a simulated recording.
    """
    # A table that counts frames has no recording, whatever their rate
    opened = None if truth is None else open_input(truth, fps=Fraction(1))
    if opened is None or opened.recording is None or opened.provenance.command != "simulate":
        return {}
    world = opened.provenance.parameters.get("world")
    known = world if isinstance(world, dict) else {}
    values = {
        "process_noise_position": known.get("process_noise_position", known.get("sigma")),
        "occluder_diameter": known.get("diameter"),
    }
    return {name: float(value) for name, value in values.items() if isinstance(value, int | float)}


def _check_held_out(tracks: Opened | None, held_out: tuple[str, ...]) -> None:
    """InputError if the tracks were made with one of the sensors `held_out`."""
    if tracks is None or not held_out:
        return
    made = tracks.provenance.parameters
    used = made.get("sensors", made.get("cameras"))
    both = [name for name in held_out if isinstance(used, list) and name in used]
    if both:
        names = ",".join(both)
        raise InputError(
            f"{tracks.path}: was made with {names}, which {option('held_out')} predicts; make it again with "
            f"`occlog track --without {names}`",
            id="wrong-content",
        )


def _of_directions(request: EvaluateRequest, job: Job) -> tuple[dict[str, float], tuple[Loss, ...]]:
    """Evaluate directions of arrival against true ones, and write the outputs.

    Return figures and data losses of inputs.

    Raises:
        UsageError: an input is missing or superfluous.
        InputError: there are no directions, or none has a truth near its time.
    """
    doa, truth = request.doa, request.truth_azimuths
    if request.tracks is not None:
        raise UsageError(
            f"{option('truth_azimuths')} is compared with {option('doa')} alone; leave TRACKS out",
            id="not-applicable",
        )
    if doa is None or truth is None:
        raise UsageError(
            f"{option('truth_azimuths')} requires directions to compare; give them with {option('doa')}",
            id="missing-option",
        )
    gate_deg = GATE_DEG if request.doa_gate_deg is None else request.doa_gate_deg
    max_gap_s = configure(EvaluateConfig(), request.settings).bridge_s
    found = open_input(doa).read(Doa)
    if not len(found):
        raise InputError(f"{doa}: has no directions; nothing can be compared", id="empty-input")
    begin_work()
    metrics = doa_metrics(found, _true_directions(truth, found), math.radians(gate_deg), round(0.5 * max_gap_s * NS))
    if metrics["doa_found"] == 0:
        raise InputError(
            f"{truth}: has no time near those of {doa}; check the clocks and units of times, or give a larger "
            f"{option('max_gap')}",
            id="disjoint-inputs",
        )
    losses = previous_losses([doa, truth])
    if request.output is not None:
        provenance = job.provenance({"doa_gate_deg": gate_deg, "max_gap_s": max_gap_s}, losses)
        write_json(request.output, {**metrics, "_provenance": provenance.as_dict()}, overwrite=job.overwrite)
    return metrics, losses


def _true_directions(path: Path, found: Doa) -> Doa:
    """Return the true directions in a table or log.

    A log without a sensor column is taken to be of the only array in `found`.
    """
    opened = open_if_ours(path)
    if opened is not None:
        return opened.read(Doa)
    names = np.unique(found.sensor).tolist()
    arrays = [MicrophoneArray(name, np.zeros(3)) for name in names]
    sole = names[0] if len(names) == 1 else None
    return Doa.merge(list(read_doa(path, arrays, DoaOptions(sensor=sole))))
