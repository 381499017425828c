"""Targets that may have taken each other's identities: rates, starts, and Monte Carlo of the covariances."""

import numpy as np
import pytest

from occlog.array_types import NS
from occlog.track.methods.images.ground.stage import (
    MIN_CONTRADICTION_PROBABILITY,
    SwitchProbabilities,
    spread_over_others,
)


def after(exchanges, contested, views, seconds=2):
    """Probability of target 7 after some seconds with a row every 0.1 s, the first of which is by two views."""
    exchanges.update(0, np.array([7]), np.zeros(1), np.array([2]))
    for k in range(1, 10 * seconds + 1):
        found = exchanges.update(k * NS // 10, np.array([7]), np.array([contested]), np.array([views]))
    return found[0]


def test_contradictions_exchange_targets_at_the_rate():
    assert after(SwitchProbabilities(0.5, 0.3, 0.0), 1.0, 2) == pytest.approx(1 - np.exp(-1.0))
    assert after(SwitchProbabilities(0.5, 0.3, 0.0), MIN_CONTRADICTION_PROBABILITY, 2) == pytest.approx(
        1 - np.exp(-0.5)
    )
    assert after(SwitchProbabilities(0.5, 0.3, 0.2), MIN_CONTRADICTION_PROBABILITY - 1e-9, 3) == pytest.approx(0.2)
    assert after(SwitchProbabilities(0.0, 0.3, 0.0), 1.0, 2) == 0.0


def test_a_view_that_is_left_alone_exchanges_and_one_that_always_was_does_not():
    assert after(SwitchProbabilities(0.5, 0.3, 0.0), 0.0, 1) == pytest.approx(1 - np.exp(-0.3))
    alone = SwitchProbabilities(0.5, 0.3, 0.0)
    for k in range(20):
        found = alone.update(k * NS, np.array([7]), np.zeros(1), np.array([1]))
    assert found[0] == 0.0


def test_long_gaps_count_as_one_second():
    long = SwitchProbabilities(0.5, 0.3, 0.0)
    long.update(0, np.array([1]), np.zeros(1), np.array([2]))
    found = long.update(100 * NS, np.array([1]), np.ones(1), np.array([2]))
    assert found[0] == pytest.approx(1 - np.exp(-0.5))


def test_second_moments_are_those_of_many_draws():
    rng = np.random.default_rng(0)
    positions = rng.uniform(-3, 3, (4, 3))
    cov = np.broadcast_to(0.01 * np.eye(3), (4, 3, 3))
    stated = spread_over_others(positions, cov, np.full(4, 0.3))
    elsewhere = rng.random(200_000) < 0.3
    truth = np.where(elsewhere[:, None], positions[rng.integers(1, 4, 200_000)], positions[0])
    off = truth + rng.normal(0, 0.1, truth.shape) - positions[0]
    assert np.allclose(stated[0], off.T @ off / len(off), atol=0.05)


def test_a_target_alone_keeps_its_covariance():
    cov = np.eye(3)[None]
    assert np.array_equal(spread_over_others(np.zeros((1, 3)), cov, np.ones(1)), cov)
