"""Constant errors of ranges: the bordered Newton step against a dense one, and what is found of simulated errors."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.errors import UsageError
from occlog.filtering.likelihood.distances import (
    RANGE,
    RangeMeasurements,
    residuals_at_own_position,
    score_and_information,
)
from occlog.records.scene import MicrophoneArray, Scene
from occlog.scans.grouping import Scan, ScanMeasurements
from occlog.track.interface import SmoothedTrajectory
from occlog.track.methods.map.config import MapConfig
from occlog.track.methods.map.kernels.gauss_markov import constant_velocity
from occlog.track.methods.map.kernels.problem import NO_PLANES, SQUARE, BearingLinesByStep, TrajectoryProblem, chain
from occlog.track.methods.map.lines_and_distances import terms
from occlog.track.methods.map.method import METHOD
from occlog.track.methods.map.station_biases import begin_biases

NS = 1_000_000_000
CORNERS = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 8.0], [0.0, 8.0]])


def measured(path: np.ndarray, bias: np.ndarray, sigma: float, prior: float, seed: int) -> list[RangeMeasurements]:
    """Ranges of the four corners at each position."""
    rng, blank = np.random.default_rng([8200, seed]), np.zeros(4)
    exact = np.hypot(*(path[:, None] - CORNERS).transpose(2, 0, 1))
    values = exact + bias + sigma * rng.standard_normal(exact.shape)
    kind, number = np.full(4, RANGE), np.arange(4)
    return [
        RangeMeasurements(kind, z, np.full(4, sigma), CORNERS, blank, CORNERS, blank, number, bias=prior)
        for z in values
    ]


def path_of(T: int, seed: int) -> np.ndarray:
    """A curve through most of the room."""
    phase = np.random.default_rng([8201, seed]).uniform(0.0, 6.0, 2)
    return np.array([5.0, 4.0]) + [3.0, 2.0] * np.sin(0.25 * 0.2 * np.arange(T)[:, None] + phase)


@pytest.mark.jit
def test_a_step_and_its_covariance_are_those_of_the_whole_system() -> None:
    """Gauss and Newton on states and biases at once, with a dense matrix."""
    T, prior, sigma = 12, 1.5, 0.2
    path = path_of(T, 0)
    parts = measured(path, np.array([0.5, 0.0, -0.3, 0.0]), sigma, prior, 0)
    columns = [np.concatenate(c) for c in zip(*(p[:8] for p in parts), strict=True)]
    rows, state = RangeMeasurements._make((*columns, *parts[0][8:])), np.repeat(np.arange(T), 4)
    steps = chain(constant_velocity(0.5, 0.0, 1.0), np.full(T - 1, 0.2), np.zeros(4), 25.0 * np.eye(4))
    none = np.empty(0)
    lines = BearingLinesByStep(
        state[:0], np.empty((0, 2)), np.empty((0, 2)), none, none, none, none, none < 0.0, none, none
    )
    X0 = np.zeros((T, 4))
    X0[:, ::2] = path + 0.1
    begun = begin_biases(rows, T)
    assert begun is not None
    noisy = begun.corrected(rows)
    np.testing.assert_allclose(noisy.sigma, np.hypot(sigma, prior))
    problem = TrajectoryProblem(steps, lines, NO_PLANES, SQUARE, 1.0, terms(noisy, state, X0, square=False))
    # Dense: columns are 4 T states, then 4 biases
    hints = problem.hints
    H, g = np.zeros((4 * T + 4, 4 * T + 4)), np.zeros(4 * T + 4)
    root = np.linalg.inv(np.linalg.cholesky(steps.spread))
    whitened = [(root, [0])]
    for t in range(T - 1):
        W = np.linalg.inv(np.linalg.cholesky(steps.sigma[steps.kind[t]]))
        whitened.append((np.hstack([-W @ steps.A[steps.kind[t]], W]), [t, t + 1]))
    for J, at in whitened:
        index = np.concatenate([np.arange(4 * t, 4 * t + 4) for t in at])
        H[np.ix_(index, index)] += J.T @ J
    r, grad = residuals_at_own_position(noisy, X0[state][:, ::2])
    pull = score_and_information(r, noisy.errors)
    for n, t in enumerate(state.tolist()):
        J = np.zeros(4 * T + 4)
        J[[4 * t, 4 * t + 2]], J[4 * T + n % 4] = grad[n], 1.0 / noisy.sigma[n]
        H += pull.weight[n] * np.outer(J, J)
        g -= pull.slope[n] * J
    H[4 * T :, 4 * T :] += np.eye(4) / prior**2
    prior_part = H.copy()[: 4 * T, : 4 * T]
    for m in range(len(hints.step)):
        index = [4 * hints.step[m], 4 * hints.step[m] + 2]
        bend = np.array([[hints.bend[m, 0], hints.bend[m, 1]], [hints.bend[m, 1], hints.bend[m, 2]]])
        prior_part[np.ix_(index, index)] -= bend
    g[: 4 * T] += prior_part @ X0.reshape(-1)
    step = np.linalg.solve(H, -g)
    # The same in two stages: the minimum of the trajectory alone, then the biases
    alone = np.linalg.solve(H[: 4 * T, : 4 * T], -g[: 4 * T]).reshape(T, 4)
    found = begun.updated(rows, state, problem, X0, X0 + alone)
    np.testing.assert_allclose(found.bias, step[4 * T :], rtol=1e-6, atol=1e-9)
    whole = np.linalg.inv(H)
    np.testing.assert_allclose(found.covariance, whole[4 * T :, 4 * T :], rtol=1e-6)
    apart = np.linalg.inv(H[: 4 * T, : 4 * T])
    for t in range(T):
        own = slice(4 * t, 4 * t + 4)
        np.testing.assert_allclose(found.spread(T)[t], whole[own, own] - apart[own, own], rtol=1e-5, atol=1e-9)


def tracked(
    seed: int, bias: np.ndarray, prior: float, lag_s: float | None = None
) -> tuple[SmoothedTrajectory, np.ndarray]:
    """The trajectory, and the errors of its positions."""
    zero, path = np.zeros(4, dtype=np.int32), path_of(120, seed)
    given = [
        Scan.of(round(0.2 * k * NS), [])._replace(measured=ScanMeasurements(zero, rows))
        for k, rows in enumerate(measured(path, bias, 0.1, prior, seed))
    ]
    arrays = tuple(MicrophoneArray(f"s{i}", np.append(p, 0.0)) for i, p in enumerate(CORNERS))
    room = np.array([[-5.0, -5.0], [15.0, -5.0], [15.0, 13.0], [-5.0, 13.0]])
    config = MapConfig(process_noise_velocity=0.3, sigma_initial_velocity=0.7, lag_s=lag_s)
    pending = METHOD.begin(Scene(arrays=arrays, room=room), config, False)
    _, out = METHOD.advance(pending, given, True)
    return out, out.xy - path


@pytest.mark.jit
def test_biases_are_found_within_their_errors_and_covariances_hold_them() -> None:
    """12 recordings of a bias of a station, of all, and of none: 4 standard errors of a mean of 48 squares."""
    squares, nees = [], []
    for seed in range(12):
        bias = ([1.0, 0.0, 0.0, 0.0], [0.8, 0.8, 0.8, 0.8], [0.0] * 4)[seed % 3]
        out, away = tracked(seed, np.array(bias), 2.0)
        squares += [((one.bias - true) / one.error) ** 2 for one, true in zip(out.biases, bias, strict=True)]
        nees.append(np.einsum("ni,nij,nj->n", away, np.linalg.inv(out.covariance[:, :2, :2]), away).mean())
    assert abs(np.mean(squares) - 1.0) < 4.0 * np.sqrt(2.0 / 48)
    assert 1.0 < np.mean(nees) < 3.0


@pytest.mark.jit
def test_biases_want_the_whole_record() -> None:
    with pytest.raises(UsageError, match="whole records"):
        tracked(0, np.zeros(4), 2.0, lag_s=2.0)
