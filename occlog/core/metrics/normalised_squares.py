"""Consistency of normalised squares (NIS, NEES): ratio to the expected value, with confidence limits.

A normalised square has a chi-square distribution if standard deviations are right; the sum of squares over the sum of
expected values is then 1. Squares of successive time steps are correlated, so that N of them hold less information than
N independent ones. `BatchMeans` estimates how much less, over a stream of rows, and `ratio_interval` converts that to
limits.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from occlog.array_types import Floats

MAX_BATCHES = 32
"""Batches that are kept; they are put together in pairs when there are as many."""
MIN_DEGREES = 0.1
"""Minimum degrees of freedom of a test: below, the quantiles of chi-square are practically zero."""
MIN_BATCHES = 8
"""Minimum number of batches for an estimate of the correlation of neighbours."""


class Ratio(NamedTuple):
    """Ratio of a sum of squares to its expected value, with standard error.

    Attributes:
        value: the ratio, 1 if standard deviations are right; NaN if nothing is expected.
        error: its standard error; infinite if nothing is expected.
    """

    value: float
    error: float

    @classmethod
    def of_parts(cls, parts: Iterable[BatchMeans]) -> Ratio:
        """Return the ratio over all parts, which are independent of each other; NaN with infinite error without any."""
        informative = [p for p in parts if p.expected > 0.0]
        expected = math.fsum(p.expected for p in informative)
        if not informative:
            return cls(math.nan, math.inf)
        error = math.sqrt(math.fsum((p.ratio.error * p.expected) ** 2 for p in informative)) / expected
        return cls(math.fsum(p.squares for p in informative) / expected, error)

    @property
    def degrees(self) -> float:
        """Return the effective degrees of freedom: those of a chi-square distribution with this relative spread.

        0 if the error is unknown or the ratio is 0.
        """
        if not (math.isfinite(self.error) and self.error > 0.0 and self.value > 0.0):
            return 0.0
        return 2.0 * (self.value / self.error) ** 2

    def interval(self, chance: float) -> tuple[float, float]:
        """Return the confidence limits (low, high) of the true ratio, which is outside with probability `chance`."""
        return ratio_interval(self.value, self.degrees, chance)


def ratio_interval(value: float, degrees: float, chance: float) -> tuple[float, float]:
    """Return the confidence limits (low, high) of a ratio: `value` times `degrees` over chi-square quantiles.

    (0, inf) for fewer degrees than `MIN_DEGREES`.

    Args:
        value: observed ratio of a sum of squares to its expected value, >= 0.
        degrees: effective degrees of freedom of the sum.
        chance: probability that the truth is beyond one of the limits, half of it at each.
    """
    if not degrees >= MIN_DEGREES:
        return 0.0, math.inf
    low, high = float(chdtri(degrees, 0.5 * chance)), float(chdtri(degrees, 1.0 - 0.5 * chance))
    return value * degrees / low, value * degrees / high if high > 0.0 else math.inf


class BatchMeans:
    """Sums of squares and of their expected values, with a standard error of the ratio by the method of batch means.

    A batch holds neighbours in time. When there are many batches they are merged in pairs, so that batches become
    longer than the correlation time, in bounded memory.
    """

    def __init__(self) -> None:
        """Start without squares, and with batches of one."""
        self.count = 0
        self.squares = self.expected = 0.0
        self._size = 1
        self._batches = np.zeros((0, 2))  # squares, expected
        self._open, self._in_open = np.zeros(2), 0

    def add(self, squares: Floats, expected: Floats) -> None:
        """Add N squares (N,) and their expected values (N,), in the order of time."""
        self.count += len(squares)
        self.squares += float(squares.sum())
        self.expected += float(expected.sum())
        rows = np.column_stack([squares, expected])
        while len(rows):
            room = self._size - self._in_open
            if self._in_open or len(rows) < room:
                # Fill the batch that is open
                now, rows = rows[:room], rows[room:]
                self._open = self._open + now.sum(axis=0)
                self._in_open += len(now)
                if self._in_open == self._size:
                    self._batches = np.vstack([self._batches, self._open])
                    self._open, self._in_open = np.zeros(2), 0
            else:
                # Whole batches, as many as fit
                fit = max(min(len(rows) // self._size, MAX_BATCHES - len(self._batches)), 1)
                now, rows = rows[: fit * self._size], rows[fit * self._size :]
                self._batches = np.vstack([self._batches, now.reshape(fit, self._size, 2).sum(axis=1)])
            if len(self._batches) >= MAX_BATCHES:
                self._batches = self._batches[:MAX_BATCHES].reshape(-1, 2, 2).sum(axis=1)
                self._size *= 2

    @property
    def ratio(self) -> Ratio:
        """Return the ratio of the sums; its standard error is at least that of independent squares.

        NaN with infinite error if nothing is expected.
        """
        if not self.expected > 0.0:
            return Ratio(math.nan, math.inf)
        value = self.squares / self.expected
        variance = 2.0 * value**2 / self.expected
        n, covered = len(self._batches), float(self._batches[:, 1].sum())
        # Batches of which nothing is expected do not scatter
        if n >= MIN_BATCHES and covered > 0.0:
            off = self._batches[:, 0] - value * self._batches[:, 1]
            # Neighbouring batches are correlated where squares are correlated for longer than a batch
            scatter = float(off @ off) + 2.0 * max(float(off[1:] @ off[:-1]), 0.0)
            variance = max(variance, scatter / covered / covered * n / (n - 1))
        return Ratio(value, math.sqrt(variance))
