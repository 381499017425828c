"""The fast error function against SciPy's."""

from __future__ import annotations

import numpy as np
from scipy.special import erf

from occlog.core.numerics.special_functions import EDGE, fast_erf


def of(values: np.ndarray) -> np.ndarray:
    return np.array([fast_erf(float(v)) for v in values])


def test_within_1e_10_everywhere() -> None:
    x = np.concatenate([np.linspace(-6, 6, 20001), [-EDGE, EDGE, 1e-300, -1e-12, 0.0, 1e300]])
    assert np.abs(of(x) - erf(x)).max() < 1e-10


def test_it_is_odd_and_knows_infinities_and_nan() -> None:
    x = np.linspace(0, 6, 301)
    np.testing.assert_array_equal(of(x), -of(-x))
    assert abs(fast_erf(np.inf) - 1.0) < 1e-10
    assert abs(fast_erf(-np.inf) + 1.0) < 1e-10
    assert np.isnan(fast_erf(np.nan))
    assert fast_erf(0.0) == 0.0
