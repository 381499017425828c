"""Effective numbers of particles over a run, in bounded memory."""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats

FEW = 10.0
"""An estimate of fewer effective particles does not say how uncertain it is."""
BINS = 100
"""A decade of effective numbers has so many bins: quantiles are right to 2 %."""
DECADES = 8


class Particles:
    """Counts effective numbers of particles in bins of equal ratio."""

    def __init__(self) -> None:
        """Nothing yet."""
        self.rows = self.few = 0
        self._sum = 0.0
        self._counts = np.zeros(BINS * DECADES + 1, dtype=np.int64)

    def add(self, ess: Floats) -> None:
        """Some more rows; those without particles (NaN) do not count."""
        ess = ess[np.isfinite(ess)]
        self.rows += len(ess)
        self.few += int(np.count_nonzero(ess < FEW))
        self._sum += float(ess.sum())
        bins = np.clip(np.log10(np.maximum(ess, 1.0)) * BINS, 0, len(self._counts) - 1)
        self._counts += np.bincount(bins.astype(np.int64), minlength=len(self._counts))

    @property
    def mean(self) -> float:
        """Mean effective number; NaN without rows."""
        return self._sum / self.rows if self.rows else math.nan

    @property
    def median(self) -> float:
        """Median effective number, to 2 %; NaN without rows."""
        if not self.rows:
            return math.nan
        middle = int(np.searchsorted(np.cumsum(self._counts), 0.5 * self.rows))
        return 10.0 ** ((middle + 0.5) / BINS) if middle else 1.0
