"""The comparison of `python -m tests.unchanged` finds what differs, and only that."""

from __future__ import annotations

import argparse
import io
import json
import subprocess
import sys
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from mcap.writer import Writer

from tests.mutate import options_of
from tests.unchanged.__main__ import PRINTED, ROOT, differences, done, run_section, sections, try_mutants
from tests.unchanged.compare import Tolerance, first_difference

EXACT, CLOSE = Tolerance(), Tolerance(1e-12)
MADE = {
    "program": "occlog",
    "version": "1",
    "command": "track",
    "seed": 1,
    "inputs": ["ab"],
    "versions": {"numpy": "2"},
}


def parquet(x: float = 0.5, unit: str = "m", **made: object) -> bytes:
    out = io.BytesIO()
    metadata = {"unit": unit, "made": json.dumps({**MADE, **made})}
    table = pa.table({"t_ns": [1, 2], "x": [x, float("nan")], "name": ["a", None]})
    pq.write_table(table.replace_schema_metadata(metadata), out)
    return out.getvalue()


def mcap(data: bytes = b"{}", **made: object) -> bytes:
    out = io.BytesIO()
    writer = Writer(out)
    writer.start()
    channel = writer.register_channel("/a", "json", writer.register_schema("s", "jsonschema", b"{}"))
    writer.add_message(channel, 5, data, 5)
    writer.add_metadata("provenance", {"json": json.dumps({**MADE, **made})})
    writer.finish()
    return out.getvalue()


def test_versions_and_the_command_may_differ_and_nothing_else() -> None:
    for name, write in (("a.parquet", parquet), ("a.mcap", mcap)):
        given = write()
        assert first_difference(given, write(version="2", versions={}, command="run"), name, EXACT) is None
        assert "seed" in (first_difference(given, write(seed=2), name, CLOSE) or "")
        assert "inputs" in (first_difference(given, write(inputs=["cd"]), name, EXACT) or "")
        assert first_difference(given, write(inputs=["cd"]), name, CLOSE) is None
    assert "message 0" in (first_difference(mcap(), mcap(b"[]"), "a.mcap", CLOSE) or "")
    assert "unit" in (first_difference(parquet(), parquet(unit="cm"), "a.parquet", CLOSE) or "")


@pytest.mark.parametrize(("factor", "same"), [(1 + 4e-13, True), (1 + 2e-12, False)])
def test_numbers_are_equal_within_the_tolerance(factor: float, same: bool) -> None:
    pairs = {
        "a.parquet": (parquet(0.5), parquet(0.5 * factor)),
        "a.json": (b'{"x": [0.5, null]}', json.dumps({"x": [0.5 * factor, None]}).encode()),
        "a.csv": (b"x,y\n0.5,a\n", f"x,y\n{0.5 * factor!r},a\n".encode()),
    }
    for name, (a, b) in pairs.items():
        assert first_difference(a, b, name, EXACT) is not None
        assert (first_difference(a, b, name, CLOSE) is None) == same


def test_the_first_place_is_named() -> None:
    assert "column x, row 0: " in (first_difference(parquet(1.0), parquet(2.0), "a.parquet", EXACT) or "")
    assert (first_difference(b'{"a": {"b": 1}}', b'{"a": {"b": 2}}', "a.json", EXACT) or "").startswith("a.b: ")
    assert (first_difference(b"1\n2 m\n", b"1\n2 cm\n", "a.txt", CLOSE) or "").startswith("line 2: ")


def test_exit_codes_files_and_printed_json_count_and_other_words_do_not(tmp_path: Path) -> None:
    lines = sections("# a comment\n[one]\nocclog --version\n! occlog nothing\nocclog schema tracks --json\n")["one"]
    assert len(lines) == 3
    sides = tmp_path / "a", tmp_path / "b"
    for side in sides:
        (side / PRINTED).mkdir(parents=True)
        for n, code in enumerate((0, 2, 0)):
            (side / PRINTED / f"{n}.code").write_text(f"{code}\n")
            (side / PRINTED / f"{n}.err").write_text("")
        (side / "x.csv").write_text("1\n")
        (side / PRINTED / "2.out.json").write_text("{}")
    assert list(differences(lines, *sides, EXACT)) == []
    (sides[1] / PRINTED / "0.err").write_text("a note")
    assert [kind for kind, _, _ in differences(lines, *sides, EXACT)] == ["~"]
    (sides[1] / PRINTED / "1.code").write_text("0\n")
    (sides[1] / PRINTED / "2.out.json").write_text("[]")
    (sides[1] / "x.csv").unlink()
    found = [where for kind, where, _ in differences(lines, *sides, EXACT) if kind == "!"]
    assert found == ["! occlog nothing", "out.json of occlog schema tracks --json", "x.csv"]


def test_a_section_that_was_stopped_goes_on_and_one_that_has_changed_begins_again(tmp_path: Path) -> None:
    lines = [f"python -c \"open('{name}', 'w')\"" for name in "abc"]
    python, folder = Path(sys.executable), tmp_path / "one"
    run_section(python, lines[:2], folder, 60)
    (folder / "a").write_text("kept")
    run_section(python, lines, folder, 60)
    assert [line for line, _ in done(folder)] == lines
    assert (folder / "a").read_text() == "kept"
    assert (folder / "c").exists()
    run_section(python, lines[1:], folder, 60)
    assert not (folder / "a").exists()


@pytest.mark.parametrize("noticed", [8, 9])
def test_nine_of_ten_mutants_of_a_folder_must_be_noticed(monkeypatch: pytest.MonkeyPatch, noticed: int) -> None:
    asked = []

    def ended(command: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        asked.append(options_of(command[3:]))
        return subprocess.CompletedProcess(command, 0, f"x: {noticed} of 10 noticed, 99 places\n", "")

    monkeypatch.setattr(subprocess, "run", ended)
    folder = "occlog/track/methods/in_space/kernels"
    given = argparse.Namespace(base=ROOT, mutants=[f"{folder}=tests/a,tests/b"], count=10, jit=False)
    assert try_mutants(given) == (noticed == 9)
    assert [(o.modules, o.tests, o.count) for o in asked] == [(folder, ["tests/a", "tests/b"], 10)]
