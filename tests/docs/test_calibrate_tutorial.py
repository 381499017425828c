"""The tutorial on videos without calibration: its commands run, and its figures are those that they print."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from places import DOCS

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.formats.scenes.scene import read_scene

PAGE = (DOCS / "tutorials" / "calibrate.md").read_text(encoding="utf-8")


def row_of(scene: str) -> list[float]:
    """MOTA, RMSE and IDF1 of a row of the table."""
    (line,) = re.findall(rf"^\| {re.escape(scene)} \|(.*)\|$", PAGE, re.MULTILINE)
    return [float(cell.strip().removesuffix(" m")) for cell in line.split("|")]


@pytest.mark.statistics
@pytest.mark.jit
def test_the_commands_of_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (scene,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    Path("rough.yaml").write_text(scene)
    blocks = re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
    commands = [shlex.split(line) for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    summaries = {}
    for name, *command in commands:
        assert name == "occlog"
        capsys.readouterr()
        assert run([*command, "--json"]) == ExitCode.DONE
        summaries[command[0]] = json.loads(capsys.readouterr().out)
    found, figures = summaries["calibrate"], summaries["evaluate"]
    assert [figures[name] for name in ("mota", "matched_rmse_m", "idf1")] == pytest.approx(
        row_of("`scene.yaml`"), abs=0.02
    )
    assert found["sigma_all_cameras"]["x"] == pytest.approx(0.25, abs=0.005)
    late = np.array([each["clock_offset_s"] for each in found["cameras"].values()])
    np.testing.assert_allclose(late, [0.0, 0.7, -0.4, 0.0], atol=0.05)
    assert Path("calibration.png").stat().st_size > 0
    assert [camera.name for camera in read_scene(Path("scene.yaml")).cameras] == list(found["cameras"])
    assert run(["track", "views.parquet", "--scene", "rough.yaml", "-o", "rough.parquet"]) == ExitCode.DONE
    capsys.readouterr()
    assert run(["evaluate", "rough.parquet", "--truth", "hall.mcap", "--json"]) == ExitCode.DONE
    figures = json.loads(capsys.readouterr().out)
    assert [figures[name] for name in ("mota", "matched_rmse_m", "idf1")] == pytest.approx(
        row_of("`rough.yaml`"), abs=0.05
    )
