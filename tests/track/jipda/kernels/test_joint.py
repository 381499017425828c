"""The update of everybody: one person and one box against a Kalman filter, densities against their definition."""

from __future__ import annotations

import numpy as np
import pytest
from random_frames import plain
from scipy.stats import multivariate_normal

from occlog.array_types import Bools, Floats
from occlog.records.scene import Camera, camera_rotation
from occlog.track.methods.jipda.kernels.body_box import box_and_slope, pack_views
from occlog.track.methods.jipda.kernels.detections import (
    DetectorModel,
    PackedDetections,
    add_axis_precision,
    add_precision,
    biased,
    edge_noise,
    interpolate,
    log_clutter,
    log_density,
)
from occlog.track.methods.jipda.kernels.joint_association import JipdaResult, update_targets
from occlog.track.methods.jipda.kernels.likelihood import association_likelihood_ratios, outlier_density

TURNED = camera_rotation(np.pi / 2, -0.35, 0.0)
VIEW = Camera("a", np.array([0.0, -6.0, 3.0]), TURNED, np.full(2, 900.0), np.array([640.0, 360.0]), (1280, 720))
MEAN = np.array([[0.4, 1.0, 0.5, 0.2, 1.7, 0.5]])
P = np.diag([0.05, 0.08, 0.1, 0.1, 0.01, 0.01])[None]
NOISE = np.array([[8.0, 1e-4], [20.0, 4e-4], [6.0, 1e-4], [15.0, 2e-4]])


def rates(detection: float = 0.9, merge: float = 0.0, wrong: float = 0.0, slow: float = 1.0) -> DetectorModel:
    """One camera without bias."""
    return DetectorModel(
        detection=np.array([detection]),
        curve=np.ones(6),
        cut=0.0,
        wrong=wrong,
        bias=np.zeros((1, 4)),
        noise=NOISE,
        gait_variance=0.0,
        lasting=np.ones(1),
        merge=np.array([merge]),
        common_miss=0.0,
        slow=slow,
    )


def boxes(*box: Floats) -> PackedDetections:
    """One look."""
    n = len(box)
    return PackedDetections(np.zeros(1, dtype=np.int64), np.zeros(1), np.array([0, n]), np.array(box).reshape(-1, 4),
                 np.ones((n, 4), dtype=bool), np.full(n, np.log(1e-9)))  # fmt: skip


def after(
    made: PackedDetections, existence: float = 0.95, known: DetectorModel | None = None, mean: Floats = MEAN
) -> JipdaResult:
    """The update of the people."""
    N, bonus = len(mean), np.zeros((len(mean), len(made.box)))
    there, known = np.full(N, existence), rates() if known is None else known
    shown = np.zeros((N, 1))
    return update_targets(
        mean, np.repeat(P, N, axis=0), there, pack_views([VIEW]), made, known, bonus, 0.0, 30.0, shown
    )


def expected() -> tuple[Floats, Floats]:
    """Box and slope."""
    box, slope = np.empty(4), np.zeros((4, 6))
    box_and_slope(pack_views([VIEW]).lens[0], MEAN[0], 0.0, box, slope)
    return box, slope


def test_one_person_and_one_box_are_a_kalman_filter() -> None:
    box, H = expected()
    z, R = box + np.array([6.0, -4.0, 9.0, 5.0]), np.empty((4, 4))
    edge_noise(box, rates(), 1.0, R)
    result = after(boxes(z))
    K = P[0] @ H.T @ np.linalg.inv(H @ P[0] @ H.T + R)
    assert result.beta[0, 0] > 0.999
    np.testing.assert_allclose(result.mean[0], MEAN[0] + K @ (z - box), atol=2e-3)
    np.testing.assert_allclose(result.covariance[0], P[0] - K @ H @ P[0], atol=2e-4)


def test_a_miss_lowers_existence_by_bayes_rule_and_moves_no_one() -> None:
    result = after(boxes(), existence=0.8)
    assert result.existence[0] == pytest.approx(0.8 * 0.1 / (0.8 * 0.1 + 0.2), rel=1e-6)
    np.testing.assert_allclose(result.mean, MEAN)


def test_a_box_that_is_far_away_is_nobodys() -> None:
    result = after(boxes(np.array([1100.0, 100.0, 1150.0, 250.0])))
    assert result.beta[0, 0] == 0.0
    assert result.free[0] == 1.0


def test_a_box_with_one_edge_that_is_something_elses_is_of_the_person_and_its_other_edges_count() -> None:
    box, H = expected()
    z, R = box + np.array([6.0, -4.0, 9.0, 5.0]), np.empty((4, 4))
    edge_noise(box, rates(), 1.0, R)
    z[1] -= 150.0
    assert after(boxes(z)).beta[0, 0] == 0.0
    result = after(boxes(z), known=rates(wrong=0.02))
    assert result.beta[0, 0] > 0.99
    assert result.odd[0] > 0.9
    R[1, :] = R[:, 1] = 0.0
    R[1, 1] = 1e10
    K = P[0] @ H.T @ np.linalg.inv(H @ P[0] @ H.T + R)
    np.testing.assert_allclose(result.mean[0], MEAN[0] + K @ (z - box), atol=5e-3)


def test_noise_that_goes_on_from_look_to_look_counts_less() -> None:
    z = expected()[0] + np.array([6.0, -4.0, 9.0, 5.0])
    sure, unsure = after(boxes(z)), after(boxes(z), known=rates(slow=4.0))
    assert (np.diag(unsure.covariance[0])[:2] > 1.5 * np.diag(sure.covariance[0])[:2]).all()


def test_a_box_is_associated_below_the_gate_of_all_edges_and_of_each() -> None:
    box, R, off = expected()[0], np.diag([4.0, 9.0, 4.0, 9.0]), np.array([6.0, -4.0, 5.0, 3.0])
    every, zero, one = np.ones(4, dtype=bool), np.zeros((4, 4)), np.ones(1)

    def ratio(z: Floats, use: Bools, gate: float) -> float:
        made = boxes(z)._replace(usable=use[None])
        found = plain(association_likelihood_ratios)(
            box[None], R[None], zero[None], 0.0 * one, one, made, 0, 1, rates(), 1280.0, 720.0, np.zeros((1, 1)), gate
        )
        return float(found.ratio[0, 0])

    distance = log_density(box + off - box, np.empty((4, 4)), every, R, zero)[1]
    assert ratio(box + off, every, distance) == 0.0
    assert ratio(box + off, every, np.nextafter(distance, np.inf)) > 0.0
    # Two edges beyond twice the gate, of which an unused one does not count
    wide = np.array([0.0, 3.0 * 6.4, 2.0 * 6.4, 0.0])
    assert ratio(box + wide, every, 1000.0) > 0.0
    for use in (every, every & (np.arange(4) != 1)):
        assert ratio(box + wide, use, 20.0) == 0.0
    alone = np.array([0.0, 0.0, 2.0 * 6.0, 0.0])
    assert ratio(box + alone, every, 36.1) > 0.0


@pytest.mark.parametrize(("detection", "some"), [(0.9e-4, False), (1e-4, True)])
def test_people_who_are_hardly_detected_are_not_associated(detection: float, some: bool) -> None:
    z = expected()[0]
    found = plain(association_likelihood_ratios)(
        z[None], 9.0 * np.eye(4)[None], np.zeros((1, 4, 4)), np.zeros(1), np.full(1, detection), boxes(z), 0, 1,
        rates(), 1280.0, 720.0, np.zeros((1, 1)), 30.0,
    )  # fmt: skip
    assert found.ratio.any() == some


@pytest.mark.parametrize(
    ("edge", "below", "cut", "wanted"),
    [
        (3, -1e-9, 0.0101, 0.0101 / (0.8 * 200.0)),
        (3, -1e-9, 0.01, 0.25 * 0.06 / (2.0 * 200.0)),
        (3, 0.0, 0.5, 0.25 * 0.06 / (2.0 * 200.0)),
        (1, -9.0, 0.5, 0.25 * 0.06 / (2.0 * 200.0)),
        (0, -9.0, 0.5, 0.25 * 0.06 / (2.0 * 50.0)),
        (2, -9.0, 0.5, 0.25 * 0.06 / (2.0 * 50.0)),
    ],
)
def test_an_outlier_is_uniform_over_the_upper_part_of_the_box_or_twice_its_size(
    edge: int, below: float, cut: float, wanted: float
) -> None:
    box = np.array([10.0, 20.0, 60.0, 220.0])
    assert outlier_density(edge, box, below, cut, 0.06) == pytest.approx(wanted, rel=1e-12)
    assert outlier_density(edge, np.array([4.0, 3.0, 4.0, 3.0]), below, cut, 0.06) == 0.0


PAIR = MEAN + np.array([[0.0], [1.0]]) * [[0.6, 0.2, 0.0, 0.0, 0.0, 0.0]]
"""Two people who touch in the image."""


def outline_of_both() -> Floats:
    """The box around both."""
    both = np.empty((2, 4))
    for k in range(2):
        box_and_slope(pack_views([VIEW]).lens[0], PAIR[k], 0.0, both[k], np.zeros((4, 6)))
    return np.concatenate([both[:, :2].min(axis=0), both[:, 2:].max(axis=0)])


def test_the_outline_of_two_people_is_one_detection_of_both() -> None:
    result = after(boxes(outline_of_both()), known=rates(merge=0.3), mean=PAIR)
    assert (result.joint[:, 0] > 0.95).all()
    assert (result.existence > 0.95).all()
    assert result.free[0] < 0.1
    np.testing.assert_allclose(result.mean[:, :2], PAIR[:, :2], atol=0.03)
    assert result.merges[0, 0] > 0.8


def test_two_boxes_of_two_people_who_touch_are_of_one_each() -> None:
    both = np.empty((2, 4))
    for k in range(2):
        box_and_slope(pack_views([VIEW]).lens[0], PAIR[k], 0.0, both[k], np.zeros((4, 6)))
    result = after(boxes(*both), known=rates(merge=0.3), mean=PAIR)
    assert (np.diag(result.beta) > 0.9).all()
    assert result.joint.max() < 0.1
    assert result.merges[0, 0] < 0.1 * result.merges[0, 1]


def test_where_boxes_never_merge_no_one_shares_one() -> None:
    result = after(boxes(outline_of_both()), mean=PAIR)
    assert result.joint.max() == 0.0


def test_edges_are_the_middle_and_half_the_size() -> None:
    box, R = np.array([100.0, 50.0, 160.0, 250.0]), np.empty((4, 4))
    edge_noise(box, rates(), 1.0, R)
    T = np.array([[0.5, 0.0, 0.5, 0.0], [-1.0, 0.0, 1.0, 0.0], [0.0, 0.5, 0.0, 0.5], [0.0, -1.0, 0.0, 1.0]])
    size = np.array([200.0, 60.0, 200.0, 200.0])
    np.testing.assert_allclose(T @ R @ T.T, np.diag(NOISE[:, 0] + NOISE[:, 1] * size**2), atol=1e-9)


@pytest.mark.parametrize("use", [(1, 1, 1, 1), (1, 1, 1, 0), (0, 1, 1, 0)])
def test_densities_are_those_of_the_edges_in_use(use: tuple[int, ...]) -> None:
    rng, keep = np.random.default_rng(0), np.array(use, dtype=bool)
    R = np.empty((4, 4))
    edge_noise(np.array([100.0, 50.0, 160.0, 250.0]), rates(), 1.0, R)
    half, off = rng.normal(size=(4, 6)), rng.normal(0.0, 5.0, 4)
    S = (R + half @ half.T)[np.ix_(keep, keep)]
    log, distance = log_density(off, np.empty((4, 4)), keep, R, half @ half.T)
    assert log == pytest.approx(multivariate_normal(np.zeros(keep.sum()), S).logpdf(off[keep]), abs=1e-4)
    assert distance == pytest.approx(off[keep] @ np.linalg.solve(S, off[keep]), abs=1e-4)
    W = np.zeros((4, 4))
    add_precision(R, keep, 1.0, W)
    np.testing.assert_allclose(W[np.ix_(keep, keep)], np.linalg.inv(R[np.ix_(keep, keep)]), rtol=1e-9)
    assert not W[~keep].any()


def test_a_detectors_bias_is_in_heights_and_in_shares_of_the_size() -> None:
    box = np.empty(4)
    biased(np.array([100.0, 50.0, 160.0, 250.0]), np.array([0.01, 0.1, -0.02, 0.05]), box)
    np.testing.assert_allclose(box, [132.0 - 33.0, 146.0 - 105.0, 132.0 + 33.0, 146.0 + 105.0])


@pytest.mark.parametrize("axis", [0, 1])
def test_the_precision_of_an_axis_is_weighted_by_what_is_observed_of_it(axis: int) -> None:
    R, at = np.empty((4, 4)), [axis, axis + 2]
    edge_noise(np.array([100.0, 50.0, 160.0, 250.0]), rates(), 1.0, R)
    for low, high, wanted in (
        (True, True, 0.7 * np.linalg.inv(R[np.ix_(at, at)])),
        (True, False, np.diag([0.3 / R[axis, axis], 0.0])),
        (False, True, np.diag([0.0, 0.5 / R[axis, axis]])),
        (False, False, np.zeros((2, 2))),
    ):
        W = np.ones((4, 4))
        add_axis_precision(R, axis, low, high, 0.3, 0.5, 0.7, W)
        np.testing.assert_allclose(W[np.ix_(at, at)], 1.0 + wanted, rtol=1e-12)
        assert W.sum() == pytest.approx(16.0 + wanted.sum())


@pytest.mark.parametrize("common", [0.0, 0.05])
def test_all_frames_may_miss_a_person_at_once(common: float) -> None:
    """A miss by all is a likelihood ratio of `common`; else that of the frame, here 1 - 0.9 of a missed detection."""
    known = rates()._replace(common_miss=common)
    result = after(boxes(), existence=0.8, known=known)
    frame, every = (1.0 - common) * 0.1, common
    assert result.missed[0] == pytest.approx(every / (frame + every), rel=1e-12)
    assert result.existence[0] == pytest.approx(0.8 * (frame + every) / (0.8 * (frame + every) + 0.2))


def test_the_density_of_no_person_counts_the_edges_in_use() -> None:
    box, every = np.array([10.0, 20.0, 60.0, 120.0]), np.ones(4, dtype=bool)
    size = np.log(20.0)
    assert log_clutter(box, every, 640.0, 480.0) == pytest.approx(-np.log(640.0 * 480.0 * 50.0 * 100.0 * size**2))
    assert log_clutter(box, ~every, 640.0, 480.0) == 0.0
    across = np.array([True, False, True, False])
    assert log_clutter(box, across, 640.0, 480.0) == pytest.approx(-np.log(640.0 * 50.0 * size))
    assert log_clutter(box, ~across, 640.0, 480.0) == pytest.approx(-np.log(480.0 * 100.0 * size))
    narrow = np.array([10.0, 20.0, 10.5, 21.5])
    assert log_clutter(narrow, every, 640.0, 480.0) == pytest.approx(-np.log(640.0 * 480.0 * 1.0 * 1.5 * size**2))
    assert log_clutter(box, np.array([True, True, True, False]), 640.0, 480.0) == pytest.approx(
        -np.log(640.0 * 480.0 * 50.0 * size)
    )


def test_curves_are_linear_between_their_values() -> None:
    curve = np.array([0.1, 0.5, 0.9, 1.0])
    for share, value in ((-0.1, 0.1), (0.5, 0.7), (0.9, 0.97), (1.0, 1.0), (1.2, 1.0)):
        assert interpolate(curve, share) == pytest.approx(value)
