"""Work of `occlog evaluate`: files and option values to an evaluation, and that to files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from occlog.cli import options
from occlog.errors import InputError, UsageError
from occlog.evaluate.bearings.cost_of_asking import cooperation_figures
from occlog.evaluate.mot.run import ground_figures
from occlog.io.files.json_file import write_json
from occlog.io.files.parquet import write_table
from occlog.io.open import open_input
from occlog.settings import configure
from occlog.track.images.run.provenance import other_video

from .evaluation import Evaluation
from .inputs import Paths, provenance_of, read_tables
from .matching.config import EvaluateConfig
from .stage import evaluate


def run_evaluate(paths: Paths, given: Mapping[str, Any], many_given: Mapping[str, Any]) -> tuple[Evaluation, str]:
    """Read, evaluate, write; the evaluation and the scene's length unit.

    Args:
        paths: inputs and outputs; outputs are written whole or not at all.
        given: settings of `EvaluateConfig` that were given.
        many_given: settings of `ManyConfig` that were given.
    """
    _check_request(paths, given)
    options.check_outputs(paths.inputs, (paths.output, paths.errors, paths.bound, paths.failures), paths.overwrite)
    t = read_tables(paths)
    unit = t.scene.length_unit
    config = configure(EvaluateConfig.in_unit(unit), {**simulated(paths.truth), **given})
    _check_held_out(paths.tracks, config.held_out)
    result = evaluate(t.tracks, t.truth, t.bearings, t.scene, config, views=t.views, truth_boxes=t.truth_boxes)
    if t.cooperation is not None:
        result.metrics.update(cooperation_figures(t.cooperation, t.tracks))
    result, many = ground_figures(
        result, t, config, told=many_given, wanted=paths.failures is not None, path=paths.tracks
    )
    result = replace(result, notes=(*result.notes, *other_video(paths.tracks, [paths.truth])))
    _write(paths, result, unit, config, many)
    return result, unit


def _check_request(paths: Paths, given: Mapping[str, Any]) -> None:
    if paths.views is not None and paths.truth is None:
        raise UsageError("--views needs --truth with true boxes")
    if paths.tracks is None and paths.views is None and (paths.directions is None or paths.truth is None):
        raise UsageError("nothing to compare: give TRACKS with --truth or --bearings, or --bearings with --truth")
    if paths.tracks is not None and paths.truth is None and paths.directions is None:
        raise UsageError("TRACKS alone cannot be evaluated; give --truth, --bearings or both")
    if given.get("held_out") and (paths.tracks is None or paths.directions is None):
        raise UsageError("--held-out needs TRACKS made without that sensor and --bearings that include it")


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
    used = open_input(tracks).provenance.parameters.get("sensors")
    both = [name for name in held_out if isinstance(used, list) and name in used]
    if both:
        names = ",".join(both)
        raise InputError(f"{tracks}: was made with {names}; make it again with `occlog track --without {names}`")


def _write(paths: Paths, result: Evaluation, unit: str, config: EvaluateConfig, many: Mapping[str, Any]) -> None:
    parameters = asdict(config) | ({"doa_labels": True} if paths.doa_labels else {})
    provenance = provenance_of(paths, {**parameters, **many})
    for path, table in ((paths.errors, result.errors), (paths.bound, result.bound), (paths.failures, result.failures)):
        if path is not None:
            write_table(path, table, provenance, overwrite=paths.overwrite, length_unit=unit)
    if paths.output is not None:
        values = {**result.metrics, "_provenance": provenance.as_dict()}
        write_json(paths.output, values, overwrite=paths.overwrite)
