"""Views against true boxes, and what cameras were asked, in stretches of time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TypeVar

from occlog.evaluate.bearings.boxes import ViewFigures
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.stage import CooperationCounts
from occlog.evaluate.stretches.sources import Sources, no_true_box, rows_during
from occlog.io.open import Opened
from occlog.records.pieces import whole_times, windows
from occlog.records.tables import Cooperation, TruthBoxes, Views

N = TypeVar("N", Views, TruthBoxes)


@dataclass(frozen=True)
class BesideTracks:
    """What is compared apart from tracks, positions and bearings; None where not given.

    Attributes:
        views: of clusters or of a detector.
        truth: which holds true boxes, if there are views.
        cooperation: what cameras were asked.
        sources: of which times rows count.
        frames: first number of the frames of views that count, and the one after the last; None: all.
    """

    views: Opened | None
    truth: Opened | None
    cooperation: Opened | None
    sources: Sources
    frames: tuple[int, int] | None = None

    def figures(self, config: EvaluateConfig, tracked: tuple[int, int] | None) -> dict[str, float]:
        """All figures; `tracked`: first and last time of the tracks, None without any.

        Raises:
            InputError: no true box is in the frames, or no frame of the views has true boxes.
        """
        out: dict[str, float] = {}
        if self.views is not None and self.truth is not None:
            found, boxes = ViewFigures(config), 0
            views, true = self._numbered(self.views.rows(Views)), self._numbered(self.truth.rows(TruthBoxes))
            for part in windows(views, true, (Views, TruthBoxes), 0):
                found.add(part.a, part.b)
                boxes += len(part.b)
            if self.frames is not None and not boxes:
                raise no_true_box(self.frames)
            out |= found.metrics()
        if self.cooperation is not None:
            counts = CooperationCounts()
            for rows in whole_times(self._requests(self.cooperation)):
                counts.add(rows)
            out |= counts.figures(tracked)
        return out

    def _numbered(self, chunks: Iterable[N]) -> Iterator[N]:
        """Rows of the frames that count."""
        if self.frames is None:
            yield from chunks
            return
        first, stop = self.frames
        for rows in chunks:
            yield rows.take((rows.frame >= first) & (rows.frame < stop))

    def _requests(self, opened: Opened) -> Iterator[Cooperation]:
        return rows_during(opened.rows(Cooperation), self.sources.during)
