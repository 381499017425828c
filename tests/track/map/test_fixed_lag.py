"""Fixed lag: which states are given out."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.track.methods.map.method import lag_ns, settled

TIMES = np.array([0, 10, 20, 30, 40])


@pytest.mark.parametrize(
    ("lag", "count"),
    [
        (None, 0),
        (0, 4),  # the last state never is
        (10, 4),  # exactly the lag before the end
        (11, 3),
        (20, 3),
        (40, 1),
        (41, 0),
    ],
)
def test_a_state_is_settled_from_exactly_the_lag_before_the_end(lag: int | None, count: int) -> None:
    assert settled(TIMES, lag) == count


def test_a_single_state_is_never_settled() -> None:
    assert settled(np.array([5]), 0) == 0


def test_a_lag_in_seconds_is_whole_nanoseconds() -> None:
    assert lag_ns(0.25) == 250_000_000
    assert lag_ns(None) is None
