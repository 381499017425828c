"""Inverses of small symmetric matrices."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.track.jipda.kernels.linear import invert


@pytest.mark.parametrize("n", [1, 4, 6])
def test_inverse_and_determinant_are_those_of_numpy(n: int) -> None:
    half = np.random.default_rng(n).normal(size=(n, n + 2))
    matrix, out = half @ half.T, np.empty((n, n))
    log_determinant = invert(matrix, out)
    np.testing.assert_allclose(out, np.linalg.inv(matrix), rtol=1e-8)
    assert log_determinant == pytest.approx(np.linalg.slogdet(matrix)[1])


def test_a_matrix_that_is_not_positive_definite_says_so() -> None:
    assert np.isnan(invert(np.array([[1.0, 2.0], [2.0, 1.0]]), np.empty((2, 2))))
    assert np.isnan(invert(np.zeros((2, 2)), np.empty((2, 2))))
