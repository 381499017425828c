"""The sum over subsets of cameras, walked as a tree, against the sum written out."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from occlog.core.occlusion.joint_occlusion import (
    by_weight,
    joint_visibility,
    over_subsets,
    relevant_priors,
    sum_disjoint,
)


def written_out(q: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    """Sum over Q of prod_j max(0, 1 - sum_Q q_ij) prod_Q (a - b) prod_not-Q b ([Ercan] Eqs. 8-9)."""
    total = 0.0
    for chosen in itertools.product((False, True), repeat=len(a)):
        Q = np.array(chosen, dtype=bool)
        p = np.prod(np.maximum(0.0, 1.0 - q[Q].sum(axis=0)))
        total += p * np.prod(np.where(Q, a - b, b))
    return total


@pytest.mark.parametrize("m", [1, 2, 5])
@pytest.mark.parametrize("occluders", [0, 1, 3, 4, 6, 9])
def test_the_tree_is_the_sum_written_out(m: int, occluders: int) -> None:
    rng = np.random.default_rng([m, occluders])
    q, a, b = rng.uniform(0, 0.6, (m, occluders)), rng.uniform(0.5, 3, m), rng.uniform(0, 0.5, m)
    assert sum_disjoint(q, a, b, 0.0) == pytest.approx(max(written_out(q, a, b), 0.0), rel=1e-8)


def test_the_sum_is_not_below_the_floor_times_the_largest_factors() -> None:
    q, a, b = np.ones((2, 1)), np.array([2.0, 3.0]), np.zeros(2)
    assert written_out(q, a, b) == 0.0
    assert sum_disjoint(q, a, b, 1e-4) == pytest.approx(6e-4)
    assert sum_disjoint(q, a, b, 0.0) == 0.0
    assert over_subsets(np.array([1.0, 0.0, 0.0, 0.0]), a, b, 1e-4) == pytest.approx(6e-4)


def test_a_camera_whose_report_is_impossible_either_way_makes_the_sum_zero() -> None:
    q, a, b = np.full((2, 3), 0.1), np.array([2.0, 0.0]), np.array([0.5, 0.0])
    assert sum_disjoint(q, a, b, 1e-4) == 0.0
    assert over_subsets(np.full(4, 0.5), a, b, 1e-4) == 0.0


@pytest.mark.parametrize("occluders", [0, 1, 3, 4, 5, 8, 11])
def test_products_of_any_number_of_occluders_stop_at_zero(occluders: int) -> None:
    sums = np.random.default_rng(occluders).uniform(0.0, 0.9, occluders)
    assert joint_visibility(sums) == pytest.approx(np.prod(1.0 - sums))
    for k in range(occluders):
        over = sums.copy()
        over[k] = 1.5
        assert joint_visibility(over) == 0.0


def test_cameras_with_one_light_branch_come_first() -> None:
    seeing, hidden = np.array([0.5, 1.0, -0.2, 0.9]), np.array([0.6, 0.01, 0.8, 0.9])
    assert by_weight(seeing, hidden).tolist() == [1, 2, 0, 3]


def test_only_occluders_that_block_a_camera_are_kept() -> None:
    q = np.zeros((3, 4, 2))
    q[0, 1, 1], q[2, 3, 1], q[1, 0, 1], q[0, 2, 0] = 0.2, 0.3, 0.4, 0.5
    assert relevant_priors(q, 1, np.array([0, 2])).tolist() == [[0.2, 0.0], [0.0, 0.3]]
    assert relevant_priors(q, 0, np.array([1, 2])).shape == (2, 0)
