"""Words next to numbers, and words of files."""

from __future__ import annotations

from occlog.console.text import LONGEST, counted, in_seconds, noun, shortened


def test_one_is_not_many() -> None:
    assert [counted(n, "camera") for n in (0, 1, 2)] == ["0 cameras", "1 camera", "2 cameras"]
    assert [counted(n, "box", "boxes") for n in (1, 3)] == ["1 box", "3 boxes"]
    assert noun(1.5, "row") == "rows"


def test_what_comes_from_files_moves_no_cursor_and_fills_no_page() -> None:
    assert shortened("a\x1b[2J\x00b\x85\u2028\u202ec\nd\té") == "a\\x1b[2J\\x00b\\x85\\u2028\\u202ec\nd\té"
    long = shortened(f"begin {'x' * 10_000} end")
    assert len(long) <= LONGEST
    assert long.startswith("begin xx")
    assert long.endswith("xx end")


def test_times_in_seconds_keep_every_digit() -> None:
    assert [in_seconds(t) for t in (0, 1_250_000_000, -1, 1_700_000_000_000_000_001)] == [
        "0",
        "1.25",
        "-0.000000001",
        "1700000000.000000001",
    ]
