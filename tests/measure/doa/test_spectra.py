"""Microphone arrays: geometry, levels, coherence and the bound, against simulation."""

from __future__ import annotations

import numpy as np

from occlog.measure.doa.locate import coherence, direction, extents, levels, sharpness, spectra

C = 343.0
SQUARE = 0.05 * np.array([[1.0, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
SOLID = np.vstack([SQUARE, [[0.0, 0.0, 0.07]]])


def test_extents_of_lines_planes_and_solids() -> None:
    rng = np.random.default_rng(0)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    line = np.outer(np.arange(4.0), [1.0, 2.0, 3.0])
    assert [extents(m @ turn.T + 5)[0] for m in (np.zeros((3, 3)), line, SQUARE, SOLID)] == [0, 1, 2, 3]
    assert np.allclose(np.abs(extents(SQUARE @ turn.T)[1]), np.abs(turn[:, 2]))


def test_a_full_scale_sine_has_level_1() -> None:
    t = np.arange(4096) / 16000
    X = spectra(np.sin(2 * np.pi * 1000 * t)[:, None], 1024, 512)
    assert X.shape == (1, 513, 7)
    assert np.allclose(levels(X, np.arange(1, 512)), 1.0, rtol=0.01)
    assert spectra(np.zeros((10, 2)), 1024, 512).shape == (2, 513, 0)


def plane_wave(rng: np.random.Generator, u: np.ndarray, omega: np.ndarray, snapshots: int, noise: float) -> np.ndarray:
    """Spectra of a wave from u with white noise; the phase at m is omega p.u/c."""
    s = rng.normal(size=(len(omega), snapshots, 2)) @ [1, 1j]
    steer = np.exp(1j * (SOLID @ u)[:, None] / C * omega)
    w = rng.normal(size=(len(SOLID), len(omega), snapshots, 2)) @ [1, 1j]
    return steer[:, :, None] * s + noise * w


def test_coherence_is_1_of_a_wave_and_0_of_noise() -> None:
    rng = np.random.default_rng(1)
    omega, bins = 2 * np.pi * np.linspace(500, 4000, 50), np.arange(50)
    u = direction(np.array(0.4), np.array(0.3))
    wave = plane_wave(rng, u, omega, 40, 0.0)
    assert coherence(wave, bins, omega, SOLID, u, C) > 1 - 1e-9
    assert coherence(wave, bins, omega, SOLID, direction(np.array(2.4), np.array(0.0)), C) < 0.5
    noise = rng.normal(size=wave.shape) + 1j * rng.normal(size=wave.shape)
    assert abs(coherence(noise, bins, omega, SOLID, u, C)) < 4 / np.sqrt(50 * 40 * 10)


def test_the_bound_is_about_the_error_of_the_most_coherent_direction() -> None:
    """Independent white noise, 200 draws: standard deviations of a search within a fifth of the bound."""
    from scipy.optimize import minimize

    omega, bins, true = 2 * np.pi * np.linspace(500, 4000, 20), np.arange(20), np.array([0.7, 0.4])
    errors, agreements = [], []
    for seed in range(200):
        X = plane_wave(np.random.default_rng(seed), direction(*true), omega, 4, 0.2)
        found = minimize(lambda a, X=X: -coherence(X, bins, omega, SOLID, direction(*a), C), true, method="Nelder-Mead")
        errors.append(found.x - true)
        agreements.append(-found.fun)
    bound = np.sqrt(np.diag(sharpness(omega, 4, SOLID, *true, C, float(np.mean(agreements)))))
    ratio = np.std(errors, axis=0) / bound
    assert ((ratio > 0.8) & (ratio < 1.25)).all(), ratio


def test_an_angle_that_is_not_stated_is_infinitely_uncertain() -> None:
    omega = np.array([6000.0])
    at_horizon = sharpness(omega, 1.0, SQUARE, 0.3, 0.0, C, 0.5)
    assert np.isinf(at_horizon[1, 1])
    assert np.isfinite(at_horizon[0, 0])
    assert np.isfinite(sharpness(omega, 1.0, SOLID, 0.3, 0.0, C, 0.5)).all()
