"""Figures of many targets on the ground, along with the other figures of `occlog evaluate`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from occlog.evaluate.matching.config import EvaluateConfig, Evaluation
from occlog.track.images.run.provenance import born_from_detections, own_notes

from .config import ManyConfig, default_distance
from .on_ground import evaluate_ground
from .options import FIELDS

if TYPE_CHECKING:
    from occlog.evaluate.inputs import Tables


def split_many(values: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Options of many targets that were given, and all others."""
    told = {name: values[name] for name in FIELDS if values.get(name) not in (None, ())}
    return told, {name: value for name, value in values.items() if name not in FIELDS}


def ground_figures(
    result: Evaluation,
    tables: Tables,
    config: EvaluateConfig,
    told: Mapping[str, Any],
    wanted: bool,
    path: Path | None = None,
) -> tuple[Evaluation, dict[str, Any]]:
    """The evaluation with the figures of many targets, and the options behind these.

    They are given where there are several tracks or targets, or where they are asked for.

    Args:
        result: the other figures.
        tables: what was read.
        config: of the other figures.
        told: options of many targets that were given.
        wanted: the table of failures is to be written.
        path: file of the tracks.
    """
    tracks, truth, unit = tables.tracks, tables.truth, tables.scene.length_unit
    if tracks is None or truth is None:
        return result, {}
    several = max(len(np.unique(tracks.target_id)), len(np.unique(truth.target_id[truth.role == "target"]))) > 1
    if not (several or told or wanted):
        return result, {}
    numbered = "start" if born_from_detections(path) else "label"
    own = numbered if config.match == "id" else "best"
    many = ManyConfig(**{"own": own, "match_distance": default_distance(unit), **told})
    if many.match_distance is None:
        line = f"lengths are in {unit}: give --match-distance for the figures of many targets"
        return replace(result, notes=(*result.notes, line)), {}
    made = evaluate_ground(tracks, truth, many, config.limit_ns, unit)
    metrics = {**result.metrics, **{name: value for name, value in made.metrics.items() if name not in result.metrics}}
    notes = (*result.notes, *made.notes, *own_notes(path, many.own, told.get("own")))
    whole = replace(result, metrics=metrics, failures=made.failures, notes=notes)
    return whole, {"many": asdict(many)}
