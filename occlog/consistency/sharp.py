"""Bearings whose stated noise is smaller than any sensor's: many filters can make no use of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator

import numpy as np

from occlog.records.tables import Bearings
from occlog.records.verdicts import Check, finding, outcome

STATED = "stated noise of the bearings"
"""Name of the check."""
LEAST_RAD = 1e-7
"""Smallest standard deviation that is believed: 0.02 seconds of arc."""


class Sharp:
    """Counts the bearings that pass by with so small a standard deviation."""

    def __init__(self) -> None:
        """None passed yet."""
        self._found: Counter[str] = Counter()
        self._least = np.inf

    def watch(self, chunks: Iterable[Bearings]) -> Iterator[Bearings]:
        """The same chunks."""
        for chunk in chunks:
            # Of those with pixels the noise is that of the reading
            small = chunk.seen & (chunk.sigma < LEAST_RAD) & ~np.isfinite(chunk.u_px)
            if small.any():
                self._found.update(chunk.sensor[small].tolist())
                self._least = min(self._least, float(chunk.sigma[small].min()))
            yield chunk

    def checks(self) -> tuple[Check, ...]:
        """Whether their noise can be."""
        if not self._found:
            return outcome(STATED, ())
        return (
            finding(
                STATED,
                "note",
                "noise-tiny",
                f"{sum(self._found.values())} bearings of {', '.join(sorted(self._found)[:3])} state a standard "
                f"deviation down to {self._least:.2g} rad (allowed: {LEAST_RAD:g}): no sensor is so exact, and "
                "filters by particles find no place that fits them: estimates may be as wide as if nothing was seen; "
                "state the noise that they have",
                sensors=sorted(self._found),
                least_rad=self._least,
                allowed=LEAST_RAD,
            ),
        )
