"""Small texts that would take minutes, or memory without end: each is refused in one line."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import pytest
from apart import check_apart

from occlog.errors import ExitCode, InputError
from occlog.io.external.source import MAX_COLUMNS
from occlog.io.files.texts import csv_rows
from occlog.io.files.texts import documents as json_file
from occlog.io.files.texts.csv_rows import FREE_LINES, text_lines
from occlog.io.files.texts.documents import MAX_TOML_BYTES, toml_values
from occlog.io.files.texts.yaml import LONGEST_NUMBER

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
        f"490001 columns; at most {MAX_COLUMNS} are read",
    ),
}


@pytest.mark.parametrize(("name", "make", "words"), CASES.values(), ids=CASES)
def test_texts_take_no_longer_than_is_promised(tmp_path: Path, name: str, make: Callable[[], str], words: str) -> None:
    path = tmp_path / name
    path.write_text(make(), encoding="utf-8")
    outcome = check_apart("info", path)
    assert (outcome.code, outcome.output.strip().count("\n")) == (ExitCode.BAD_INPUT, 0)
    assert words in outcome.output
    assert check_apart("doctor", path).code in (ExitCode.LOSSY, ExitCode.BAD_INPUT)


def test_tables_of_toml_take_no_more_than_is_promised(tmp_path: Path) -> None:
    boxes, path = tmp_path / "b.csv", tmp_path / "c.toml"
    boxes.write_text("frame,left,top,width,height\n0,1,2,3,4\n", encoding="utf-8")
    words = ["--boxes", f"a={boxes}", "--fps", "10", "--calibration", path, "-o", tmp_path / "r.mcap"]
    lines = [f"[a{n}.b.c.d]" for n in range(200_000)]
    path.write_text("\n".join(lines), encoding="utf-8")
    outcome = check_apart("ingest", *words)
    assert (outcome.code, outcome.output.strip().count("\n")) == (ExitCode.BAD_INPUT, 0)
    with pytest.raises(InputError, match=f"in TOML of at most {MAX_TOML_BYTES} bytes"):
        toml_values(path.read_text(encoding="utf-8"), path, "a calibration")
    # As much as may be
    path.write_text("\n".join(lines)[:MAX_TOML_BYTES].rpartition("\n")[0], encoding="utf-8")
    assert check_apart("ingest", *words).code == ExitCode.BAD_INPUT


def test_a_packed_text_has_no_lines_without_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.csv.gz"
    path.write_bytes(gzip.compress(b"t,sensor,azimuth_deg\n" + b"\n" * 100_000_000, 9))
    outcome = check_apart("export", path, "-o", tmp_path / "b.csv")
    assert (outcome.code, outcome.output.strip().count("\n")) == (ExitCode.BAD_INPUT, 0)
    assert f"more than {FREE_LINES} lines, too many for {path.stat().st_size} compressed bytes" in outcome.output
    # As many as may be, and one more; in text that is not packed any number
    monkeypatch.setattr(csv_rows, "FREE_LINES", 1000)
    plain = tmp_path / "a.csv"
    for lines, good in ((1000, True), (1001, False)):
        text = b"x\n" * lines
        path.write_bytes(gzip.compress(text))
        plain.write_bytes(text)
        with gzip.open(path, "rt") as packed, plain.open() as unpacked:
            assert len(list(text_lines(plain, unpacked))) == lines
            with nullcontext() if good else pytest.raises(InputError, match="more than 1000 lines"):
                assert len(list(text_lines(path, packed))) == lines


JSON: dict[str, tuple[Callable[[], str], str]] = {
    "objects": (
        lambda: "[" + ",".join(["{}"] * 4_000_000) + "]",
        "4000001 objects and lists in 12000001 characters of JSON",
    ),
    "lists": (lambda: "[" + ",".join(["[]"] * 4_000_000) + "]", "4000001 objects and lists in"),
    "lines of lists": (lambda: "[]\n" * 900_000 + "\n" * 5_000_000, "5900000 lines in"),
    "numbers": (lambda: "[" + ",".join(["1"] * 6_000_000) + "]", "entry 1: '1'; an object with a box was expected"),
}


@pytest.mark.parametrize(("make", "words"), JSON.values(), ids=JSON)
def test_json_has_no_more_objects_than_say_anything(tmp_path: Path, make: Callable[[], str], words: str) -> None:
    path = tmp_path / "a.json"
    path.write_text(make(), encoding="utf-8")
    outcome = check_apart("ingest", "--boxes", f"a={path}", "--fps", "10", "-o", tmp_path / "r.mcap")
    assert (outcome.code, outcome.output.strip().count("\n")) == (ExitCode.BAD_INPUT, 0)
    assert words in outcome.output


def test_the_limits_of_json(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(json_file, "FREE_VALUES", 3)
    assert json_file.parse_json("[{},[]]", "a", "JSON") == json_file.parse_json(b"[{},[]]", "a", "JSON") == [{}, []]
    for text in ("[{},[],{}]", b"[{},[],{}]"):
        with pytest.raises(InputError, match="a: 4 objects and lists in 10 characters of JSON; at most 3 are read"):
            json_file.parse_json(text, "a", "JSON")
    assert len(json_file.parse_json("[{},[],{}" + " " * 50 + "]", "a", "JSON")) == 3
