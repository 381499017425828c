"""Doubts of rows while one sensor contradicts the estimate: most of what it measured lately is not believed.

Its clock, pose or labels are wrong, or the track follows the others, which may be the wrong ones.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from occlog.array_types import NS, Bools, Ints
from occlog.records.tables import Diagnostics, Residuals

from .doubts import DISAGREES

WINDOW_NS = NS
"""How far back bearings count [ns]."""
SHARE = 2.0 / 3.0
"""Share of a sensor's bearings of a target in this time that are not believed, from which it contradicts."""
FEWEST = 5
"""So many bearings at least are not believed: single false ones contradict nothing."""


class Disagreement:
    """Adds these doubts to a run's rows, chunk by chunk; the last residuals are remembered."""

    def __init__(self) -> None:
        """Nothing was compared yet."""
        self._kept: list[Residuals] = []

    def judged(self, diagnostics: Diagnostics, residuals: Residuals) -> Diagnostics:
        """Diagnostics of the next rows with their doubts, by the residuals at these rows."""
        known = Residuals.concat([*self._kept, residuals])
        if not len(diagnostics):
            self._kept = [known]
            return diagnostics
        self._kept = [known.take(known.t_ns > diagnostics.t_ns[-1] - WINDOW_NS)]
        against = np.zeros(len(diagnostics), dtype=np.bool_)
        if np.count_nonzero(known.believed < 0.5) >= FEWEST:
            for target in np.unique(diagnostics.target_id).tolist():
                rows = diagnostics.target_id == target
                against[rows] = _against(diagnostics.t_ns[rows], known.take(known.target_id == target))
        if not against.any():
            return diagnostics
        doubt = [",".join(filter(None, (old, DISAGREES))) for old in diagnostics.doubt[against].tolist()]
        every = diagnostics.doubt.astype(object)
        every[against] = doubt
        return replace(diagnostics, doubt=every.astype(np.str_))


def _against(t_ns: Ints, residuals: Residuals) -> Bools:
    """(N,) whether any sensor contradicts the estimates of one target at these times."""
    out = np.zeros(len(t_ns), dtype=np.bool_)
    for name in np.unique(residuals.sensor).tolist():
        own = residuals.take(residuals.sensor == name)
        not_believed = np.concatenate([[0], np.cumsum(own.believed < 0.5)])
        first, end = (np.searchsorted(own.t_ns, t, side="right") for t in (t_ns - WINDOW_NS, t_ns))
        many = not_believed[end] - not_believed[first]
        out |= (many >= FEWEST) & (many >= SHARE * (end - first))
    return out
