"""Figures in words: what each metric means, its unit, and numbers as a person writes them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from .model import NS, ReportInput
from .sight import distances

LENGTH = "length"


@dataclass(frozen=True)
class Figure:
    """One row of a table: what, how much, in which unit, and what it means."""

    name: str
    value: str
    unit: str = ""
    note: str = ""


METRICS: tuple[tuple[str, str, str, str], ...] = (
    (r"rmse", "RMSE", LENGTH, "root mean square distance between estimate and truth"),
    (r"rmse_(x|y|z)", "RMSE along {0}", LENGTH, "root mean square error along one axis"),
    (r"(?:mae|mean_error)", "mean error", LENGTH, "mean distance between estimate and truth"),
    (r"median_error", "median error", LENGTH, "half of the estimates are nearer to the truth than this"),
    (r"max_error", "largest error", LENGTH, "farthest distance between estimate and truth"),
    (r"(?:p|error_p)(\d+)(?:_error)?", "{0} % of errors below", LENGTH, ""),
    (r"bias_(x|y)", "bias along {0}", LENGTH, "mean of estimate minus truth"),
    (r"bound(?:_rmse)?", "bound", LENGTH, "posterior Cramér–Rao bound on the RMSE, for what was really visible"),
    (r"bound_(x|y)", "bound along {0}", LENGTH, "posterior Cramér–Rao bound along one axis"),
    (r"(?:ratio|rmse_to_bound|bound_ratio|rmse_over_bound)", "RMSE / bound", "", "1 is the best possible"),
    (r"nees|mean_nees", "mean NEES", "", "normalised squared error; 2 where the filter's covariance is right"),
    (r"coverage(?:_95)?", "inside the 95 % ellipse", "%", "share of the estimates whose ellipse holds the truth"),
    (r"recall|detection_rate", "recall", "%", "share of the visible targets that were seen"),
    (r"precision", "precision", "%", "share of the sightings that are of the target"),
    (r"(?:n_)?false_alarms", "false alarms", "", "sightings that belong to no target"),
    (r"(?:n_)?misses", "misses", "", "target visible, not seen"),
    (r"(?:n_)?detections", "detections", "", "sightings of the target"),
    (r"(?:n_)?steps|n_estimates", "estimates", "", "estimates compared with the truth"),
    (r"(?:n_)?unmatched", "estimates without truth", "", "no truth near enough in time"),
    (r"(?:n_)?targets", "targets", "", ""),
    (r"duration_s", "duration", "s", ""),
)  # fmt: skip
"""Known metrics: pattern of the key, name, unit, meaning.  Others are shown under their own key."""

SUFFIXES = (("_px", "px"), ("_deg", "°"), ("_rad", "rad"), ("_s", "s"), ("_ms", "ms"), ("_m", LENGTH))
TARGET = re.compile(r"(.+?)[_.](?:target|id)[_.]?(-?\d+)")


def number(value: Any) -> str:
    """A number with about four digits, thousands apart; a dash for NaN and None."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "–" if value is None or math.isnan(value) else ("∞" if value > 0 else "\N{MINUS SIGN}∞")
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, str):
        return value
    if isinstance(value, int | np.integer) or (1000 <= abs(value) < 1e15 and float(value).is_integer()):
        return f"{int(value):,}".replace(",", "\N{NARROW NO-BREAK SPACE}").replace("-", "\N{MINUS SIGN}")
    return f"{float(value):.4g}".replace("-", "\N{MINUS SIGN}")


def metric_figures(data: ReportInput) -> list[Figure]:
    """All metrics in words, in the order they are given; nested ones by their path."""
    return [_metric(key, value, data.unit) for key, value in _flat(data.metrics)]


def _flat(values: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    """Scalars of a mapping with dotted paths; entries that begin with `_` (provenance) are left out."""
    out: list[tuple[str, Any]] = []
    for key, value in values.items():
        if str(key).startswith("_"):
            continue
        if isinstance(value, Mapping):
            out += _flat(value, f"{prefix}{key}.")
        elif value is None or isinstance(value, str | int | float | bool | np.number):
            out.append((f"{prefix}{key}", value))
    return out


def _metric(key: str, value: Any, length_unit: str) -> Figure:
    whose, base = "", key
    if found := TARGET.fullmatch(key):
        base, whose = found[1], f", target {found[2]}"
    for pattern, name, unit, note in METRICS:
        match = re.fullmatch(pattern, base)
        if match:
            return _figure(name.format(*match.groups()) + whose, value, unit, note, length_unit)
    for suffix, unit in SUFFIXES:
        if base.endswith(suffix):
            return _figure(base.removesuffix(suffix).replace("_", " ") + whose, value, unit, "", length_unit)
    return _figure(base.replace("_", " ") + whose, value, "", "", length_unit)


def _figure(name: str, value: Any, unit: str, note: str, length_unit: str) -> Figure:
    measured = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    if unit == "%" and measured:
        value = 100.0 * value
    if unit == "rad" and measured:
        value, unit = math.degrees(value), "°"
    return Figure(name, number(value), length_unit if unit == LENGTH else unit, note)


def headline(data: ReportInput) -> list[Figure]:
    """The few figures on top of the page: accuracy first, then how much was processed."""
    out = _accuracy(data)
    if data.time.length > 0:
        out.append(Figure("recorded time", number(round(data.time.length, 2)), data.time.unit))
    if data.tracks is not None:
        out.append(Figure("estimates", number(len(data.tracks)), "", f"of {plural(len(data.targets), 'target')}"))
    if data.bearings is not None and len(data.bearings):
        share = 100.0 * float(data.bearings.seen.mean())
        out.append(Figure("target seen", number(round(share, 1)), "%", f"of {number(len(data.bearings))} looks"))
    if data.losses:
        lost = sum(loss.count for loss in data.losses)
        out.append(Figure("input lost", number(lost or len(data.losses)), "", "items" if lost else "stretches"))
    return out


def _accuracy(data: ReportInput) -> list[Figure]:
    """RMSE, bound and their ratio over all targets, from the tables themselves; without truth, what there is."""
    if data.errors is None or not len(data.errors):
        return _sight(data)
    rmse = float(np.sqrt(np.mean(data.errors.error**2)))
    out = [Figure("RMSE", number(rmse), data.unit, "estimate to truth")]
    if data.bound is not None and len(data.bound):
        bound = float(np.sqrt(np.mean(data.bound.bound**2)))
        out.append(Figure("bound", number(bound), data.unit, "no filter can do better"))
        if bound > 0:
            out.append(Figure("RMSE / bound", number(round(rmse / bound, 3)), "", "1 is the best possible"))
    return out


def _sight(data: ReportInput) -> list[Figure]:
    """RMS distance of the tracks from where the sight lines meet."""
    if data.tracks is None or data.bearings is None or data.scene is None:
        return []
    found = [distances(data.tracks, data.bearings, data.scene, target)[1] for target in data.targets]
    every = np.concatenate([np.empty(0), *found])
    if not len(every):
        return []
    return [Figure("off sight lines", number(float(np.sqrt(np.mean(every**2)))), data.unit, "RMS; no truth is given")]


def plural(count: int, what: str) -> str:
    """`1 target`, `2 targets`."""
    return f"{number(count)} {what}{'' if count == 1 else 's'}"


def row_counts(data: ReportInput) -> list[Figure]:
    """How many rows each table has, and the time it covers."""
    out = []
    for name in ("truth", "bearings", "tracks", "diagnostics", "errors", "bound"):
        table = getattr(data, name)
        if table is None:
            continue
        if not len(table):
            out.append(Figure(name, "0", "rows", "empty"))
            continue
        seconds = number((int(table.t_ns[-1]) - int(table.t_ns[0])) / NS)
        span = f"{seconds} s, {plural(len(np.unique(table.t_ns)), 'time')}"
        out.append(Figure(name, number(len(table)), "rows", span))
    return out
