"""Noise at known places: what was put in comes out, with error bars, and too few readings are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tracker_scenes import observe, room100, walk

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.evaluate.bearings.noise import MIN_READINGS, measured_noise
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import read_scene, scene_to_yaml
from occlog.records.tables import Truth


def test_error_bars_hold_and_false_readings_do_not_count() -> None:
    rng, off = np.random.default_rng(0), []
    for _ in range(12):
        residual = 3.0 * rng.standard_normal(300)
        residual[rng.random(300) < 0.05] = rng.uniform(-200, 200)
        found = measured_noise(residual)
        assert found is not None
        assert found.readings == 300
        off.append((found.sigma - 3.0) / found.error)
    assert abs(np.mean(off)) < 1.0
    assert 0.4 < np.std(off) < 2.0


def test_too_few_readings_measure_nothing() -> None:
    residual = np.random.default_rng(1).standard_normal(MIN_READINGS)
    assert measured_noise(residual) is not None
    assert measured_noise(residual[1:]) is None


@pytest.fixture
def files(tmp_path: Path) -> list[str]:
    """Two cameras with 3 px of reading and no error of the pose, of which the scene says 1 px and 5 degrees of yaw."""
    true = room100(pillar=False, cameras=3, sigma_position=0.0, sigma_yaw=0.0, sigma_read_px=3.0)
    path = walk(250, np.random.default_rng(2))
    stated = room100(pillar=False, cameras=3, sigma_position=0.0, sigma_yaw=0.09, sigma_read_px=1.0)
    (tmp_path / "scene.yaml").write_text(scene_to_yaml(stated), encoding="utf-8")
    seen = observe(true, path, np.random.default_rng(3))
    few = (seen.sensor != "cam3") | (np.cumsum((seen.sensor == "cam3") & seen.seen) < MIN_READINGS)
    write_table(tmp_path / "seen.parquet", seen.take(few), Provenance("detect"), length_unit="unit")
    n = len(path)
    truth = Truth.of(
        t_ns=np.arange(n) * 1_000_000_000,
        target_id=np.zeros(n, dtype=np.int32),
        role=np.full(n, "target"),
        x=path[:, 0],
        y=path[:, 1],
        z=np.zeros(n),
    )
    write_table(tmp_path / "truth.parquet", truth, Provenance("simulate"), length_unit="unit")
    names = [str(tmp_path / name) for name in ("seen.parquet", "scene.yaml", "truth.parquet", "new.yaml")]
    return ["evaluate", "--bearings", names[0], "--scene", names[1], "--truth", names[2], "--write-scene", names[3]]


@pytest.mark.jit
def test_a_scene_is_written_with_the_noise_of_each_camera(files: list[str], capsys) -> None:
    assert run(files) == ExitCode.DONE
    new = read_scene(Path(files[-1]))
    for camera in new.cameras[:2]:
        assert camera.sigma_read_px == pytest.approx(3.0, rel=0.2)
        assert (camera.sigma_position, camera.sigma_yaw) == (0.0, 0.0)
    assert (new.cameras[2].sigma_read_px, new.cameras[2].sigma_yaw) == (1.0, 0.09)
    assert "cam3: fewer than 60 readings" in capsys.readouterr().err
    assert "#   cam1: " in Path(files[-1]).read_text(encoding="utf-8")
    assert run(files) != ExitCode.DONE  # is there already


def test_known_places_are_wanted(files: list[str], capsys) -> None:
    assert run(["evaluate", *files[1:5], *files[7:]]) == ExitCode.USAGE
    assert "--truth" in capsys.readouterr().err
    assert not Path(files[-1]).exists()
