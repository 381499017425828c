"""Laplace approximations of particles' posteriors in space: against matrices and closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from occlog.array_types import Floats
from occlog.track.methods.in_space.kernels.importance import ScanRows, adapt, draw

PLACE = np.array([1.0, 2.0, 1.5])


def scan(seed: int, sigma: float, wrong: float = 0.0) -> ScanRows:
    """Four sensors around `PLACE`: two directions, an azimuth alone, and one with two candidates; scales differ."""
    rng, sensor = np.random.default_rng(seed), np.array([0, 1, 2, 3, 3])
    position = PLACE + 4.0 * np.array([[1.0, 0.2, 0.3], [-0.7, 0.8, 0.1], [0.1, -1.0, -0.4], [-0.5, -0.6, 0.7]])[sensor]
    away = PLACE - position + 4.0 * sigma * rng.normal(size=(5, 3))
    away[4] += [0.9, -0.4, 0.3]
    away[1] += wrong
    along = away / np.linalg.norm(away, axis=1)[:, None]
    left = np.cross([0.0, 0.0, 1.0], along)
    left /= np.linalg.norm(left, axis=1)[:, None]
    variance = sigma**2 * np.array([[1.0, 1.5], [0.7, 1.0], [1.0, np.inf], [2.0, 1.0], [1.0, 1.0]])
    scale, rival = np.array([0.9, 0.8, 1.0, 0.5, 0.4]), np.array([0.1, 0.2, 0.05, 0.3, 0.3])
    return ScanRows(np.array([0, 1, 2, 3, 5]), position, along, left, np.cross(along, left), variance, scale, rival)


def posterior(m0: Floats, C: Floats, s: ScanRows) -> tuple[Floats, Floats]:
    """Mode and precision by Gauss-Newton with annealed acceptance, in matrices, coordinates of the world."""
    p, share, last, prior = m0, 1.0, False, np.linalg.inv(C)
    for step in range(8):
        last = last or step == 7
        open_still, A, b = False, prior.copy(), prior @ (m0 - p)
        for k in range(len(s.first) - 1):
            rows, found = range(s.first[k], s.first[k + 1]), []
            for r in rows:
                d = p - s.position[r]
                u = s.along[r] @ d
                if not u > 0.05 * np.linalg.norm(d):
                    found.append((0.0, np.zeros(0), np.zeros((0, 3)), np.zeros(0)))
                    continue
                measured = np.isfinite(s.variance[r])
                axes = np.array([s.left[r], s.above[r]])[measured]
                t = axes @ d / u
                G = (axes - t[:, None] * s.along[r]) / u
                wide = share * np.diag(G @ C @ G.T)
                V = s.variance[r][measured]
                open_still |= bool((wide > 0.01 * V).any())
                found.append((s.scale[r] * norm.pdf(t, 0.0, np.sqrt(wide + V)).prod(), t, G, V))
            total = sum(each[0] for each in found)
            for r, (density, t, G, V) in zip(rows, found, strict=True):
                e = density / (total + s.rival[r])
                if last:
                    e = float(e > 0.5)
                if e > 1e-6:
                    A += e * (G.T / V) @ G
                    b -= e * (G.T / V) @ t
        step_of = np.linalg.solve(A, b)
        p = p + step_of
        if last:
            break
        last = not open_still and b @ step_of < 0.01
        share = 0.01 * share if open_still else 0.0
    return p, A


@pytest.mark.parametrize("spread", [0.02, 0.3, 1.0])
@pytest.mark.parametrize(("sigma", "wrong"), [(0.02, 0.0), (0.1, 0.0), (0.02, 1.0)])
@pytest.mark.parametrize("seed", range(2))
def test_an_approximation_is_that_of_gauss_newton_in_matrices(
    seed: int, sigma: float, wrong: float, spread: float
) -> None:
    rng, s = np.random.default_rng(seed), scan(seed, sigma, wrong)
    root = spread * np.linalg.cholesky(np.array([[1.0, 0.3, -0.2], [0.3, 0.8, 0.1], [-0.2, 0.1, 0.6]]))
    mean = (PLACE + rng.normal(size=(6, 3)) @ root.T).T
    modes, factors, volume = adapt(mean, root, s)
    for k in range(6):
        p, A = posterior(mean[:, k], root @ root.T, s)
        y, L = np.linalg.solve(root, p - mean[:, k]), np.linalg.cholesky(root.T @ A @ root)
        np.testing.assert_allclose(modes[:, k], y, rtol=1e-6, atol=1e-7)
        np.testing.assert_allclose(factors[:, k], L[[0, 1, 1, 2, 2, 2], [0, 0, 1, 0, 1, 2]], rtol=1e-6, atol=1e-9)
        assert volume[k] == pytest.approx(-0.5 * y @ y - np.log(np.diag(L)).sum())


def test_a_position_behind_or_beside_a_sensor_is_not_moved_by_its_direction() -> None:
    one = scan(0, 0.02)._replace(first=np.array([0, 1]))
    one = one._replace(**{name: getattr(one, name)[:1] for name in ("position", "along", "left", "above", "variance")})
    one = one._replace(variance=np.full((1, 2), 300.0), scale=np.ones(1), rival=np.full(1, 1e-30))
    for depth, moved in ((-0.1, False), (0.0499, False), (0.0501, True)):
        across = math.sqrt(1.0 - depth**2)
        mean = (one.position[0] + depth * one.along[0] + across * one.left[0])[:, None]
        modes, factors, volume = adapt(mean, 1e-3 * np.eye(3), one)
        assert modes.any() == moved
        assert (factors[[0, 2, 5], 0] == 1.0).all() != moved
        assert (volume[0] == 0.0) != moved


@pytest.mark.parametrize("defensive", [0.05, 0.5])
def test_positions_are_drawn_from_either_part_and_their_ratio_is_that_of_the_densities(defensive: float) -> None:
    rng, n = np.random.default_rng(0), 40
    half = rng.normal(size=(2, 3, 3))
    precision = half @ half.transpose(0, 2, 1) + np.eye(3)
    L, modes, chosen = np.linalg.cholesky(precision), rng.normal(size=(3, 2)), rng.integers(2, size=n)
    factors = np.array([L[:, 0, 0], L[:, 1, 0], L[:, 1, 1], L[:, 2, 0], L[:, 2, 1], L[:, 2, 2]])
    u, noise = rng.random(n), rng.normal(size=(3, n))
    u[0] = defensive
    y, ratio = draw(modes, factors, chosen, defensive, u, noise)
    prior = multivariate_normal(np.zeros(3))
    for i, p in enumerate(chosen):
        wanted = noise[:, i] if u[i] < defensive else modes[:, p] + np.linalg.solve(L[p].T, noise[:, i])
        np.testing.assert_allclose(y[:, i], wanted)
        near = multivariate_normal(modes[:, p], np.linalg.inv(precision[p])).pdf(y[:, i])
        q = (1.0 - defensive) * near + defensive * prior.pdf(y[:, i])
        assert ratio[i] == pytest.approx(prior.logpdf(y[:, i]) - np.log(q))
