"""Paths through modes: the dynamic programme against all paths, and the second difference against simulated motion."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from occlog.track.methods.map.kernels.mode_path import (
    ModeChain,
    PairCosts,
    distinct_paths,
    modes_of_path,
    pair_costs,
)

Q = 0.7


def chain_of(seed: int, counts: list[int]) -> ModeChain:
    """Modes at random, with random covariances and costs, at uneven times."""
    rng = np.random.default_rng([8100, seed])
    N = sum(counts)
    root = 0.5 * rng.standard_normal((N, 2, 2))
    return ModeChain(
        np.concatenate([[0], np.cumsum(counts)]),
        np.cumsum(rng.uniform(0.3, 2.0, len(counts))),
        rng.uniform(0.0, 4.0, (N, 2)),
        root @ root.transpose(0, 2, 1) + 0.01 * np.eye(2),
        rng.uniform(0.0, 3.0, N),
    )


def reference_cost(chain: ModeChain, path: tuple[int, ...], velocity: np.ndarray, spread: np.ndarray) -> float:
    """The cost of one path, term by term."""
    x, C, t = chain.xy, chain.covariance, chain.seconds
    total = float(chain.cost[list(path)].sum())
    i, j = path[:2]
    a = t[1] - t[0]
    e = x[j] - x[i] - a * velocity
    total += 0.5 * float(e @ np.linalg.solve(C[i] + C[j] + a**2 * spread + Q * a**3 / 3.0 * np.eye(2), e))
    for n in range(2, len(path)):
        i, j, k = path[n - 2 : n + 1]
        a, b = t[n - 1] - t[n - 2], t[n] - t[n - 1]
        r = b / a
        e = x[k] - (1.0 + r) * x[j] + r * x[i]
        S = C[k] + (1.0 + r) ** 2 * C[j] + r**2 * C[i] + Q * b**2 * (a + b) / 3.0 * np.eye(2)
        total += 0.5 * float(e @ np.linalg.solve(S, e))
    return total


def solved(chain: ModeChain) -> tuple[PairCosts, np.ndarray, np.ndarray]:
    velocity, spread = np.array([0.4, -0.2]), np.array([[0.5, 0.1], [0.1, 0.3]])
    return pair_costs(chain, Q, velocity, spread), velocity, spread


@pytest.mark.parametrize(
    ("seed", "counts"), [(0, [2, 3, 1, 3, 2]), (1, [3, 2, 2, 2, 3, 2]), (2, [1, 4]), (3, [2, 1, 2])]
)
def test_the_cheapest_paths_through_every_pair_are_those_of_all_paths(seed: int, counts: list[int]) -> None:
    chain = chain_of(seed, counts)
    pairs, velocity, spread = solved(chain)
    paths = list(product(*(range(a, b) for a, b in zip(chain.first, chain.first[1:], strict=False))))
    costs = np.array([reference_cost(chain, path, velocity, spread) for path in paths])
    through = pairs.before + pairs.after
    p = 0
    for t in range(len(counts) - 1):
        for i in range(chain.first[t], chain.first[t + 1]):
            for j in range(chain.first[t + 1], chain.first[t + 2]):
                own = [n for n, path in enumerate(paths) if path[t] == i and path[t + 1] == j]
                best = own[int(np.argmin(costs[own]))]
                np.testing.assert_allclose(through[p], costs[best], rtol=1e-12)
                assert modes_of_path(chain, pairs, p).tolist() == list(paths[best])
                p += 1
    assert p == len(through)


def test_distinct_paths_rise_in_cost_and_each_has_a_mode_away_from_those_before() -> None:
    chain = chain_of(4, [3] * 8)
    pairs, velocity, spread = solved(chain)
    found = distinct_paths(chain, pairs, 5, 1e9)
    costs = [reference_cost(chain, tuple(path.tolist()), velocity, spread) for path in found]
    assert len(found) == 3
    assert costs == sorted(costs)
    for n in range(1, len(found)):
        apart = np.ones(8, dtype=np.bool_)
        for other in found[:n]:
            away = chain.xy[found[n]] - chain.xy[other]
            C = chain.covariance[found[n]] + chain.covariance[other]
            apart &= np.einsum("ti,tij,tj->t", away, np.linalg.inv(C), away) > 9.0
        assert apart.any()
    # A gap of less than the second costs leaves one
    assert len(distinct_paths(chain, pairs, 5, 0.5 * (costs[1] - costs[0]))) == 1


def test_second_differences_of_an_integrated_random_walk_have_the_variance_of_the_docstring() -> None:
    """White acceleration with the variance q a second, in 400 steps; 20000 paths, 4 standard errors of a variance."""
    rng = np.random.default_rng(8101)
    a, b, n = 0.8, 1.7, 400
    dt = (a + b) / n
    v = np.cumsum(np.sqrt(Q * dt) * rng.standard_normal((20000, n)), axis=1)
    x = np.cumsum(v * dt, axis=1)
    middle = round(a / dt) - 1
    e = x[:, -1] - x[:, middle] - b / a * x[:, middle]
    expected = Q * b**2 * (a + b) / 3.0
    assert abs(e.var() / expected - 1.0) < 4.0 * np.sqrt(2.0 / 20000) + 4.0 / n
