"""Views against true boxes, and what cameras were asked, in stretches of time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from occlog.io.open import Opened
from occlog.records.pieces import whole_times, windows
from occlog.records.tables import Cooperation, TruthBoxes, Views

from .bearings.boxes import ViewFigures
from .matching.config import EvaluateConfig
from .sources import Sources, rows_during
from .stage import CooperationCounts


@dataclass(frozen=True)
class BesideTracks:
    """What is compared apart from tracks, positions and bearings; None where not given.

    Attributes:
        views: of clusters or of a detector.
        truth: which holds true boxes, if there are views.
        cooperation: what cameras were asked.
        sources: of which times rows count.
    """

    views: Opened | None
    truth: Opened | None
    cooperation: Opened | None
    sources: Sources

    def figures(self, config: EvaluateConfig, tracked: tuple[int, int] | None) -> dict[str, float]:
        """All figures; `tracked`: first and last time of the tracks, None without any."""
        out: dict[str, float] = {}
        if self.views is not None and self.truth is not None:
            found = ViewFigures(config)
            for part in windows(self.views.rows(Views), self.truth.rows(TruthBoxes), (Views, TruthBoxes), 0):
                found.add(part.a, part.b)
            out |= found.metrics()
        if self.cooperation is not None:
            counts = CooperationCounts()
            for rows in whole_times(self._requests(self.cooperation)):
                counts.add(rows)
            out |= counts.figures(tracked)
        return out

    def _requests(self, opened: Opened) -> Iterator[Cooperation]:
        return rows_during(opened.rows(Cooperation), self.sources.during)
