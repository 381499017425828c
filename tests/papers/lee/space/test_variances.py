"""Where the printed projection of directions on planes is wrong."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.array_types import Floats
from occlog.core.geometry.camera import wrap_angle
from occlog.core.geometry.projected_planes import XY, YZ, ZX, direction_angles, projected_angles
from occlog.papers.lee.space.variances import printed_projection


def sphere(seed: int, n: int) -> tuple[Floats, Floats, Floats]:
    """Evenly spread unit vectors (n, 3), their theta and phi."""
    u = np.random.default_rng(seed).standard_normal((n, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    return u, *direction_angles(u)


def test_printed_projection_is_right_on_a_half_for_yz_and_on_a_quarter_for_zx() -> None:
    u, theta, phi = sphere(2, 4000)
    wrong = ~(np.abs(wrap_angle(printed_projection(theta, phi) - projected_angles(u))) < 1e-9)
    x, _, z = u.T
    assert not wrong[:, XY].any()
    np.testing.assert_array_equal(wrong[:, YZ], x < 0)
    np.testing.assert_array_equal(wrong[:, ZX], ~((x >= 0) & (z >= 0)))
    # four standard deviations of a share of 4000 directions
    assert wrong[:, YZ].mean() == pytest.approx(0.5, abs=4 * 0.5 / 4000**0.5)
    assert wrong[:, ZX].mean() == pytest.approx(0.75, abs=4 * 0.75**0.5 * 0.5 / 4000**0.5)


def test_printed_projection_has_no_value_where_no_case_is_printed() -> None:
    u, theta, phi = sphere(3, 1000)
    np.testing.assert_array_equal(np.isnan(printed_projection(theta, phi)[:, ZX]), (u[:, 2] < 0) & (u[:, 0] >= 0))
