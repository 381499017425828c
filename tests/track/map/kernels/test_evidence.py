"""Scales of noise and covariances by the sandwich, against dense matrices and known noise."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from trajectory_reference import dense_hessian, random_lines, random_steps

from occlog.track.methods.map.kernels.gauss_markov import constant_velocity
from occlog.track.methods.map.kernels.interior_point import Options, covariance, derivatives, minimise
from occlog.track.methods.map.kernels.noise_scales import (
    PRIOR_RESIDUALS,
    ResidualEvidence,
    between,
    evidence,
    rescaled,
    sandwich,
)
from occlog.track.methods.map.kernels.problem import NO_PLANES, BearingLinesByStep, TrajectoryProblem, chain
from occlog.track.methods.map.kernels.terms import residuals


def fixed(T: int, per: int, rng, *, noise: float, acceleration: float) -> TrajectoryProblem:
    """A walk at 2 Hz with so much acceleration, stated as 1, seen by linear sight lines of that noise, stated as 1."""
    model = constant_velocity(1.0, 0.0, 1.0)
    steps = chain(model, np.full(T - 1, 0.5), np.zeros(4), np.eye(4))
    X = np.zeros((T, 4))
    for t in range(T - 1):
        X[t + 1] = steps.A[0] @ X[t] + acceleration * np.linalg.cholesky(steps.sigma[0]) @ rng.standard_normal(4)
    n = T * per
    angle = rng.uniform(0, 2 * np.pi, n)
    step = np.repeat(np.arange(T), per)
    axis = np.column_stack([np.cos(angle), np.sin(angle)])
    h = axis[:, 0] * X[step, 2] - axis[:, 1] * X[step, 0]
    position = (h + noise * rng.standard_normal(n))[:, None] * np.column_stack([-axis[:, 1], axis[:, 0]])
    return TrajectoryProblem(
        steps,
        BearingLinesByStep(
            step=step,
            position=np.ascontiguousarray(position),
            axis=axis,
            focal=np.ones(n),
            reading=np.zeros(n),
            c0=np.zeros(n),
            c1=np.ones(n),
            direction=np.zeros(n, dtype=np.bool_),
            volume=np.zeros(n),
            lean=np.zeros(n),
        ),
        NO_PLANES,
        0,
        1.0,
    )


def solved(problem: TrajectoryProblem):
    return minimise(problem, np.zeros((problem.T, 4)), Options(1e-9)).X


def test_sums_of_squares_and_their_freedoms() -> None:
    rng = np.random.default_rng(0)
    X = rng.normal(size=(6, 4))
    problem = TrajectoryProblem(random_steps(rng, 6), random_lines(rng, X, 3.0), NO_PLANES, 0, 1.0)
    spread = covariance(problem, X)
    evidence_of = evidence(problem, X, spread)
    assert evidence_of.lines == pytest.approx(np.sum(residuals(problem.lines, X) ** 2))
    H, s = dense_hessian(problem.steps, derivatives(problem, X, 0.0)[1]), problem.steps
    G = dense_hessian(s, np.zeros((6, 3)))
    # Variances that depend on the distance have curvature of their own next to that of the residuals.
    assert evidence_of.steps_freedom == pytest.approx(np.trace(np.linalg.inv(H) @ (H - G)), rel=0.15)
    steps = 0.0
    for t in range(5):
        e = X[t + 1] - s.A[s.kind[t]] @ X[t]
        steps += e @ np.linalg.solve(s.sigma[s.kind[t]], e)
    assert evidence_of.steps == pytest.approx(steps)


@pytest.mark.parametrize(
    ("noise", "acceleration"),
    [(3.0, 1.0), *(pytest.param(*case, marks=pytest.mark.jit) for case in ((1.0, 1.0), (1.0, 4.0), (0.5, 1.0)))],
)
def test_scales_are_those_of_the_noise(noise: float, acceleration: float) -> None:
    problem = fixed(800, 3, np.random.default_rng(1), noise=noise, acceleration=acceleration)
    right = rescaled(problem, noise**2, acceleration**2)
    X = solved(right)
    evidence_of = evidence(right, X, covariance(right, X))
    assert evidence_of.lines_scale == pytest.approx(1.0, rel=0.12)
    assert evidence_of.steps_scale == pytest.approx(1.0, rel=0.2)
    wrong = evidence(problem, solved(problem), covariance(problem, solved(problem)))
    assert (wrong.lines_scale > 1.5) == (noise > 1.0 or acceleration > 1.0)


def test_what_is_stated_counts_as_some_residuals() -> None:
    nothing = ResidualEvidence(0.0, 0.0, 0.0, 0.0)
    assert (nothing.lines_scale, nothing.steps_scale) == (1.0, 1.0)
    assert ResidualEvidence(60.0, 20.0, 0.0, 0.0).lines_scale == (PRIOR_RESIDUALS + 60.0) / (PRIOR_RESIDUALS + 20.0)


def test_the_sandwich_is_that_of_dense_matrices() -> None:
    problem = fixed(12, 6, np.random.default_rng(2), noise=4.0, acceleration=1.0)
    X = solved(problem)
    spread = covariance(problem, X)
    evidence_of = evidence(problem, X, spread)
    H = dense_hessian(problem.steps, derivatives(problem, X, 0.0)[1])
    G = dense_hessian(problem.steps, np.zeros((12, 3)))
    C = np.linalg.inv(H)
    want = C @ (evidence_of.lines_scale * (H - G) + max(evidence_of.steps_scale, 1.0) * G) @ C
    blocks = np.array([want[4 * t : 4 * t + 4, 4 * t : 4 * t + 4] for t in range(12)])
    assert evidence_of.lines_scale > 3.0
    assert_allclose(sandwich(problem, X, spread), blocks, rtol=0.05, atol=0.02 * np.abs(blocks).max())


@pytest.mark.jit
def test_covariances_by_the_sandwich_are_honest_where_the_noise_is_not_as_stated() -> None:
    nees: list[float] = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        problem = fixed(120, 4, rng, noise=3.0, acceleration=1.0)
        true = fixed(120, 4, np.random.default_rng(seed), noise=0.0, acceleration=1.0)
        X = solved(problem)
        spread = sandwich(problem, X, covariance(problem, X))
        away = (X - solved(true._replace(lines=true.lines._replace(c1=np.full(480, 1e-6)))))[:, ::2]
        nees += np.einsum("ti,tij,tj->t", away, np.linalg.inv(spread[:, ::2, ::2]), away).tolist()
    assert 1.5 < np.mean(nees) < 2.6


def test_what_rounding_leaves_of_a_part_stays_within_the_whole() -> None:
    """Steps of a nanosecond leave little but rounding of a difference; a sandwich of it had negative variances."""
    rng = np.random.default_rng(3)
    root = rng.normal(size=(3, 4, 4)) * np.array([1e-2, 1.0, 1e-2, 1.0])[:, None]
    whole = root @ root.transpose(0, 2, 1)
    part = root @ np.diag([0.1, 0.5, 0.9, 1.0]) @ root.transpose(0, 2, 1)
    wrong = part + np.array([0.0, 0.2, -0.5])[:, None, None] * np.eye(4)
    found = between(wrong, whole)
    assert_allclose(found[0], part[0])
    for one, limit in zip(found, whole, strict=True):
        assert np.linalg.eigvalsh(one).min() > -1e-12
        assert np.linalg.eigvalsh(limit - one).min() > -1e-12
