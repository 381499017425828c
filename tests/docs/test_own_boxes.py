"""The page on boxes of one's own: its commands run on the sample data, and print what it says."""

from __future__ import annotations

import json
import runpy
import shlex
import shutil
from pathlib import Path

import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode

ROOT = Path(__file__).resolve().parents[2]
SAMPLE = ROOT / "sample_data" / "boxes"
PAGE = (ROOT / "docs" / "how-to" / "own-boxes.md").read_text()


@pytest.mark.statistics
def test_the_commands_of_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(SAMPLE, tmp_path / "boxes")
    monkeypatch.chdir(tmp_path / "boxes")
    block = PAGE.split("```sh\n")[1].split("```")[0].replace("\\\n", " ")
    enter, *commands = [shlex.split(line) for line in block.splitlines()]
    assert enter == ["cd", "sample_data/boxes"]
    for command in commands:
        capsys.readouterr()
        assert command[0] == "occlog"
        assert run([*command[1:], "--json"]) == ExitCode.DONE
    figures = json.loads(capsys.readouterr().out)
    assert f"an RMSE of {100 * figures['rmse_m']:.1f} cm" in PAGE
    assert figures["id_switches"] == 0
    assert "no identity switch" in PAGE
    head = (SAMPLE / "left.csv").read_text().splitlines()[:3]
    assert "\n".join(head) in PAGE


def test_the_sample_data_are_what_their_script_makes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Calibrations are written by OpenCV, in the way of its version."""
    monkeypatch.setattr("sys.argv", ["make.py", str(tmp_path)])
    runpy.run_path(str(SAMPLE / "make.py"), run_name="__main__")
    for name in ("left.csv", "right.csv", "truth.csv"):
        assert (tmp_path / name).read_bytes() == (SAMPLE / name).read_bytes()
    # Commands of the page write other files here
    shipped = {p.name for p in SAMPLE.iterdir() if p.suffix in (".csv", ".yaml")}
    assert {path.name for path in tmp_path.iterdir()} == shipped - {"run.yaml"}
