"""The E step against a dense Gaussian: likelihood and expected sums."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from occlog.track.methods.map.fit_motion.smoother import CV, VAGUE, smooth


def problem(seed: int, K: int = 9):
    rng = np.random.default_rng(seed)
    first = np.zeros(K, np.bool_)
    first[[0, 5]] = True
    seen = rng.uniform(size=K) < 0.7
    seen[first] = True
    off = np.where(seen & ~first, rng.uniform(-0.5, 0.5, K), 0.0)
    xy = np.where(seen[:, None], rng.normal(size=(K, 2)), 0.0)
    M, N = rng.normal(size=(K, 2, 2)), rng.normal(size=(4, 4))
    R = M @ M.swapaxes(1, 2) + 0.1 * np.eye(2)
    A = np.kron(np.eye(2), [[1, 1], [0, 0.9]]) + 0.05 * rng.normal(size=(4, 4))
    return first, seen, off, xy, R, A, N @ N.T * 0.1 + 0.01 * np.eye(4)


def dense(first, seen, off, xy, R, A, sigma):
    """One Gaussian of all states of all trajectories, conditioned on all measurements."""
    K = len(first)
    F = np.eye(4 * K)  # F x = prior mean + noise
    Q, mean = np.zeros((4 * K, 4 * K)), np.zeros(4 * K)
    for k in range(K):
        s = slice(4 * k, 4 * k + 4)
        if first[k]:
            Q[s, s] = VAGUE * np.eye(4)
            mean[4 * k], mean[4 * k + 2] = xy[k]
        else:
            Q[s, s] = sigma
            F[s, 4 * k - 4 : 4 * k] = -A
    inverse = np.linalg.inv(F)
    mean, cov = inverse @ mean, inverse @ Q @ inverse.T
    at = np.flatnonzero(seen)
    H, V = np.zeros((2 * len(at), 4 * K)), np.zeros((2 * len(at), 2 * len(at)))
    for i, k in enumerate(at):
        for axis in range(2):
            H[2 * i + axis, 4 * k + 2 * axis] = 1.0
            H[2 * i + axis, 4 * k + 2 * axis + 1] = off[k]
        V[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = R[k]
    e = xy[at].ravel() - H @ mean
    W = H @ cov @ H.T + V
    value = -0.5 * (e @ np.linalg.solve(W, e) + np.linalg.slogdet(2 * np.pi * W)[1])
    G = cov @ H.T @ np.linalg.inv(W)
    mean, cov = mean + G @ e, cov - G @ H @ cov
    second = cov + np.outer(mean, mean)
    block = second.reshape(K, 4, K, 4).swapaxes(1, 2)
    steps = [k for k in range(1, K) if not first[k]]
    rest = xy[at].ravel() - H @ mean
    E = (H @ cov @ H.T + np.outer(rest, rest)).reshape(len(at), 2, len(at), 2)
    sums = (
        sum(block[k, k] for k in steps),
        sum(block[k, k - 1] for k in steps),
        sum(block[k - 1, k - 1] for k in steps),
        sum(E[i, :, i] for i in range(len(at))),
    )
    return value, sums, mean.reshape(K, 4)


@pytest.mark.parametrize("seed", range(8))
def test_dense_gaussian_agrees(seed: int) -> None:
    case = problem(seed)
    value, sums, mean, _ = smooth(*case)
    want, (S11, S10, S00, E), want_mean = dense(*case)
    assert value == pytest.approx(want, rel=1e-9)
    assert sums.n == 7
    assert sums.m == case[1].sum()
    assert_allclose(mean, want_mean, rtol=1e-7, atol=1e-8)
    DX = S10 - CV @ S00
    DD = S11 - S10 @ CV.T - CV @ S10.T + CV @ S00 @ CV.T
    for have, right in ((sums.DD, DD), (sums.DX, DX), (sums.XX, S00), (sums.E, E)):
        assert_allclose(have, right, rtol=1e-7, atol=1e-7)
