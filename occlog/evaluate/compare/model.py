"""What comes of a comparison."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from occlog.core.metrics.paired import Difference
from occlog.records.losses import Loss


class Condition(NamedTuple):
    """The comparison fails if the figure of a later method is worse than that of the first by more than a margin."""

    figure: str
    margin: float = 0.0

    def __str__(self) -> str:
        """As it is given."""
        return f"{self.figure} worse" + (f" by {self.margin:g}" if self.margin else "")


@dataclass(frozen=True)
class Row:
    """One method against the first one in one figure.

    Attributes:
        method: place among those that were given, from 1.
        figure: name.
        found: what was found.
        holm: p, with all rows of a comparison looked at together (Holm 1979).
        verdict: `better`, `worse`, `no difference shown` or `not decided`, for the later method.
    """

    method: int
    figure: str
    found: Difference
    holm: float
    verdict: str


class Implausible(NamedTuple):
    """Tracks that a stage found not plausible.

    Attributes:
        method: place among those that were given, from 0.
        recording: name.
        warnings: the lines that say why.
    """

    method: int
    recording: str
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class Comparison:
    """All of it.

    Attributes:
        rows: by method and figure.
        recordings: names.
        frames: how many there are in all.
        unit: of lengths.
        failed: one sentence for each condition that is met.
        losses: what was lost when tracks and truth were made.
        implausible: tracks that a stage found not plausible.
    """

    rows: tuple[Row, ...]
    recordings: tuple[str, ...]
    frames: int
    unit: str
    failed: tuple[str, ...]
    losses: tuple[Loss, ...]
    implausible: tuple[Implausible, ...]
