"""Means over runs, with their spread and their confidence intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit


class Summary(NamedTuple):
    """Figures of one quantity over n runs; NaN where there are too few."""

    n: int
    mean: float
    sd: float  # with n - 1
    se: float  # of the mean
    low: float  # confidence interval of the mean
    high: float


def summarise(values: Sequence[float], confidence: float = 0.95) -> Summary:
    """Figures of some runs; values that are NaN are left out.

    Args:
        values: one a run.
        confidence: of the interval, by Student's t distribution, so for means of about normal values.
    """
    good = np.array([v for v in values if not math.isnan(v)], dtype=np.float64)
    n = len(good)
    if n == 0:
        return Summary(0, math.nan, math.nan, math.nan, math.nan, math.nan)
    mean = float(good.mean())
    if n == 1:
        return Summary(1, mean, math.nan, math.nan, math.nan, math.nan)
    sd = float(good.std(ddof=1))
    se = sd / math.sqrt(n)
    reach = float(stdtrit(n - 1, 0.5 + 0.5 * confidence)) * se
    return Summary(n, mean, sd, se, mean - reach, mean + reach)
