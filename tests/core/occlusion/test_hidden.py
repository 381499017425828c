"""P(hidden) for a few places against closed forms: every way in which the kernels save work."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import erf

from occlog.core.occlusion.occlusion_probability import (
    IMPROVED,
    PRINTED,
    blocking_probabilities,
    visibility_probability,
)
from occlog.core.occlusion.priors import gaussian_priors

SIGMA, DIAMETER = 2.0, 3.0


def closed_form(positions: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """[Ercan] Eq. 7 of an isotropic prior, for which it is exact, from a camera at the origin."""
    r = np.hypot(*positions.T)
    u = positions / r[:, None]
    a, b = u @ mean, u[:, 0] * mean[1] - u[:, 1] * mean[0]
    scale = SIGMA * np.sqrt(2.0)
    across = erf((DIAMETER / 2 - b) / scale) + erf((DIAMETER / 2 + b) / scale)
    return 0.25 * across * (erf((r - a) / scale) + erf(a / scale))


@pytest.mark.parametrize("form", [PRINTED, IMPROVED])
@pytest.mark.parametrize(
    ("distance", "mean"),
    [
        (60.0, (30.0, 1.0)),  # between the camera and every place
        (33.0, (30.0, 1.0)),  # in front of the camera, next to the places
        (60.0, (3.0, 1.0)),  # next to the camera, nearer than every place
        (6.0, (3.0, 1.0)),  # next to both
        (6.0, (-3.0, -1.0)),  # mostly behind the camera
    ],
)
def test_isotropic_priors_are_those_of_equation_7_wherever_they_are(form: int, distance: float, mean: tuple) -> None:
    angles = np.linspace(-0.1, 0.15, 7)
    positions = (distance + np.linspace(-1, 1, 7))[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    priors = gaussian_priors(np.array([mean]), SIGMA**2 * np.eye(2)[None], DIAMETER)
    got = blocking_probabilities(positions, np.arange(7), 0.0, 0.0, priors, form, 8.5)[0]
    np.testing.assert_allclose(got, closed_form(positions, np.array(mean)), atol=1e-9)
    np.testing.assert_allclose(visibility_probability(positions, np.arange(7), 0.0, 0.0, priors, form, 8.5), 1.0 - got)


def test_a_known_position_hides_from_the_border_of_the_rectangle_on() -> None:
    positions, none = np.array([[10.0, 0.0]]), np.zeros((1, 2, 2))
    for at, hidden in (
        ((5.0, 1.5), 1.0),
        ((5.0, -1.5), 1.0),
        ((5.0, 1.5 + 1e-9), 0.0),
        ((0.0, 0.0), 1.0),
        ((-1e-9, 0.0), 0.0),
        ((10.0, 0.0), 1.0),
        ((10.0 + 1e-9, 0.0), 0.0),
    ):
        priors = gaussian_priors(np.array([at]), none, DIAMETER)
        assert blocking_probabilities(positions, np.arange(1), 0.0, 0.0, priors, PRINTED, 8.5).tolist() == [[hidden]]


@pytest.mark.parametrize(("aside", "counts"), [(0.999, True), (1.001, False)])
def test_a_prior_counts_up_to_so_many_deviations_from_the_rectangle(aside: float, counts: bool) -> None:
    far = 2.0
    mean = np.array([[10.0, aside * (far * SIGMA + DIAMETER / 2)]])
    priors = gaussian_priors(mean, SIGMA**2 * np.eye(2)[None], DIAMETER)
    got = blocking_probabilities(np.array([[20.0, 0.0]]), np.arange(1), 0.0, 0.0, priors, PRINTED, far)
    assert (got[0, 0] > 0.0) == counts
