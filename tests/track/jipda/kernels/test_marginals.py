"""Marginals by belief propagation: against the sum over all joint associations."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from occlog.array_types import Floats
from occlog.track.methods.jipda.kernels.marginals import box_messages


def marginals(weight: Floats) -> Floats:
    """(N, M) probabilities from the messages."""
    nu = box_messages(weight)
    return weight * nu / (1.0 + np.sum(weight * nu, axis=1, keepdims=True))


def enumerated(weight: Floats) -> Floats:
    """(N, M) exact probabilities: every person takes one box or none, no box twice."""
    N, M = weight.shape
    out, total = np.zeros((N, M)), 0.0
    for event in itertools.product(range(-1, M), repeat=N):
        taken = [j for j in event if j >= 0]
        if len(taken) != len(set(taken)):
            continue
        w = float(np.prod([weight[i, j] for i, j in enumerate(event) if j >= 0]))
        total += w
        for i, j in enumerate(event):
            if j >= 0:
                out[i, j] += w
    return out / total


def test_a_tree_is_exact() -> None:
    weight = np.array([[3.0, 0.5, 0.0], [0.0, 2.0, 1.0], [0.0, 0.0, 4.0]])
    np.testing.assert_allclose(marginals(weight), enumerated(weight), atol=1e-4)


@pytest.mark.parametrize("seed", range(5))
def test_loops_are_near_the_exact_sum(seed: int) -> None:
    weight = np.exp(np.random.default_rng(seed).normal(0.0, 2.0, (4, 4)))
    assert np.abs(marginals(weight) - enumerated(weight)).max() < 0.12


def test_shares_of_a_person_and_of_a_box_are_at_most_one() -> None:
    p = marginals(np.exp(np.random.default_rng(0).normal(2.0, 3.0, (20, 25))))
    assert p.sum(axis=1).max() <= 1.0 + 1e-9
    assert p.sum(axis=0).max() <= 1.0 + 0.05


def test_a_single_person_and_box_have_the_odds_of_the_weight() -> None:
    assert marginals(np.array([[3.0]]))[0, 0] == pytest.approx(0.75)


def test_no_boxes_and_no_one_are_fine() -> None:
    assert box_messages(np.zeros((3, 0))).shape == (3, 0)
    assert box_messages(np.zeros((0, 2))).shape == (0, 2)
