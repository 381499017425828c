"""Every reader, given changed files: it reads them, or refuses them in one line with the file."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from .mutations import EDITS, Change, Edit, changed
from .readers import READERS
from .watch import EVERY, Watch, watching

EXAMPLES = 280 // EVERY
EDIT = st.builds(Edit, st.integers(0, len(EDITS) - 1), st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1))
CHANGE = st.builds(Change, st.booleans(), st.lists(EDIT, min_size=1, max_size=4).map(tuple))
NUMBER = st.integers(0, 99)


@pytest.fixture(scope="module")
def watch() -> Iterator[Watch]:
    with watching() as found:
        yield found


@pytest.mark.parametrize("name", READERS)
def test_a_changed_file_is_read_or_refused_in_one_line(name: str, watch: Watch) -> None:
    reader = READERS[name]

    @settings(max_examples=EXAMPLES, database=None, suppress_health_check=list(HealthCheck))
    @given(NUMBER, NUMBER, CHANGE)
    def check(number: int, other: int, change: Change) -> None:
        seeds = reader.seeds
        data = changed(seeds[number % len(seeds)], change, seeds[other % len(seeds)], reader.layer)
        outcome = watch.outcome(reader, data)
        assert not outcome.found, (outcome, change)

    check()
