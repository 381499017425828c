"""`occlog info` of a folder: a line a file, what cannot be read, and bags, which are one thing."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from places import ROOT

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.examine.info import MAX_ENTRIES
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.recognition import is_one_bag
from occlog.records.losses import Loss
from occlog.records.tables import Tracks

GOLDEN = ROOT / "tests" / "golden" / "expected" / "simulated"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A recording, a table, one that was cut off, text, and a folder."""
    for name in ("recording.mcap", "tracks.parquet"):
        shutil.copy(GOLDEN / name, tmp_path / name)
    (tmp_path / "cut.parquet").write_bytes((GOLDEN / "tracks.parquet").read_bytes()[:300])
    (tmp_path / "notes.txt").write_text("a note")
    (tmp_path / "more").mkdir()
    return tmp_path


def test_each_file_has_a_line(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["info", str(folder)]) == ExitCode.DONE
    head, cut, recording, tracks, others = capsys.readouterr().out.splitlines()
    assert head == "folder, 3 files that occlog reads"
    assert cut.startswith("cut.parquet     cannot be read: ")
    assert recording.startswith("recording.mcap  recording, ")
    assert tracks.startswith("tracks.parquet  table tracks, ")
    assert " to " in tracks
    assert others == "others: 1 x .txt, 1 x folder"


def test_the_same_as_json(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["info", str(folder), "--json"]) == ExitCode.DONE
    found = json.loads(capsys.readouterr().out)
    assert [each["file"] for each in found["files"]] == ["cut.parquet", "recording.mcap", "tracks.parquet"]
    assert found["files"][0]["kind"] == "unreadable"
    assert found["others"] == {".txt": 1, "folder": 1}
    assert found["complete"] is True


def test_an_empty_folder_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["info", str(tmp_path)]) == ExitCode.BAD_INPUT
    assert "is an empty folder" in capsys.readouterr().err


@pytest.mark.parametrize("more", [0, 1])
def test_of_very_many_entries_the_first_are_looked_at(
    more: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for n in range(MAX_ENTRIES + more):
        (tmp_path / f"{n}.txt").touch()
    assert run(["info", str(tmp_path)]) == ExitCode.DONE
    assert (f"entries after the first {MAX_ENTRIES} were not checked" in capsys.readouterr().out) == bool(more)


def test_parts_of_one_name_are_one_bag_and_recordings_are_none(folder: Path, tmp_path: Path) -> None:
    assert not is_one_bag(folder)
    bag = tmp_path / "bag"
    bag.mkdir()
    for n in range(2):
        (bag / f"walk_{n}.mcap").write_bytes(b"\x89MCAP0\r\n")
    assert is_one_bag(bag)
    (bag / "other_0.mcap").write_bytes(b"\x89MCAP0\r\n")
    assert not is_one_bag(bag)


def test_a_table_says_how_much_was_lost(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lost = Provenance("x", losses=(Loss("cam", "frames 3 to 9", "gone", 7),))
    write_table(tmp_path / "tracks.parquet", Tracks.empty(), lost)
    assert run(["info", str(tmp_path / "tracks.parquet")]) == ExitCode.DONE
    assert "lost      cam: frames 3 to 9: gone (7 lost)" in capsys.readouterr().out
