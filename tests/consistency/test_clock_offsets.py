"""Steps and drifts of a clock against another one, and what resembles them."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.array_types import NS, Floats
from occlog.consistency.clock_offsets import ReceivedTimes, offset_words

START_S = 1_700_000_000.0
TIMES = START_S + np.arange(500) / 10.0


def test_an_offset_is_stated_with_the_seconds_to_add() -> None:
    assert offset_words(0.20004) == {"offset": "0.2", "sense": "large", "correction": "-0.2"}
    assert offset_words(-3600.5) == {"offset": "3600.5", "sense": "small", "correction": "3600.5"}


def received(stamps: Floats, stall_s: float = 0.0, seed: int = 0) -> ReceivedTimes:
    """Times that are received some milliseconds later, or at the end of a stall 10 s after the start."""
    logged = TIMES + np.random.default_rng(seed).exponential(0.003, len(TIMES))
    held = (logged > START_S + 10.0) & (logged < START_S + 10.0 + stall_s)
    logged[held] = START_S + 10.0 + stall_s
    out = ReceivedTimes()
    for stamp, log in zip(stamps.tolist(), logged.tolist(), strict=True):
        out.add(round((stamp - START_S) * NS) + round(START_S) * NS, round((log - START_S) * NS) + round(START_S) * NS)
    return out


@pytest.mark.parametrize("step_s", [0.7, 42.0, -5.5, -1.69e9])
def test_a_clock_that_is_set_is_found_with_size_and_time(step_s: float) -> None:
    found = received(TIMES + step_s * (np.arange(500) >= 200), stall_s=1.5)
    found_s, before_ns, drift, by_recorder = found.change()
    assert not by_recorder
    assert found_s == pytest.approx(step_s, rel=0.02)
    assert before_ns / NS == pytest.approx(TIMES[199], abs=0.1)
    assert drift == 0.0


@pytest.mark.parametrize("ppm", [-3000.0, 900.0])
def test_a_drift_is_found_with_its_size_also_after_a_step(ppm: float) -> None:
    stamps = TIMES + 1e-6 * ppm * (TIMES - START_S)
    for step_s in (0.0, 8.0):
        found_s, _, drift, _ = received(stamps + step_s * (np.arange(500) >= 300)).change()
        assert found_s == pytest.approx(step_s, rel=0.02)
        assert 1e6 * drift == pytest.approx(ppm, rel=0.05)


@pytest.mark.parametrize("seed", range(5))
def test_a_recorder_that_stalls_and_times_that_repeat_are_no_change_of_the_clock(seed: int) -> None:
    still = TIMES.copy()
    still[100:140] = still[100]
    for stamps in (TIMES, still):
        found = received(stamps, stall_s=2.0, seed=seed)
        assert found.change()[:3] == (0.0, 0, 0.0)
        assert max(map(abs, found.range_s)) < 0.1


def test_memory_is_bounded_and_a_step_still_found() -> None:
    found = ReceivedTimes()
    for k in range(40_000):
        found.add(k * NS + 3 * NS * (k > 20_000), k * NS)
    assert len(found._blocks) <= 257
    assert found.change()[0] == pytest.approx(3.0)
