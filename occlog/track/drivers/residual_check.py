"""Whether residuals contradict what was stated: shares of bearings not believed, and normalised squared residuals.

NIS is the sum of squared residuals of bearings, by their probability of being true, over what it is expected to be:
1 if standard deviations are right.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from occlog.records.tables import Residuals

from .rows import Solve

LEAST = 20
"""Of fewer bearings, or expected squares, nothing is said."""
MANY = 0.25
"""Share of bearings not believed that is too many."""
SMALL, LARGE = 0.25, 2.0
"""NIS below and above which standard deviations are wrong."""
LIVELY = 4.0
"""Factor of the motion's variance from which on its model is wrong."""


@dataclass(frozen=True)
class Agreement:
    """How bearings agree with the estimates.

    Attributes:
        bearings: how many were used.
        believed: how many of them are more probably true than false.
        squares: sum of squared residuals, by the probability of being true.
        expected: what that sum is expected to be.
    """

    bearings: int = 0
    believed: int = 0
    squares: float = 0.0
    expected: float = 0.0

    def __add__(self, other: Agreement) -> Agreement:
        """Both together."""
        return Agreement(
            self.bearings + other.bearings,
            self.believed + other.believed,
            self.squares + other.squares,
            self.expected + other.expected,
        )

    @property
    def doubted(self) -> float:
        """Share of bearings that are not believed; NaN without any."""
        return 1.0 - self.believed / self.bearings if self.bearings else math.nan

    @property
    def nis(self) -> float:
        """Normalised squared residual; NaN where nothing is expected."""
        return self.squares / self.expected if self.expected > 0.0 else math.nan


@dataclass
class ResidualCheck:
    """Gathers residuals and learned noises while they stream by.

    Attributes:
        sensors: agreement of the bearings of each sensor, by its name.
        noise: of each target the largest factor by which its motion's variance exceeds what was stated.
    """

    sensors: dict[str, Agreement] = field(default_factory=dict)
    noise: dict[int, float] = field(default_factory=dict)

    def add(self, part: Residuals | None, solves: Iterable[Solve] = ()) -> None:
        """Count some more rows."""
        for solve in solves:
            if solve.noise is not None:
                self.noise[solve.target] = max(self.noise.get(solve.target, 0.0), solve.noise.motion)
        if part is None:
            return
        for name in np.unique(part.sensor).tolist():
            own = part.take(part.sensor == name)
            found = Agreement(
                bearings=len(own),
                believed=int(np.count_nonzero(own.believed >= 0.5)),
                squares=float(own.believed @ own.residual**2),
                expected=float(own.believed @ own.expected),
            )
            self.sensors[name] = self.sensors.get(name, Agreement()) + found

    @property
    def all(self) -> Agreement:
        """Agreement of all bearings."""
        return sum(self.sensors.values(), Agreement())

    def figures(self) -> dict[str, float | int]:
        """Figures for a summary; none if no bearing was judged."""
        whole = self.all
        if not whole.bearings:
            return {}
        return {
            "bearings": whole.bearings,
            "bearings_not_believed": whole.bearings - whole.believed,
            **({"nis": whole.nis} if math.isfinite(whole.nis) else {}),
        }

    def contradictions(self) -> list[str]:
        """Sentences on what residuals contradict: beliefs, standard deviations, the motion; none if nothing."""
        said = []
        whole = self.all
        for name, own in sorted(self.sensors.items()):
            if own.bearings >= LEAST and own.doubted > MANY:
                said.append(
                    f"{name}: {own.doubted:.0%} of {own.bearings} bearings are not believed; its pose, its clock or "
                    "its identities may be wrong"
                )
        wrong = {n: a for n, a in self.sensors.items() if a.expected >= LEAST and not SMALL <= a.nis <= LARGE}
        if whole.expected >= LEAST and not SMALL <= whole.nis <= LARGE:
            said.append(f"residuals of all bearings: {_off(whole)}")
        else:
            said += [f"residuals of {name}: {_off(own)}" for name, own in sorted(wrong.items())]
        for target, factor in sorted(self.noise.items()):
            if factor > LIVELY:
                said.append(
                    f"target {target}: moves {math.sqrt(factor):.1f} times as irregularly as the settings of its "
                    "motion say (acceleration)"
                )
        return said


def _off(own: Agreement) -> str:
    """By how much standard deviations are wrong."""
    return (
        f"NIS {own.nis:.2g}, so that bearings are {math.sqrt(own.nis):.1f} times as far off as stated "
        "(sigma of the bearings, noise in the scene)"
    )
