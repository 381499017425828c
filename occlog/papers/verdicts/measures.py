"""Measured quantities: value, standard error, and the range in which the true value lies.

The range reaches two standard errors to each side.  For few runs it is wider, by Student's t, so that the
true value is below it, or above it, in 2.3 % of all cases whatever the number of runs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import betaincinv, stdtrit

from occlog.array_types import Ints

from .model import Row, deviation

CONFIDENCE = 0.5 * (1.0 + math.erf(math.sqrt(2.0)))
"""Probability that a normal variable is less than two standard deviations above its mean."""


class Measure(NamedTuple):
    """A quantity that was measured, or computed exactly."""

    value: float
    error: float  # standard error; 0: computed exactly, NaN: not known
    runs: int  # independent samples that the error is from
    low: float
    high: float

    @property
    def half_width(self) -> float:
        """Half the width of the range."""
        return 0.5 * (self.high - self.low)


def errors_allowed(runs: int) -> float:
    """Return how many standard errors the range reaches to each side: 2 for many runs; infinite below two."""
    return float(stdtrit(runs - 1, CONFIDENCE)) if runs >= 2 else math.inf


def estimate(value: float, error: float, runs: int) -> Measure:
    """Return a quantity with its standard error; an unknown error bar (NaN) says nothing about it."""
    if error == 0.0 and not math.isnan(value):
        return Measure(value, error, runs, value, value)
    if math.isnan(value) or math.isnan(error) or runs < 2:
        return Measure(value, error, runs, -math.inf, math.inf)
    width = errors_allowed(runs) * error
    return Measure(value, error, runs, value - width, value + width)


def exact(value: float, runs: int = 1) -> Measure:
    """Return a quantity without error: a formula, or a count of what the statement is about."""
    return estimate(value, 0.0, runs)


def sample(values: Sequence[float]) -> Measure:
    """Return the mean of independent values."""
    n = len(values)
    if n == 0:
        return estimate(math.nan, math.nan, 0)
    return estimate(math.fsum(values) / n, deviation(values) / math.sqrt(n), n)


def mean_of(row: Row) -> Measure:
    """Return the mean of a row over its runs."""
    return sample(row.values)


def share_of(held: int, runs: int) -> Measure:
    """Return the share of runs in which something holds; its range is that of Clopper and Pearson.

    The error is that of two further runs in which it holds and two in which it does not (Agresti and Coull),
    since the plain one vanishes where all runs agree.
    """
    if runs == 0:
        return estimate(math.nan, math.nan, 0)
    tail, rest = 1.0 - CONFIDENCE, runs - held
    low = float(betaincinv(held, rest + 1, tail)) if held else 0.0
    high = float(betaincinv(held + 1, rest, CONFIDENCE)) if rest else 1.0
    middle = (held + 2.0) / (runs + 4.0)
    return Measure(held / runs, math.sqrt(middle * (1.0 - middle) / (runs + 4.0)), runs, low, high)


def difference(low: Row, high: Row) -> tuple[float, float]:
    """Return the mean of high - low and its standard error, run by run where the numbers of runs are equal."""
    if low.runs == high.runs:
        gap = sample([b - a for a, b in zip(low.values, high.values, strict=True)])
        return gap.value, gap.error
    return high.mean - low.mean, math.hypot(low.error, high.error)


def difference_of(low: Row, high: Row) -> Measure:
    """Return the mean of high - low as `difference` does."""
    return estimate(*difference(low, high), min(low.runs, high.runs))


def quotient(above: Row, below: Row) -> tuple[float, float]:
    """Return the quotient of two means and its standard error by the delta method; NaN if `below` has mean 0.

    Where the numbers of runs are equal, the runs are taken as pairs.
    """
    if not below.mean:
        return math.nan, math.nan
    ratio = above.mean / below.mean
    if above.runs == below.runs:
        left = [a - ratio * b for a, b in zip(above.values, below.values, strict=True)]
        return ratio, deviation(left) / math.sqrt(len(left)) / abs(below.mean)
    return ratio, math.hypot(above.error, ratio * below.error) / abs(below.mean)


def quotient_of(above: Row, below: Row) -> Measure:
    """Return the quotient of two means as `quotient` does."""
    return estimate(*quotient(above, below), min(above.runs, below.runs))


def power_of(rows: Sequence[Row]) -> Measure:
    """Return the exponent of x, fitted by least squares to log y against log x in every run.

    Args:
        rows: of equal numbers of runs, with positive x and values; below two rows there is no exponent.
    """
    if len(rows) < 2:
        return estimate(math.nan, math.nan, 0)
    x = np.log([row.x for row in rows])
    x = x - x.mean()
    return sample([float(x @ np.log([row.values[k] for row in rows]) / (x @ x)) for k in range(rows[0].runs)])


def bootstrapped(runs: int, statistic: Callable[[Ints], float], resamples: int) -> Measure:
    """Return a statistic of the runs with the range of its bootstrap samples, wider for few runs as `estimate`'s.

    Args:
        runs: number of runs.
        statistic: figure of the runs with these numbers, which may repeat; NaN where there is none.
        resamples: number of samples.  If the statistic is NaN for more than a tenth of them, nothing is known.
    """
    value = statistic(np.arange(runs))
    drawn = np.random.default_rng(2009).integers(runs, size=(resamples, runs)) if runs else np.empty((0, 0), int)
    found = [x for d in drawn if not math.isnan(x := statistic(d))]
    if math.isnan(value) or runs < 2 or len(found) < 0.9 * resamples:
        return estimate(math.nan, math.nan, runs)
    wide = 0.5 * errors_allowed(runs)
    low, high = (float(q) for q in np.quantile(found, [1.0 - CONFIDENCE, CONFIDENCE]))
    return Measure(value, deviation(found), runs, value - wide * (value - low), value + wide * (high - value))
