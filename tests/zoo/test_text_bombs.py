"""Small texts that would take minutes, or memory without end: each is refused in one line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from apart import check_apart

from occlog.errors import ExitCode
from occlog.io.files.texts.yaml_nodes import LONGEST_NUMBER
from occlog.io.foreign.source import MAX_COLUMNS

CASES: dict[str, tuple[str, Callable[[], str], str]] = {
    "a number to the base of 60": (
        "a.yaml",
        lambda: "cameras: 1" + ":59" * 1_300_000,
        f"line 1: a number of 3900001 characters; at most {LONGEST_NUMBER} are read",
    ),
    "a fraction to the base of 60": ("a.yaml", lambda: "\n? 1" + ":59" * 1_300_000 + ".5\n: 1", "line 2: a number of "),
    "columns": (
        "a.csv",
        lambda: ",".join(["t"] + ["c"] * 490_000) + "\n" + (",".join(["1"] * 490_001) + "\n") * 3,
        f"490001 columns; a table of at most {MAX_COLUMNS} was expected",
    ),
}


@pytest.mark.parametrize(("name", "make", "words"), CASES.values(), ids=CASES)
def test_texts_take_no_longer_than_is_promised(tmp_path: Path, name: str, make: Callable[[], str], words: str) -> None:
    path = tmp_path / name
    path.write_text(make(), encoding="utf-8")
    told = check_apart("info", path)
    assert (told.code, told.told.strip().count("\n")) == (ExitCode.BAD_INPUT, 0)
    assert words in told.told
    assert check_apart("doctor", path).code in (ExitCode.LOSSY, ExitCode.BAD_INPUT)
