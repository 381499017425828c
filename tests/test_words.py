"""Words beside numbers."""

from __future__ import annotations

from occlog.words import counted, noun


def test_one_is_not_many() -> None:
    assert [counted(n, "camera") for n in (0, 1, 2)] == ["0 cameras", "1 camera", "2 cameras"]
    assert [counted(n, "box", "boxes") for n in (1, 3)] == ["1 box", "3 boxes"]
    assert noun(1.5, "row") == "rows"
