"""Factors of the block-tridiagonal Hessian against dense matrices."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from trajectory_reference import PAPER, dense_chain, dense_hessian, make_steps, random_model, random_steps

from occlog.track.methods.map.kernels.gauss_markov import constant_velocity
from occlog.track.methods.map.kernels.interior_point import factor_rows, factor_sum, inverse_blocks, solve


def random_information(rng, T: int, share: float = 0.6):
    """(T, 3) positive semi-definite, many of rank one or zero."""
    a, b = rng.normal(size=(2, T, 2)) * rng.choice([0.1, 1.0, 30.0], (2, T, 1))
    a[rng.uniform(size=T) > share] = 0.0
    b[rng.uniform(size=T) > 0.3] = 0.0
    return np.column_stack([a[:, i] * a[:, j] + b[:, i] * b[:, j] for i, j in ((0, 0), (0, 1), (1, 1))])


def factors(steps, H, way: str):
    R, N = np.empty((len(H), 4, 4)), np.empty((len(H), 4, 4))
    if way == "sum":
        assert factor_sum(steps, H, R, N)
    else:
        factor_rows(steps, H, R, N)
    return R, N


def dense_factor(R, N):
    T = len(R)
    out = np.zeros((4 * T, 4 * T))
    for t in range(T):
        out[4 * t : 4 * t + 4, 4 * t : 4 * t + 4] = R[t]
        if t < T - 1:
            out[4 * t : 4 * t + 4, 4 * t + 4 : 4 * t + 8] = N[t]
    return out


@pytest.mark.parametrize("way", ["sum", "rows"])
@pytest.mark.parametrize("T", [1, 2, 3, 40])
@pytest.mark.parametrize("seed", range(4))
def test_factor_solution_and_covariances(seed: int, T: int, way: str) -> None:
    rng = np.random.default_rng(100 * T + seed)
    steps, H = random_steps(rng, T), random_information(rng, T)
    dense = dense_hessian(steps, H)
    R, N = factors(steps, H, way)
    square = dense_factor(R, N)
    assert np.array_equal(np.tril(square, -1), np.zeros_like(square))
    assert np.array_equal(N[-1], np.zeros((4, 4)))
    assert_allclose(square.T @ square, dense, rtol=0, atol=1e-11 * np.abs(dense).max())
    b, x, P = rng.normal(size=(T, 4)), np.empty((T, 4)), np.empty((T, 4, 4))
    solve(R, N, b, x)
    want = np.linalg.solve(dense, b.ravel())
    assert_allclose(x.ravel(), want, rtol=0, atol=1e-8 * np.abs(want).max())
    inverse_blocks(R, N, P)
    inverse = np.linalg.inv(dense)
    for t in range(T):
        block = inverse[4 * t : 4 * t + 4, 4 * t : 4 * t + 4]
        assert_allclose(P[t], block, rtol=0, atol=1e-8 * np.abs(block).max())
        assert np.array_equal(P[t], P[t].T)


@pytest.mark.parametrize("model", [PAPER, constant_velocity(0.5, 0.0, 0.5), random_model(np.random.default_rng(7))])
def test_both_ways_agree_on_long_chains(model) -> None:
    rng = np.random.default_rng(1)
    T = 300
    steps = make_steps(model, np.arange(T) * 0.5, np.zeros(4), np.diag([25.0, 1.0, 25.0, 1.0]))
    H = random_information(rng, T)
    b, x, y = rng.normal(size=(T, 4)), np.empty((T, 4)), np.empty((T, 4))
    solve(*factors(steps, H, "sum"), b, x)
    solve(*factors(steps, H, "rows"), b, y)
    assert_allclose(x, y, rtol=0, atol=1e-5 * np.abs(y).max())


def test_rows_keep_their_digits_where_steps_are_very_short() -> None:
    """Steps of 1e-5 s: the inverse of Sigma spans 20 decades, more than a sum of squares can hold.  Its rows
    span ten, so that six of sixteen digits are left.

    Without measurements the covariances are those of the forward recursion P -> A P A' + Sigma, which loses nothing.
    """
    model = constant_velocity(0.5, 0.0, 1.0)
    seconds = np.concatenate([[0.0], np.cumsum(np.tile([1e-5, 1.0, 1e-5], 10))])
    spread = np.diag([25.0, 1.0, 25.0, 1.0])
    steps = make_steps(model, seconds, np.zeros(4), spread)
    T = len(seconds)
    P = np.empty((T, 4, 4))
    inverse_blocks(*factors(steps, np.zeros((T, 3)), "rows"), P)
    want = spread
    for t in range(T):
        if t:
            k = steps.kind[t - 1]
            want = steps.A[k] @ want @ steps.A[k].T + steps.sigma[k]
        assert_allclose(P[t], want, rtol=0, atol=1e-5 * want.max())
    # One position measured at the end: the Kalman update of the last state
    H = np.zeros((T, 3))
    H[-1] = [4.0, 1.0, 2.0]
    inverse_blocks(*factors(steps, H, "rows"), P)
    C = np.eye(4)[[0, 2]]
    K = want @ C.T @ np.linalg.inv(C @ want @ C.T + np.linalg.inv([[4.0, 1.0], [1.0, 2.0]]))
    after = want - K @ C @ want
    assert_allclose(P[-1], after, rtol=0, atol=1e-5 * after.max())


def test_rows_solve_very_short_steps_against_exact_arithmetic() -> None:
    """Rational arithmetic through the dense system of the same rows."""
    from fractions import Fraction

    model = constant_velocity(0.5, 0.0, 1.0)
    steps = make_steps(model, np.array([0.0, 1e-5, 2e-5]), np.zeros(4), np.diag([25.0, 1.0, 25.0, 1.0]))
    rng = np.random.default_rng(0)
    T, n = 3, 12
    H, b = np.zeros((T, 3)), rng.normal(size=(T, 4))
    H[:, 0], H[:, 2] = [4.0, 9.0, 1.0], [1.0, 4.0, 16.0]
    rows = []
    for i in range(4):
        rows.append([Fraction(steps.whiten_first[i, j]) for j in range(4)] + [Fraction(0)] * 8)
    for t, k in enumerate(steps.kind):
        U, A = ([[Fraction(float(v)) for v in row] for row in m[k]] for m in (steps.whiten, steps.A))
        for i in range(4):
            row = [Fraction(0)] * n
            for j in range(4):
                row[4 * t + j] = -sum(U[i][m] * A[m][j] for m in range(4))
                row[4 * t + 4 + j] = U[i][j]
            rows.append(row)
    for t in range(T):
        for axis, column in ((0, 0), (2, 2)):
            row = [Fraction(0)] * n
            row[4 * t + axis] = Fraction(float(np.sqrt(H[t, column])))
            rows.append(row)
    M = [[sum(r[i] * r[j] for r in rows) for j in range(n)] + [Fraction(float(b.flat[i]))] for i in range(n)]
    for i in range(n):
        for m in range(i + 1, n):
            q = M[m][i] / M[i][i]
            M[m] = [u - q * v for u, v in zip(M[m], M[i], strict=True)]
    want = [Fraction(0)] * n
    for i in reversed(range(n)):
        want[i] = (M[i][n] - sum(M[i][j] * want[j] for j in range(i + 1, n))) / M[i][i]
    exact = np.array([float(v) for v in want])
    x = np.empty((T, 4))
    solve(*factors(steps, H, "rows"), b, x)
    assert_allclose(x.ravel(), exact, rtol=0, atol=1e-5 * np.abs(exact).max())


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("T", [1, 5, 30])
def test_an_indefinite_hessian_is_refused_by_the_sum(seed: int, T: int) -> None:
    rng = np.random.default_rng(seed)
    steps, H = random_steps(rng, T), random_information(rng, T)
    R, N = np.empty((T, 4, 4)), np.empty((T, 4, 4))
    t = int(rng.integers(T))
    # The curvature of the rest along x at state t, and then a little more or less than that
    inverse = np.linalg.inv(dense_hessian(steps, H))
    curvature = 1.0 / inverse[4 * t, 4 * t]
    for share, definite in ((0.99, True), (1.01, False), (30.0, False)):
        bent = H.copy()
        bent[t, 0] -= share * curvature
        assert (np.linalg.eigvalsh(dense_hessian(steps, bent))[0] > 0) == definite
        assert factor_sum(steps, bent, R, N) == definite


def test_a_prior_alone_gives_back_its_covariance() -> None:
    rng = np.random.default_rng(5)
    steps = random_steps(rng, 12)
    P = np.empty((12, 4, 4))
    inverse_blocks(*factors(steps, np.zeros((12, 3)), "sum"), P)
    assert_allclose(P[0], steps.spread, rtol=1e-10)
    assert_allclose(P[-1], np.linalg.inv(dense_chain(steps))[-4:, -4:], rtol=1e-8)
