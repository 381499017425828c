"""A run of the real stages, packed, is made again to the same bytes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode

SCENE = """
occlog_scene: 1
room: [[0, 0], [8, 0], [8, 6], [0, 6]]
cameras:
- {name: a, position: [0, 0], yaw_deg: 40, focal_px: 300, fov_deg: 100, noise: {measurement_noise_px: 2}}
- {name: b, position: [8, 0], yaw_deg: 140, focal_px: 300, fov_deg: 100, noise: {measurement_noise_px: 2}}
"""
CONFIG = """
occlog_run: 1
seed: 3
simulate: {scene: room.yaml, steps: 6}
track: {particles: 20}
"""


def test_a_packed_run_is_made_again_to_the_same_bytes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "room.yaml").write_text(SCENE)
    (tmp_path / "run.yaml").write_text(CONFIG)
    config, folder, archive = (str(tmp_path / name) for name in ("run.yaml", "out", "x.zip"))
    assert run(["run", config, "-o", folder, "-q"]) == ExitCode.DONE
    assert run(["pack", folder, "--config", config, "-o", archive]) == ExitCode.DONE
    capsys.readouterr()
    assert run(["verify", archive, "--json", "-q"]) == ExitCode.DONE
    found = json.loads(capsys.readouterr().out)
    assert found["result"] == "made again to the same bytes"
    assert (found["different"], found["same_values"], found["versions"]) == ({}, [], {})
    assert found["same_bytes"] == 11
