"""`occlog export` of cameras: formats by names of outputs, scenes of recordings, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from walking_people import cameras

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.formats.calibration.common import CalibrationOptions
from occlog.io.formats.calibration.reader import read_calibration
from occlog.io.formats.scenes.scene import read_scene, scene_to_yaml
from occlog.records.scene import Scene


def scene(folder: Path) -> str:
    (folder / "scene.yaml").write_text(scene_to_yaml(Scene(tuple(cameras()))))
    return str(folder / "scene.yaml")


@pytest.mark.parametrize("name", ["opencv", "colmap", "camera_info", "camchain.yaml"])
def test_cameras_are_the_same_when_read_again(tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / name
    assert run(["export", scene(tmp_path), "-o", str(out), "--json"]) == ExitCode.DONE
    assert json.loads(capsys.readouterr().out)["cameras"] == ["cam0", "cam1", "cam2"]
    for found, true in zip(read_calibration([out], "auto", CalibrationOptions("m")).cameras, cameras(), strict=True):
        np.testing.assert_allclose(found.position, true.position, atol=1e-12)
        np.testing.assert_allclose(found.rotation, true.rotation, atol=1e-12)
    assert run(["export", scene(tmp_path), "-o", str(out)]) == ExitCode.EXISTS
    assert run(["export", scene(tmp_path), "-o", str(out), "--overwrite"]) == ExitCode.DONE


def test_a_scene_file_is_written(tmp_path: Path) -> None:
    assert run(["export", scene(tmp_path), "-o", str(tmp_path / "again.yml")]) == ExitCode.DONE
    assert scene_to_yaml(read_scene(tmp_path / "again.yml")) == scene_to_yaml(Scene(tuple(cameras())))


def test_options_of_tables_are_refused(tmp_path: Path) -> None:
    asked = ["export", scene(tmp_path), "-o", str(tmp_path / "colmap")]
    assert run([*asked, "--target", "1"]) == ExitCode.USAGE
    assert run(["export", str(tmp_path / "scene.yaml"), "-o", "-", "--to", "ros"]) == ExitCode.USAGE
    assert not (tmp_path / "colmap").exists()
