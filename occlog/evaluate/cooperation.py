"""What it costs to ask cameras for their bearings: requests, frames and their mean period."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np

from occlog.array_types import NS
from occlog.records.tables import Cooperation

SHARED = "shared"
CAUSES = ("periodic", "count", "bearing", "ellipse", "spread")


class CooperationCounts:
    """Counts of requests that come in the order of time."""

    def __init__(self) -> None:
        """No request yet."""
        self._rows = self._own = self._answered = self._frames = self._times = 0
        self._causes: Counter[str] = Counter()
        self._span: tuple[int, int] | None = None

    def update(self, asked: Cooperation) -> None:
        """Requests of some more times."""
        own = asked.take(asked.cause != SHARED)
        self._rows, self._own = self._rows + len(asked), self._own + len(own)
        self._answered += int(np.count_nonzero(own.answered))
        self._frames += int(asked.frames.sum())
        self._causes.update(cause for text in own.cause.tolist() for cause in text.split(","))
        times = np.unique(own.t_ns)
        self._times += len(times)
        if len(times):
            self._span = (int(times[0]) if self._span is None else self._span[0]), int(times[-1])

    def result(self, tracked: tuple[int, int] | None) -> dict[str, float]:
        """Requests, frames and their mean period.

        Args:
            tracked: first and last time of the tracks; the period is the time between them by the number of times at
                which cameras were asked.  None, without tracks: the mean time between these.

        Returns:
            `cooperation_requests` (one for each target and time), `cooperation_answered`, `cooperation_shared` (rows
            of this cause are no requests, but places that came along with others), `cooperation_frames`,
            `cooperation_period_s` (NaN if it is not known), and `cooperation_requests_CAUSE`; a request with several
            causes counts for each.
        """
        first, last = tracked or self._span or (0, 0)
        count, causes = (self._times if tracked else self._times - 1), self._causes
        return {
            "cooperation_requests": float(self._own),
            "cooperation_answered": float(self._answered),
            "cooperation_shared": float(self._rows - self._own),
            "cooperation_frames": float(self._frames),
            "cooperation_period_s": float(last - first) / NS / count if count > 0 else math.nan,
            **{f"cooperation_requests_{c}": float(causes[c]) for c in (*CAUSES, *sorted(set(causes) - set(CAUSES)))},
        }
