"""`occlog track --method fix` on files: what one camera alone can and cannot tell."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tracker_scenes import observe, room100, walk

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.records.tables import Tracks

STEPS = 12


@pytest.fixture
def command(tmp_path: Path) -> list[str]:
    """Track what the cameras of a room saw of one target."""
    scene, rng = room100(pillar=False), np.random.default_rng(1)
    (tmp_path / "scene.yaml").write_text(scene_to_yaml(scene), encoding="utf-8")
    write_table(tmp_path / "seen.parquet", observe(scene, walk(STEPS, rng), rng), Provenance("detect"))
    paths = {name: str(tmp_path / name) for name in ("seen.parquet", "scene.yaml", "out.parquet")}
    return [
        "track",
        paths["seen.parquet"],
        "--scene",
        paths["scene.yaml"],
        "--method",
        "fix",
        "-o",
        paths["out.parquet"],
    ]


def test_one_camera_gives_no_position_and_the_message_says_what_is_wanted(command, capsys) -> None:
    assert run([*command, "--cameras", "cam1"]) == ExitCode.BAD_INPUT
    error = capsys.readouterr().err
    assert "no time step of the chosen targets and sensors gives a position" in error
    assert "needs two directions at one time (--window) with lines that meet" in error
    assert error.count("\n") == 1
    assert not Path(command[-1]).exists()


def test_two_cameras_give_positions(command) -> None:
    assert run([*command, "--cameras", "cam1,cam3", "-q"]) == ExitCode.DONE
    assert 0 < len(read_table(Path(command[-1]), Tracks)) <= STEPS
