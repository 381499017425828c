"""Work of `occlog evaluate`: files and option values to an evaluation, and that to files.

`run_evaluate` compares tracks and bearings with the truth, `run_evaluate_doa` directions of arrival with true ones.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from occlog.array_types import NS
from occlog.console.details import begin_work
from occlog.errors import InputError, UsageError, option
from occlog.evaluate.bearings.azimuths import doa_metrics
from occlog.evaluate.bearings.known_places import MeasuredNoise, comment, scene_with
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.mot.config import ManyConfig, many_config, own_targets_by
from occlog.io.files.atomic import check_outputs, write_bytes
from occlog.io.files.inputs import hash_inputs
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import TableWriter
from occlog.io.files.texts.json_file import write_json
from occlog.io.open import Opened, of_others, open_if_ours, open_input
from occlog.io.scenes.scene import scene_to_yaml
from occlog.io.sound.csv_log import DoaOptions
from occlog.io.sound.directions import read_doa
from occlog.plugins.chosen import Chosen
from occlog.records.columns import Table
from occlog.records.declared.views import Counts, Failures
from occlog.records.losses import Loss
from occlog.records.scene import MicrophoneArray, Scene
from occlog.records.tables import Bound, Doa, Errors, Tracks, Truth
from occlog.settings import configure, declaration, declared
from occlog.track.images.run.provenance import born_from_detections, other_video, own_notes

from .by_plugin import with_plugins
from .inputs import Paths, lost_earlier, open_sources, provenance_of
from .results import Evaluation
from .stage import Evaluator


def run_evaluate(
    paths: Paths,
    given: Mapping[str, object],
    many_given: Mapping[str, object],
    frames: tuple[int, int] | None = None,
    plugged: Sequence[Chosen] = (),
) -> tuple[Evaluation, str]:
    """Read, evaluate, write; the evaluation and the scene's length unit.

    Args:
        paths: inputs and outputs; outputs are written whole or not at all.
        given: settings of `EvaluateConfig` that were given.
        many_given: settings of `ManyConfig` that were given.
        frames: first frame to compare, and the one after the last; see `in_frames`.
        plugged: metrics of plug-ins, for tracks and truth.
    """
    _check_request(paths, given)
    written = (paths.output, paths.errors, paths.bound, paths.write_scene, paths.failures, paths.counts)
    check_outputs(paths.inputs, written, paths.overwrite)
    held_boxes = bool(given.get("held_out")) and paths.views is not None
    sources, scene, tracks = open_sources(paths, frames, held_boxes=held_boxes)
    unit = scene.length_unit
    # A tracker that numbers its tracks itself gives them numbers of targets by chance only
    numbered_itself = born_from_detections(paths.tracks) or of_others(paths.tracks)
    own_numbers = "match" not in given and numbered_itself
    paired = {"match": "optimal"} if own_numbers else {}
    config = configure(EvaluateConfig.in_unit(unit), {**simulated(paths.truth), **paired, **given})
    _check_held_out(tracks, config.held_out)
    begin_work()
    evaluator = Evaluator(sources, scene, config)
    many, unknown = None, None
    asked_for = bool(many_given) or paths.failures is not None or paths.counts is not None
    if sources.tracks is not None and sources.truth is not None and (evaluator.several or asked_for):
        many, unknown = many_config(unit, own_targets_by(config, numbered_itself=numbered_itself), many_given)
    asked = None if many_given.get("own") is None else str(many_given["own"])
    numbers = () if many is None else own_notes(paths.tracks, many.own, asked)
    parameters = _parameters(paths, config, many)
    if plugged:
        parameters |= {"metrics": [each.provenance(unit) for each in plugged]}
    provenance = provenance_of(paths, parameters)
    kept: list[Errors] = []
    with ExitStack() as stack:
        writers = {
            table.NAME: stack.enter_context(
                TableWriter(path, table, provenance, overwrite=paths.overwrite, length_unit=unit)
            )
            for table, path in _tables(paths)
            if path is not None
        }

        def take(rows: Table) -> None:
            if rows.NAME in writers:
                writers[rows.NAME].write(rows)
            if plugged and isinstance(rows, Errors):
                kept.append(rows)

        result = evaluator.run(take, many, places=paths.write_scene is not None, numbers=numbers)
        if result.checks is not None:
            provenance = provenance.with_checks(result.checks)
            for writer in writers.values():
                writer.annotate(provenance)
        if plugged and sources.tracks is not None and sources.truth is not None:
            whole = Tracks.concat(sources.tracks()), Truth.concat(sources.truth())
            result = with_plugins(replace(result, errors=Errors.concat(kept)), plugged, *whole, unit)
    how = f"{option('match')} optimal"
    told = f"{paths.tracks}: track IDs are not those of the truth; matching by distance ({how})"
    more = () if unknown is None else (unknown,)
    other = other_video(paths.tracks, [paths.truth])
    notes = (*((told,) if own_numbers else ()), *result.notes, *more, *other)
    result = replace(result, notes=notes, verdicts=provenance.judged)
    if paths.write_scene is not None:
        _write_scene(paths.write_scene, scene, evaluator.noise, overwrite=paths.overwrite)
    if paths.output is not None:
        values = {**result.figures, "_provenance": provenance.as_dict()}
        write_json(paths.output, values, overwrite=paths.overwrite)
    return result, unit


def _tables(paths: Paths) -> list[tuple[type[Table], Path | None]]:
    """Tables that are written while they are made."""
    return [(Errors, paths.errors), (Bound, paths.bound), (Failures, paths.failures), (Counts, paths.counts)]


def _parameters(paths: Paths, config: EvaluateConfig, many: ManyConfig | None) -> dict[str, object]:
    """Parameters of the comparison, as the provenance of outputs has them."""
    labels = {"doa_labels": True} if paths.doa_labels else {}
    return {**asdict(config), **labels, **({} if many is None else {"many": asdict(many)})}


def _write_scene(path: Path, scene: Scene, noise: Mapping[str, MeasuredNoise], *, overwrite: bool) -> None:
    """Write the scene with the noise that was measured at known places."""
    text = comment(noise) + scene_to_yaml(scene_with(scene, noise))
    write_bytes(path, text.encode(), overwrite)


def _check_request(paths: Paths, given: Mapping[str, object]) -> None:
    held_boxes = bool(given.get("held_out")) and paths.tracks is not None and paths.views is not None
    if paths.views is not None and paths.truth is None and not held_boxes:
        raise UsageError(
            f"{option('views')} needs {option('truth')} with true boxes, or TRACKS and {option('held_out')}"
        )
    if paths.tracks is None and paths.views is None and (paths.directions is None or paths.truth is None):
        raise UsageError(
            f"nothing to compare: give TRACKS with {option('truth')} or "
            f"{option('bearings')}, or {option('bearings')} with {option('truth')}"
        )
    if paths.write_scene is not None and (paths.truth is None or paths.directions is None):
        raise UsageError(
            f"{option('write_scene')} measures noise at known places; give {option('bearings')} and {option('truth')}"
        )
    if paths.tracks is not None and paths.truth is None and paths.directions is None and not held_boxes:
        raise UsageError(f"TRACKS alone cannot be evaluated; give {option('truth')}, {option('bearings')} or both")
    if paths.measurements is not None and (paths.tracks is None or paths.truth is None):
        raise UsageError(f"{option('measurements')} are for the bound; give TRACKS and {option('truth')} as well")
    if given.get("held_out") and (paths.tracks is None or (paths.directions is None and not held_boxes)):
        raise UsageError(
            f"{option('held_out')} needs TRACKS made without that sensor, and "
            f"{option('bearings')} or {option('views')} that include it"
        )
    _check_used(paths, given)


LOOKS = "bearings against the truth", f"{option('bearings')} (or {option('doa')}) and {option('truth')}"
BOUND = "the bound", "--bearings (or --doa, --measurements) and --truth"
LINES = "sight lines", f"{option('bearings')} (or {option('doa')})"
OF_WHAT = {
    **dict.fromkeys(("gate_sigma", "gate_px", "occluder_diameter"), LOOKS),
    **dict.fromkeys(("motion", "sigma_v", "prior_cov", "prior_z", "bound_in"), BOUND),
    **dict.fromkeys(("acceleration_density", "sigma_speed"), ("the bound", f"{BOUND[1]}, and --motion cv")),
    **dict.fromkeys(("lines_min_sensors", "lines_window_s", "lines_loss", "lines_limit", "lines_min_crossing"), LINES),
    "held_out_gate": ("held-out bearings", "--held-out and --bearings (or --doa)"),
    "held_out_gate_px": ("held-out boxes", "--held-out and --views"),
    "box_overlap": ("views against true boxes", "--views and --truth"),
}
"""What settings are of that change nothing without some inputs, and these."""


def _check_used(paths: Paths, given: Mapping[str, object]) -> None:
    """UsageError for a setting that was given, but of figures for which there are no inputs."""
    looks, truth, held = paths.directions is not None, paths.truth is not None, bool(given.get("held_out"))
    bound = truth and (looks or paths.measurements is not None)
    there = {LOOKS: looks and truth, BOUND: bound, LINES: looks}
    used = {name: there.get(of, False) for name, of in OF_WHAT.items()}
    used["acceleration_density"] = used["sigma_speed"] = bound and given.get("motion") == "cv"
    used |= {"held_out_gate": held and looks, "held_out_gate_px": held and paths.views is not None}
    used["box_overlap"] = truth and paths.views is not None
    options_of = {f.name: declaration(f).option for f in declared(EvaluateConfig)}
    for name in given:
        if not used.get(name, True):
            raise UsageError(
                f"{options_of[name]} is of {OF_WHAT[name][0]} and has no effect here; give {OF_WHAT[name][1]}"
            )


def simulated(truth: Path | None) -> dict[str, float]:
    """Noise of the walk and diameter of moving objects, as the simulation had them that made the truth."""
    opened = None if truth is None else open_input(truth)
    if opened is None or opened.recording is None or opened.provenance.command != "simulate":
        return {}
    world = opened.provenance.parameters.get("world")
    known = world if isinstance(world, dict) else {}
    values = {"sigma_v": known.get("sigma"), "occluder_diameter": known.get("diameter")}
    return {name: float(value) for name, value in values.items() if isinstance(value, int | float)}


def _check_held_out(tracks: Opened | None, held_out: tuple[str, ...]) -> None:
    """InputError if the tracks say that they were made with a sensor that is held out."""
    if tracks is None or not held_out:
        return
    made = tracks.provenance.parameters
    used = made.get("sensors", made.get("cameras"))
    both = [name for name in held_out if isinstance(used, list) and name in used]
    if both:
        names = ",".join(both)
        raise InputError(f"{tracks.path}: was made with {names}; make it again with `occlog track --without {names}`")


def run_evaluate_doa(
    paths: Paths, truth: Path, gate_deg: float, max_gap_s: float
) -> tuple[dict[str, float], tuple[Loss, ...]]:
    """Read, compare, write; the figures, and what was lost in making the inputs.

    Args:
        paths: `doa`, directions: a table, or a recording that holds them; `output`, JSON to write.
        truth: true directions: the same, or a log (CSV: time, azimuth_deg, perhaps sensor).
        gate_deg: pairs further apart are a missed and a false direction.
        max_gap_s: a set is compared with the true one nearest in time, at most half of this away.
    """
    doa, output = paths.doa, paths.output
    if paths.tracks is not None:
        raise UsageError(
            f"{option('truth_azimuths')} goes with {option('doa')} and nothing else to compare; leave TRACKS out"
        )
    if doa is None:
        raise UsageError(f"{option('truth_azimuths')} wants directions to compare; give them with {option('doa')}")
    check_outputs([doa, truth], [output], paths.overwrite)
    found = open_input(doa).read(Doa)
    if not len(found):
        raise InputError(f"{doa}: has no directions; nothing can be compared")
    begin_work()
    metrics = doa_metrics(found, _true_directions(truth, found), math.radians(gate_deg), round(0.5 * max_gap_s * NS))
    if metrics["doa_found"] == 0:
        raise InputError(
            f"{truth}: has no time near those of {doa}; look at the times, or give a larger {option('max_gap')}"
        )
    losses = lost_earlier([doa, truth])
    if output is not None:
        parameters = {"doa_gate_deg": gate_deg, "max_gap_s": max_gap_s}
        provenance = Provenance("evaluate", parameters, None, hash_inputs([doa, truth]), losses)
        write_json(output, {**metrics, "_provenance": provenance.as_dict()}, overwrite=paths.overwrite)
    return metrics, losses


def _true_directions(path: Path, found: Doa) -> Doa:
    """True directions; a log without a column of sensors is of the only one that there is."""
    opened = open_if_ours(path)
    if opened is not None:
        return opened.read(Doa)
    names = np.unique(found.sensor).tolist()
    arrays = [MicrophoneArray(name, np.zeros(3)) for name in names]
    sole = names[0] if len(names) == 1 else None
    return Doa.merge(list(read_doa(path, arrays, DoaOptions(sensor=sole))))
