"""Options of every command: a dry run writes nothing and says what it would write; -v says what is done."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from places import ROOT

from occlog.cli.main import run
from occlog.console.summary import echo_summary
from occlog.errors import ExitCode

GOLDEN = ROOT / "tests" / "golden" / "expected" / "simulated"
RECORDING, TRACKS = str(GOLDEN / "recording.mcap"), str(GOLDEN / "tracks.parquet")
BEARINGS = str(GOLDEN / "bearings.parquet")
CASES = {
    "track": ["track", BEARINGS, "--scene", RECORDING, "--method", "ekf", "-o", "a", "--diagnostics", "b"],
    "simulate": ["simulate", str(ROOT / "examples" / "room.yaml"), "-o", "a.mcap", "--steps", "5"],
    "detect": ["detect", str(ROOT / "sample_data" / "room" / "recording.mcap"), "-o", "a"],
    "evaluate": ["evaluate", TRACKS, "--truth", RECORDING, "-o", "a.json", "--errors", "b"],
    "report": ["report", TRACKS, "--scene", RECORDING, "-o", "a.html"],
    "export": ["export", TRACKS, "-o", "a.csv"],
    "sweep": ["sweep", str(ROOT / "examples" / "sweep.yaml"), "-o", "a"],
    "fuse": ["fuse", BEARINGS, "--scene", RECORDING, "-o", "a"],
    "fit-motion": ["fit-motion", RECORDING, "-o", "a.json"],
}


@pytest.mark.parametrize("name", CASES)
def test_a_dry_run_writes_nothing_and_says_what_it_would_write(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run([*CASES[name], "--dry-run", "--json"]) == ExitCode.DONE
    result = json.loads(capsys.readouterr().out)
    written = [word for word in CASES[name] if word.startswith(("a", "b")) and len(word) < 8]
    assert result["would_write"] == written
    assert result["would_replace"] == []
    assert set(result["reads"]) >= {word for word in CASES[name] if word.startswith("/")} - {RECORDING}
    assert not list(tmp_path.iterdir())


def test_a_dry_run_finds_what_the_work_would_find_before_it_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a").write_text("")
    assert run([*CASES["track"], "--dry-run"]) == ExitCode.EXISTS
    assert run([*CASES["track"], "--dry-run", "--overwrite", "--json"]) == ExitCode.DONE
    assert json.loads(capsys.readouterr().out)["would_replace"] == ["a"]
    assert run([*CASES["track"], "--dry-run", "--overwrite", "--only", "nobody"]) == ExitCode.USAGE
    assert (tmp_path / "a").read_text() == ""


def test_details_say_what_inputs_are_taken_for_and_what_was_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run([*CASES["export"], "-v"]) == ExitCode.DONE
    err = capsys.readouterr().err
    assert "a table of occlog: tracks, lengths in m" in err
    assert f"wrote a.csv ({(tmp_path / 'a.csv').stat().st_size} bytes)" in err
    assert run([*CASES["export"], "--overwrite"]) == ExitCode.DONE
    assert capsys.readouterr().err == ""


def test_figures_of_each_of_many_take_a_line_each(capsys: pytest.CaptureFixture[str]) -> None:
    echo_summary(
        {"rows": 3, "boxes": {"cam_1": {"unassociated": 2, "seen": 1.5}, "cam_2": {}}, "detection_rates": {"a": 1}},
        False,
    )
    assert capsys.readouterr().out.splitlines() == [
        "rows:            3",
        "boxes:           cam_1: unassociated 2, seen 1.5",
        "                 cam_2:",
        "detection rates: a 1",
    ]


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (0.123456, "0.1235"),
        (9999.4, "9999"),
        (29_999.99, "30000"),
        (-18_000.0, "-18000"),
        (1e16, "1e+16"),
        (1e-9, "1e-09"),
    ],
)
def test_large_figures_are_reported_without_powers_of_ten(
    capsys: pytest.CaptureFixture[str], value: float, words: str
) -> None:
    echo_summary({"seconds": value}, as_json=False)
    assert capsys.readouterr().out == f"seconds: {words}\n"
