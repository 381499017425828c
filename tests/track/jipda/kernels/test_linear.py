"""Inverses of small symmetric matrices."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.track.methods.jipda.kernels.linear import cholesky, eigen, invert


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


@pytest.mark.parametrize("n", [1, 2, 6])
def test_factors_and_eigenvalues_are_those_of_numpy(n: int) -> None:
    rng = np.random.default_rng(n)
    root = rng.normal(size=(n, n))
    L, symmetric, axes = np.full((n, n), np.nan), root + root.T, np.full((n, n), np.nan)
    cholesky(root @ root.T, L)
    np.testing.assert_allclose(L, np.linalg.cholesky(root @ root.T), atol=1e-12)
    diagonal = symmetric.copy()
    eigen(diagonal, axes)
    np.testing.assert_allclose(np.sort(np.diag(diagonal)), np.linalg.eigvalsh(symmetric), atol=1e-12)
    np.testing.assert_allclose((axes * np.diag(diagonal)) @ axes.T, symmetric, atol=1e-12)
    np.testing.assert_allclose(axes.T @ axes, np.eye(n), atol=1e-12)


@pytest.mark.parametrize(("entry", "rotated"), [(0.9e-15, False), (1.4e-15, True), (-1.4e-15, True)])
def test_entries_below_1e_15_of_the_diagonal_are_zero(entry: float, rotated: bool) -> None:
    """The eigenvectors of equal diagonal entries are half a right angle from the axes."""
    axes = np.empty((2, 2))
    eigen(np.array([[4.0, 4.0 * entry], [4.0 * entry, 4.0]]), axes)
    np.testing.assert_allclose(np.abs(axes), np.full((2, 2), np.sqrt(0.5)) if rotated else np.eye(2))


def test_a_diagonal_matrix_has_its_entries_for_eigenvalues() -> None:
    matrix, axes = np.diag([3.0, -1.0, 0.0]), np.empty((3, 3))
    eigen(matrix, axes)
    np.testing.assert_array_equal(matrix, np.diag([3.0, -1.0, 0.0]))
    np.testing.assert_array_equal(axes, np.eye(3))
