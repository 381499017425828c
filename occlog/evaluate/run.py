"""Work of `occlog evaluate`: files and option values to an evaluation, and that to files.

`run_evaluate` compares tracks and bearings with the truth, `run_evaluate_doa` directions of arrival with true ones.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from occlog.array_types import NS, Ints
from occlog.console.details import begin_work
from occlog.errors import InputError, UsageError
from occlog.evaluate.bearings.azimuths import doa_metrics
from occlog.evaluate.bearings.held_out import few_held_out
from occlog.evaluate.bearings.known_places import (
    MeasuredNoise,
    comment,
    figures_of,
    noise_at_known_places,
    notes_of,
    scene_with,
)
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.mot.run import ground_figures, many_config
from occlog.evaluate.stretches.sources import Sources, any_long, span_of_frames, streamed_bearings
from occlog.evaluate.stretches.tracks import BOUND_WITHOUT_DISTANCES, InStretches, parameters_of
from occlog.evaluate.stretches.views import BesideTracks
from occlog.io.files.atomic import check_outputs, write_bytes
from occlog.io.files.provenance import Provenance, hash_inputs
from occlog.io.files.tables.table_writer import write_table
from occlog.io.files.texts.json_file import write_json
from occlog.io.open import of_others, open_if_ours, open_input
from occlog.io.scenes.scene import scene_to_yaml
from occlog.io.sound.csv_log import DoaOptions
from occlog.io.sound.directions import read_doa
from occlog.plugins.chosen import Chosen
from occlog.records.losses import Loss
from occlog.records.scene import MicrophoneArray, Scene
from occlog.records.tables import Diagnostics, Doa, Truth, TruthBoxes
from occlog.settings import configure, declaration, declared
from occlog.track.images.run.provenance import born_from_detections, other_video

from .by_plugin import with_plugins
from .inputs import Paths, in_frames, lost_earlier, open_measured, open_tables, provenance_of, read_tables
from .stage import Evaluation, evaluate
from .verdict import judge


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
    if not plugged:
        found = run_in_stretches(paths, given, many_given, frames)
        if found is not None:
            return found
    t = read_tables(paths, everybody=bool(given.get("held_out")) and paths.views is not None)
    t = t if frames is None else in_frames(t, frames)
    unit = t.scene.length_unit
    config, numbered_itself, own_numbers = _configured(paths, given, unit)
    _check_held_out(paths.tracks, config.held_out)
    begin_work()
    result = evaluate(
        t.tracks,
        t.truth,
        t.bearings,
        t.scene,
        config,
        views=t.views,
        truth_boxes=t.truth_boxes,
        cooperation=t.cooperation,
        smoothed=t.made.smoothed,
        found=t.found,
        measured=t.measured,
    )
    result, many = ground_figures(
        result,
        t,
        config,
        told=many_given,
        own=own_targets_by(config, numbered_itself),
        wanted=paths.failures is not None or paths.counts is not None,
        path=paths.tracks,
    )
    if t.tracks is not None and t.truth is not None:
        result = with_plugins(result, plugged, t.tracks, t.truth, unit)
    if paths.write_scene is not None:
        noise = noise_at_known_places(result.looks, t.scene)
        metrics, notes = {**result.metrics, **figures_of(noise)}, (*result.notes, *notes_of(t.scene, noise))
        result = replace(result, metrics=metrics, notes=notes)
        _write_scene(paths.write_scene, t.scene, noise, overwrite=paths.overwrite)
    findings = judge(
        t.tracks,
        t.scene,
        t.made,
        diagnostics=t.diagnostics,
        bearings=t.bearings,
        errors=result.errors,
        metrics=result.metrics,
        held_out=config.held_out,
    )
    if t.made.measured and paths.measurements is None and len(result.bound):
        result = replace(result, notes=(*result.notes, BOUND_WITHOUT_DISTANCES))
    result = replace(result, notes=_notes(paths, own_numbers, result.notes), findings=findings)
    told_of = {"metrics": [each.provenance(unit) for each in plugged]} if plugged else {}
    parameters = {**parameters_of(paths, config, many), **told_of}
    _write(paths, result, unit, parameters)
    return result, unit


def _configured(paths: Paths, given: Mapping[str, object], unit: str) -> tuple[EvaluateConfig, bool, bool]:
    """Settings; whether the tracks have numbers of their own; and whether they are paired by distance for that."""
    # A tracker that numbers its tracks itself gives them numbers of targets by chance only
    numbered_itself = born_from_detections(paths.tracks) or of_others(paths.tracks)
    own_numbers = "match" not in given and numbered_itself
    paired = {"match": "optimal"} if own_numbers else {}
    config = configure(EvaluateConfig.in_unit(unit), {**simulated(paths.truth), **paired, **given})
    return config, numbered_itself, own_numbers


def own_targets_by(config: EvaluateConfig, numbered_itself: bool) -> str:
    """Which target is a track's own unless that is given; see `ManyConfig.own`."""
    return "label" if config.match == "id" else ("start" if numbered_itself else "best")


def _notes(paths: Paths, own_numbers: bool, found: tuple[str, ...]) -> tuple[str, ...]:
    """What the user must know of the inputs, about what was found."""
    told = f"{paths.tracks}: its numbers are its own; targets and tracks are paired by distance (--match optimal)"
    return (*((told,) if own_numbers else ()), *found, *other_video(paths.tracks, [paths.truth]))


def run_in_stretches(
    paths: Paths,
    given: Mapping[str, object],
    many_given: Mapping[str, object],
    frames: tuple[int, int] | None = None,
) -> tuple[Evaluation, str] | None:
    """The same as `run_evaluate` in flat memory.

    None where there are sensors held out without tracks or bearings or beside views, many tracks with them, nothing to
    compare, or short tables in a recording.
    """
    if given.get("held_out") and (paths.tracks is None or paths.directions is None or paths.views is not None):
        return None
    tracks, truth, scene = open_tables(paths)
    views = None if paths.views is None else open_input(paths.views)
    positions = tracks is not None or paths.directions is not None
    if truth is not None and not truth.has(Truth if positions else TruthBoxes):
        return None
    if views is not None and (truth is None or not truth.has(TruthBoxes)):
        return None
    bearings = streamed_bearings(paths.bearings, paths.doa, paths.doa_labels, scene)
    beside = (paths.bearings, paths.doa, paths.measurements)
    recorded = [truth, views, *(None if p is None else open_input(p) for p in beside)]
    if any(o is not None and o.recording is not None for o in recorded) and not any_long(tracks, *recorded):
        return None
    unit = scene.length_unit
    config, numbered_itself, own_numbers = _configured(paths, given, unit)
    _check_held_out(paths.tracks, config.held_out)
    begin_work()
    diagnostics = None if paths.diagnostics is None else open_input(paths.diagnostics, Diagnostics)
    measured = None if paths.measurements is None else open_measured(paths.measurements, tracks, scene)
    sources = Sources(tracks, truth, bearings, diagnostics, measured)
    timed = positions or paths.cooperation or paths.diagnostics or (truth is not None and truth.has(Truth))
    if frames is not None and timed:
        spans = (span_of_frames(times, frames) for times in _times_of_frames(sources))
        during = next((span for span in spans if span is not None), None)
        if during is None:
            return None
        sources = replace(sources, during=during)
    compared = InStretches(sources, scene, config) if positions else None
    if compared is not None and not (compared.can and few_held_out(config, len(compared.known.tracks))):
        return None
    cooperation = None if paths.cooperation is None else open_input(paths.cooperation)
    more = BesideTracks(views, truth, cooperation, sources, frames).figures(
        config, None if compared is None else compared.known.tracks_ns
    )
    many, unknown = None, None
    asked_for = bool(many_given) or paths.failures is not None or paths.counts is not None
    both = tracks is not None and truth is not None
    if (compared is not None and compared.several) or (asked_for and both):
        many, unknown = many_config(unit, own_targets_by(config, numbered_itself), many_given)
    parameters = parameters_of(paths, config, many)
    asked = None if many_given.get("own") is None else str(many_given["own"])
    if compared is not None:
        result = compared.evaluate(paths, parameters, many, asked, more)
        if paths.write_scene is not None:
            _write_scene(paths.write_scene, scene, compared.noise, overwrite=paths.overwrite)
    else:
        result = Evaluation({name: float(value) for name, value in more.items()})
    notes = result.notes if unknown is None else (*result.notes, unknown)
    result = replace(result, notes=_notes(paths, own_numbers, notes))
    rest = paths if compared is None else replace(paths, errors=None, bound=None)
    rest = rest if many is None else replace(rest, failures=None, counts=None)  # the others are written already
    _write(rest, result, unit, parameters)
    return result, unit


def _times_of_frames(sources: Sources) -> Iterator[Iterator[Ints]]:
    """Times by which frames are numbered: those of true targets; where there are none, of what comes next."""
    truth = sources.truth
    if truth is not None and truth.has(Truth):
        yield (rows.t_ns[rows.role == "target"] for rows in sources.rows_of_truth())
    if truth is not None and truth.has(TruthBoxes):
        yield (rows.t_ns for rows in truth.rows(TruthBoxes))
    yield (rows.t_ns for rows in sources.rows_of_bearings())
    yield (rows.t_ns for rows in sources.rows_of_tracks())


def _write_scene(path: Path, scene: Scene, noise: Mapping[str, MeasuredNoise], *, overwrite: bool) -> None:
    """Write the scene with the noise that was measured at known places."""
    text = comment(noise) + scene_to_yaml(scene_with(scene, noise))
    write_bytes(path, text.encode(), overwrite)


def _check_request(paths: Paths, given: Mapping[str, object]) -> None:
    held_boxes = bool(given.get("held_out")) and paths.tracks is not None and paths.views is not None
    if paths.views is not None and paths.truth is None and not held_boxes:
        raise UsageError("--views needs --truth with true boxes, or TRACKS and --held-out")
    if paths.tracks is None and paths.views is None and (paths.directions is None or paths.truth is None):
        raise UsageError("nothing to compare: give TRACKS with --truth or --bearings, or --bearings with --truth")
    if paths.write_scene is not None and (paths.truth is None or paths.directions is None):
        raise UsageError("--write-scene measures noise at known places; give --bearings and --truth")
    if paths.tracks is not None and paths.truth is None and paths.directions is None and not held_boxes:
        raise UsageError("TRACKS alone cannot be evaluated; give --truth, --bearings or both")
    if paths.measurements is not None and (paths.tracks is None or paths.truth is None):
        raise UsageError("--measurements are for the bound; give TRACKS and --truth as well")
    if given.get("held_out") and (paths.tracks is None or (paths.directions is None and not held_boxes)):
        raise UsageError("--held-out needs TRACKS made without that sensor, and --bearings or --views that include it")
    _check_used(paths, given)


LOOKS = "bearings against the truth", "--bearings (or --doa) and --truth"
BOUND = "the bound", "--bearings (or --doa, --measurements) and --truth"
LINES = "sight lines", "--bearings (or --doa)"
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


def _check_held_out(tracks: Path | None, held_out: tuple[str, ...]) -> None:
    """InputError if the tracks say that they were made with a sensor that is held out."""
    if tracks is None or not held_out:
        return
    made = open_input(tracks).provenance.parameters
    used = made.get("sensors", made.get("cameras"))
    both = [name for name in held_out if isinstance(used, list) and name in used]
    if both:
        names = ",".join(both)
        raise InputError(f"{tracks}: was made with {names}; make it again with `occlog track --without {names}`")


def _write(paths: Paths, result: Evaluation, unit: str, parameters: Mapping[str, object]) -> None:
    provenance = provenance_of(paths, parameters)
    made = (
        (paths.errors, result.errors),
        (paths.bound, result.bound),
        (paths.failures, result.failures),
        (paths.counts, result.counts),
    )
    for path, table in made:
        if path is not None:
            write_table(path, table, provenance, overwrite=paths.overwrite, length_unit=unit)
    if paths.output is not None:
        values = {**result.figures, "_provenance": provenance.as_dict()}
        write_json(paths.output, values, overwrite=paths.overwrite)


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
        raise UsageError("--truth-azimuths goes with --doa and nothing else to compare; leave TRACKS out")
    if doa is None:
        raise UsageError("--truth-azimuths wants directions to compare; give them with --doa")
    check_outputs([doa, truth], [output], paths.overwrite)
    found = open_input(doa).read(Doa)
    if not len(found):
        raise InputError(f"{doa}: has no directions; nothing can be compared")
    begin_work()
    metrics = doa_metrics(found, _true_directions(truth, found), math.radians(gate_deg), round(0.5 * max_gap_s * NS))
    if metrics["doa_found"] == 0:
        raise InputError(f"{truth}: has no time near those of {doa}; look at the times, or give a larger --max-gap")
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
