"""The learned probability of a false bearing: the mean of a beta distribution."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import beta

from occlog.filtering.false_bearings import FalseBearings


def test_the_probability_is_the_posterior_mean_up_to_one_half() -> None:
    """The prior is worth 20 bearings: Beta(20 p, 20 (1 - p))."""
    counts = FalseBearings()
    assert counts.probability(0.1) == pytest.approx(0.1)
    counts = counts.counted(np.array([1.0, 0.25, 0.5])).counted(np.array([0.0]))
    assert counts == pytest.approx((2.25, 4))
    assert counts.probability(0.1) == pytest.approx(beta(2.0 + 2.25, 18.0 + 1.75).mean())
    assert counts.probability(0.0) == 0.0
    assert FalseBearings(20.0, 20).probability(0.1) == 0.5
    assert FalseBearings(17.9, 20).probability(0.1) == pytest.approx(19.9 / 40.0)
