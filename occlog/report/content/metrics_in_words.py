"""Names of an evaluation's metrics for people: meaning, unit, and target or sensor."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from occlog.evaluate.mot.figures import INDEPENDENT_IDS

LENGTH = "length"
AREA = "squared length"
SHARE = "share"


class Word(NamedTuple):
    """Vocabulary entry of a metric: where it is shown, and its name in words.

    `group`: title of its group; `base`: key without target, sensor and unit; `unit`: `length`, `squared length`,
    `share`, `px` or `mrad`, empty: none; `note`: explanation; `short`: whether it is also shown for each target or
    sensor.
    """

    group: str
    base: str
    name: str
    unit: str = ""
    note: str = ""
    short: bool = True  # shown for each target or sensor too


_ACCURACY, _BOUND, _TRUST = "Accuracy", "Bound", "Consistency"
_MANY = "Tracking of many targets"
_SEEN, _MEET, _HELD, _VIEWS = "Detection", "Lines of sight", "Prediction of held-out sensors", "Views and true boxes"

WORDS: tuple[Word, ...] = (
    Word(_MANY, "hota", "HOTA", "", "geometric mean of detection and association, over thresholds of similarity"),
    Word(_MANY, "deta", "DetA", "", "detection part of HOTA"),
    Word(_MANY, "assa", "AssA", "", "association part of HOTA"),
    Word(_MANY, "loca", "LocA", "", "mean similarity of the matches"),
    Word(_MANY, "idf1", "IDF1", "", "share of rows with the right identity"),
    Word(_MANY, "mota", "MOTA", "", "1 - (missed + false + switches) / true rows"),
    Word(_MANY, "id_switches", "identity switches"),
    Word(_MANY, "fragmentations", "fragmentations", "", "times that a target is tracked again after a gap"),
    Word(_MANY, "recall", "recall", SHARE, "true rows with a track"),
    Word(_MANY, "precision", "precision", SHARE, "rows of tracks with a target"),
    Word(_MANY, "matched_rmse", "RMSE, matching per frame", LENGTH, "within the gate"),
    Word(_MANY, "matched_error_median", "median error, matching per frame", LENGTH),
    Word(_MANY, "matched_error_p95", "95 % of these errors below", LENGTH),
    Word(_MANY, "matched_gate", "gate of a match", LENGTH),
    Word(_MANY, "matched_nees_mean", "mean NEES, matching per frame", "", "2 where covariances are right"),
    Word(_MANY, "matched_nees_share_95", "inside the 95 % ellipse", SHARE, "95 where covariances are right"),
    Word(_MANY, "gospa", "mean GOSPA", LENGTH),
    Word(_MANY, "tgospa", "trajectory GOSPA", LENGTH),
    Word(_MANY, "ospa2", "OSPA(2)", LENGTH),
    Word(_MANY, "ospa2_localisation", "OSPA(2), localisation", LENGTH, "", False),
    Word(_MANY, "ospa2_cardinality", "OSPA(2), cardinality", LENGTH, "", False),
    Word(_MANY, "ospa2_window", "OSPA(2), mean over windows", LENGTH, "", False),
    Word(_MANY, "gospa", "mean GOSPA of 1 - IoU", "", "", False),
    Word(_MANY, "gospa_localisation", "mean GOSPA, localisation", AREA, "", False),
    Word(_MANY, "gospa_localisation", "mean GOSPA of 1 - IoU, localisation", "", "", False),
    Word(_MANY, "gospa_missed", "mean GOSPA, missed", AREA, "", False),
    Word(_MANY, "gospa_missed", "mean GOSPA of 1 - IoU, missed", "", "", False),
    Word(_MANY, "gospa_false", "mean GOSPA, false", AREA, "", False),
    Word(_MANY, "gospa_false", "mean GOSPA of 1 - IoU, false", "", "", False),
    Word(_MANY, "tgospa_localisation", "trajectory GOSPA, localisation", AREA, "", False),
    Word(_MANY, "tgospa_missed", "trajectory GOSPA, missed", AREA, "", False),
    Word(_MANY, "tgospa_false", "trajectory GOSPA, false", AREA, "", False),
    Word(_MANY, "tgospa_switch", "trajectory GOSPA, switches", AREA, "", False),
    Word(_MANY, "detre", "DetRe", "", "recall of the detection part of HOTA", False),
    Word(_MANY, "detpr", "DetPr", "", "precision of the detection part of HOTA", False),
    Word(_MANY, "assre", "AssRe", "", "recall of the association part of HOTA", False),
    Word(_MANY, "asspr", "AssPr", "", "precision of the association part of HOTA", False),
    Word(_MANY, "idr", "identity recall", SHARE, "true rows with the right identity", False),
    Word(_MANY, "idp", "identity precision", SHARE, "rows of tracks with the right identity", False),
    Word(_MANY, "idf1_across_views", "IDF1 across views", "", "identities that are those of all views", False),
    Word(_MANY, "idr_across_views", "identity recall across views", SHARE, "", False),
    Word(_MANY, "idp_across_views", "identity precision across views", SHARE, "", False),
    Word(_MANY, "idtp", "rows with the right identity", "", "", False),
    Word(_MANY, "idfp", "rows without the right identity", "", "", False),
    Word(_MANY, "idfn", "true rows without the right identity", "", "", False),
    Word(_MANY, "tp", "matched rows", "", "", False),
    Word(_MANY, "fp", "false rows", "", "", False),
    Word(_MANY, "fn", "missed rows", "", "", False),
    Word(_MANY, "motp", "MOTP", LENGTH, "mean distance of the pairs", False),
    Word(_MANY, "motp", "MOTP of 1 - IoU", "", "mean of the pairs", False),
    Word(_MANY, "motp_iou", "mean IoU of the pairs", "", "", False),
    Word(_MANY, "moda", "MODA", "", "1 - (missed + false) / true rows", False),
    Word(_MANY, "modp", "MODP", "", "1 is the best possible", False),
    Word(_MANY, "moda_missed", "missed rows of MODA", "", "", False),
    Word(_MANY, "moda_false", "false rows of MODA", "", "", False),
    Word(_MANY, "fr_p", "FR_p", SHARE, "targets without a tracker on them", False),
    Word(_MANY, "fr_l", "FR_l", SHARE, "trackers on another target than their own", False),
    Word(_MANY, "position_failures", "targets without a tracker", "", "numerator of FR_p", False),
    Word(_MANY, "label_failures", "trackers on another target", "", "numerator of FR_l", False),
    Word(_MANY, "mostly_tracked", "targets mostly tracked", "", "", False),
    Word(_MANY, "partly_tracked", "targets partly tracked", "", "", False),
    Word(_MANY, "mostly_lost", "targets mostly lost", "", "", False),
    Word(_MANY, "count_targets_mean", "targets at a time, true", "", "mean", False),
    Word(_MANY, "count_tracks_mean", "tracks at a time", "", "mean", False),
    Word(_MANY, "count_error_mean", "difference in number, mean", "", "", False),
    Word(_MANY, "count_error_rms", "difference in number, RMS", "", "", False),
    Word(_MANY, "count_error_max", "difference in number, largest", "", "", False),
    Word(_MANY, "matched_nees_compared", "rows with a NEES", "", "", False),
    Word(_MANY, "objects", "true rows", "", "", False),
    Word(_MANY, "objects_interpolated", "true rows, interpolated", "", "", False),
    Word(_MANY, "objects_ignored", "true rows that do not count", "", "", False),
    Word(_MANY, "overlap", "overlap from which boxes match", "", "", False),
    Word(_MANY, "estimates_compared", "rows compared", "", "", False),
    Word(_MANY, "estimates_other_frames", "rows in frames without truth", "", "", False),
    Word(_MANY, "frames", "frames", "", "", False),
    Word(_MANY, "frames_without_tracks", "frames without tracks", "", "", False),
    Word(_MANY, "views_without_tracks", "views without tracks", "", "", False),
    Word(_ACCURACY, "rmse", "RMSE", LENGTH, "root mean square distance between estimate and truth"),
    Word(_ACCURACY, "rmse_x", "RMSE along x", LENGTH, "root mean square error along one axis"),
    Word(_ACCURACY, "rmse_y", "RMSE along y", LENGTH, "root mean square error along one axis"),
    Word(_ACCURACY, "error_mean", "mean error", LENGTH, "mean distance between estimate and truth"),
    Word(_ACCURACY, "error_median", "median error", LENGTH, "half of the estimates are nearer than this"),
    Word(_ACCURACY, "error_p95", "95 % of errors below", LENGTH),
    Word(_ACCURACY, "error_max", "largest error", LENGTH),
    Word(_ACCURACY, "bias_x", "bias along x", LENGTH, "mean of estimate minus truth"),
    Word(_ACCURACY, "bias_y", "bias along y", LENGTH, "mean of estimate minus truth"),
    Word(_ACCURACY, "rmse_space", "RMSE in space", LENGTH, "root mean square distance in space"),
    Word(_ACCURACY, "rmse_z", "RMSE along z", LENGTH, "root mean square error of the height"),
    Word(_ACCURACY, "error_space_mean", "mean error in space", LENGTH, "mean distance in space"),
    Word(_ACCURACY, "error_space_median", "median error in space", LENGTH),
    Word(_ACCURACY, "error_space_p95", "95 % of errors in space below", LENGTH),
    Word(_ACCURACY, "error_space_max", "largest error in space", LENGTH),
    Word(_ACCURACY, "bias_z", "bias along z", LENGTH, "mean of estimate minus truth"),
    Word(_ACCURACY, "estimates_space", "estimates in space", "", "with a height and a true height", False),
    Word(_ACCURACY, "estimates", "estimates", "", "compared with the truth"),
    Word(_ACCURACY, "estimates_interpolated_truth", "truth interpolated", "", "between its own times", False),
    Word(_ACCURACY, "estimates_without_truth", "estimates without truth", "", "no truth near enough in time"),
    Word(_ACCURACY, "estimates_unmatched", "estimates of no target", "", "their track belongs to no true target"),
    Word(_ACCURACY, "tracks", "tracks"),
    Word(_ACCURACY, "tracks_smoothed", "tracks smoothed", "", "1: estimated with later measurements", False),
    Word(_ACCURACY, "tracks_unmatched", "tracks of no target"),
    Word(_ACCURACY, "targets", "true targets"),
    Word(_ACCURACY, "targets_unmatched", "true targets without track"),
    Word(_ACCURACY, "time_coverage", "time covered", SHARE, "of the targets' true path"),
    Word(_BOUND, "bound_rmse", "bound on the RMSE", LENGTH, "posterior Cramér–Rao bound for the true visibility"),
    Word(_BOUND, "bound_ratio", "RMSE / bound", "", "1 is the best possible"),
    Word(_BOUND, "smoothed_bound_rmse", "bound of smoothing", LENGTH, "with everything known that was seen later, too"),
    Word(_BOUND, "smoothed_bound_ratio", "RMSE / bound of smoothing", "", "1 is the best possible of all estimates"),
    Word(_BOUND, "bound_rmse_space", "bound on the RMSE in space", LENGTH, "posterior Cramér–Rao bound"),
    Word(_BOUND, "bound_ratio_space", "RMSE / bound in space", "", "1 is the best possible"),
    Word(_BOUND, "smoothed_bound_rmse_space", "bound of smoothing in space", LENGTH),
    Word(_BOUND, "smoothed_bound_ratio_space", "RMSE / bound of smoothing in space"),
    Word(_BOUND, "smoothed_bound_rmse_z", "bound of smoothing along z", LENGTH, "", False),
    Word(_BOUND, "bound_rmse_z", "bound on the RMSE along z", LENGTH, "", False),
    Word(_BOUND, "bound_estimates", "times compared", "", "that have both an error and a bound"),
    Word(_TRUST, "nees_mean", "mean NEES", "", "normalised squared error; 2 where the filter's covariance is right"),
    Word(_TRUST, "nees_share_95", "inside the 95 % ellipse", SHARE, "95 where the filter's covariance is right"),
    Word(_TRUST, "nees_singular", "singular covariances", "", "", False),
    Word(_TRUST, "nees_space_mean", "mean NEES in space", "", "3 where the filter's covariance is right"),
    Word(
        _TRUST, "nees_space_share_95", "inside the 95 % ellipsoid", SHARE, "95 where the filter's covariance is right"
    ),
    Word(_TRUST, "nees_space_singular", "singular covariances in space", "", "", False),
    Word(_SEEN, "detection_rate", "detected of visible", SHARE, "visible targets that were seen where they are"),
    Word(_SEEN, "false_alarms_per_frame", "false alarms a frame"),
    Word(_SEEN, "detection_frames", "frames", "", "", False),
    Word(_SEEN, "detection_opportunities", "detection opportunities", "", "a frame of a sensor, for each target"),
    Word(_SEEN, "detection_opportunities_without_truth", "opportunities without truth", "", "", False),
    Word(_SEEN, "visible", "target visible", "", "in view and not hidden, by the truth"),
    Word(_SEEN, "detected", "detected", "", "visible, and seen where it is"),
    Word(_SEEN, "missed", "missed", "", "visible, but not seen where it is"),
    Word(_SEEN, "detected_hidden", "detected though hidden", "", "", False),
    Word(_SEEN, "correct_rejections", "rightly not seen", "", "", False),
    Word(_SEEN, "false_alarms", "false alarms", "", "seen where no target is"),
    Word(_SEEN, "bearing_rms", "RMS bearing error", "px"),
    Word(_SEEN, "bearing_bias", "mean bearing error", "px"),
    Word(_SEEN, "bearing_rms", "RMS bearing error", "mrad"),
    Word(_SEEN, "bearing_nis", "squared error / variance", "", "1 where the stated noise is right"),
    Word(_SEEN, "elevation_rms", "RMS elevation error", "mrad", "", False),
    Word(_SEEN, "elevation_nis", "squared elevation error / variance", "", "1 where the stated noise is right", False),
    Word(_SEEN, "bearings_unmatched", "bearings of no target", "", "labelled with a target that the truth has not"),
    Word(
        _MEET,
        "triangulation_distance_rms",
        "RMS distance",
        LENGTH,
        "of the track from where the lines of sight meet",
    ),
    Word(_MEET, "triangulation_distance_median", "median distance", LENGTH),
    Word(_MEET, "triangulation_distance_p95", "95 % of distances below", LENGTH),
    Word(_MEET, "triangulation_distance_max", "largest distance", LENGTH),
    Word(
        _MEET, "triangulation_share_within", "within the limit", SHARE, "distances up to the limit that was asked for"
    ),
    Word(_MEET, "triangulation_sigma_median", "uncertainty of the meeting point", LENGTH, "median standard deviation"),
    Word(
        _MEET,
        "triangulation_residual_rms",
        "RMS miss of the lines of sight",
        "mrad",
        "from their triangulated position",
    ),
    Word(_MEET, "triangulation_scans", "scans", "", "with lines of sight from enough sensors"),
    Word(
        _MEET,
        "triangulation_refused",
        "scans without meeting point",
        "",
        "lines of sight nearly parallel, or that do not meet",
    ),
    Word(_MEET, "triangulation_compared", "scans compared", "", "during the track"),
    Word(
        _MEET,
        "measurement_noise_scale",
        "noise required / stated",
        "",
        "factor on standard deviations, from three lines and more",
    ),
    Word(_MEET, "measurement_noise_px", "noise required", "px", "median"),
    Word(_MEET, "measurement_noise_scans", "scans with three lines or more", "", "", False),
    Word(
        _HELD, "held_out_median", "median miss", "px", "of the nearest reported bearing; the track was made without it"
    ),
    Word(_HELD, "held_out_median_chance", "median miss by chance", "px", "with frames and predictions shifted in time"),
    Word(_HELD, "held_out_p95", "95 % of misses below", "px"),
    Word(_HELD, "held_out_rms", "RMS miss", "px"),
    Word(_HELD, "held_out_rms_within", "RMS miss inside the gate", "px"),
    Word(_HELD, "held_out_bias", "mean miss", "px", "", False),
    Word(_HELD, "held_out_median", "median miss", "mrad"),
    Word(_HELD, "held_out_rms", "RMS miss", "mrad", "", False),
    Word(
        _HELD, "held_out_share_within", "inside the gate", SHARE, "of the frames in which the target should be in view"
    ),
    Word(_HELD, "held_out_share_within_chance", "inside the gate by chance", SHARE),
    Word(_HELD, "held_out_frames", "frames", "", "in which the track is in view"),
    Word(_HELD, "held_out_reported", "frames with a bearing", "", "", False),
    Word(_VIEWS, "views_recall", "recall", SHARE, "true boxes that a view was found for"),
    Word(_VIEWS, "views_precision", "precision", SHARE, "views that are of a true box"),
    Word(_VIEWS, "views_error_rms", "RMS horizontal error", "px"),
    Word(_VIEWS, "views_error_median", "median horizontal error", "px"),
    Word(_VIEWS, "views_error_bias", "mean horizontal error", "px"),
    Word(_VIEWS, "views_frames", "frames", "", "", False),
    Word(_VIEWS, "views_true_boxes", "true boxes"),
    Word(_VIEWS, "views_matched", "views of a true box", "", "", False),
    Word(_VIEWS, "views_false", "other views", "", "", False),
    Word(_VIEWS, "views_without_truth", "views in frames without truth"),
)


WHOSE = r"(?:_target_(?P<target>-?\d+)|_sensor_(?P<sensor>.+?)|_(?P<box>clear|front|hidden))?"
BOXES = {"clear": "in the clear", "front": "in front of other people", "hidden": "partly hidden"}
SETTLED = "settled_"
LONGEST_FIRST = sorted(WORDS, key=lambda word: -len(word.base))
"""Longest prefixes first: `detected_hidden` must not match `detected`."""


@dataclass(frozen=True)
class Figure:
    """Table row of a figure: name, value as text, unit, and its meaning in words."""

    name: str
    value: str
    unit: str = ""
    note: str = ""


@dataclass(frozen=True)
class Breakdown:
    """Table with a column for each figure, and a row for each target, sensor or kind of box; cells are text.

    Attributes:
        kind: kind of the rows: `target`, `sensor` or `boxes`.
        columns: names of the figures.
        rows: name of each row, and its cells.
    """

    kind: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[str, ...]], ...]


@dataclass
class MetricGroup:
    """Related figures of the report.

    Attributes:
        title: heading of the group.
        figures: overall figures.
        breakdowns: tables of figures by target, sensor or kind of box.
    """

    title: str
    figures: list[Figure] = field(default_factory=list)
    breakdowns: list[Breakdown] = field(default_factory=list)


Value = str | int | float | np.number | np.bool_ | None
"""A figure of merit, as a file of metrics holds it."""


class MetricValue(NamedTuple):
    """Value of a metric, with its entry in the vocabulary of metrics.

    Attributes:
        word: entry in the vocabulary.
        settled: whether the value is of the time after settling.
        kind: `target`, `sensor`, `box`, or empty for an overall value.
        subject: name of the target, sensor or kind of box.
        value: the value.
    """

    word: Word
    settled: bool
    kind: str  # "", "target", "sensor" or "box"
    subject: str
    value: Value


def number(value: Value) -> str:
    """Return a value as text: four significant digits, integers in full with thousands separators.

    NaN and None are a dash, infinity is a sign, bools are yes or no, and texts are unchanged.
    """
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "–" if value is None or math.isnan(value) else ("∞" if value > 0 else "\N{MINUS SIGN}∞")
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, str):
        return value
    size = float(value)
    if isinstance(value, int | np.integer) or (1000 <= abs(size) < 1e15 and size.is_integer()):
        return f"{int(value):,}".replace(",", "\N{NARROW NO-BREAK SPACE}").replace("-", "\N{MINUS SIGN}")
    return f"{size:.4g}".replace("-", "\N{MINUS SIGN}")


def groups(metrics: Mapping[str, object], length_unit: str) -> list[MetricGroup]:
    """Return all metrics in groups with titles, in the order of the vocabulary.

    Unknown ones last, under their own names. If there are no errors of position, counts of the group "Accuracy" go to
    the figures of many targets, or are left out.
    """
    parsed = [_parse(key, value, length_unit) for key, value in _flat(metrics)]
    order = {word.base + word.unit: n for n, word in enumerate(WORDS)}
    found = sorted(parsed, key=lambda m: (m.settled, order.get(m.word.base + m.word.unit, len(order))))
    out: dict[str, list[MetricValue]] = {}
    with_errors = any(m.word.group == _ACCURACY and m.word.unit == LENGTH for m in found)
    of_many = any(m.word.group == _MANY for m in found)
    for metric in found:
        group = metric.word.group
        if group == _ACCURACY and not with_errors:  # counts of tracks, without an error
            if not of_many:
                continue
            group = _MANY
        title = group + (", after the start" if metric.settled else "")
        out.setdefault(title, []).append(metric)
    return [_group(title, members, length_unit) for title, members in out.items()]


def _flat(values: Mapping[str, object], prefix: str = "") -> list[tuple[str, Value]]:
    """Return the entries of nested mappings as a list of (path, value), with keys joined by dots after `prefix`.

    Provenance (names that begin with `_`), the verdict, and the flag of independent identities are left out.
    """
    out: list[tuple[str, Value]] = []
    for key, value in values.items():
        if str(key).startswith("_") or key in ("plausible", INDEPENDENT_IDS):  # shown with reasons elsewhere
            continue
        if isinstance(value, Mapping):
            out += _flat(value, f"{prefix}{key}.")
        elif value is None or isinstance(value, str | int | float | bool | np.number):
            out.append((f"{prefix}{key}", value))
    return out


def _parse(key: str, value: Value, length_unit: str) -> MetricValue:
    settled = key.startswith(SETTLED)
    plain = key.removeprefix(SETTLED)
    for word in LONGEST_FIRST:
        if not plain.startswith(word.base):
            continue
        unit = {LENGTH: length_unit, AREA: f"{length_unit}2", "px": "px", "mrad": "mrad"}.get(word.unit, "")
        ending = f"_{re.escape(unit)}" if unit else ""
        if match := re.fullmatch(f"{word.base}{WHOSE}{ending}", plain):
            kind = next((k for k in ("target", "sensor", "box") if match[k] is not None), "")
            return MetricValue(word, settled, kind, match[kind] if kind else "", value)
    return MetricValue(Word("Other figures", key, key.replace("_", " "), "", "", False), False, "", "", value)


def _group(title: str, members: list[MetricValue], length_unit: str) -> MetricGroup:
    figures = [_figure(m, length_unit) for m in members if not m.kind]
    kinds = [k for k in ("target", "sensor", "box") if any(m.kind == k for m in members)]
    tables = [_breakdown(k, [m for m in members if m.kind == k and m.word.short], length_unit) for k in kinds]
    return MetricGroup(title, figures, [t for t in tables if t.rows])


def _breakdown(kind: str, members: list[MetricValue], length_unit: str) -> Breakdown:
    words = list(dict.fromkeys(m.word for m in members))
    names = list(dict.fromkeys(m.subject for m in members))
    values = {(m.subject, m.word): _shown(m) for m in members}
    heads = tuple(f"{w.name} [{u}]" if (u := _unit(w, length_unit)) else w.name for w in words)
    rows = tuple((BOXES.get(n, n), tuple(values.get((n, w), "–") for w in words)) for n in names)
    return Breakdown({"box": "boxes"}.get(kind, kind), heads, rows)


def _figure(metric: MetricValue, length_unit: str) -> Figure:
    return Figure(metric.word.name, _shown(metric), _unit(metric.word, length_unit), metric.word.note)


def _unit(word: Word, length_unit: str) -> str:
    return {LENGTH: length_unit, AREA: f"{length_unit}²", SHARE: "%", "mrad": "°"}.get(word.unit, word.unit)


def _shown(metric: MetricValue) -> str:
    """Return a metric's value as text in the unit for readers: shares in per cent, angles in degrees."""
    value = metric.value
    if isinstance(value, int | float | np.number) and not isinstance(value, bool):
        if metric.word.unit == SHARE:
            return number(100.0 * value)
        if metric.word.unit == "mrad":
            return number(math.degrees(value / 1000.0))
    return number(value)
