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

from .metric_names import ACCURACY, UNITS, summary_rows
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
    """Return a message for each threshold that is met (a failure), or has a missing, ambiguous or NaN figure."""
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
Entry = tuple[str, str, str]
"""Name without unit, heading of a column, and unit; `length` represents the scene's unit."""
BY_SENSOR_IN_IMAGES = (
    ("fr_p", "FR_p", ""),
    ("fr_l", "FR_l", ""),
    ("mota", "MOTA", ""),
    ("idf1", "IDF1", ""),
    ("hota", "HOTA", ""),
    ("objects", "true rows", ""),
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
    own = headline.independent_ids(metrics)
    groups: dict[str, list[str]] = {"Tracks": []} if own else {}
    first = headline.names(unit) if own else ()
    rows = {key: (group, label, of) for group, key, label, of in summary_rows(unit) if key in metrics}
    for key in (*first, *(key for key in rows if key not in first)):
        if key in rows:
            group, label, of = rows[key]
            line = f"  {label:<{LABEL}}{number(metrics[key]):>12} {of}".rstrip()
            groups.setdefault("Tracks" if key in first else group, []).append(line)
    lines: list[str] = []
    for heading, of_group in groups.items():
        if heading == ACCURACY and (own or headline.matchings_differ(metrics, unit)):
            heading = f"{ACCURACY}, one-to-one matching over the whole run"
        lines += ["", heading, *of_group] if lines else [heading, *of_group]
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
