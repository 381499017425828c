"""How long people are there before they are seen: by hand."""

import numpy as np
import pytest

from occlog.track.methods.jipda.batch.mcmc_association import missed_run
from occlog.track.methods.jipda.batch.states import dwell_times

pytestmark = pytest.mark.jit
MISS = np.log([[0.5]])


def wait(time, k, step, rate=1e-6, hiding=(0.0, 0.0)):
    looked = np.arange(len(time) + 1, dtype=np.float64)[:, None]
    total, rest = dwell_times(np.asarray(time), looked, np.array([k]), MISS, np.array([hiding]), np.array([rate]), step)
    return total[0], rest[0]


def test_moments_that_are_equally_far_apart_are_waited_for_until_one_sees():
    # 0.1 s (1 + 1/2 + 1/4 + ..)
    total, rest = wait(np.arange(100) / 10.0, 60, -1)
    assert (total, rest) == (pytest.approx(0.2, rel=1e-3), 0.0)
    assert wait(np.arange(100) / 10.0, 60, 1)[0] == pytest.approx(0.2, rel=1e-3)


@pytest.mark.parametrize("pause", [60.0, 600.0, 10800.0])
def test_a_pause_counts_next_to_itself_only(pause):
    time = np.concatenate([np.arange(50) / 10.0, pause + np.arange(50) / 10.0])
    # Whoever is seen first after the pause has come in it, and not left
    total, _ = wait(time, 50, -1, rate=1.0 / 60.0)
    assert total == pytest.approx(60.0 * (1.0 - np.exp(-(pause - 4.9) / 60.0)), rel=0.01)
    assert wait(time, 90, -1)[0] == pytest.approx(0.2, rel=1e-3)
    assert wait(time, 10, 1)[0] == pytest.approx(0.2, rel=1e-3)


def test_all_are_there_at_first_or_have_come_since_or_left():
    for step, k in ((-1, 3), (1, 1)):
        total, rest = dwell_times(
            np.array([0.0, 1.0, 4.0, 4.5, 9.0]),
            np.zeros((6, 1)),
            np.array([k]),
            MISS,
            np.zeros((1, 2)),
            np.array([0.3]),
            step,
        )
        assert 0.3 * total[0] + rest[0] == pytest.approx(1.0)


def test_misses_that_last_are_those_of_a_chain_of_two_states():
    miss, hide, appear = 0.3, 0.05, 0.2
    change = np.array([[miss * (1.0 - hide), miss * appear], [hide, 1.0 - appear]])
    for count in (0, 1, 2, 7, 40):
        by_powers = np.linalg.matrix_power(change, count) @ [1.0, 0.0]
        np.testing.assert_allclose(missed_run(float(count), miss, hide, appear), by_powers, rtol=1e-12)
    assert missed_run(5.0, miss, 0.0, appear) == (pytest.approx(miss**5), 0.0)


def test_who_may_be_hidden_is_waited_for_longer():
    time = np.arange(400) / 10.0
    total, _ = wait(time, 10, 1, hiding=(0.1, 0.1))
    change = np.array([[0.45, 0.05], [0.1, 0.9]])
    # 0.1 s times the sum of the probabilities of all runs of misses
    assert total == pytest.approx(0.1 * (np.linalg.inv(np.eye(2) - change) @ [1.0, 0.0]).sum(), rel=1e-3)
