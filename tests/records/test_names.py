"""The first name that is there twice."""

from __future__ import annotations

import pytest

from occlog.records.names import first_double


@pytest.mark.parametrize(
    ("names", "double"),
    [((), None), (("a",), None), (("a", "b"), None), (("a", "b", "b", "a"), "b"), (("", ""), ""), (("a", "A"), None)],
)
def test_the_first_name_that_was_there_before(names: tuple[str, ...], double: str | None) -> None:
    assert first_double(names) == double


def test_many_names_take_no_time_in_proportion_to_their_square() -> None:
    """Looked for pair by pair, these would take an hour."""
    names = [str(n) for n in range(300_000)]
    assert first_double(names) is None
    assert first_double([*names, "7"]) == "7"
