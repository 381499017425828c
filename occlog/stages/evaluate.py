"""Tracks, truth and bearings to figures: errors, detections, the posterior bound, and checks without truth."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..errors import InputError
from ..records import Bearings, Bound, Errors, Tracks, Truth, TruthBoxes, Views
from ..scene import Scene
from .evaluate_bound import compute_bound
from .evaluate_boxes import view_metrics
from .evaluate_config import EvaluateConfig, Evaluation
from .evaluate_detection import detection_metrics, looks_of
from .evaluate_errors import compare, error_metrics, settled
from .evaluate_heldout import held_out_metrics
from .evaluate_meeting import meeting_metrics
from .evaluate_ratio import bound_metrics
from .evaluate_thresholds import Threshold, failures, parse_threshold

__all__ = ["EvaluateConfig", "Evaluation", "Threshold", "evaluate", "failures", "parse_threshold"]


def evaluate(
    tracks: Tracks | None,
    truth: Truth | None,
    bearings: Bearings | None,
    scene: Scene,
    config: EvaluateConfig | None = None,
    *,
    views: Views | None = None,
    truth_boxes: TruthBoxes | None = None,
) -> Evaluation:
    """Every figure that the given tables allow.

    Tracks and truth give errors; bearings and truth give detections and the bound;
    bearings alone give the distance of the tracks from where sight lines meet, and the
    prediction of held-out sensors; views and true boxes give recall and precision.
    Lengths are in the scene's unit, which ends the names of such metrics (`rmse_m`).

    Raises:
        InputError: the tables do not fit together (no common identity, time or sensor).
    """
    config = config or EvaluateConfig()
    metrics: dict[str, float] = {}
    errors, bound, pairs = Errors.empty(), Bound.empty(), dict[int, int]()
    if tracks is not None and truth is not None:
        matched = compare(tracks, truth, config)
        errors, pairs = matched.errors, matched.pairs
        metrics |= matched.counts | error_metrics(errors, scene.length_unit)
    elif tracks is not None:
        metrics |= {"tracks": len(np.unique(tracks.target_id)), "estimates_without_truth": len(tracks)}
    if bearings is not None and truth is not None:
        labels = _labels(bearings, truth, pairs)
        looks = looks_of(bearings, truth, scene, labels, config)
        unmatched = (bearings.target_id >= 0) & ~np.isin(bearings.target_id, list(labels))
        metrics |= detection_metrics(looks) | {"bearings_unmatched": int(np.count_nonzero(unmatched))}
        used = {name: found for name, found in looks.items() if name not in config.held_out}
        bound = compute_bound(used, truth, errors, scene, config)
        metrics |= bound_metrics(errors, bound, scene.length_unit)
    if len(errors) and (config.skip_s > 0 or config.from_ns is not None):
        metrics |= _settled(errors, bound, scene.length_unit, config)
    metrics |= _without_truth(tracks, bearings, scene, config)
    if views is not None and truth_boxes is not None:
        metrics |= view_metrics(views, truth_boxes, config)
    return Evaluation({name: float(value) for name, value in metrics.items()}, errors, bound)


def _without_truth(
    tracks: Tracks | None, bearings: Bearings | None, scene: Scene, config: EvaluateConfig
) -> dict[str, float]:
    if config.held_out and (tracks is None or bearings is None):
        raise InputError("evaluate: a held-out sensor needs tracks made without it and bearings that include it")
    if tracks is None or bearings is None:
        return {}
    out = meeting_metrics(tracks, bearings, scene, config)
    return out | held_out_metrics(tracks, bearings, scene, config) if config.held_out else out


def _labels(bearings: Bearings, truth: Truth, pairs: Mapping[int, int]) -> dict[int, int]:
    """Identity in the bearings to identity in the truth: as the tracks were paired, else by equal numbers."""
    out, taken = dict(pairs), set(pairs.values())
    targets = set(np.unique(truth.target_id[truth.role == "target"]).tolist())
    for label in np.unique(bearings.target_id).tolist():
        if label >= 0 and label not in out and label in targets and label not in taken:
            out[label] = label
    return out


def _settled(errors: Errors, bound: Bound, unit: str, config: EvaluateConfig) -> dict[str, float]:
    """The figures of errors and bound once more after the transient, with names that begin with `settled_`."""
    late = errors.take(settled(errors, config))
    figures = error_metrics(late, unit) | {"estimates": len(late)}
    figures |= bound_metrics(late, bound, unit) if len(bound) and len(late) else {}
    return {f"settled_{name}": value for name, value in figures.items()}
