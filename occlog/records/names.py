"""Names of sensors, targets and nodes, which must differ."""

from __future__ import annotations

from collections.abc import Iterable


def first_double(names: Iterable[str]) -> str | None:
    """First repeated name; None if all differ.

    Linear in the number of names.
    """
    before: set[str] = set()
    for name in names:
        if name in before:
            return name
        before.add(name)
    return None
