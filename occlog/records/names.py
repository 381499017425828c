"""Names of sensors, targets and nodes, which must differ."""

from __future__ import annotations

from collections.abc import Iterable


def first_double(names: Iterable[str]) -> str | None:
    """The first name that was there before; None where all differ.  It takes time in proportion to their number."""
    before: set[str] = set()
    for name in names:
        if name in before:
            return name
        before.add(name)
    return None
