"""The scatter of places about a walk, learned."""

import numpy as np
import pytest

from occlog.track.methods.jipda.batch.tracklet_nodes import NU, gait_variances


def drawn(n, scale, seed):
    """Places that are off a known walk by Student's t, measured to 1 cm."""
    rng = np.random.default_rng(seed)
    weight = rng.gamma(NU / 2.0, 2.0 / NU, n)
    off = rng.normal(0.0, scale, (n, 2)) / np.sqrt(weight)[:, None] + rng.normal(0.0, 0.01, (n, 2))
    J = np.zeros((n, 6, 6))
    J[:, [0, 1], [0, 1]] = 1e4
    h = np.zeros((n, 6))
    h[:, :2] = 1e4 * off
    return off, J, h, np.zeros((n, 6)), np.tile(1e-4 * np.eye(6), (n, 1, 1))


def test_the_scale_is_found():
    _, J, h, mean, covariance = drawn(4000, 0.08, 0)
    square = 0.03**2
    for _ in range(6):
        _, square = gait_variances(J, h, mean, covariance, square, 1.0)
    assert np.sqrt(square) == pytest.approx(0.08, rel=0.1)


def test_a_place_far_off_the_walk_has_a_variance_of_its_own():
    off, J, h, mean, covariance = drawn(200, 0.02, 1)
    off[7] = [1.0, 0.0]
    h[:, :2] = 1e4 * off
    own, square = gait_variances(J, h, mean, covariance, 0.02**2, 1.0)
    assert own[7] > 0.1
    assert np.median(own) < 2.0 * square


@pytest.mark.parametrize(("places", "kept"), [(49, True), (50, False)])
def test_few_places_leave_the_scale_as_it_is(places, kept):
    _, J, h, mean, covariance = drawn(places, 0.1, 2)
    _, square = gait_variances(J, h, mean, covariance, 0.03**2, 1.0)
    assert (square == 0.03**2) == kept
