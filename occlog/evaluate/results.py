"""What an evaluation gives, and conditions such as `rmse>0.5` that judge its figures."""

from __future__ import annotations

import difflib
import math
import operator
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

from occlog.errors import UsageError
from occlog.evaluate.figures import UNITS
from occlog.records.declared.views import Counts, Failures
from occlog.records.tables import Bound, Errors
from occlog.records.verdicts import Check, Verdict, summary_of

OPERATORS: dict[str, Callable[[float, float], bool]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "<": operator.lt,
    ">": operator.gt,
}
CONDITION = re.compile(r"\s*([^<>=]+?)\s*(<=|>=|<|>)\s*([^<>=]+?)\s*")


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
        checks: what was checked of the tracks; None: nothing could be.
        verdicts: that of this evaluation, after those of the stages before it.
        plugged: names of the metrics that are of plug-ins.
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
        """The metrics with the verdict."""
        return {**self.metrics, **summary_of(self.verdicts)}


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
