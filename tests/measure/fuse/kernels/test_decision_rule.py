"""Detection fusion of [Lee] Ch. 4: by hand, the three case studies, limits, and Fig. 4-3 against a plain simulation."""

from __future__ import annotations

import math
import random
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occlog.array_types import Bools, Floats
from occlog.measure.fuse.kernels import (
    CAUSES,
    KEPT,
    NOT_LOOKING,
    NOTHING,
    RECOVERED,
    REMOVED_FALSE,
    REMOVED_FAR,
    FusionDecisions,
    decision_value,
    fuse,
    fused_position,
    prior_present,
    quality,
)

GONE = (math.nan, math.nan)
CASES = {  # local detections, prediction, and the thesis' printed W and P_1
    1: ([GONE, (5.2, 5.2), (4.9, 5.0)], (5.0, 5.0), [math.nan, 0.9608, 0.9950], 0.9938),
    2: ([(13.0, 7.0), (15.2, 7.4), (15.8, 6.9)], (13.1, 7.0), [0.9950, 0.1018, 0.026], 0.8892),
    3: ([(7.3, 5.1), (7.1, 6.3), GONE], (4.9, 3.4), [0.0132, 0.0013, math.nan], 0.0114),
}


def case(number: int) -> tuple[Floats, Floats]:
    positions, predicted, _, _ = CASES[number]
    return np.array([positions]), np.array([predicted])


def found(positions: Floats, *, at: tuple[float, float] = (0.0, 0.0), **options: object) -> FusionDecisions:
    """One time, P_M = P_F = 0.2, sigma 1, gate 2."""
    return fuse(np.array([positions], dtype=float), np.array([at]), 1.0, 0.2, 0.2, 2.0, **options)  # type: ignore[arg-type]


# (4.13) by hand


def test_decision_by_hand_with_own_rates_of_each_camera() -> None:
    value = decision_value(
        np.array([[True, False, True]]), np.array([[0.9, math.nan, 0.3]]), 0.6, [0.1, 0.3, 0.25], [0.05, 0.2, 0.4]
    )
    # Cameras 1 and 3 detect: (1 - P_M)/P_F, not the printed (1 - P_F)/P_F; camera 2 misses: P_M/(1 - P_F)
    by_hand = math.log(0.6 / 0.4) + math.log(0.9 / 0.05) + math.log(0.9 / 0.1) + math.log(0.3 / 0.8)
    by_hand += math.log(0.75 / 0.4) + math.log(0.3 / 0.7)
    assert value == pytest.approx([by_hand], rel=1e-12)


def test_printed_4_11_would_give_another_value() -> None:
    """1 - P_M and 1 - P_F differ, so this fails with the thesis' slip."""
    value = decision_value(np.array([[True]]), np.array([[0.5]]), 0.5, 0.5, 0.1)
    assert value == pytest.approx([math.log(0.5 / 0.1)], rel=1e-12)
    assert abs(value[0] - math.log(0.9 / 0.1)) > 0.5


def test_decision_is_bayes_rule_with_weighted_evidence() -> None:
    """The value is the log of posterior odds worked out by multiplying probabilities."""
    rng = np.random.default_rng(4)
    n, j = 200, 5
    detected, w = rng.random((n, j)) < 0.6, rng.uniform(0.01, 0.99, (n, j))
    miss, false, prior = rng.uniform(0.05, 0.6, (n, j)), rng.uniform(0.05, 0.6, (n, j)), rng.uniform(0.05, 0.95, n)
    value = decision_value(detected, w, prior, miss, false)
    for k in range(n):
        present, absent = prior[k], 1.0 - prior[k]
        for c in range(j):
            present *= (1.0 - miss[k, c]) * w[k, c] if detected[k, c] else miss[k, c]
            absent *= false[k, c] * (1.0 - w[k, c]) if detected[k, c] else 1.0 - false[k, c]
        assert value[k] == pytest.approx(math.log(present / absent), abs=1e-9)


@given(
    detected=st.lists(st.booleans(), min_size=1, max_size=6),
    prior=st.floats(0.01, 0.99),
    miss=st.floats(0.01, 0.99),
    false=st.floats(0.01, 0.99),
)
def test_rule_with_every_quality_one_half_is_4_3_by_plain_arithmetic(
    detected: list[bool], prior: float, miss: float, false: float
) -> None:
    seen = np.array([detected])
    plain = decision_value(seen, np.full(seen.shape, 0.5), prior, miss, false)
    hits = sum(detected)
    by_hand = math.log(prior / (1 - prior)) + hits * math.log((1 - miss) / false)
    by_hand += (len(detected) - hits) * math.log(miss / (1 - false))
    assert plain == pytest.approx([by_hand], abs=1e-9)


def test_base_only_scales() -> None:
    args = (np.array([[True, False]]), np.array([[0.8, 0.5]]), 0.7, 0.2, 0.1)
    assert decision_value(*args, base=10.0) == pytest.approx(decision_value(*args) / math.log(10.0), rel=1e-12)


# The three case studies


@pytest.mark.parametrize(
    ("number", "weights", "fused", "prior"),
    [
        (1, [math.nan, 0.9608, 0.9950], (5.05, 5.10), 0.9941),
        (2, [0.9950, 0.1018, 0.0260], (13.264, 7.034), 0.9860),  # thesis: (13.55, 7.18) and 0.8892, not by (4.22)
        (3, [0.0132, 0.0013, math.nan], (7.28, 5.21), 0.0114),
    ],
)
def test_case_studies_weights_positions_and_priors(
    number: int, weights: list[float], fused: tuple[float, float], prior: float
) -> None:
    positions, predicted = case(number)
    np.testing.assert_allclose(quality(positions, predicted, 1.0)[0], weights, atol=5.1e-5)
    xy = fused_position(positions, predicted, 1.0)
    np.testing.assert_allclose(xy[0], fused, atol=0.5e-3 if number == 2 else 0.5e-2)
    assert prior_present(xy, predicted, 1.0) == pytest.approx([prior], abs=5.1e-5)


@pytest.mark.parametrize(("number", "value"), [(1, 6.495), (2, 2.490), (3, -6.095)])
def test_case_studies_by_4_13_from_the_printed_weights(number: int, value: float) -> None:
    """log10; cases 1 and 2 are the 6.49 and 2.49 of the printed formula."""
    _, _, weights, prior = CASES[number]
    w = np.array([weights])
    assert decision_value(~np.isnan(w), w, prior, 0.2, 0.2, base=10.0) == pytest.approx([value], abs=5e-4)


@pytest.mark.parametrize(("number", "value"), [(1, 6.516), (2, 3.436), (3, -6.085)])
def test_case_studies_by_4_13_from_the_positions(number: int, value: float) -> None:
    """log10; case 3 is the -6.085 of the printed formula, case 2 gains by its right fused position."""
    result = fuse(*case(number), 1.0, 0.2, 0.2, 1.5)
    assert result.value / math.log(10.0) == pytest.approx([value], abs=5e-4)


def test_case_studies_what_becomes_of_the_detections() -> None:
    one, two, three = (fuse(*case(k), 1.0, 0.2, 0.2, 1.5) for k in (1, 2, 3))
    assert one.declared[0]
    assert one.cause.tolist() == [[RECOVERED, KEPT, KEPT]]
    assert two.declared[0]
    assert two.cause.tolist() == [[KEPT, REMOVED_FAR, REMOVED_FAR]]
    assert not three.declared[0]
    assert three.cause.tolist() == [[REMOVED_FALSE, REMOVED_FALSE, NOTHING]]
    plain = decision_value(np.array([[True, True, False]]), np.full((1, 3), 0.5), 0.5, 0.2, 0.2)
    assert plain[0] > 0.0  # by (4.3) the false object would be declared


# Bookkeeping


@pytest.mark.parametrize("position", [(1.0, 0.0), (-0.6, 0.7), (9.0, 9.0), (0.0, 300.0)])
def test_false_detection_of_one_camera_is_not_propagated(position: tuple[float, float]) -> None:
    result = found([position, GONE, GONE, GONE])
    assert not result.declared[0]
    assert result.cause.tolist() == [[REMOVED_FALSE, NOTHING, NOTHING, NOTHING]]
    assert result.removed.tolist() == [[True, False, False, False]]
    assert not result.recovered.any()
    assert not result.kept.any()
    assert not found([position, GONE, GONE, GONE], at=GONE).declared[0]  # nor where no prediction is known


def test_how_near_the_prediction_one_detection_carries_three_misses() -> None:
    """By (4.13) with P_1 = W: 2 log W/(1 - W) > 2 log 4, W > 0.8; a false detection so near does propagate."""
    edge = math.sqrt(-2.0 * math.log(0.8))  # 0.668 sigma
    assert found([(edge - 1e-6, 0.0), GONE, GONE, GONE]).declared[0]
    assert not found([(edge + 1e-6, 0.0), GONE, GONE, GONE]).declared[0]


def test_missed_detection_is_recovered() -> None:
    result = found([(0.1, 0.0), GONE, (-0.1, 0.2), (0.0, 0.1)])
    assert result.declared[0]
    assert result.cause.tolist() == [[KEPT, RECOVERED, KEPT, KEPT]]
    assert result.recovered.tolist() == [[False, True, False, False]]
    assert np.hypot(*result.xy[0]) < 0.15


def test_camera_that_did_not_look_has_no_part() -> None:
    near = [(0.1, 0.0), (-0.1, 0.2), (0.0, 0.1)]
    with_blind = found([*near, (0.2, 0.2), GONE], observing=np.array([[True, True, True, False, False]]))
    assert with_blind.value == pytest.approx(found(near).value, rel=1e-12)
    np.testing.assert_allclose(with_blind.xy, found(near).xy, rtol=1e-12)
    assert with_blind.cause[0, 3:].tolist() == [NOT_LOOKING, NOT_LOOKING]


def test_far_detection_outvotes_all_unless_out_of_reach() -> None:
    local = [(0.3, 0.0), (-0.3, 0.2), (0.3, 0.1), (9.0, 0.0)]
    assert not found(local).declared[0]
    result = found(local, reach=4.0)
    assert result.declared[0]
    assert result.cause.tolist() == [[KEPT, KEPT, KEPT, REMOVED_FAR]]
    as_missed = found([*local[:3], GONE])
    assert result.value == pytest.approx(as_missed.value, rel=1e-12)
    np.testing.assert_allclose(result.xy, as_missed.xy, rtol=1e-12)
    assert result.quality[0, 3] == pytest.approx(math.exp(-40.5))


def test_without_prediction_the_majority_decides_on_the_plain_mean() -> None:
    result = found([(2.0, 0.0), (4.0, 2.0), GONE], at=GONE)
    assert result.value == pytest.approx([math.log(0.8 / 0.2)], rel=1e-12)
    assert result.prior[0] == 0.5
    np.testing.assert_allclose(result.xy, [[3.0, 1.0]])
    assert result.declared[0]
    assert result.cause.tolist() == [[KEPT, KEPT, RECOVERED]]


def test_many_times_are_as_one_at_a_time() -> None:
    rng = np.random.default_rng(11)
    positions = rng.normal(0.0, 1.0, (300, 5, 2))
    positions[rng.random((300, 5)) < 0.4] = np.nan
    predicted, looked = rng.normal(0.0, 0.3, (300, 2)), rng.random((300, 5)) < 0.8
    together = fuse(positions, predicted, 0.8, 0.3, 0.1, 1.0, looked)
    for k in range(300):
        single = fuse(positions[k : k + 1], predicted[k : k + 1], 0.8, 0.3, 0.1, 1.0, looked[k : k + 1])
        for all_of_them, one in zip(together, single, strict=True):
            np.testing.assert_allclose(all_of_them[k], one[0], rtol=1e-12)
    assert set(together.cause.ravel().tolist()) == set(range(len(CAUSES)))
    exclusive = together.kept.astype(int) + together.recovered + together.removed
    np.testing.assert_array_equal(exclusive == 1, together.cause > NOTHING)


# Limits


def test_no_camera_leaves_the_prior() -> None:
    empty: Bools = np.zeros((2, 0), dtype=np.bool_)
    value = decision_value(empty, np.zeros((2, 0)), np.array([0.9, 0.2]), 0.2, 0.2)
    assert value == pytest.approx([math.log(9.0), math.log(0.25)], rel=1e-12)
    result = fuse(np.zeros((2, 0, 2)), np.zeros((2, 2)), 1.0, 0.2, 0.2, 1.0)
    assert not result.declared.any()
    assert np.isnan(result.xy).all()
    assert result.cause.shape == (2, 0)


def test_all_miss_and_all_detect() -> None:
    nothing = found([GONE] * 3)
    assert not nothing.declared[0]
    assert nothing.cause.tolist() == [[NOTHING] * 3]
    assert nothing.value == pytest.approx([3 * math.log(0.25)], rel=1e-12)
    assert np.isnan(nothing.xy).all()
    assert np.isnan(nothing.quality).all()
    exact = found([(0.0, 0.0)] * 3)  # W = P_1 = 1 exactly: finite, and certain
    assert exact.declared[0]
    assert np.isfinite(exact.value[0])
    assert exact.value[0] > 80.0
    # Cameras worse than chance make "all miss" speak for the object; there is still nothing to declare
    worse = fuse(np.full((1, 2, 2), np.nan), np.zeros((1, 2)), 1.0, 0.9, 0.8, 1.0)
    assert worse.value[0] > 0.0
    assert not worse.declared[0]


@pytest.mark.parametrize(
    ("detected", "miss", "false", "sign"),
    [
        ([True], 0.2, 0.0, 1),  # never false: a detection is certain
        ([False], 0.0, 0.2, -1),  # never misses: a miss is certain
        ([True], 1.0, 0.2, -1),  # never detects what is there
        ([False], 0.2, 1.0, 1),  # always detects what is not there
        ([True], 0.0, 1.0, 0),  # always detects: says nothing
        ([True, False], 0.0, 0.0, 0),  # two certainties that contradict each other cancel
    ],
)
def test_rates_of_zero_and_one_stay_finite(detected: list[bool], miss: float, false: float, sign: int) -> None:
    value = decision_value(np.array([detected]), np.full((1, len(detected)), 0.5), 0.5, miss, false)[0]
    assert math.isfinite(value)
    assert abs(value) < 1e-3 if sign == 0 else value * sign > 20.0


def test_detections_beyond_underflow_still_have_a_mean() -> None:
    positions, predicted = np.array([[[100.0, 0.0], [100.0, 2.0]]]), np.array([[0.0, 1.0]])
    np.testing.assert_allclose(fused_position(positions, predicted, 1.0), [[100.0, 1.0]])
    assert (quality(positions, predicted, 1.0) == 0.0).all()
    result = fuse(positions, predicted, 1.0, 0.2, 0.2, 5.0)
    assert np.isfinite(result.value[0])
    assert not result.declared[0]


def test_quality_by_hand_and_unit_of_length_does_not_matter() -> None:
    positions, predicted = np.array([[[1.5, 2.0], [0.3, -0.4], [0.0, 1.0]]]), np.array([[0.0, 0.2]])
    squared = np.array([1.5**2 + 1.8**2, 0.3**2 + 0.6**2, 0.8**2])
    np.testing.assert_allclose(quality(positions, predicted, 2.5)[0], np.exp(-squared / (2.0 * 6.25)), rtol=1e-12)
    metres = fuse(positions, predicted, 2.5, 0.3, 0.1, 1.2)
    feet = fuse(positions / 0.3048, predicted / 0.3048, 2.5 / 0.3048, 0.3, 0.1, 1.2 / 0.3048)
    np.testing.assert_allclose(feet.value, metres.value, rtol=1e-9)
    np.testing.assert_allclose(feet.xy * 0.3048, metres.xy, rtol=1e-9)
    assert feet.cause.tolist() == metres.cause.tolist() == [[REMOVED_FAR, KEPT, KEPT]]


# Fig. 4-3: six cameras, P_M = P_F = 0.2, sigma 1

VARIANCES = (0.03, 0.1, 0.3, 0.8, 2.0)
TRIALS = 20_000


@cache
def share_declared(seen: int, variance: float, trials: int = TRIALS) -> float:
    """P(G_1) when `seen` of six cameras detect, by the kernels."""
    rng = np.random.default_rng([seen, round(variance * 1000)])
    positions = np.full((trials, 6, 2), np.nan)
    positions[:, :seen] = rng.normal(0.0, math.sqrt(variance), (trials, seen, 2))
    return float(fuse(positions, np.zeros((trials, 2)), 1.0, 0.2, 0.2, math.inf).declared.mean())


def plain_share(seen: int, variance: float, trials: int) -> float:
    """The same in plain Python, by products of probabilities."""
    draw, declared = random.Random(seen * 1000 + round(variance * 1000)), 0
    for _ in range(trials):
        spread = math.sqrt(variance)
        places = [(draw.gauss(0.0, spread), draw.gauss(0.0, spread)) for _ in range(seen)]
        weights = [math.exp(-(x * x + y * y) / 2.0) for x, y in places]
        gx = sum(w * x for w, (x, _) in zip(weights, places, strict=True)) / sum(weights)
        gy = sum(w * y for w, (_, y) in zip(weights, places, strict=True)) / sum(weights)
        prior = math.exp(-(gx * gx + gy * gy) / 2.0)
        present, absent = prior * 0.2 ** (6 - seen), (1.0 - prior) * 0.8 ** (6 - seen)
        for w in weights:
            present, absent = present * 0.8 * w, absent * 0.2 * (1.0 - w)
        declared += present > absent
    return declared / trials


@pytest.mark.parametrize("seen", range(1, 7))
def test_fig_4_3_against_a_plain_simulation(seen: int) -> None:
    """Within 4.5 standard errors of the difference of two shares; 18 comparisons, so about 1e-4 by chance."""
    trials = 1500
    for variance in VARIANCES[::2]:
        ours, plain = share_declared(seen, variance), plain_share(seen, variance, trials)
        p = (ours * TRIALS + plain * trials + 1.0) / (TRIALS + trials + 2.0)
        error = math.sqrt(p * (1.0 - p) * (1.0 / TRIALS + 1.0 / trials))
        assert abs(ours - plain) <= 4.5 * error, (seen, variance, ours, plain, error)


def test_fig_4_3_one_detection_in_closed_form() -> None:
    """With one detection P_1 = W, so G_1 iff W/(1 - W) > 4^2; d^2/2 is exponential with mean the variance."""
    reach = -math.log(16.0 / 17.0)
    for variance in VARIANCES:
        p = 1.0 - math.exp(-reach / variance)
        assert abs(share_declared(1, variance) - p) < 4.5 * math.sqrt(p * (1.0 - p) / TRIALS)


def test_fig_4_3_falls_with_the_variance_and_rises_with_the_detections() -> None:
    """Each step beyond 3 standard errors (at most 0.005 each), or both shares above 0.995."""
    share = np.array([[share_declared(seen, v) for v in VARIANCES] for seen in range(1, 7)])
    error = np.sqrt(share * (1.0 - share) / TRIALS)
    for axis, sign in ((1, -1.0), (0, 1.0)):
        step = sign * np.diff(share, axis=axis)
        low, high = (np.take(share, range(k, share.shape[axis] - 1 + k), axis=axis) for k in (0, 1))
        errors = [np.take(error, range(k, share.shape[axis] - 1 + k), axis=axis) for k in (0, 1)]
        saturated = np.minimum(low, high) > 0.995
        assert ((step > 3.0 * np.hypot(*errors)) | saturated).all(), share
        assert (step > -0.005).all()
    assert share[5, 0] - share[5, -1] > 0.3
    assert share[5, 2] - share[0, 2] > 0.7
