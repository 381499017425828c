"""Input files on the command line: missing ones, and `-` for standard input."""

from __future__ import annotations

import io
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.tables.parquet import read_provenance

TRUTH = b"t_ns,id,x,y\n1000,0,1,2\n2000,0,1.5,2\n"


class Piped:
    """A standard input that is no terminal."""

    def __init__(self, data: bytes) -> None:
        self.buffer = io.BytesIO(data)

    def isatty(self) -> bool:
        return False


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of temporary files, which must be empty after each command."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def piped(data: bytes, args: list[str], monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(sys, "stdin", Piped(data))
    return run(args)


def test_a_table_of_another_program_is_read_from_standard_input(
    temporary: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    assert piped(TRUTH, ["info", "-", "--json"], monkeypatch) == ExitCode.DONE
    assert json.loads(capsys.readouterr().out)["table"] == "tracks"
    out = str(tmp_path / "out.parquet")
    assert piped(TRUTH, ["export", "-", "-o", out, "--table", "truth"], monkeypatch) == ExitCode.DONE
    assert piped(Path(out).read_bytes(), ["diff", "-", out], monkeypatch) == ExitCode.DONE
    assert not list(temporary.iterdir())


def test_errors_speak_of_standard_input_and_leave_no_file(
    temporary: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    assert piped(TRUTH.replace(b"1.5", b"a"), ["export", "-", "-o", "-", "--to", "csv"], monkeypatch) == 4
    assert "standard input: line 3: x is 'a'" in capsys.readouterr().err
    assert piped(b"", ["info", "-"], monkeypatch) == ExitCode.BAD_INPUT
    assert "standard input: is empty" in capsys.readouterr().err
    assert not list(temporary.iterdir())


def test_two_inputs_cannot_both_be_standard_input(
    temporary: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    assert piped(TRUTH, ["diff", "-", "-"], monkeypatch) == ExitCode.USAGE
    assert "is an input already" in capsys.readouterr().err
    assert not list(temporary.iterdir())


def test_provenance_has_the_digest_of_what_was_piped(
    temporary: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    header = b"time,id,x,y,cov_xx,cov_xy,cov_yy\n"
    rows = header + b"".join(b"%d,0,%d,%d,0.1,0,0.1\n" % (k, k % 7, k % 5) for k in range(60))
    scene = tmp_path / "scene.csv"
    scene.write_text("name,x,y\na,0,0\n")
    out = tmp_path / "occluders.parquet"
    args = ["priors", "kalman", "-", "--scene", str(scene), "-o", str(out), "--measured"]
    assert piped(rows, args, monkeypatch) == ExitCode.DONE
    assert read_provenance(out).inputs[0][0] == "-"


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("berings.parquet", "berings.parquet: no such file; did you mean {}/bearings.parquet?"),
        ("tracks.csv", "tracks.csv: no such file; check the name and the folder"),
        ("bearings.parquet/a", "a: no such file; check the name and the folder"),
    ],
)
def test_a_missing_input_is_reported_with_the_nearest_name(
    name: str, expected: str, tmp_path: Path, capsys: Any
) -> None:
    (tmp_path / "bearings.parquet").write_bytes(b"PAR1")
    assert run(["evaluate", str(tmp_path / name)]) == ExitCode.BAD_INPUT
    assert expected.format(tmp_path) in capsys.readouterr().err


def test_a_missing_input_is_reported_before_anything_heavy_is_loaded(tmp_path: Path) -> None:
    code = """
import sys
from occlog.cli.main import run
for args in (["track", "a.csv", "-o", "t.csv"], ["detect", "a.mcap", "-o", "b.csv"], ["evaluate", "a.csv"]):
    assert run(args) == 4, args
print([name for name in ("numba", "scipy", "pyarrow", "pandas", "cv2") if name in sys.modules])
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
    assert done.stderr.count("no such file") == 3
