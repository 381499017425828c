"""`occlog view`: which program is started with what, and what is stated where there is none."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.records.tables import Tracks


@pytest.fixture
def table(tmp_path: Path) -> Path:
    zero = {name: [0.0] for name in ("vx", "vy", "cov_xx", "cov_xy", "cov_yy")}
    write_table(
        tmp_path / "t.parquet", Tracks.of(t_ns=[5], target_id=[1], x=[1.0], y=[2.0], **zero), Provenance("test")
    )
    return tmp_path / "t.parquet"


def program(folder: Path, name: str, code: int = 0) -> Path:
    """A program that writes its arguments down, and whether the file is there."""
    path = folder / "bin" / name
    path.parent.mkdir(exist_ok=True)
    path.write_text(f'#!/bin/sh\nfor file; do :; done\necho "$@" > {folder}/said\ntest -s "$file" && exit {code}\n')
    path.chmod(0o755)
    return path


@pytest.mark.parametrize("name", ["rerun", "foxglove", "lichtblick"])
def test_the_viewer_that_is_installed_is_started(
    table: Path, name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PATH", f"{program(table.parent, name).parent}:/bin:/usr/bin")
    assert run(["view", str(table), "--json", "-q"]) == ExitCode.DONE
    shown = json.loads(capsys.readouterr().out)
    assert shown["format"] == ("rerun" if name == "rerun" else "foxglove")
    statement = (table.parent / "said").read_text().split()
    assert statement[-1] == shown["output"]
    assert statement[:-1] == (["--bind", "127.0.0.1", "--new"] if name == "rerun" else [])
    assert not Path(shown["output"]).exists()


def test_print_leaves_the_file_and_starts_nothing(
    table: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = table.parent / "a b.mcap"
    monkeypatch.setenv("PATH", f"{program(table.parent, 'foxglove').parent}:/bin:/usr/bin")
    assert run(["view", str(table), "--print", "-q", "-o", str(out), "--json"]) == ExitCode.DONE
    shown = json.loads(capsys.readouterr().out)
    assert shown["command"].endswith(f"foxglove '{out}'")
    assert out.is_file()
    assert Path(shown["layout"]).is_file()
    assert not (table.parent / "said").exists()


def test_a_file_that_was_made_for_a_viewer_is_opened_as_it_is(
    table: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = table.parent / "made.mcap"
    program(table.parent, "rerun")
    monkeypatch.setenv("PATH", f"{program(table.parent, 'lichtblick').parent}:/bin:/usr/bin")
    assert run(["export", str(table), "--to", "foxglove", "-o", str(path), "-q"]) == ExitCode.DONE
    before = path.read_bytes()
    assert run(["view", str(path)]) == ExitCode.DONE  # not in Rerun, which is looked for first
    assert (table.parent / "said").read_text().split() == [str(path)]
    assert path.read_bytes() == before
    assert run(["view", str(path), "--viewer", "rerun"]) == ExitCode.USAGE
    assert "the file is an export for foxglove" in capsys.readouterr().err
    assert run(["export", str(path), "--to", "rerun", "-o", str(table.parent / "again.mcap")]) == ExitCode.USAGE
    assert "is an export for foxglove" in capsys.readouterr().err


def test_a_file_that_was_made_for_all_viewers_is_opened_in_any(table: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = table.parent / "made.mcap"
    assert run(["export", str(table), "-o", str(path), "-q"]) == ExitCode.DONE
    for name in ("lichtblick", "rerun"):
        monkeypatch.setenv("PATH", f"{program(table.parent, name).parent}:/bin:/usr/bin")
        assert run(["view", str(path), "--viewer", name]) == ExitCode.DONE
        assert (table.parent / "said").read_text().split()[-1] == str(path)


def test_it_says_how_to_get_a_viewer(
    table: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PATH", str(table.parent))
    assert run(["view", str(table)]) == ExitCode.USAGE
    assert "no viewer is installed" in capsys.readouterr().err
    assert run(["view", str(table), "--viewer", "rerunn"]) == ExitCode.USAGE
    assert "--viewer rerunn: no such program" in capsys.readouterr().err
    assert run(["view", str(table), "--print"]) == ExitCode.USAGE
    assert "name it with -o" in capsys.readouterr().err


def test_a_viewer_that_fails_is_an_error(table: Path, capsys: pytest.CaptureFixture[str]) -> None:
    viewer = program(table.parent, "rerun", 3)
    assert run(["view", str(table), "--viewer", str(viewer), "-q"]) == ExitCode.BAD_INPUT
    assert "ended with code 3" in capsys.readouterr().err
