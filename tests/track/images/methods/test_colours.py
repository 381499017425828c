"""Which targets have colours for each half, and in which order the axes of an ellipse are."""

import numpy as np
import pytest

from occlog.track.images.methods.colours import level, upright


@pytest.mark.parametrize(("height", "split"), [(12.0, True), (12.0 - 1e-9, False), (8.0, False)])
def test_targets_as_many_times_higher_than_wide_have_halves(height, split):
    ellipse = np.array([[40.0, 40.0, 8.0, height, 0.0]])
    assert upright(ellipse, 1.5).tolist() == [split]
    # The other order of the axes is the same ellipse
    turned = np.array([[40.0, 40.0, height + 1e-6 * split, 8.0, 0.5 * np.pi]])
    assert upright(turned, 1.5).tolist() == [split]


def test_no_target_has_halves_for_a_share_of_none():
    assert not upright(np.array([[40.0, 40.0, 8.0, 80.0, 0.0]]), 0.0).any()


@pytest.mark.parametrize("rho", [-1.5, -0.8, -0.7, 0.0, 0.7, 0.8, 1.5, 3.0])
def test_the_first_axis_is_the_more_horizontal_one_of_the_same_ellipse(rho):
    given = np.array([[40.0, 40.0, 8.0, 12.0, rho]])
    out = level(given)[0]
    assert -0.25 * np.pi <= out[4] <= 0.25 * np.pi
    for angle in np.linspace(0.0, np.pi, 7):
        reach = [np.hypot(e[2] * np.cos(angle - e[4]), e[3] * np.sin(angle - e[4])) for e in (given[0], out)]
        assert reach[0] == pytest.approx(reach[1])
