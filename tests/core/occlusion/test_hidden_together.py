"""The sum over subsets of cameras, walked as a tree, against the sum written out."""

from __future__ import annotations

import itertools
from contextlib import nullcontext

import numpy as np
import pytest

from occlog.core.occlusion.blocking_probability import shares
from occlog.core.occlusion.joint_occlusion import (
    MAX_CAMERAS,
    add_joint,
    by_weight,
    joint_visibility,
    over_subsets,
    relevant_priors,
    sum_disjoint,
)
from occlog.core.occlusion.occlusion_probability import QUADRATURE, blocking_probabilities
from occlog.core.occlusion.priors import gaussian_priors, no_priors


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


@pytest.mark.parametrize("exact", [True, False])
def test_the_log_likelihood_of_the_cameras_that_count_is_added(exact: bool) -> None:
    """Three frames, of which the second does not count for the first position, and none for the third."""
    positions = np.array([[0.0, 0.0], [40.0, 0.0], [18.0, 25.0], [3.0, 9.0]])
    priors = gaussian_priors(np.array([[12.0, 5.0], [21.0, 8.0]]), np.array([[[9.0, 3.0], [3.0, 4.0]]] * 2), 3.33)
    rng, sensor, xy = (
        np.random.default_rng(0),
        np.array([3, 1, 2]),
        np.array([[20.0, 9.0], [17.0, 7.0], [5.0, 5.0], [1.0, 1.0]]),
    )
    a, b = rng.uniform(0.5, 3.0, (3, 4)), rng.uniform(0.1, 0.5, 3)
    assigned = np.array([[True, True, False, True], [False, True, False, True], [True, True, False, True]])
    total = np.array([0.3, -0.2, 0.7, -np.inf])
    got = total.copy()
    add_joint(got, xy, sensor, a, b, assigned, positions, priors, exact, QUADRATURE, 1e-9, 8.0)
    for p in range(2):
        use, wanted = np.flatnonzero(assigned[:, p]), 0.0
        q = np.array([blocking_probabilities(xy, np.array([p]), *positions[i], priors, QUADRATURE, 8.0)[:, 0]
                      for i in sensor[use]])  # fmt: skip
        hidden = [shares(*xy[p], positions[sensor[use]], priors, j) for j in range(2)]
        for one, other in itertools.product(range(1 << len(use)), repeat=2):
            blocked = np.array([bool((one | other) >> k & 1) for k in range(len(use))])
            wanted += hidden[0][one] * hidden[1][other] * np.prod(np.where(blocked, b[use], a[use, p]))
        wanted = wanted if exact else written_out(q, a[use, p], b[use])
        assert got[p] == pytest.approx(total[p] + np.log(wanted), rel=1e-9)
    np.testing.assert_array_equal(got[2:], total[2:])


@pytest.mark.parametrize(("frames", "refused"), [(MAX_CAMERAS, False), (MAX_CAMERAS + 1, True)])
def test_more_than_sixteen_cameras_are_refused(frames: int, refused: bool) -> None:
    args = (
        np.zeros(frames, dtype=np.int64),
        np.ones((frames, 1)),
        np.full(frames, 0.5),
        np.ones((frames, 1), dtype=bool),
    )
    with pytest.raises(ValueError) if refused else nullcontext():
        add_joint(np.zeros(1), np.ones((1, 2)), *args, np.zeros((1, 2)), no_priors(), False, QUADRATURE, 0.0, 5.0)


def test_cameras_with_one_light_branch_come_first() -> None:
    seeing, hidden = np.array([0.5, 1.0, -0.2, 0.9]), np.array([0.6, 0.01, 0.8, 0.9])
    assert by_weight(seeing, hidden).tolist() == [1, 2, 0, 3]


def test_only_occluders_that_block_a_camera_are_kept() -> None:
    q = np.zeros((3, 4, 2))
    q[0, 1, 1], q[2, 3, 1], q[1, 0, 1], q[0, 2, 0] = 0.2, 0.3, 0.4, 0.5
    assert relevant_priors(q, 1, np.array([0, 2])).tolist() == [[0.2, 0.0], [0.0, 0.3]]
    assert relevant_priors(q, 0, np.array([1, 2])).shape == (2, 0)
