from __future__ import annotations

import numpy as np
import pytest

from occlog.measure.clusters.em import Mixture, e_step, log_prior, m_step, run_em, shared_entropy
from occlog.measure.regions.regions import gather

AREA = 5000.0


def matrix(rows: np.ndarray) -> np.ndarray:
    """(K, 2, 2) from rows xx, xy, yy."""
    return np.array([[[a, b], [b, c]] for a, b, c in rows])


def textbook_step(
    x: np.ndarray, means: np.ndarray, covs: np.ndarray, mass: np.ndarray, prior: np.ndarray, nu: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """One MAP-EM update over pixels x (N, 2), and the objective before it, written from the definition."""
    share = mass / mass.sum()
    density = np.empty((len(x), len(means) + 1))
    for k, (m, s) in enumerate(zip(means, covs, strict=True)):
        d = x - m
        d2 = np.einsum("ni,ij,nj->n", d, np.linalg.inv(s), d)
        density[:, k] = share[k] * np.exp(-0.5 * d2) / (2 * np.pi * np.sqrt(np.linalg.det(s)))
    density[:, -1] = share[-1] / AREA
    objective = np.log(density.sum(axis=1)).sum()
    for s, s0, v in zip(covs, prior, nu, strict=True):
        ratio = np.linalg.solve(s, s0)
        objective -= 0.5 * v * (np.trace(ratio) - 2 - np.log(np.linalg.det(ratio)))
    r = density / density.sum(axis=1, keepdims=True)
    n = r.sum(axis=0)
    new_means = (r[:, :-1].T @ x) / n[:-1, None]
    new_covs = np.empty_like(covs)
    for k in range(len(means)):
        d = x - new_means[k]
        scatter = np.einsum("n,ni,nj->ij", r[:, k], d, d)
        new_covs[k] = (nu[k] * prior[k] + scatter) / (nu[k] + n[k])
    return new_means, new_covs, n, float(objective)


def random_case(seed: int, n_clusters: int) -> tuple[np.ndarray, Mixture, np.ndarray, np.ndarray]:
    """A mask with blobs and specks, a poor start, and a prior."""
    rng = np.random.default_rng(seed)
    mask = np.where(rng.random((50, 100)) < 0.02, 255, 0).astype(np.uint8)
    for _ in range(n_clusters):
        y, x = rng.integers(5, 30), rng.integers(5, 85)
        mask[y : y + 15, x : x + 8] = 255
    means = rng.uniform([0, 0], [100, 50], (n_clusters, 2))
    covs = np.tile([12.0, 1.0, 30.0], (n_clusters, 1))
    mass = np.append(rng.uniform(20, 100, n_clusters), 20.0)
    prior = np.tile([6.0, 0.5, 20.0], (n_clusters, 1))
    return mask, Mixture(means, covs, mass), prior, rng.uniform(10, 200, n_clusters)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("n_clusters", [1, 3])
def test_a_step_on_single_pixels_is_the_textbook_step(seed: int, n_clusters: int) -> None:
    mask, mixture, prior, nu = random_case(seed, n_clusters)
    cells, _ = gather(mask, 1)
    labels = np.empty(len(cells), dtype=np.int64)
    value, statistics = e_step(cells, mixture, AREA, labels)
    got = m_step(statistics, prior, nu)
    want = textbook_step(cells[:, 1:3], mixture.means, matrix(mixture.covs), mixture.mass, matrix(prior), nu)
    # Densities below exp(-20) of a cluster's peak are left out, hence not to the last digit.
    np.testing.assert_allclose(got.means, want[0], rtol=1e-6)
    np.testing.assert_allclose(matrix(got.covs), want[1], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(got.mass, want[2], rtol=1e-6)
    np.testing.assert_allclose(value + log_prior(mixture.covs, prior, nu), want[3], rtol=1e-9)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("side", [1, 4])
def test_the_objective_never_falls(seed: int, side: int) -> None:
    mask, mixture, prior, nu = random_case(seed, 3)
    cells, _ = gather(mask, side)
    labels = np.empty(len(cells), dtype=np.int64)
    values = []
    for _ in range(30):
        value, statistics = e_step(cells, mixture, AREA, labels)
        values.append(value + log_prior(mixture.covs, prior, nu))
        mixture = m_step(statistics, prior, nu)
    assert np.diff(values).min() > -1e-6 * abs(values[0])
    assert values[-1] > values[0]


def test_small_cells_give_what_pixels_give() -> None:
    # A cell's pixels share their responsibilities; at a quarter of a cluster's width that hardly matters.
    mask = np.zeros((60, 120), dtype=np.uint8)
    mask[10:50, 20:36] = 255
    mask[15:55, 60:76] = 255
    start = Mixture(np.array([[30.0, 25.0], [66.0, 40.0]]), np.tile([20.0, 0.0, 130.0], (2, 1)), np.full(3, 100.0))
    prior, nu = np.tile([20.0, 0.0, 130.0], (2, 1)), np.full(2, 300.0)
    found = []
    for side in (1, 4):
        cells, _ = gather(mask, side)
        labels = np.empty(len(cells), dtype=np.int64)
        found.append(run_em(cells, start, prior, nu, 7200.0, labels, 50, 1e-9)[0])
    np.testing.assert_allclose(found[1].means, found[0].means, atol=0.05)
    np.testing.assert_allclose(found[1].covs, found[0].covs, rtol=0.02, atol=0.2)
    np.testing.assert_allclose(found[1].mass, found[0].mass, rtol=0.01, atol=0.01)


def test_the_prior_alone_shapes_a_cluster_without_pixels() -> None:
    mixture = Mixture(np.array([[500.0, 500.0]]), np.array([[9.0, 0.0, 9.0]]), np.array([5.0, 5.0]))
    cells, _ = gather(np.full((4, 4), 255, dtype=np.uint8), 4)
    labels = np.empty(1, dtype=np.int64)
    _, statistics = e_step(cells, mixture, AREA, labels)
    got = m_step(statistics, np.array([[7.0, 2.0, 30.0]]), np.array([50.0]))
    np.testing.assert_allclose(got.covs, [[7.0, 2.0, 30.0]])
    assert got.mass.tolist() == [0.0, 16.0]
    assert labels.tolist() == [-1]


@pytest.mark.parametrize("seed", range(3))
def test_shared_entropy_is_that_of_the_responsibilities(seed: int) -> None:
    mask, mixture, _, _ = random_case(seed, 3)
    cells, _ = gather(mask, 1)
    share = mixture.mass / mixture.mass.sum()
    density = np.empty((len(cells), 4))
    for k, (m, s) in enumerate(zip(mixture.means, matrix(mixture.covs), strict=True)):
        d = cells[:, 1:3] - m
        d2 = np.einsum("ni,ij,nj->n", d, np.linalg.inv(s), d)
        density[:, k] = share[k] * np.exp(-0.5 * d2) / (2 * np.pi * np.sqrt(np.linalg.det(s)))
    density[:, 3] = share[3] / AREA
    r = density / density.sum(axis=1, keepdims=True)
    got = shared_entropy(cells, mixture, AREA)
    np.testing.assert_array_equal(got, got.T)
    for a, b in ((1, 0), (2, 0), (2, 1)):
        p = np.clip(r[:, a] / np.maximum(r[:, a] + r[:, b], 1e-300), 1e-15, 1 - 1e-15)
        want = ((r[:, a] + r[:, b]) * (-p * np.log(p) - (1 - p) * np.log(1 - p))).sum()
        assert got[a, b] == pytest.approx(want, rel=1e-3, abs=1e-3)


def test_log_prior_is_greatest_at_the_persons_covariance() -> None:
    prior, nu = np.array([[10.0, 3.0, 50.0]]), np.array([20.0])
    assert log_prior(prior, prior, nu) == pytest.approx(0.0, abs=1e-12)
    rng = np.random.default_rng(0)
    for _ in range(20):
        a = rng.normal(size=(2, 2)) * 5
        s = a @ a.T + np.eye(2)
        assert log_prior(np.array([[s[0, 0], s[0, 1], s[1, 1]]]), prior, nu) < 0.0
