"""Work of `occlog evaluate`: files and option values to an evaluation, and that to files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from occlog.cli import options
from occlog.errors import InputError, UsageError
from occlog.evaluate.bearings.cost_of_asking import cooperation_figures
from occlog.evaluate.matching.config import default_sigma_v
from occlog.evaluate.mot.run_on_ground import ground_figures, split_many
from occlog.io.files.json_file import write_json
from occlog.io.files.parquet import write_table
from occlog.io.open import open_input
from occlog.track.images.run.provenance import other_video

from .inputs import Paths, provenance_of, read_tables
from .stage import EvaluateConfig, Evaluation, evaluate


def run_evaluate(paths: Paths, values: Mapping[str, Any]) -> tuple[Evaluation, str]:
    """Read, evaluate, write; the evaluation and the scene's length unit.

    Args:
        paths: inputs and outputs; outputs are written whole or not at all.
        values: fields of EvaluateConfig as the options give them (degrees, milliradians).
    """
    _check_request(paths, values)
    options.check_outputs(paths.inputs, (paths.output, paths.errors, paths.bound, paths.failures), paths.overwrite)
    t = read_tables(paths)
    own, values = split_many(values)
    config = make_config(with_defaults(values, paths.truth, t.scene.length_unit))
    _check_held_out(paths.tracks, config.held_out)
    result = evaluate(t.tracks, t.truth, t.bearings, t.scene, config, views=t.views, truth_boxes=t.truth_boxes)
    if t.cooperation is not None:
        result.metrics.update(cooperation_figures(t.cooperation, t.tracks))
    result, many = ground_figures(result, t, config, own, paths.failures is not None, paths.tracks)
    result = replace(result, notes=(*result.notes, *other_video(paths.tracks, [paths.truth])))
    _write(paths, result, t.scene.length_unit, config, many)
    return result, t.scene.length_unit


def _check_request(paths: Paths, values: Mapping[str, Any]) -> None:
    if paths.views is not None and paths.truth is None:
        raise UsageError("--views needs --truth with true boxes")
    if paths.tracks is None and paths.views is None and (paths.directions is None or paths.truth is None):
        raise UsageError("nothing to compare: give TRACKS with --truth or --bearings, or --bearings with --truth")
    if paths.tracks is not None and paths.truth is None and paths.directions is None:
        raise UsageError("TRACKS alone cannot be evaluated; give --truth, --bearings or both")
    if values.get("held_out") and (paths.tracks is None or paths.directions is None):
        raise UsageError("--held-out needs TRACKS made without that sensor and --bearings that include it")


def with_defaults(values: Mapping[str, Any], truth: Path | None, unit: str) -> dict[str, Any]:
    """The values, with noise of the walk and diameter of the simulation that made the truth where none are given."""
    out = dict(values)
    opened = None if truth is None else open_input(truth)
    if opened is not None and opened.recording is not None:
        made = opened.provenance
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
    fields = dict(values)
    fields["lines_min_crossing"] = math.radians(fields["lines_min_crossing"])
    fields["held_out_gate"] = 1e-3 * fields["held_out_gate"]
    fields["held_out"] = tuple(name for text in fields["held_out"] for name in text.split(",") if name)
    return EvaluateConfig(**fields)


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
