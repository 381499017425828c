"""Steps of any length: closed forms, matrix exponentials, integrals."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad_vec
from scipy.linalg import expm
from trajectory_reference import PAPER, PAPER_A, PAPER_SIGMA, random_model

from occlog.track.methods.map.kernels.gauss_markov import GaussMarkov, constant_velocity, diffusion, transitions

MODELS = (PAPER, constant_velocity(0.5, 0.1, 0.5), *(random_model(np.random.default_rng(s)) for s in range(3)))


def damped(rng, rate: float = 0.3):
    """Generator and noise of a stable model, and the discrete model of its step by plain integration."""
    B = np.kron(np.eye(2), [[-0.1, 1.0], [-0.2, -rate]]) + 0.1 * rng.normal(size=(4, 4))
    M = rng.normal(size=(4, 4))
    return B, M @ M.T + 0.1 * np.eye(4)


def collected(B, S, dt: float):
    """Integral over 0..dt of exp(B s) S exp(B s)'."""
    return quad_vec(lambda s: expm(B * s) @ S @ expm(B * s).T, 0.0, dt, epsabs=1e-13, epsrel=1e-12)[0]


@pytest.mark.parametrize("own", [0.04, 0.5, 1.0])
@pytest.mark.parametrize("jitter", [0.0, 0.2])
def test_constant_velocity_has_its_closed_form_for_any_step(own: float, jitter: float) -> None:
    dt = np.array([1e-4, 0.013, own, 0.7, 30.0, 4000.0])
    a = 0.6
    A, sigma = transitions(constant_velocity(a, jitter, own), dt)
    for t, got, noise in zip(dt, A, sigma, strict=True):
        Q = a**2 * np.array([[t**3 / 3, t**2 / 2], [t**2 / 2, t]]) + [[jitter**2 * t, 0.0], [0.0, 0.0]]
        assert_allclose(got, np.kron(np.eye(2), [[1.0, t], [0.0, 1.0]]), rtol=1e-9, atol=1e-12)
        # Each entry by its own scale: the position's variance of a short step is far below the velocity's
        scale = np.sqrt(np.outer(np.diag(Q), np.diag(Q)))
        assert_allclose(noise / np.kron(np.ones((2, 2)), scale), np.kron(np.eye(2), Q / scale), rtol=0, atol=1e-5)


@pytest.mark.parametrize("seed", range(4))
def test_damped_models_against_exponential_and_integral(seed: int) -> None:
    B, S = damped(np.random.default_rng(seed))
    own = 0.5
    model = GaussMarkov(expm(B * own), collected(B, S, own), own)
    flow = diffusion(model)
    assert_allclose(flow.B, B, rtol=0, atol=1e-10)
    assert_allclose(flow.S, S, rtol=0, atol=1e-9)
    dt = np.array([0.001, 0.2, 0.9, 7.0])
    A, sigma = transitions(model, dt)
    for t, got, noise in zip(dt, A, sigma, strict=True):
        assert_allclose(got, expm(B * t), rtol=0, atol=1e-9)
        assert_allclose(noise, collected(B, S, t), rtol=1e-8, atol=1e-11)
        assert np.array_equal(noise, noise.T)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("dt", [0.02, 0.3, 3.0])
def test_two_half_steps_are_one(model: GaussMarkov, dt: float) -> None:
    A, sigma = transitions(model, np.array([dt / 2, dt]))
    assert_allclose(A[0] @ A[0], A[1], rtol=1e-9, atol=1e-12)
    assert_allclose(A[0] @ sigma[0] @ A[0].T + sigma[0], sigma[1], rtol=1e-8, atol=1e-10 * np.abs(sigma[1]).max())


@pytest.mark.parametrize("step_s", [0.5, 2.0])
def test_a_step_of_the_models_own_length_is_the_model_itself(step_s: float) -> None:
    model = GaussMarkov(PAPER_A, PAPER_SIGMA, step_s)
    A, sigma = transitions(model, np.array([step_s, 0.3, step_s * (1 + 1e-12)]))
    for k in (0, 2):
        assert np.array_equal(A[k], model.A)
        assert np.array_equal(sigma[k], model.sigma)
    assert not np.array_equal(A[1], model.A)


def test_the_papers_noise_is_of_no_diffusion_and_the_nearest_one_is_taken() -> None:
    flow = diffusion(PAPER)
    assert_allclose(flow.B, np.kron(np.eye(2), [[0.0, 1.0], [0.0, 0.0]]), rtol=0, atol=1e-12)
    # One axis: Sigma = S_pp t + S_pv t^2 + S_vv t^3/3, S_pv t + S_vv t^2/2, S_vv t for the symmetric S
    t, (pp, vv) = 0.5, (1e-10, 1e-6)
    raw = np.array([[pp / t + vv * t / 6, -vv / 2], [-vv / 2, vv / t]])
    values, vectors = np.linalg.eigh(raw)
    assert values[0] < 0.0 < values[1]
    nearest = (vectors * np.maximum(values, 0.0)) @ vectors.T
    assert_allclose(flow.S, np.kron(np.eye(2), nearest), rtol=0, atol=1e-6 * vv)
    _, sigma = transitions(PAPER, np.array([0.25, 0.5, 1.0, 60.0]))
    for noise in sigma:
        np.linalg.cholesky(noise)


@pytest.mark.parametrize("entry", [-0.5, 0.0])
def test_no_real_logarithm_is_an_error_but_for_the_models_own_step(entry: float) -> None:
    A = np.kron(np.eye(2), [[1.0, 0.5], [0.0, 1.0]])
    A[3, 3] = entry
    model = GaussMarkov(A, np.eye(4), 0.5)
    with pytest.raises(ValueError, match="no real logarithm"):
        transitions(model, np.array([0.3]))
    got, sigma = transitions(model, np.array([0.5]))
    assert np.array_equal(got[0], A)
    assert np.array_equal(sigma[0], np.eye(4))
    assert transitions(model, np.empty(0))[0].shape == (0, 4, 4)
