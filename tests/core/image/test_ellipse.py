"""Ellipses against sampled outlines."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occlog.core.image import nearness, support_radius, touching


def outline(e, n=4000):
    t = np.linspace(0, 2 * np.pi, n, endpoint=False)
    c, s = math.cos(e[4]), math.sin(e[4])
    u, v = e[2] * np.cos(t), e[3] * np.sin(t)
    return np.column_stack([e[0] + c * u - s * v, e[1] + s * u + c * v])


def random_ellipses(rng, n):
    return np.column_stack(
        [rng.uniform(-8, 48, n), rng.uniform(-8, 38, n), rng.uniform(0.3, 12, (n, 2)), rng.uniform(-7, 7, n)]
    )


angles = st.floats(-20, 20)
axes = st.floats(0.1, 300)


@given(axes, axes, angles, angles)
def test_support_radius_is_the_farthest_point_in_a_direction(a, b, rho, theta):
    e = np.array([5.0, -3.0, a, b, rho])
    along = (outline(e) - e[:2]) @ [math.cos(theta), math.sin(theta)]
    assert support_radius(e, theta) == pytest.approx(along.max(), rel=1e-5)


def test_circles_touch_up_to_the_sum_of_their_radii():
    for ratio, is_touching in ((0.999, True), (1.001, False)):
        e = np.array([[10.0, 20, 22, 22, 0], [10 + 0.6 * 44 * ratio, 20 + 0.8 * 44 * ratio, 22, 22, 1]])
        assert touching(e).tolist() == [[False, is_touching], [is_touching, False]]
        assert nearness(e)[0, 1] == pytest.approx(ratio)
    in_contact = np.array([[0.0, 0, 16, 16, 0], [32.0, 0, 16, 16, 0]])
    assert touching(in_contact)[0, 1]


def test_nearness_is_symmetric_and_of_the_direction_between_centres():
    rng = np.random.default_rng(3)
    e = random_ellipses(rng, 9)
    near = nearness(e)
    assert np.array_equal(near, near.T)
    for i in range(9):
        for j in range(i):
            d = e[j, :2] - e[i, :2]
            u = d / np.hypot(*d)
            reach = ((outline(e[i]) - e[i, :2]) @ u).max() + ((outline(e[j]) - e[j, :2]) @ u).max()
            assert near[i, j] == pytest.approx(np.hypot(*d) / reach, rel=1e-5)
    e[4] = np.nan
    assert np.isinf(nearness(e)[4]).all()
    assert touching(np.zeros((0, 5))).shape == (0, 0)
