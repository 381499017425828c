"""Names of an evaluation's metrics for people: meaning, unit, and target or sensor."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from occlog.evaluate.metric_names import (
    ACCURACY,
    BOXES,
    LENGTH,
    METRICS,
    SETTLED,
    SHARE,
    TARGETS,
    MetricDefinition,
)
from occlog.evaluate.mot.figures import INDEPENDENT_IDS

SUBJECT = r"(?:_target_(?P<target>-?\d+)|_sensor_(?P<sensor>.+?)|_(?P<box>clear|front|hidden))?"
LONGEST_FIRST = sorted(METRICS, key=lambda metric: -len(metric.name))
"""Longest prefixes first: `detected_hidden` must not match `detected`."""


@dataclass(frozen=True)
class Figure:
    """Table row of a figure: name, value as text, unit (empty: none), and its meaning in words (`note`)."""

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
    """Value of a metric, with the unit in which its name ends, and the target, sensor or kind of box that it is of.

    `settled`: only after the settling time; `kind` is `target`, `sensor`, `box`, or empty for a value of all together;
    `subject` is the identity or name of that one.
    """

    metric: MetricDefinition
    unit: str  # in which the name ends, "" for none
    settled: bool
    kind: str  # "", "target", "sensor" or "box"
    subject: str
    value: Value

    @property
    def label(self) -> str:
        """The metric's label, without the unit; "... of 1 - IoU" for a distance that has no unit."""
        return self.metric.label_in(self.unit)


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

    Unknown ones come last, under their own names. If there are no errors of position, the metrics of the group
    "Accuracy" are added to those of many targets, or omitted if there are none of these.

    Args:
        metrics: values by name, which may be nested mappings.
        length_unit: unit of lengths, in which names may end.
    """
    parsed = [_parse(key, value, length_unit) for key, value in _flat(metrics)]
    order = {metric.name: n for n, metric in enumerate(METRICS)}
    found = sorted(parsed, key=lambda m: (m.settled, order.get(m.metric.name, len(order))))
    out: dict[str, list[MetricValue]] = {}
    with_errors = any(m.metric.group == ACCURACY and m.metric.unit == LENGTH for m in found)
    of_many = any(m.metric.group == TARGETS for m in found)
    for value in found:
        group = value.metric.group
        if group == ACCURACY and not with_errors:  # counts of tracks, without an error
            if not of_many:
                continue
            group = TARGETS
        title = group + (", after the start" if value.settled else "")
        out.setdefault(title, []).append(value)
    return [_group(title, members, length_unit) for title, members in out.items()]


def _flat(values: Mapping[str, object], prefix: str = "") -> list[tuple[str, Value]]:
    """Return the entries of nested mappings as a list of (path, value), with keys joined by dots after `prefix`.

    Left out are provenance (names that begin with `_`), the verdict (`plausible`), the flag of independent identities,
    lists, and values of other types. `prefix` includes its final dot.
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
    for metric in LONGEST_FIRST:
        if not plain.startswith(metric.name):
            continue
        for unit in metric.units(length_unit):
            ending = f"_{re.escape(unit)}" if unit else ""
            if match := re.fullmatch(f"{metric.name}{SUBJECT}{ending}", plain):
                kind = next((k for k in ("target", "sensor", "box") if match[k] is not None), "")
                return MetricValue(metric, unit, settled, kind, match[kind] if kind else "", value)
    return MetricValue(MetricDefinition("Other figures", key, key.replace("_", " ")), "", False, "", "", value)


def _group(title: str, members: list[MetricValue], length_unit: str) -> MetricGroup:
    figures = [Figure(m.label, _shown(m), _unit(m, length_unit), m.metric.note) for m in members if not m.kind]
    kinds = [k for k in ("target", "sensor", "box") if any(m.kind == k for m in members)]
    tables = [_breakdown(k, [m for m in members if m.kind == k and "e" in m.metric.marks], length_unit) for k in kinds]
    return MetricGroup(title, figures, [t for t in tables if t.rows])


def _breakdown(kind: str, members: list[MetricValue], length_unit: str) -> Breakdown:
    heads = {(m.metric, m.unit): f"{m.label} [{u}]" if (u := _unit(m, length_unit)) else m.label for m in members}
    names = list(dict.fromkeys(m.subject for m in members))
    values = {(m.subject, m.metric, m.unit): _shown(m) for m in members}
    rows = tuple((BOXES.get(n, n), tuple(values.get((n, *of), "–") for of in heads)) for n in names)
    return Breakdown({"box": "boxes"}.get(kind, kind), tuple(heads.values()), rows)


def _unit(value: MetricValue, length_unit: str) -> str:
    if value.metric.unit == SHARE:
        return "%"
    return {"mrad": "°", "deg": "°", f"{length_unit}2": f"{length_unit}²"}.get(value.unit, value.unit)


def _shown(value: MetricValue) -> str:
    """Return a metric's value as text in the unit for readers: shares in per cent, angles in degrees."""
    figure = value.value
    if isinstance(figure, int | float | np.number) and not isinstance(figure, bool):
        if value.metric.unit == SHARE:
            return number(100.0 * figure)
        if value.unit == "mrad":
            return number(math.degrees(figure / 1000.0))
    return number(figure)
