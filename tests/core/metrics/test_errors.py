"""Figures of merit on scenes small enough to work out by hand, and pairings against all permutations."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occlog.core.metrics import errors as metrics


def test_rmse_of_five_frames() -> None:
    sums = metrics.error_sums(np.array([[3.0, 4.0], [0.0, 0.0], [1.0, -1.0], [-2.0, 0.0], [0.0, 3.0]]))
    assert sums.rmse == pytest.approx(math.sqrt((25 + 0 + 2 + 4 + 9) / 5))
    assert sums.rmse_x == pytest.approx(math.sqrt((9 + 1 + 4) / 5))
    assert sums.rmse_y == pytest.approx(math.sqrt((16 + 1 + 9) / 5))


def test_tracks_of_unequal_length_are_added_not_averaged() -> None:
    long = metrics.error_sums(np.full((9, 2), 1.0))  # RMSE sqrt(2)
    short = metrics.error_sums(np.array([[0.0, 10.0]]))  # RMSE 10
    both = metrics.add_sums([long, short])
    assert both.rmse == pytest.approx(math.sqrt((9 * 2 + 100) / 10))
    assert both.rmse != pytest.approx((long.rmse + short.rmse) / 2)


def test_nothing_gives_nan_not_zero() -> None:
    empty = metrics.add_sums([])
    assert empty.n == 0
    assert math.isnan(empty.rmse)
    assert math.isnan(metrics.error_sums(np.zeros((0, 2))).rmse_x)
    assert math.isnan(metrics.quantile(np.zeros(0), 0.5))
    assert math.isnan(metrics.ratio_or_nan(0, 0))


def test_normalised_squared_errors_by_hand() -> None:
    P = np.array([[[4.0, 0.0], [0.0, 1.0]], [[2.0, 1.0], [1.0, 2.0]], [[1.0, 1.0], [1.0, 1.0]], np.zeros((2, 2))])
    e = np.array([[2.0, 3.0], [1.0, 1.0], [1.0, 1.0], [0.0, 0.0]])
    nees = metrics.normalised_squared_errors(e, P)
    np.testing.assert_allclose(nees[:2], [1 + 9, 2 / 3])
    assert np.isnan(nees[2:]).all()


def test_consistent_errors_have_a_mean_of_two_and_95_percent_inside() -> None:
    rng, n = np.random.default_rng(0), 50_000
    P = np.array([[2.0, 0.7], [0.7, 1.0]])
    e = rng.normal(size=(n, 2)) @ np.linalg.cholesky(P).T
    nees = metrics.normalised_squared_errors(e, np.broadcast_to(P, (n, 2, 2)))
    assert abs(nees.mean() - 2.0) < 4 * 2 / math.sqrt(n)
    inside = np.mean(nees <= metrics.CHI2_95_2D)
    assert abs(inside - 0.95) < 4 * math.sqrt(0.95 * 0.05 / n)


def best_pairing(cost: np.ndarray, limit: float) -> tuple[int, float]:
    """Most pairs and their least total cost, by trying all."""
    n, m = cost.shape
    best = (0, 0.0)
    for size in range(1, min(n, m) + 1):
        for rows in itertools.combinations(range(n), size):
            for columns in itertools.permutations(range(m), size):
                chosen = [cost[i, j] for i, j in zip(rows, columns, strict=True)]
                if all(c <= limit for c in chosen):
                    total = float(sum(chosen))
                    if size > best[0] or (size == best[0] and total < best[1]):
                        best = (size, total)
    return best


@given(st.integers(0, 10_000), st.integers(1, 4), st.integers(1, 4))
def test_pairs_within_against_all_pairings(seed: int, n: int, m: int) -> None:
    cost = np.random.default_rng(seed).uniform(0, 2, (n, m))
    cost[np.random.default_rng(seed + 1).random((n, m)) < 0.2] = np.inf
    pairs = metrics.pair_within(cost, 1.0)
    assert len({i for i, _ in pairs}) == len({j for _, j in pairs}) == len(pairs)
    size, total = best_pairing(cost, 1.0)
    assert len(pairs) == size
    assert sum(cost[i, j] for i, j in pairs) == pytest.approx(total)


def test_pairs_within_takes_two_over_one_perfect() -> None:
    # Row 0 fits column 0 perfectly, but then row 1 would have none
    assert metrics.pair_within(np.array([[0.0, 0.9], [0.8, 5.0]]), 1.0) == [(0, 1), (1, 0)]


def test_pairs_within_nothing_allowed() -> None:
    assert metrics.pair_within(np.array([[2.0, np.nan]]), 1.0) == []
    assert metrics.pair_within(np.zeros((0, 3)), 1.0) == []


@given(st.integers(0, 10_000), st.integers(1, 4), st.integers(1, 4))
def test_tracks_over_equal_times_get_the_least_overall_rmse(seed: int, n: int, m: int) -> None:
    e2 = np.random.default_rng(seed).exponential(size=(n, m, 5))
    pairs = metrics.pair_tracks([[e2[i, j] for j in range(m)] for i in range(n)])
    assert len(pairs) == min(n, m)
    _, least = best_pairing(e2.sum(axis=2), np.inf)
    assert sum(e2[i, j].sum() for i, j in pairs) == pytest.approx(least)


def test_a_short_piece_does_not_beat_a_whole_track() -> None:
    whole, piece, far = np.full(100, 0.5), np.full(2, 0.01), np.full(100, 400.0)
    # Both fit target 0; the whole track has the larger RMSE but covers far more
    assert metrics.pair_tracks([[piece], [whole]]) == [(1, 0)]
    assert metrics.pair_tracks([[whole, far], [far, whole]]) == [(0, 0), (1, 1)]


def test_tracks_without_a_common_time_are_no_pair() -> None:
    none = np.zeros(0)
    assert metrics.pair_tracks([[none, np.ones(3)], [none, none]]) == [(0, 1)]
    assert metrics.pair_tracks([[none]]) == []
    assert metrics.pair_tracks([]) == []


def test_overlap_of_boxes_by_hand() -> None:
    a = np.array([[0.0, 0.0, 2.0, 2.0]])
    b = np.array([[0.0, 0, 2, 2], [1, 1, 2, 2], [2, 0, 2, 2], [0.5, 0.5, 1, 1]])
    np.testing.assert_allclose(metrics.intersection_over_union(a, b), [[1, 1 / 7, 0, 1 / 4]])
    np.testing.assert_allclose(metrics.intersection_areas(a, b), [[4, 1, 0, 1]])
    assert metrics.intersection_over_union(a, b[:0]).shape == (1, 0)


def test_a_pair_may_cost_as_much_as_the_limit_and_no_more() -> None:
    cost = np.array([[2.0]])
    assert metrics.pair_within(cost, 2.0) == [(0, 0)]
    assert metrics.pair_within(cost, np.nextafter(2.0, 0.0)) == []


def test_a_longer_piece_with_larger_errors_beats_a_shorter_one() -> None:
    """A time covered is worth more than the largest squared error, whichever pair that belongs to."""
    long, short = np.append(np.full(9, 4.0), 0.0), np.array([0.0, 1.0])
    assert metrics.pair_tracks([[long], [short]]) == [(0, 0)]
    assert metrics.pair_tracks([[short], [long]]) == [(1, 0)]


def test_normalised_squared_errors_in_space_are_those_of_the_inverse() -> None:
    rng = np.random.default_rng(5)
    root = rng.normal(size=(50, 3, 3)) * [1.0, 10.0, 0.01]
    P, e = root @ np.swapaxes(root, 1, 2), rng.normal(size=(50, 3))
    want = np.einsum("ni,nij,nj->n", e, np.linalg.inv(P), e)
    np.testing.assert_allclose(metrics.normalised_squared_errors_in_space(e, P), want, rtol=1e-6)


def test_errors_in_space_that_are_not_known_or_have_no_spread_have_no_normalised_square() -> None:
    e, P = np.ones((5, 3)), np.tile(np.eye(3), (5, 1, 1))
    e[0, 2] = np.nan
    P[1, 0, 2] = P[1, 2, 0] = np.nan
    P[2, 1, 1] = 0.0
    P[3] = 1.0  # singular: all axes are the same
    got = metrics.normalised_squared_errors_in_space(e, P)
    np.testing.assert_array_equal(np.isnan(got), [True, True, True, True, False])
    assert got[4] == 3.0
    assert metrics.normalised_squared_errors_in_space(np.zeros((0, 3)), np.zeros((0, 3, 3))).shape == (0,)


def test_areas_that_boxes_share_by_hand() -> None:
    a = np.array([[0.0, 0.0, 4.0, 2.0]])
    b = np.array([[1.0, 1.0, 9.0, 9.0], [4.0, 0.0, 1.0, 1.0], [0.0, 2.0, 1.0, 1.0], [-1.0, 0.5, 2.0, 1.0]])
    assert metrics.intersection_areas(a, b).tolist() == [[3.0, 0.0, 0.0, 1.0]]
