"""The metrics of an evaluation in words: what each means, its unit, and for which target or sensor it is."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from .vocabulary import LENGTH, SHARE, WORDS, Word

WHOSE = r"(?:_target_(?P<target>-?\d+)|_sensor_(?P<sensor>.+?)|_(?P<box>clear|front|hidden))?"
BOXES = {"clear": "in the clear", "front": "in front of others", "hidden": "partly hidden"}
SETTLED = "settled_"
LONGEST_FIRST = sorted(WORDS, key=lambda word: -len(word.base))
"""So that `detected_hidden` is not read as `detected` of what is `hidden`."""


@dataclass(frozen=True)
class Figure:
    """One row of a table: what, how much, in which unit, and what it means."""

    name: str
    value: str
    unit: str = ""
    note: str = ""


@dataclass(frozen=True)
class Breakdown:
    """One figure a column, one target, sensor or kind of box a row."""

    kind: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[str, ...]], ...]


@dataclass
class Group:
    """Figures that belong together: over everything, then broken down."""

    title: str
    figures: list[Figure] = field(default_factory=list)
    breakdowns: list[Breakdown] = field(default_factory=list)


class Metric(NamedTuple):
    """One number and what it is of."""

    word: Word
    settled: bool
    kind: str  # "", "target", "sensor" or "box"
    whose: str
    value: Any


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


def groups(metrics: Mapping[str, Any], length_unit: str) -> list[Group]:
    """All metrics, gathered in the order of the vocabulary; unknown ones last, under their own names."""
    parsed = [_parse(key, value, length_unit) for key, value in _flat(metrics)]
    order = {word.base + word.unit: n for n, word in enumerate(WORDS)}
    found = sorted(parsed, key=lambda m: (m.settled, order.get(m.word.base + m.word.unit, len(order))))
    out: dict[str, list[Metric]] = {}
    for metric in found:
        title = metric.word.group + (", after the start" if metric.settled else "")
        out.setdefault(title, []).append(metric)
    return [_group(title, members, length_unit) for title, members in out.items()]


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


def _parse(key: str, value: Any, length_unit: str) -> Metric:
    settled = key.startswith(SETTLED)
    plain = key.removeprefix(SETTLED)
    for word in LONGEST_FIRST:
        if not plain.startswith(word.base):
            continue
        unit = length_unit if word.unit == LENGTH else word.unit if word.unit in ("px", "mrad") else ""
        ending = f"_{re.escape(unit)}" if unit else ""
        if match := re.fullmatch(f"{word.base}{WHOSE}{ending}", plain):
            kind = next((k for k in ("target", "sensor", "box") if match[k] is not None), "")
            return Metric(word, settled, kind, match[kind] if kind else "", value)
    return Metric(Word("Other figures", key, key.replace("_", " "), "", "", False), False, "", "", value)


def _group(title: str, members: list[Metric], length_unit: str) -> Group:
    figures = [_figure(m, length_unit) for m in members if not m.kind]
    kinds = [k for k in ("target", "sensor", "box") if any(m.kind == k for m in members)]
    tables = [_breakdown(k, [m for m in members if m.kind == k and m.word.short], length_unit) for k in kinds]
    return Group(title, figures, [t for t in tables if t.rows])


def _breakdown(kind: str, members: list[Metric], length_unit: str) -> Breakdown:
    words = list(dict.fromkeys(m.word for m in members))
    names = list(dict.fromkeys(m.whose for m in members))
    values = {(m.whose, m.word): _shown(m) for m in members}
    heads = tuple(f"{w.name} [{u}]" if (u := _unit(w, length_unit)) else w.name for w in words)
    rows = tuple((BOXES.get(n, n), tuple(values.get((n, w), "–") for w in words)) for n in names)
    return Breakdown({"box": "boxes"}.get(kind, kind), heads, rows)


def _figure(metric: Metric, length_unit: str) -> Figure:
    return Figure(metric.word.name, _shown(metric), _unit(metric.word, length_unit), metric.word.note)


def _unit(word: Word, length_unit: str) -> str:
    return {LENGTH: length_unit, SHARE: "%", "mrad": "°"}.get(word.unit, word.unit)


def _shown(metric: Metric) -> str:
    """The number as a person reads it: shares in per cent, angles in degrees."""
    value = metric.value
    measured = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    if measured and metric.word.unit == SHARE:
        value = 100.0 * value
    if measured and metric.word.unit == "mrad":
        value = math.degrees(value / 1000.0)
    return number(value)
