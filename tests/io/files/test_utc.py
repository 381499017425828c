"""Times as people write them."""

from __future__ import annotations

import pytest

from occlog.io.files.timing.utc import time_words


@pytest.mark.parametrize(
    ("t_ns", "words"),
    [
        (0, "0 s"),
        (-1_500_000_000, "-1.5 s"),
        (7_000, "0.000007 s"),
        (1_577_836_800_100_000_000, "2020-01-01T00:00:00.100Z"),
        (1_577_836_800_000_000_001, "2020-01-01T00:00:00.000000001Z"),
    ],
)
def test_times_are_exact(t_ns: int, words: str) -> None:
    assert time_words(t_ns) == words
