"""Computes every figure that tracks, truth, bearings and requests of cameras allow.

Figures are judged by conditions such as `rmse>0.5`.
"""

from __future__ import annotations

import difflib
import math
import operator
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from occlog.array_types import NS
from occlog.consistency.verdict import Finding, figures
from occlog.errors import InputError, UsageError
from occlog.evaluate.bearings.boxes import view_metrics
from occlog.evaluate.bearings.detections import detection_metrics, looks_of
from occlog.evaluate.bearings.held_out import held_out_metrics
from occlog.evaluate.bearings.held_out_boxes import held_out_box_metrics
from occlog.evaluate.bearings.meeting import meeting_metrics
from occlog.evaluate.bearings.noise import noise_metrics
from occlog.evaluate.errors.bound import Measured, bound_metrics, compute_bound
from occlog.evaluate.errors.distances import DistancesOfTargets
from occlog.evaluate.errors.on_ground import compare, gaps_note, settled
from occlog.evaluate.errors.sums import error_metrics
from occlog.evaluate.figures import UNITS
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.matching.looks import SensorLooks
from occlog.records.declared.measurements import Measurements
from occlog.records.declared.people import PeopleTracks
from occlog.records.declared.views import Counts, Failures
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Bound, Boxes, Cooperation, Errors, Tracks, Truth, TruthBoxes, Views
from occlog.scans.config import MeasuredConfig
from occlog.scans.measured import Radio

OPERATORS: dict[str, Callable[[float, float], bool]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "<": operator.lt,
    ">": operator.gt,
}
CONDITION = re.compile(r"\s*([^<>=]+?)\s*(<=|>=|<|>)\s*([^<>=]+?)\s*")
SHARED = "shared"
CAUSES = ("periodic", "count", "bearing", "ellipse", "spread")


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Figures, and the tables behind them.

    Attributes:
        metrics: flat; the unit is the end of the name.
        errors: of every estimate that has a truth.
        bound: posterior Cramer-Rao bound.
        failures: of trackers.
        counts: of targets and tracks on the ground, over time.
        notes: lines that the user must know of.
        findings: what speaks against the tracks; None: nobody has judged them.
        looks: of every sensor at targets whose place is known.
        plugged: names of the metrics that are of plug-ins.
    """

    metrics: dict[str, float]
    errors: Errors = field(default_factory=Errors.empty)
    bound: Bound = field(default_factory=Bound.empty)
    failures: Failures = field(default_factory=Failures.empty)
    counts: Counts = field(default_factory=Counts.empty)
    notes: tuple[str, ...] = ()
    findings: tuple[Finding, ...] | None = None
    looks: Mapping[str, SensorLooks] = field(default_factory=dict)
    plugged: tuple[str, ...] = ()

    @property
    def figures(self) -> dict[str, object]:
        """The metrics with the verdict."""
        return {**self.metrics, **({} if self.findings is None else figures(self.findings))}


@dataclass(frozen=True)
class Threshold:
    """The evaluation fails if `metric operator limit` is true, or cannot be told."""

    metric: str
    operator: str
    limit: float

    def __str__(self) -> str:
        return f"{self.metric}{self.operator}{self.limit:g}"


def parse_threshold(text: str) -> Threshold:
    """Threshold from text such as `rmse>0.5`; UsageError for any other text.

    A comparison that no number satisfies or every number does (`> nan`, `> inf`) is refused too.
    """
    found = CONDITION.fullmatch(text)
    try:
        limit = float(found[3]) if found else math.nan
    except ValueError:
        limit = math.nan
    if not found or not math.isfinite(limit):
        raise UsageError(f"{text!r}: must be a metric, one of > >= < <=, and a number, as in 'rmse>0.5'")
    return Threshold(found[1], found[2], limit)


def failures(metrics: Mapping[str, float], thresholds: Iterable[Threshold]) -> list[str]:
    """One line for each threshold that is broken, or whose metric is missing, ambiguous or not a number."""
    return [line for t in thresholds if (line := _failure(metrics, t)) is not None]


def _failure(metrics: Mapping[str, float], threshold: Threshold) -> str | None:
    names = find_metric(metrics, threshold.metric)
    if not names:
        near = difflib.get_close_matches(threshold.metric, metrics, n=3, cutoff=0.5)
        hint = f"; did you mean {' or '.join(near)}?" if near else ""
        return f"{threshold}: there is no metric {threshold.metric!r}{hint}"
    if len(names) > 1:
        return f"{threshold}: {threshold.metric!r} can be {' or '.join(names)}; name one"
    value = metrics[names[0]]
    if not math.isfinite(value):
        return f"{threshold}: {names[0]} is not a number ({value}): there was nothing to compute it from"
    if OPERATORS[threshold.operator](value, threshold.limit):
        return f"{threshold}: {names[0]} is {value:.6g}"
    return None


def find_metric(metrics: Mapping[str, float], name: str) -> list[str]:
    """Full names that a name with or without its unit can stand for; a full name stands for itself."""
    if name in metrics:
        return [name]
    return [full for full in (f"{name}_{unit}" for unit in UNITS) if full in metrics]


def evaluate(
    tracks: Tracks | None,
    truth: Truth | None,
    bearings: Bearings | None,
    scene: Scene,
    config: EvaluateConfig | None = None,
    *,
    views: Views | None = None,
    truth_boxes: TruthBoxes | None = None,
    cooperation: Cooperation | None = None,
    smoothed: bool = False,
    found: Boxes | Views | None = None,
    measured: tuple[Measurements, MeasuredConfig, Radio | None] | None = None,
) -> Evaluation:
    """Every figure that the given tables allow.

    Tracks and truth give errors; bearings and truth give detections and the bound;
    bearings alone give the distance of the tracks from where sight lines meet, and the
    prediction of held-out sensors; views and true boxes give recall and precision;
    requests of cameras give their cost.
    Lengths are in the scene's unit, which ends the names of such metrics (`rmse_m`).
    `smoothed` says that the tracks know what came after them; `found` are boxes of everybody, to be predicted where
    their camera is held out.
    `measured` are measurements of distances, which count in the bound, with what must be known of them.

    Raises:
        InputError: the tables do not fit together (no common identity, time or sensor).
    """
    config = config or EvaluateConfig()
    metrics: dict[str, float] = {}
    errors, bound, pairs = Errors.empty(), Bound.empty(), dict[int, int]()
    looks: dict[str, SensorLooks] = {}
    notes: list[str] = []
    if tracks is not None and truth is not None:
        matched = compare(tracks, truth, config)
        errors, pairs = matched.errors, matched.pairs
        gaps = gaps_note(tracks, truth, pairs, config)
        notes += [] if gaps is None else [gaps]
        metrics |= matched.counts | error_metrics(errors, scene.length_unit)
        if np.isnan(tracks.cov_xx).any():
            metrics = {name: value for name, value in metrics.items() if not name.startswith("nees_")}
    elif tracks is not None:
        metrics |= {"tracks": len(np.unique(tracks.target_id)), "estimates_without_truth": len(tracks)}
    if bearings is not None and truth is not None:
        labels = _labels(bearings, truth, pairs)
        looks = looks_of(bearings, truth, scene, labels, config)
        unmatched = (bearings.target_id >= 0) & ~np.isin(bearings.target_id, list(labels))
        metrics |= detection_metrics(looks) | {"bearings_unmatched": int(np.count_nonzero(unmatched))}
        used = {name: found for name, found in looks.items() if name not in config.held_out}
        distances = None if measured is None else _distances(measured, truth, pairs, scene)
        bound = compute_bound(used, truth, errors, scene, config, distances)
        metrics |= bound_metrics(errors, bound, scene.length_unit)
    elif measured is not None and truth is not None:
        bound = compute_bound({}, truth, errors, scene, config, _distances(measured, truth, pairs, scene))
        metrics |= bound_metrics(errors, bound, scene.length_unit)
    if len(errors) and (config.skip_s > 0 or config.from_ns is not None):
        metrics |= _settled(errors, bound, scene.length_unit, config)
    metrics |= {} if bearings is None else noise_metrics(bearings, scene, config)
    metrics |= {"tracks_smoothed": 1.0} if smoothed else {}
    if config.held_out and (tracks is None or (bearings is None and found is None)):
        raise InputError(
            "evaluate: a held-out sensor needs tracks made without it, and bearings or boxes that include it"
        )
    compared = _without_truth(tracks, bearings, scene, config)
    if tracks is not None and bearings is not None and truth is None and not compared:
        notes.append(no_meeting(bool(np.any(bearings.seen & (bearings.target_id >= 0))), config))
    metrics |= compared
    if found is not None and isinstance(tracks, PeopleTracks):
        metrics |= held_out_box_metrics(tracks, found, scene, config)
    if views is not None and truth_boxes is not None:
        metrics |= view_metrics(views, truth_boxes, config)
    if cooperation is not None:
        metrics |= cooperation_figures(cooperation, tracks)
    figures = {name: float(value) for name, value in metrics.items()}
    return Evaluation(figures, errors, bound, looks=looks, notes=tuple(notes))


def no_meeting(labelled: bool, config: EvaluateConfig) -> str:
    """Why no track was compared with where sight lines meet, and what to do.

    Args:
        labelled: a bearing says which target it is of.
        config: how far apart bearings of one scan may be.
    """
    if labelled:
        return (
            f"warning: at no time bearings of one target come from {config.lines_min_sensors} sensors within "
            f"{config.lines_window_s:g} s, so that the tracks are compared with nothing; widen it (lines_window)"
        )
    return (
        "warning: no bearing says which target it is of, so that the tracks are compared with nothing; label them with "
        "`occlog label`, or take the numbers of sources for targets (doa_labels)"
    )


def _without_truth(
    tracks: Tracks | None, bearings: Bearings | None, scene: Scene, config: EvaluateConfig
) -> dict[str, float]:
    if tracks is None or bearings is None:
        return {}
    out = meeting_metrics(tracks, bearings, scene, config)
    return out | held_out_metrics(tracks, bearings, scene, config) if config.held_out else out


def _distances(
    measured: tuple[Measurements, MeasuredConfig, Radio | None], truth: Truth, pairs: Mapping[int, int], scene: Scene
) -> Measured:
    """Measurements of distances of the targets of the truth."""
    table, config, radio = measured
    labels = _labels(table, truth, pairs)
    found = DistancesOfTargets(labels, scene, config, radio)
    out = found.add(table)
    found.finish()
    return out


def _labels(bearings: Bearings | Measurements, truth: Truth, pairs: Mapping[int, int]) -> dict[int, int]:
    """Identity in the bearings to identity in the truth: as the tracks were paired, else by equal numbers.

    A number below 0 is no identity in bearings, though a track may have it.
    """
    out, taken = {track: target for track, target in pairs.items() if track >= 0}, set(pairs.values())
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


def cooperation_figures(asked: Cooperation, tracks: Tracks | None = None) -> dict[str, float]:
    """Requests, frames and their mean period.

    Args:
        asked: requests; rows of cause `shared` are none, but places that came along with others.
        tracks: what was tracked; the period is their length by the number of times at which
            cameras were asked.  None: the mean time between these.

    Returns:
        `cooperation_requests` (one for each target and time), `cooperation_answered`,
        `cooperation_shared`, `cooperation_frames`, `cooperation_period_s` (NaN if it cannot be
        told), and `cooperation_requests_CAUSE`; a request with several causes counts for each.
    """
    found = CooperationCounts()
    found.add(asked)
    return found.figures(None if tracks is None or not len(tracks) else (int(tracks.t_ns[0]), int(tracks.t_ns[-1])))


class CooperationCounts:
    """Counts requests while they stream by."""

    def __init__(self) -> None:
        """No request yet."""
        self._rows = self._own = self._answered = self._frames = self._times = 0
        self._causes: Counter[str] = Counter()
        self._span: tuple[int, int] | None = None

    def add(self, asked: Cooperation) -> None:
        """Requests of some more times."""
        own = asked.take(asked.cause != SHARED)
        self._rows, self._own = self._rows + len(asked), self._own + len(own)
        self._answered += int(np.count_nonzero(own.answered))
        self._frames += int(asked.frames.sum())
        self._causes.update(cause for text in own.cause.tolist() for cause in text.split(","))
        times = np.unique(own.t_ns)
        self._times += len(times)
        if len(times):
            self._span = (int(times[0]) if self._span is None else self._span[0]), int(times[-1])

    def figures(self, tracked: tuple[int, int] | None) -> dict[str, float]:
        """As `cooperation_figures`; `tracked`: first and last time of the tracks; None: there are none."""
        first, last = tracked or self._span or (0, 0)
        count, causes = (self._times if tracked else self._times - 1), self._causes
        return {
            "cooperation_requests": float(self._own),
            "cooperation_answered": float(self._answered),
            "cooperation_shared": float(self._rows - self._own),
            "cooperation_frames": float(self._frames),
            "cooperation_period_s": float(last - first) / NS / count if count > 0 else math.nan,
            **{f"cooperation_requests_{c}": float(causes[c]) for c in (*CAUSES, *sorted(set(causes) - set(CAUSES)))},
        }
