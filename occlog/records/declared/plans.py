"""The table of what is expected of sensors that are planned.  Conventions: see `tables`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.errors import InputError
from occlog.records.columns import Table, check_order, column, first_row


@dataclass(frozen=True, slots=True, eq=False)
class PlanMap(Table):
    """What is expected of a filter at places spread over the floor."""

    NAME: ClassVar[str] = "plan"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "y", "x")

    t_ns: Ints = column("i8", "ns", "0: what is planned is of no time; tables are ordered by it")
    x: Floats = column("f8", "m", "middle of a square of the floor")
    y: Floats = column("f8", "m", "middle of a square of the floor")
    weight: Floats = column("f8", "1", "share of the floor, or of the time that people of --paths spent there")
    rmse: Floats = column("f8", "m", "expected root mean square error of the place of a target that walks through")
    rmse_error: Floats = column("f8", "m", "standard error of `rmse` by the draws of walks and crowds")
    seen_by_0: Floats = column("f8", "1", "probability that no sensor sees or hears the target")
    seen_by_1: Floats = column("f8", "1", "probability that exactly one sensor does")
    seen_by_2: Floats = column("f8", "1", "probability that two or more do")
    no_fix: Floats = column(
        "f8",
        "1",
        "share of the draws in which the place is known, along its worst direction, no better than half as well as "
        "by the room alone",
    )

    def check(self) -> None:
        """Probabilities are between 0 and 1."""
        check_order(self)
        for name in ("weight", "seen_by_0", "seen_by_1", "seen_by_2", "no_fix"):
            values = getattr(self, name)
            bad = ~((values >= 0.0) & (values <= 1.0 + 1e-9))
            if np.any(bad):
                row = first_row(bad)
                raise InputError(f"PlanMap: row {row}: {name} {values[row]} must be from 0 to 1")
