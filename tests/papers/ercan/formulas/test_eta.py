"""p(eta | u): recursion against its definition, exact against draws, all against each other in limits."""

from itertools import product

import numpy as np
import pytest

from occlog.core.occlusion.priors import Priors, gaussian_priors, polygon_priors
from occlog.papers.ercan.formulas.blocking import (
    QUADRATURE,
    blocking_all,
    independent,
    patterns,
    seen_by_recursion,
    seen_exactly,
)


def eq_9(q: np.ndarray, eta: tuple[int, ...], known: dict[int, int]) -> float:
    """Eqs. 8-9 as printed: q (N, M); `known` are the cameras so far, by their eta."""
    rest = [i for i in range(len(eta)) if i not in known]
    hidden = [i for i in rest if eta[i] == 0]
    if not hidden:
        Q = [i for i in range(len(eta)) if known.get(i, eta[i]) == 1]
        return float(np.prod(np.maximum(0.0, 1.0 - q[Q].sum(axis=0))))
    n = hidden[0]
    return eq_9(q, eta, {**known, n: -1}) - eq_9(q, eta, {**known, n: 1})


def number(eta: np.ndarray) -> int:
    return sum(1 << i for i, one in enumerate(eta) if one)


def all_etas(N: int) -> list[np.ndarray]:
    return [np.array(eta, dtype=bool) for eta in product((0, 1), repeat=N)]


def anisotropic(seed: int, M: int, spread: float, diameter: float = 3.33) -> Priors:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(M, 2, 2)) * spread
    return gaussian_priors(rng.uniform(0, 40, (M, 2)), A @ A.transpose(0, 2, 1), diameter)


@pytest.mark.parametrize("seed", range(5))
def test_recursion_is_eq_9_as_printed(seed: int) -> None:
    q = np.random.default_rng(seed).uniform(0, 0.25, (3, 4, 5))
    for eta in all_etas(4):
        want = [max(0.0, eq_9(row, tuple(eta.astype(int)), {})) for row in q]
        found = patterns(seen_by_recursion(q))[:, number(eta)]
        np.testing.assert_allclose(np.maximum(found, 0.0), want, atol=1e-14)


@pytest.mark.jit
@pytest.mark.parametrize("N", [1, 2, 4, 6])
def test_probabilities_of_all_eta_sum_to_one(N: int) -> None:
    rng = np.random.default_rng(N)
    priors, cameras, xy = anisotropic(N, 6, 2.0), rng.uniform(0, 40, (N, 2)), rng.uniform(0, 40, (5, 2))
    q = blocking_all(xy, cameras, priors, QUADRATURE) * 0.15  # so that nothing is clipped
    assert q.sum(axis=1).max() < 1.0
    assert patterns(seen_by_recursion(q)).min() > -1e-15
    for found in (patterns(seen_by_recursion(q)), independent(q), patterns(seen_exactly(xy, cameras, priors))):
        np.testing.assert_allclose(found.sum(axis=1), 1.0, atol=1e-12)


def hidden(points: np.ndarray, x: np.ndarray, camera: np.ndarray, diameter: float) -> np.ndarray:
    """Which points are in the rectangle from the camera to x."""
    u = (x - camera) / np.hypot(*(x - camera))
    along, across = (points - camera) @ u, (points - camera) @ np.array([-u[1], u[0]])
    return (along >= 0) & (along <= np.hypot(*(x - camera))) & (abs(across) <= diameter / 2)


def share_of_patterns(draws: np.ndarray, x: np.ndarray, cameras: np.ndarray, diameter: float) -> np.ndarray:
    """Relative frequencies of eta over draws (n, M, 2) of all occluders."""
    number = np.zeros(len(draws), dtype=int)
    for i, camera in enumerate(cameras):
        seen = ~hidden(draws.reshape(-1, 2), x, camera, diameter).reshape(draws.shape[:2]).any(axis=1)
        number += seen << i
    return np.bincount(number, minlength=1 << len(cameras)) / len(draws)


@pytest.mark.jit
@pytest.mark.parametrize("seed", range(3))
def test_exact_is_what_draws_show(seed: int) -> None:
    rng, draws = np.random.default_rng(seed), 40_000
    priors = anisotropic(seed, 5, 3.0, 6.0)
    cameras, xy = rng.uniform(0, 40, (4, 2)), rng.uniform(10, 30, (3, 2))
    z = rng.normal(size=(draws, 5, 2)) * np.stack([priors.sigma, priors.minor], axis=1)
    normal = np.stack([-priors.axis[:, 1], priors.axis[:, 0]], axis=1)
    points = priors.mean + z[..., :1] * priors.axis + z[..., 1:] * normal
    p = patterns(seen_exactly(xy, cameras, priors))
    for x, row in zip(xy, p, strict=True):
        error = np.abs(share_of_patterns(points, x, cameras, 6.0) - row)
        assert np.all(error < 5 * np.sqrt(np.maximum(row * (1 - row), 1e-5) / draws))  # five standard errors


def test_exact_with_known_positions_is_certain() -> None:
    rng = np.random.default_rng(4)
    mean, cameras, xy = rng.uniform(0, 40, (12, 2)), rng.uniform(0, 40, (4, 2)), rng.uniform(0, 40, (20, 2))
    priors = gaussian_priors(mean, np.zeros((12, 2, 2)), 3.0)
    p = patterns(seen_exactly(xy, cameras, priors))
    for x, row in zip(xy, p, strict=True):
        np.testing.assert_allclose(row, share_of_patterns(mean[None], x, cameras, 3.0), atol=1e-15)


def test_exact_with_a_prior_on_a_line_and_a_polygon() -> None:
    rng, draws = np.random.default_rng(7), 40_000
    cameras, xy = np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 20.0]]), rng.uniform(6, 14, (4, 2))
    e = np.array([0.6, 0.8])
    line = gaussian_priors(np.array([[10.0, 9.0]]), 9.0 * np.outer(e, e)[None], 4.0)
    assert line.minor[0] == 0.0
    on_line = np.array([10.0, 9.0]) + 3.0 * rng.normal(size=(draws, 1)) * e
    L_shape = np.array([[5.0, 5.0], [15.0, 5.0], [15.0, 9.0], [9.0, 9.0], [9.0, 15.0], [5.0, 15.0]])
    points = rng.uniform(5, 15, (4 * draws, 2))
    points = points[(points[:, 0] < 9) | (points[:, 1] < 9)]
    for priors, cloud in ((line, on_line), (polygon_priors([L_shape], 4.0), points)):
        p = patterns(seen_exactly(xy, cameras, priors))
        for x, row in zip(xy, p, strict=True):
            error = np.abs(share_of_patterns(cloud[:, None], x, cameras, 4.0) - row)
            assert np.all(error < 5 * np.sqrt(np.maximum(row * (1 - row), 1e-5) / len(cloud)))


@pytest.mark.jit
def test_one_camera_makes_all_forms_equal() -> None:
    rng = np.random.default_rng(1)
    priors, camera, xy = anisotropic(1, 8, 2.0), rng.uniform(0, 40, (1, 2)), rng.uniform(0, 40, (10, 2))
    q = blocking_all(xy, camera, priors, QUADRATURE)
    want = patterns(seen_exactly(xy, camera, priors))
    np.testing.assert_allclose(patterns(seen_by_recursion(q)), want, atol=1e-11)
    np.testing.assert_allclose(independent(q), want, atol=1e-11)


@pytest.mark.jit
def test_recursion_is_exact_where_no_prior_is_near_an_overlap() -> None:
    """Cameras on opposite sides have disjoint rectangles; each prior is between the place and one of them."""
    cameras, xy = np.array([[0.0, 0.0], [40.0, 0.0]]), np.array([[20.0, 0.0]])
    priors = gaussian_priors(np.array([[10.0, 0.5], [30.0, -1.0], [8.0, 2.0]]), np.tile(np.eye(2), (3, 1, 1)), 3.33)
    q = blocking_all(xy, cameras, priors, QUADRATURE)
    want = patterns(seen_exactly(xy, cameras, priors))
    np.testing.assert_allclose(patterns(seen_by_recursion(q)), want, atol=1e-11)
    # Here each occluder can hide from one camera only, so cameras are independent too.
    np.testing.assert_allclose(independent(q)[:, 0], want[:, 0], atol=1e-9)


@pytest.mark.jit
def test_two_cameras_at_one_place_see_the_same() -> None:
    cameras, xy = np.zeros((2, 2)), np.array([[20.0, 5.0], [3.0, 9.0]])
    priors = anisotropic(3, 10, 2.0)
    p = patterns(seen_exactly(xy, cameras, priors))
    np.testing.assert_allclose(p[:, 1:3], 0.0, atol=1e-13)
    one = patterns(seen_exactly(xy, cameras[:1], priors))
    np.testing.assert_allclose(p[:, [0, 3]], one, atol=1e-13)


def test_recursion_is_zero_with_more_hidden_cameras_than_occluders() -> None:
    q = np.random.default_rng(0).uniform(0.05, 0.2, (6, 3, 2))
    np.testing.assert_allclose(patterns(seen_by_recursion(q))[:, 0], 0.0, atol=1e-15)
    assert np.all(independent(q)[:, 0] > 0)


def test_independent_cameras_are_the_products_of_each() -> None:
    q = np.random.default_rng(3).uniform(0.0, 0.4, (6, 3, 2))
    seen = np.prod(1.0 - q, axis=2)
    for eta in all_etas(3):
        np.testing.assert_allclose(independent(q)[:, number(eta)], np.prod(np.where(eta, seen, 1.0 - seen), axis=1))


def test_clipping_of_eq_8() -> None:
    q = np.array([[[0.7, 0.1], [0.6, 0.1]]])
    np.testing.assert_allclose(seen_by_recursion(q)[0], [1.0, 0.3 * 0.9, 0.4 * 0.9, 0.0])
    assert patterns(seen_by_recursion(q)).sum() == pytest.approx(1.0)


def test_a_camera_at_the_place_sees_it() -> None:
    priors = gaussian_priors(np.array([[5.0, 5.0]]), np.eye(2)[None], 4.0)
    p = seen_exactly(np.array([[5.0, 5.0]]), np.array([[5.0, 5.0], [0.0, 0.0]]), priors)[0]
    assert p[1] == 1.0
    assert p[2] < 0.7


def test_too_many_cameras_are_refused() -> None:
    with pytest.raises(ValueError, match="subsets of 17 cameras: at most 16"):
        seen_by_recursion(np.zeros((1, 17, 1)))
