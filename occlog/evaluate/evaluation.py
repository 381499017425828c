"""The result of an evaluation."""

from __future__ import annotations

from dataclasses import dataclass, field

from occlog.records.tables import Bound, Errors
from occlog.records.views import Failures


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Figures, and the tables behind them.

    Attributes:
        metrics: flat; the unit is the end of the name.
        errors: of every estimate that has a truth.
        bound: posterior Cramer-Rao bound.
        failures: of trackers.
        notes: lines that the user must know of.
    """

    metrics: dict[str, float]
    errors: Errors = field(default_factory=Errors.empty)
    bound: Bound = field(default_factory=Bound.empty)
    failures: Failures = field(default_factory=Failures.empty)
    notes: tuple[str, ...] = ()
