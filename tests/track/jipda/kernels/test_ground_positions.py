"""Positions on the ground as detections: expected, in view, likelihoods, update and track initiation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from crowds import cameras_around
from random_frames import plain
from scipy.stats import multivariate_normal

from occlog.array_types import Floats
from occlog.track.methods.jipda.interface import PositionSource
from occlog.track.methods.jipda.kernels.body_box import (
    COVERAGE_MARGIN_M,
    box_and_slope,
    cover_positions,
    expected_box,
    pack_views,
)
from occlog.track.methods.jipda.kernels.detections import (
    UNOBSERVED_VARIANCE,
    DetectorModel,
    PackedDetections,
    add_precision,
    position_noise,
)
from occlog.track.methods.jipda.kernels.joint_association import update_targets
from occlog.track.methods.jipda.kernels.lasting_errors.clock_residuals import clock_residuals
from occlog.track.methods.jipda.kernels.likelihood import position_likelihood_ratios
from occlog.track.methods.jipda.kernels.track_initiation import BirthIntensity, state_from_box
from occlog.track.methods.jipda.kernels.visibility import COLUMNS, ROWS, in_view, visibility

VIEWS = cover_positions(
    pack_views([*cameras_around(1, 10.0, 8.0), PositionSource("lidar")]), 1, np.array([[0.0, 1.0], [10.0, 7.0]]), 1.0
)
STATE = np.array([4.0, 3.0, 0.6, -0.4, 1.7, 0.5])
P = np.diag([0.05, 0.08, 0.1, 0.1, 0.01, 0.01])
P[0, 1] = P[1, 0] = 0.02
P[0, 2] = P[2, 0] = 0.03
FEATURES, CLUTTER = np.array([[0.3, -0.2, 0.1]]), np.log([0.5, 0.8, 0.2])


def positions(at: Floats, tail: float = 0.0) -> PackedDetections:
    """Positions of one frame of the source, each with another covariance."""
    n, x, y = len(at), at[:, 0], at[:, 1]
    stated = np.array([0.04, 0.01, 0.02]) * (1.0 + np.arange(n))[:, None]
    return PackedDetections(
        np.ones(1, dtype=np.int64), np.zeros(1), np.array([0, n]), np.column_stack([x, y, x, y]),
        np.tile([True, True, False, False], (n, 1)), CLUTTER[:n], stated, np.full(n, tail),
    )  # fmt: skip


def covariance_of(made: PackedDetections, j: int) -> Floats:
    """(2, 2) stated covariance of a position."""
    xx, xy, yy = made.covariance[j]
    return np.array([[xx, xy], [xy, yy]])


RATES = DetectorModel(
    np.full(2, 0.8), np.ones(6), 0.0, 0.0, np.zeros((2, 4)), np.ones((4, 2)), 0.0, np.ones(2), np.zeros(2), 0.0, 1.0
)


def test_a_position_is_expected_where_the_target_is_after_the_delay() -> None:
    box, slope = np.empty(4), np.full((4, 6), np.nan)
    assert expected_box(VIEWS.lens[1], 4.0, 3.0, 1.7, 0.5, box) == 1.0
    np.testing.assert_array_equal(box, [4.0, 3.0, 4.0, 3.0])
    assert box_and_slope(VIEWS.lens[1], STATE, 0.5, box, slope) == 1.0
    np.testing.assert_allclose(box, [4.3, 2.8, 4.3, 2.8])
    np.testing.assert_array_equal(
        slope, np.tile(np.column_stack([np.eye(2), 0.5 * np.eye(2), np.zeros((2, 2))]), (2, 1))
    )


def test_a_source_covers_the_rectangle_of_its_positions_with_a_margin() -> None:
    cells, e = np.empty((ROWS, COLUMNS)), 1e-9
    low, high = np.array([0.0, 1.0]) - COVERAGE_MARGIN_M, np.array([10.0, 7.0]) + COVERAGE_MARGIN_M
    np.testing.assert_array_equal(VIEWS.size[1], high - low)
    for x, y in ((low[0], 3.0), (high[0], 3.0), (4.0, low[1]), (4.0, high[1])):
        assert in_view(VIEWS, 1, x, y, np.zeros(4), cells)
        assert (cells == 1.0).all()
    for x, y in ((low[0] - e, 3.0), (high[0] + e, 3.0), (4.0, low[1] - e), (4.0, high[1] + e)):
        assert not in_view(VIEWS, 1, x, y, np.zeros(4), cells)
    none = cover_positions(VIEWS, 1, np.zeros((0, 2)), 1.0)
    assert none is VIEWS
    # A further position extends the rectangle on its side alone; in centimetres the margin is 100
    more = cover_positions(VIEWS, 1, np.array([[-500.0, 3.0]]), 100.0)
    np.testing.assert_array_equal(more.lens[1, :4], [-600.0, -97.0, 11.0, 103.0])


def test_no_one_hides_a_position() -> None:
    cells, two = np.zeros((ROWS, COLUMNS)), np.zeros((2, 4))
    args = two, np.ones(2), np.ones(2), np.ones(2), np.ones(2)
    assert visibility(VIEWS, 1, STATE, 0, *args, cells) == 1.0
    assert (cells == 1.0).all()


def test_the_noise_of_a_position_is_its_covariance_and_the_other_edges_are_not_observed() -> None:
    made, noise = positions(np.array([[4.0, 3.0], [5.0, 3.0]])), np.full((4, 4), 7.0)
    assert position_noise(made, 1, 3.0, noise)
    np.testing.assert_allclose(noise[:2, :2], 3.0 * covariance_of(made, 1))
    np.testing.assert_array_equal(noise[2:, 2:], UNOBSERVED_VARIANCE * np.eye(2))
    assert not noise[:2, 2:].any()
    assert not noise[2:, :2].any()
    W = np.ones((4, 4))
    add_precision(noise, made.usable[1], 0.5, W)
    np.testing.assert_allclose(W[:2, :2] - 1.0, 0.5 * np.linalg.inv(3.0 * covariance_of(made, 1)))
    assert (W[2:] == 1.0).all()
    for boxes in (made._replace(covariance=np.full((2, 3), np.nan)), made._replace(covariance=np.zeros((0, 3)))):
        noise[:] = 7.0
        assert not position_noise(boxes, 1, 3.0, noise)
        assert (noise == 7.0).all()


@pytest.mark.parametrize("tail", [0.0, 0.7])
def test_a_likelihood_is_a_mixture_with_a_wide_part_for_manoeuvres(tail: float) -> None:
    at = np.array([[4.1, 3.2], [5.5, 2.0], [4.0, 7.5]])
    made, box, spread = positions(at, tail), np.array([[4.0, 3.0, 4.0, 3.0]]), np.zeros((1, 4, 4))
    spread[0, :2, :2] = P[:2, :2]
    args = box, spread, np.array([0.8]), made, 0, 3, 80.0, FEATURES
    got = plain(position_likelihood_ratios)(*args, 30.0, 2.0)
    for j in range(3):
        S, off = P[:2, :2] + 2.0 * covariance_of(made, j), at[j] - box[0, :2]
        wide = S + tail * np.eye(2)
        density = 0.9 * multivariate_normal.pdf(off, cov=S) + 0.1 * multivariate_normal.pdf(off, cov=wide)
        near = off @ np.linalg.solve(wide, off) < 30.0
        wanted = near * density * 80.0 * math.exp(FEATURES[0, j] - CLUTTER[j])
        assert got.ratio[0, j] == pytest.approx(wanted, rel=1e-9)
    assert (got.ratio[0] > 0.0).tolist() == [True, True, tail > 0.0]
    assert (got.whole == 1.0).all()
    assert (got.outlier == -1).all()
    # Part of the positions, and a target that is hardly detected
    np.testing.assert_array_equal(plain(position_likelihood_ratios)(*args[:4], 1, 2, *args[6:], 30.0, 2.0).ratio,
                                  got.ratio[:, 1:2])  # fmt: skip
    for detection, some in ((0.9e-4, False), (1e-4, True)):
        rare = plain(position_likelihood_ratios)(*args[:2], np.array([detection]), *args[3:], 30.0, 2.0)
        assert rare.ratio.any() == some


def test_a_position_is_associated_below_the_gate() -> None:
    """Both variances are 1 + 2 * 0.5, so that a distance of 2 has the square 2."""
    made = positions(np.array([[6.0, 3.0]]))._replace(covariance=np.array([[0.5, 0.0, 0.5]]))
    args = np.array([[4.0, 3.0, 4.0, 3.0]]), np.eye(4)[None], np.ones(1), made, 0, 1, 80.0, FEATURES
    for gate, some in ((2.0, False), (np.nextafter(2.0, 3.0), True)):
        assert plain(position_likelihood_ratios)(*args, gate, 2.0).ratio.any() == some


def after_a_box(made: PackedDetections) -> PackedDetections:
    """The positions after a frame of the camera with one box."""
    return PackedDetections(
        np.array([0, 1]), np.zeros(2), np.append(0, made.first + 1),
        np.concatenate([[[100.0, 100.0, 150.0, 250.0]], made.box]), np.concatenate([[4 * [True]], made.usable]),
        np.append(0.0, made.clutter), np.concatenate([[3 * [np.nan]], made.covariance]), np.append(0.0, made.tail),
    )  # fmt: skip


def test_the_update_is_probabilistic_data_association() -> None:
    """One target: beta_j = P_D l_j / (1 + b) / (1 - P_D + sum); moments of the mixture of Kalman updates.

    A frame of a camera that the target is hidden from comes first, and changes nothing.
    """
    at, new, existence = np.array([[4.1, 3.2], [4.4, 2.7]]), 0.25, np.array([0.7])
    made, features, hidden = positions(at, 0.3), FEATURES[:, :2].copy(), np.array([[1.0, 0.1]])
    got = update_targets(
        STATE[None], P[None], existence, VIEWS, after_a_box(made), RATES, np.append(0.0, features)[None], new, 30.0,
        hidden,
    )  # fmt: skip
    box, spread, H = np.tile(STATE[:2], 2)[None], np.zeros((1, 4, 4)), np.eye(2, 6)
    spread[0, :2, :2] = P[:2, :2]
    area, detection = float(VIEWS.size[1].prod()), 0.8 * 0.9
    ratio = plain(position_likelihood_ratios)(
        box, spread, np.ones(1), made, 0, 2, area, features, 30.0, 2.0
    ).ratio[0]  # fmt: skip
    evidence = 1.0 - detection + detection * ratio.sum() / (1.0 + new)
    beta = detection * ratio / (1.0 + new) / evidence
    np.testing.assert_allclose(got.beta[0], np.append(0.0, beta), rtol=1e-9)
    np.testing.assert_allclose(got.existence, existence * evidence / (1.0 - existence + existence * evidence))
    assert got.visible[1, 0] == 1.0
    np.testing.assert_allclose(got.detection[:, 0], [0.0, detection])
    mean, second = (1.0 - beta.sum()) * STATE, (1.0 - beta.sum()) * (P + np.outer(STATE, STATE))
    for j in range(2):
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + covariance_of(made, j))
        m, C = STATE + K @ (at[j] - STATE[:2]), P - K @ H @ P
        mean, second = mean + beta[j] * m, second + beta[j] * (C + np.outer(m, m))
    np.testing.assert_allclose(got.mean[0], mean, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(got.covariance[0], second - np.outer(mean, mean), rtol=1e-5, atol=1e-8)
    # Edges are counted of boxes alone
    assert not np.concatenate([got.cuts, got.wrong, got.odd, got.merges.ravel()]).any()


@pytest.mark.parametrize("in_image", [0.5, 50.0])
def test_a_position_proposes_a_target_there(in_image: float) -> None:
    made, body = positions(np.array([[4.0, 3.0], [5.0, 2.0]])), np.array([1.7, 0.12, 0.55, 0.11, 0.9])
    arrival, mean, C = BirthIntensity(0.02, in_image, np.zeros((0, 2)), np.zeros(0), 1.0), np.empty(6), np.empty((6, 6))
    log = state_from_box(VIEWS, made, RATES, body, arrival, 1, 1, mean, C)
    assert log == pytest.approx(math.log(min(0.02, in_image / (12.0 * 8.0))))
    none = state_from_box(VIEWS, made, RATES, body, arrival._replace(everywhere=0.0), 1, 1, mean, C)
    assert none == pytest.approx(math.log(1e-300))
    np.testing.assert_array_equal(mean, [5.0, 2.0, 0.0, 0.0, 1.7, 0.55])
    wanted = np.diag([0.0, 0.0, 0.9**2, 0.9**2, 0.12**2, 0.11**2])
    wanted[:2, :2] = covariance_of(made, 1)
    np.testing.assert_allclose(C, wanted)


def test_clocks_of_positions_count_in_heights_of_the_target() -> None:
    made = positions(np.array([[4.0, 3.0], [4.1, 3.1]]))
    owner, centre = np.zeros(2, dtype=np.int64), np.zeros((2, 4))
    _, sums = clock_residuals(STATE[None], VIEWS, made, owner, owner == 0, np.zeros(2), centre)
    np.testing.assert_allclose(sums[1], [2.0, 0.1 / 1.7, 0.1 / 1.7, 2 * 0.6 / 1.7, 2 * -0.4 / 1.7])
