"""The tracker's fast kernels against plain forms: `blocking` and `eta` of `occlog.papers.ercan.formulas`."""

import numpy as np
import pytest

from occlog.core.occlusion.joint_occlusion import clear_exact, over_subsets, sum_disjoint
from occlog.core.occlusion.occlusion_probability import blocking_probabilities, visibility_probability
from occlog.core.occlusion.priors import Priors, gaussian_priors, polygon_priors
from occlog.papers.ercan.formulas.blocking import (
    IMPROVED,
    PRINTED,
    QUADRATURE,
    blocking,
    blocking_all,
    patterns,
    seen_by_recursion,
    seen_exactly,
)

FORMS = (PRINTED, IMPROVED, QUADRATURE)
WIDE = 8.5


def covariances(sigma: float, alpha: float, size: int, rng: np.random.Generator) -> np.ndarray:
    angle = rng.uniform(0, np.pi, size)
    e = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return sigma**2 / alpha * np.eye(2) + sigma**2 * (1 - 1 / alpha) * e[:, :, None] * e[:, None, :]


def kind(name: str, rng: np.random.Generator, size: int = 12) -> Priors:
    mean = rng.uniform(0, 100, (size, 2))
    if name == "polygon":
        return polygon_priors([m + rng.uniform(2, 6) * np.array([[0, 0], [3, 0], [1, 1], [0, 3]]) for m in mean], 3.33)
    if name == "known":
        return gaussian_priors(mean, np.zeros((size, 2, 2)), 3.33)
    priors = gaussian_priors(mean, covariances(4.7, 1.0 if name == "isotropic" else 9.0, size, rng), 3.33)
    return priors._replace(minor=np.zeros(size)) if name == "line" else priors


@pytest.mark.parametrize("spread", [50.0, 4.0])
@pytest.mark.parametrize("name", ["isotropic", "anisotropic", "line", "known", "polygon"])
@pytest.mark.parametrize("form", FORMS)
def test_fast_q_is_q(name: str, form: int, spread: float) -> None:
    rng = np.random.default_rng(int(spread))
    priors, camera = kind(name, rng), np.array([3.0, 5.0])
    xy = 50 + rng.uniform(-spread, spread, (60, 2))
    rows = np.sort(rng.choice(60, 40, replace=False))
    want = blocking(xy[rows], camera, priors, form)
    got = blocking_probabilities(xy, rows, camera[0], camera[1], priors, form, WIDE)
    np.testing.assert_allclose(got.T, want, atol=1e-9)
    share = visibility_probability(xy, rows, camera[0], camera[1], priors, form, WIDE)
    np.testing.assert_allclose(share, np.prod(1 - want, axis=1), atol=1e-8)


@pytest.mark.jit
def test_what_is_left_out_is_small() -> None:
    rng = np.random.default_rng(5)
    priors, xy = kind("anisotropic", rng, 60), rng.uniform(0, 100, (200, 2))
    exact = blocking(xy, np.zeros(2), priors, QUADRATURE)
    got = blocking_probabilities(xy, np.arange(200), 0.0, 0.0, priors, QUADRATURE, 5.5)
    assert np.abs(got.T - exact).max() < 4e-8  # both tails beyond 5.5 standard deviations


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", ["isotropic", "anisotropic", "line", "known"])
def test_a_place_at_the_camera_is_not_hidden(name: str, form: int) -> None:
    priors = kind(name, np.random.default_rng(1), 3)._replace(mean=np.array([[3.0, 5.0], [4.0, 5.0], [60.0, 60.0]]))
    xy = np.array([[3.0, 5.0], [30.0, 40.0]])
    got = blocking_probabilities(xy, np.arange(2), 3.0, 5.0, priors, form, WIDE)
    assert got[:, 0].tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("seed", range(3))
def test_sums_over_subsets_are_sums_over_eta(seed: int) -> None:
    """Sum over Q of p_Q prod_Q (a - b) prod_not-Q b = sum over eta of p(eta) prod_seen a prod_hidden b."""
    rng = np.random.default_rng(seed)
    cameras, xy = rng.uniform(0, 100, (4, 2)), rng.uniform(20, 80, (5, 2))
    priors = kind("anisotropic", rng)
    q = blocking_all(xy, cameras, priors, QUADRATURE)
    a, b = rng.uniform(0, 3, 4), rng.uniform(0, 1, 4)
    number = np.arange(16)[:, None] >> np.arange(4) & 1
    products = np.prod(np.where(number, a, b), axis=1)
    for p in range(5):
        disjoint = seen_by_recursion(q[p : p + 1])[0]
        together = clear_exact(xy[p, 0], xy[p, 1], cameras, priors)
        np.testing.assert_allclose(together, seen_exactly(xy[p : p + 1], cameras, priors)[0], atol=1e-14)
        for seen in (disjoint, together):
            want = patterns(seen[None])[0] @ products
            assert over_subsets(seen, a, b, 0.0) == pytest.approx(max(want, 0.0), abs=1e-12)
        want = patterns(disjoint[None])[0] @ products
        assert sum_disjoint(np.ascontiguousarray(q[p]), a, b, 0.0) == pytest.approx(max(want, 0.0), abs=1e-12)
