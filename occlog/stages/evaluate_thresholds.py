"""Conditions such as `rmse>0.5` under which an evaluation counts as failed."""

from __future__ import annotations

import difflib
import math
import operator
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from ..errors import UsageError

OPERATORS: dict[str, Callable[[float, float], bool]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "<": operator.lt,
    ">": operator.gt,
}
CONDITION = re.compile(r"\s*([^<>=]+?)\s*(<=|>=|<|>)\s*([^<>=]+?)\s*")
UNITS = ("m", "unit", "ft", "in", "px", "mrad")
"""Units that end the names of metrics and may be left away."""


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
        raise UsageError(f"--fail-if {text!r}: must be a metric, one of > >= < <=, and a number, as in 'rmse>0.5'")
    return Threshold(found[1], found[2], limit)


def failures(metrics: Mapping[str, float], thresholds: Iterable[Threshold]) -> list[str]:
    """One line for each threshold that is broken, or whose metric is missing, ambiguous or not a number."""
    return [line for t in thresholds if (line := _failure(metrics, t)) is not None]


def _failure(metrics: Mapping[str, float], threshold: Threshold) -> str | None:
    names = find_metric(metrics, threshold.metric)
    if not names:
        near = difflib.get_close_matches(threshold.metric, metrics, n=3, cutoff=0.5)
        hint = f"; did you mean {' or '.join(near)}?" if near else ""
        return f"--fail-if {threshold}: there is no metric {threshold.metric!r}{hint}"
    if len(names) > 1:
        return f"--fail-if {threshold}: {threshold.metric!r} can be {' or '.join(names)}; name one"
    value = metrics[names[0]]
    if not math.isfinite(value):
        return f"--fail-if {threshold}: {names[0]} is not a number ({value}): there was nothing to compute it from"
    if OPERATORS[threshold.operator](value, threshold.limit):
        return f"--fail-if {threshold}: {names[0]} is {value:.6g}"
    return None


def find_metric(metrics: Mapping[str, float], name: str) -> list[str]:
    """Full names that a name with or without its unit can stand for; a full name stands for itself."""
    if name in metrics:
        return [name]
    return [full for full in (f"{name}_{unit}" for unit in UNITS) if full in metrics]
