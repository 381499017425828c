"""Results of an evaluation, conditions such as `rmse>0.5`, and the figures as text (groups, targets, sensors)."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from occlog.errors import UsageError, nearest
from occlog.records.declared.views import Counts, Failures
from occlog.records.tables import Bound, Errors
from occlog.records.verdicts import Check, Verdict, summary_of

from .metric_names import UNITS
from .mot import figures as headline

OPERATORS: dict[str, Callable[[float, float], bool]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "<": operator.lt,
    ">": operator.gt,
}
CONDITION = re.compile(r"\s*([^<>=]+?)\s*(<=|>=|<|>)\s*([^<>=]+?)\s*")


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Figures of an evaluation, and the tables behind them.

    Attributes:
        metrics: figures by name, which ends in the unit.
        errors: error of each estimate that has a truth.
        bound: posterior Cramer-Rao bound over time.
        failures: failures of trackers.
        counts: numbers of targets and tracks on the ground over time.
        notes: lines for the user.
        checks: checks of the tracks; None: no check was possible.
        verdicts: consistency verdicts of the earlier stages, then of this evaluation.
        plugged: names of the figures of plug-ins.
    """

    metrics: dict[str, float]
    errors: Errors = field(default_factory=Errors.empty)
    bound: Bound = field(default_factory=Bound.empty)
    failures: Failures = field(default_factory=Failures.empty)
    counts: Counts = field(default_factory=Counts.empty)
    notes: tuple[str, ...] = ()
    checks: tuple[Check, ...] | None = None
    verdicts: tuple[Verdict, ...] = ()
    plugged: tuple[str, ...] = ()

    @property
    def figures(self) -> dict[str, object]:
        """All figures by name, with the verdict on plausibility."""
        return {**self.metrics, **summary_of(self.verdicts)}


@dataclass(frozen=True)
class Threshold:
    """Condition of failure such as `rmse>0.5`: it is met if the comparison is true or undecidable (NaN, missing).

    Attributes:
        metric: name of the figure.
        operator: comparison, for example `>`.
        limit: number that the figure is compared with.
    """

    metric: str
    operator: str
    limit: float

    def __str__(self) -> str:
        return f"{self.metric}{self.operator}{self.limit:g}"


def parse_threshold(text: str) -> Threshold:
    """Parse a threshold such as `rmse>0.5`; UsageError for any other text.

    A limit that is not finite (`> nan`, `> inf`) is refused too.
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
    """Return a message for each threshold that is met (a failure), or whose figure is missing, ambiguous or NaN."""
    return [line for t in thresholds if (line := _failure(metrics, t)) is not None]


def _failure(metrics: Mapping[str, float], threshold: Threshold) -> str | None:
    names = find_metric(metrics, threshold.metric)
    if not names:
        near = nearest(threshold.metric, metrics, n=3, cutoff=0.5)
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
    """Return the full names in `metrics` that a name, with or without unit, can mean; empty if unknown."""
    if name in metrics:
        return [name]
    return [full for full in (f"{name}_{unit}" for unit in UNITS) if full in metrics]


LABEL = 48
"""Width of labels before a number: that of the longest."""
GROUP = (
    "many targets",
    (
        ("fr_p", "targets without a tracker, FR_p", ""),
        ("fr_l", "trackers on another target, FR_l", ""),
        ("mota", "MOTA", ""),
        ("motp", "mean 1 - IoU of the pairs, MOTP", ""),
        ("motp", "mean distance of the pairs, MOTP", "length"),
        ("idf1", "IDF1", ""),
        ("idf1_across_views", "IDF1 across views", ""),
        ("hota", "HOTA", ""),
        ("deta", "  detection, DetA", ""),
        ("assa", "  association, AssA", ""),
        ("loca", "  localisation, LocA", ""),
        ("gospa", "mean GOSPA of 1 - IoU", ""),
        ("gospa", "mean GOSPA", "length"),
        ("tgospa", "trajectory GOSPA", "length"),
        ("ospa2", "OSPA(2)", "length"),
        ("ospa2_window", "  mean over windows", "length"),
        ("moda", "MODA", ""),
        ("modp", "MODP", ""),
        ("matched_rmse", "RMSE of the pairs", "length"),
        ("matched_nees_mean", "  mean NEES (consistent: 2)", ""),
        ("matched_nees_share_95", "  inside the 95 % ellipse", ""),
        ("count_targets_mean", "people at a time, true", ""),
        ("count_tracks_mean", "  estimated", ""),
        ("count_error_rms", "  RMS difference", ""),
        ("recall", "recall", ""),
        ("precision", "precision", ""),
        ("fp", "false", ""),
        ("fn", "missed", ""),
        ("id_switches", "identity switches", ""),
        ("fragmentations", "fragmentations", ""),
        ("mostly_tracked", "targets mostly tracked", ""),
        ("partly_tracked", "  partly", ""),
        ("mostly_lost", "  mostly lost", ""),
        ("objects", "true rows", ""),
        ("objects_interpolated", "  of them interpolated", ""),
        ("frames", "frames", ""),
        ("estimates_other_frames", "skipped: rows in other frames", ""),
    ),
)
PAIRS = (
    ("hota", "HOTA", ""),
    ("idf1", "IDF1", ""),
    ("mota", "MOTA", ""),
    ("id_switches", "identity switches", ""),
    ("matched_rmse", "RMSE, matching per frame", "length"),
    ("matched_nees_mean", "  mean NEES (consistent: 2)", ""),
    ("matched_nees_share_95", "  inside the 95 % ellipse", ""),
    ("matched_gate", "  gate of a match", "length"),
)
"""First figures of tracks with their own identities."""
BY_SENSOR_IN_IMAGES = (
    ("fr_p", "FR_p", ""),
    ("fr_l", "FR_l", ""),
    ("mota", "MOTA", ""),
    ("idf1", "IDF1", ""),
    ("hota", "HOTA", ""),
    ("objects", "true rows", ""),
)


Entry = tuple[str, str, str]

# Heading, then (name without unit, label, unit); `length` represents the scene's unit.
GROUPS: tuple[tuple[str, tuple[Entry, ...]], ...] = (
    (
        "errors",
        (
            ("rmse", "RMSE", "length"),
            ("rmse_x", "along x", "length"),
            ("rmse_y", "along y", "length"),
            ("error_mean", "mean", "length"),
            ("error_median", "median", "length"),
            ("error_p95", "95 %", "length"),
            ("error_max", "largest", "length"),
            ("nees_mean", "mean NEES (consistent: 2)", ""),
            ("nees_share_95", "inside the 95 % ellipse", ""),
            ("estimates", "estimates", ""),
            ("rmse_z", "along z", "length"),
            ("rmse_space", "RMSE in space", "length"),
            ("error_space_median", "median in space", "length"),
            ("error_space_p95", "95 % in space", "length"),
            ("nees_space_mean", "mean NEES in space (consistent: 3)", ""),
            ("nees_space_share_95", "inside the 95 % ellipsoid", ""),
            ("estimates_space", "estimates in space", ""),
            ("estimates_interpolated_truth", "of them with a truth that was interpolated", ""),
            ("estimates_without_truth", "skipped: no truth given, or none near in time", ""),
            ("estimates_unmatched", "skipped: of no target", ""),
            ("time_coverage", "truth covered", ""),
        ),
    ),
    (
        "settled",
        (
            ("settled_rmse", "RMSE", "length"),
            ("settled_bound_rmse", "bound", "length"),
            ("settled_bound_ratio", "RMSE / bound", ""),
            ("settled_smoothed_bound_rmse", "bound of smoothing", "length"),
            ("settled_smoothed_bound_ratio", "RMSE / bound of smoothing", ""),
            ("settled_rmse_space", "RMSE in space", "length"),
            ("settled_bound_rmse_space", "bound in space", "length"),
            ("settled_bound_ratio_space", "RMSE / bound in space", ""),
            ("settled_estimates", "estimates", ""),
        ),
    ),
    (
        "bound",
        (
            ("bound_rmse", "bound on the RMSE", "length"),
            ("bound_ratio", "RMSE / bound", ""),
            ("smoothed_bound_rmse", "  the future known, too (smoothing)", "length"),
            ("smoothed_bound_ratio", "  RMSE / bound of smoothing", ""),
            ("bound_rmse_z", "bound along z", "length"),
            ("bound_rmse_space", "bound in space", "length"),
            ("bound_ratio_space", "RMSE / bound in space", ""),
            ("smoothed_bound_rmse_space", "  the future known, too, in space", "length"),
            ("smoothed_bound_ratio_space", "  RMSE / bound of smoothing in space", ""),
        ),
    ),
    (
        "bearings",
        (
            ("detection_rate", "detection rate", ""),
            ("detected", "detected", ""),
            ("missed", "missed", ""),
            ("false_alarms", "false alarms", ""),
            ("false_alarms_per_frame", "false alarms a frame", ""),
            ("correct_rejections", "hidden and not reported", ""),
            ("bearing_rms", "RMS error", "px"),
            ("bearing_bias", "bias", "px"),
            ("bearing_rms", "RMS error", "mrad"),
            ("elevation_rms", "RMS error of elevations", "mrad"),
        ),
    ),
    (
        "lines of sight",
        (
            ("triangulation_distance_max", "track to meeting point, largest", "length"),
            ("triangulation_distance_median", "median", "length"),
            ("triangulation_distance_p95", "95 %", "length"),
            ("triangulation_share_within", "share within the limit", ""),
            ("triangulation_compared", "scans compared", ""),
            ("triangulation_refused", "scans refused (lines nearly parallel)", ""),
            ("triangulation_residual_rms", "lines miss the meeting point by", "mrad"),
        ),
    ),
    (
        "noise, from how far lines of three sensors and more miss one another",
        (
            ("measurement_noise_scale", "factor on stated standard deviations", ""),
            ("measurement_noise_px", "noise", "px"),
            ("measurement_noise_scans", "scans", ""),
        ),
    ),
    (
        "held out",
        (
            ("held_out_median", "median residual", "px"),
            ("held_out_median_chance", "  by chance", "px"),
            ("held_out_rms", "RMS residual", "px"),
            ("held_out_p95", "95 %", "px"),
            ("held_out_median", "median residual", "mrad"),
            ("held_out_share_within", "frames predicted", ""),
            ("held_out_share_within_chance", "  by chance", ""),
            ("held_out_frames", "frames", ""),
        ),
    ),
    (
        "boxes of held-out cameras",
        (
            ("held_out_boxes_share", "predicted", ""),
            ("held_out_boxes_share_chance", "  by chance", ""),
            ("held_out_boxes_feet_share", "  by their feet", ""),
            ("held_out_boxes_precision", "expected people with a box", ""),
            ("held_out_boxes_median", "median distance", "px"),
            ("held_out_boxes", "boxes", ""),
        ),
    ),
    (
        "cooperation",
        (
            ("cooperation_requests", "requests", ""),
            ("cooperation_answered", "answered", ""),
            ("cooperation_shared", "shared positions", ""),
            ("cooperation_frames", "frames asked for", ""),
            ("cooperation_period", "mean time between requests", "s"),
            ("cooperation_requests_periodic", "  by the period", ""),
            ("cooperation_requests_count", "  by the count", ""),
            ("cooperation_requests_bearing", "  by the bearing", ""),
            ("cooperation_requests_ellipse", "  by the ellipse", ""),
            ("cooperation_requests_spread", "  by the spread", ""),
        ),
    ),
    (
        "views",
        (
            ("views_recall", "recall", ""),
            ("views_recall_clear", "  in the clear", ""),
            ("views_recall_front", "  in front of other targets", ""),
            ("views_recall_hidden", "  partly hidden", ""),
            ("views_precision", "precision", ""),
            ("views_error_rms", "horizontal RMS error", "px"),
            ("views_error_rms_clear", "  in the clear", "px"),
            ("views_error_rms_front", "  in front of others", "px"),
            ("views_error_rms_hidden", "  partly hidden", "px"),
        ),
    ),
    GROUP,
)

MAX_TARGETS_SHOWN = 10
"""Targets in the table; of more the worst are shown, and none of them in the summary in JSON."""
OF_TARGET = re.compile(r"_target_\d+(_|$)")
BY_TARGET = (
    ("rmse", "RMSE", "length"),
    ("bound_rmse", "bound", "length"),
    ("bound_ratio", "ratio", ""),
    ("rmse_space", "in space", "length"),
    ("bound_rmse_space", "bound", "length"),
    ("bound_ratio_space", "ratio", ""),
    ("nees_mean", "NEES", ""),
    ("estimates", "estimates", ""),
)
OF_SMOOTHED = tuple(
    (f"smoothed_{name}" if name.startswith("bound_") else name, label, of) for name, label, of in BY_TARGET
)
"""For smoothed tracks: the bound of smoothing with their errors."""
BY_SENSOR = (
    ("detection_rate", "rate", ""),
    ("detected", "detected", ""),
    ("missed", "missed", ""),
    ("false_alarms", "false", ""),
    ("bearing_rms", "RMS", "px"),
    ("held_out_median", "held out", "px"),
    ("views_recall", "recall", ""),
    ("views_precision", "precision", ""),
    *BY_SENSOR_IN_IMAGES,
)


BY_RECORDING = (
    ("mota", "MOTA", ""),
    ("idf1", "IDF1", ""),
    ("hota", "HOTA", ""),
    ("moda", "MODA", ""),
    ("recall", "recall", ""),
    ("precision", "precision", ""),
    ("id_switches", "switches", ""),
    ("matched_rmse", "RMSE", "length"),
    ("matched_nees_mean", "NEES", ""),
    ("ospa2", "OSPA(2)", "length"),
    ("tgospa", "T-GOSPA", "length"),
    ("fr_p", "FR_p", ""),
    ("fr_l", "FR_l", ""),
    ("objects", "true rows", ""),
)


def recording_lines(each: Mapping[str, Mapping[str, float]], combined: Mapping[str, float], unit: str) -> list[str]:
    """Return the lines of a text table with a row for each recording, and one for all together.

    Args:
        each: figures of each recording by name.
        combined: figures over all.
        unit: unit of lengths.
    """
    rows = {**each, "all": combined}
    flat = {f"{key}_recording_{name}": value for name, row in rows.items() for key, value in row.items()}
    used = [entry for entry in BY_RECORDING if next(_keys([entry], "", unit))[0] in combined]
    width = max(10, *(len(name) + 2 for name in rows))
    titles = [f"{label} [{of}]" if of else label for _, label, of in _keys(used, "", unit)]
    lines = [f"{'recording':<{width}}" + "".join(f"{title:>13}" for title in titles)]
    for name in rows:
        cells = [flat.get(f"{key}_recording_{name}", math.nan) for key, _, _ in _keys(used, "", unit)]
        lines.append(f"{name:<{width}}" + "".join(f"{number(value):>13}" for value in cells))
    return lines


def summary_lines(metrics: Mapping[str, float], unit: str) -> list[str]:
    """Return the figures as lines of text: a group for each topic, then tables of targets and sensors.

    Only groups and columns with figures are shown. `unit`: unit of lengths. Errors of smoothed tracks
    (`tracks_smoothed`) are compared with the smoothing bound.
    """
    lines: list[str] = []
    own = headline.independent_ids(metrics)
    groups = (("tracks", PAIRS), GROUP, *GROUPS[:-1]) if own else GROUPS
    for heading, entries in groups:
        shown = [(label, metrics[key], of) for key, label, of in _keys(entries, "", unit) if key in metrics]
        if own and entries is GROUP[1]:
            keys = [key for key, _, _ in _keys(entries, "", unit) if key in metrics]
            shown = [row for key, row in zip(keys, shown, strict=True) if key not in headline.names(unit)]
        if shown:
            if heading == "errors" and (own or headline.matchings_differ(metrics, unit)):
                heading = "errors, one-to-one matching over the whole run"
            lines += ["", heading] if lines else [heading]
            lines += [f"  {label:<{LABEL}}{number(value):>12} {of}".rstrip() for label, value, of in shown]
    for kind, columns in (
        ("target", OF_SMOOTHED if metrics.get("tracks_smoothed") else BY_TARGET),
        ("sensor", BY_SENSOR),
    ):
        names = _names(metrics, kind, columns, unit)
        left = 0
        if kind == "target" and len(names) > MAX_TARGETS_SHOWN:
            left = len(names) - MAX_TARGETS_SHOWN
            worst = sorted(names, key=lambda name: -metrics.get(f"rmse_target_{name}_{unit}", 0.0))[:MAX_TARGETS_SHOWN]
            names = [name for name in names if name in worst]
        lines += _table(metrics, kind, names, columns, unit) if names else []
        lines += [f"and {left} targets with a smaller RMSE; the figures in a file (-o) are of all"] if left else []
    return lines


def without_per_target(figures: Mapping[str, object]) -> dict[str, object]:
    """Return a copy of the figures, without those of single targets if these are more than `MAX_TARGETS_SHOWN`."""
    targets = {found[0] for name in figures if (found := OF_TARGET.search(name))}
    few = len({name.rstrip("_") for name in targets}) <= MAX_TARGETS_SHOWN
    return {name: value for name, value in figures.items() if few or not OF_TARGET.search(name)}


def number(value: float) -> str:
    """Return `value` as text: four digits, whole numbers in full, a dash for NaN."""
    if not math.isfinite(value):
        return "-"
    return f"{value:.0f}" if value == round(value) and abs(value) < 1e15 else f"{value:.4g}"


def _keys(entries: Iterable[Entry], suffix: str, unit: str) -> Iterator[tuple[str, str, str]]:
    """Generate full name, label and unit of each entry of a table of figures (name, label, unit).

    `suffix` follows the name; `unit`: unit of lengths, replaces `length`.
    """
    for name, label, of in entries:
        of = unit if of == "length" else of
        yield f"{name}{suffix}_{of}" if of else f"{name}{suffix}", label, of


def _names(metrics: Mapping[str, float], kind: str, columns: Iterable[Entry], unit: str) -> list[str]:
    """Return the names of the targets or sensors that have a figure in one of the columns, in the order of the metrics.

    Args:
        metrics: figures by full name.
        kind: `target` or `sensor`.
        columns: columns of the table (name, label, unit).
        unit: unit of lengths.
    """
    found: dict[str, None] = {}
    for pattern, _, _ in _keys(columns, f"_{kind}_\0", unit):
        start, end = pattern.split("\0")
        for key in metrics:
            if key.startswith(start) and key.endswith(end):
                found[key[len(start) : len(key) - len(end)]] = None
    return list(found)


def _table(metrics: Mapping[str, float], kind: str, names: list[str], columns: Iterable[Entry], unit: str) -> list[str]:
    used = [c for c in columns if any(k in metrics for n in names for k, _, _ in _keys([c], f"_{kind}_{n}", unit))]
    width = max(10, *(len(n) + 2 for n in names))
    titles = [f"{label} [{of}]" if of else label for _, label, of in _keys(used, "", unit)]
    lines = ["", f"{kind:<{width}}" + "".join(f"{title:>15}" for title in titles)]
    for name in names:
        cells = [metrics.get(key, math.nan) for key, _, _ in _keys(used, f"_{kind}_{name}", unit)]
        lines.append(f"{name:<{width}}" + "".join(f"{number(value):>15}" for value in cells))
    return lines
