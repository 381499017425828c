"""Numbers in names: the last one counts, and digits of hashes are none."""

from __future__ import annotations

import pytest

from occlog.io.files.names import last_number


@pytest.mark.parametrize(
    ("name", "number"),
    [
        ("frame_000012", "000012"),
        ("cam2_000003_x", "000003"),
        ("a", None),
        ("", None),
        ("12", "12"),
        ("frame_000012_jpg.rf.5f3a1d9c0b7e42868d1f5b3c2a1e0f94", "000012"),
        ("clip-7_mp4-33_jpg.rf.Zk3xQ9", "33"),
        ("a.rf.12", None),
        ("rf.12", "12"),
        ("1.rf.2.rf.3", "2"),
        ("9" * 100_000 + "a", "9" * 100_000),
        ("9" * 100_000 + "a1b", "1"),
    ],
    ids=lambda value: str(value)[:30],
)
def test_the_last_number_counts(name: str, number: str | None) -> None:
    assert last_number(name) == number
