"""Assignment within a gate against all ways to pair, and at the gate."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from occlog.core.numerics.assignment import assign, maximum_weight_matching


def best(cost: np.ndarray, gate: float) -> tuple[int, float]:
    """Most pairs within the gate, and of these the least sum, over all one-to-one pairings."""
    n, m = cost.shape
    found = [(0, 0.0)]
    for size in range(1, min(n, m) + 1):
        for rows in itertools.combinations(range(n), size):
            for columns in itertools.permutations(range(m), size):
                costs = [cost[i, j] for i, j in zip(rows, columns, strict=True)]
                if max(costs) <= gate:
                    found.append((-size, sum(costs)))
    size, total = min(found)
    return -size, total


@pytest.mark.parametrize(("n", "m"), [(1, 1), (2, 3), (4, 2), (3, 3), (4, 4)])
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e6])
def test_there_are_as_many_pairs_as_the_gate_lets_and_of_these_the_cheapest(
    n: int, m: int, seed: int, scale: float
) -> None:
    cost = scale * np.random.default_rng([seed, n, m]).uniform(0, 10, (n, m))
    cost[0, 0] = np.inf
    rows, columns = assign(cost, 6.0 * scale)
    assert (np.diff(rows) > 0).all()
    assert len(set(columns.tolist())) == len(columns)
    size, total = best(cost, 6.0 * scale)
    assert len(rows) == size
    assert float(cost[rows, columns].sum()) == pytest.approx(total)


def test_a_pair_may_cost_as_much_as_the_gate_and_no_more() -> None:
    cost = np.array([[2.0, np.inf], [np.inf, np.nextafter(2.0, 3.0)]])
    rows, columns = assign(cost, 2.0)
    assert (rows.tolist(), columns.tolist()) == ([0], [0])


def test_with_a_gate_of_zero_only_exact_pairs_are_made() -> None:
    rows, columns = assign(np.array([[0.0, 1.0], [1e-300, 0.0]]), 0.0)
    assert (rows.tolist(), columns.tolist()) == ([0, 1], [0, 1])


@pytest.mark.parametrize("shape", [(0, 0), (0, 3), (3, 0)])
def test_without_a_side_there_are_no_pairs(shape: tuple[int, int]) -> None:
    rows, columns = assign(np.zeros(shape), 1.0)
    assert len(rows) == len(columns) == 0
    assert rows.dtype == columns.dtype == np.int64


@pytest.mark.parametrize("scale", [1e-300, 1e-9, 1.0, 1e12, 1e300])
@pytest.mark.parametrize("seed", range(6))
def test_matchings_weigh_as_much_as_those_of_the_whole_matrix(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    n, m = rng.integers(1, 40, 2)
    weights = np.where(rng.random((n, m)) < rng.choice([0.05, 0.5, 1.0]), rng.uniform(-2.0, 9.0, (n, m)), 0.0)
    rows, columns = np.nonzero(weights)
    order = rng.permutation(len(rows))
    rows, columns = rows[order], columns[order]
    made = maximum_weight_matching(rows, columns, scale * weights[rows, columns])
    assert (np.diff(rows[made]) > 0).all()
    assert len(set(columns[made].tolist())) == len(made)
    whole = linear_sum_assignment(np.maximum(weights, 0.0), maximize=True)
    assert weights[rows[made], columns[made]].sum() == pytest.approx(np.maximum(weights, 0.0)[whole].sum(), rel=1e-12)
    assert (weights[rows[made], columns[made]] > 0).all()


def test_a_matching_of_nothing_is_empty() -> None:
    none = np.zeros(0, dtype=np.int64)
    assert not len(maximum_weight_matching(none, none, np.zeros(0)))
    assert not len(maximum_weight_matching(np.array([3]), np.array([-5]), np.array([0.0])))
    assert maximum_weight_matching(np.array([3]), np.array([-5]), np.array([1e-320])).tolist() == [0]
