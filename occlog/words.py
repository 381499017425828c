"""Words beside numbers, in messages and summaries."""

from __future__ import annotations


def noun(count: float, one: str, many: str = "") -> str:
    """`one` for 1, `many` for other counts (`one` and an s where nothing else is said)."""
    return one if count == 1 else many or f"{one}s"


def counted(count: int, one: str, many: str = "") -> str:
    """`1 camera`, `2 cameras`, `2 boxes` with many="boxes"."""
    return f"{count} {noun(count, one, many)}"
