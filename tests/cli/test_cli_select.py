"""Selection of cameras with `occlog track`: options, columns, summary, one-line errors."""

from __future__ import annotations

import json

import numpy as np
import pytest
from tracker_scenes import observe, room100, walk

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.parquet import read_table, write_table
from occlog.io.provenance import Provenance
from occlog.io.scene_file import scene_to_yaml
from occlog.records import Diagnostics

pytestmark = pytest.mark.jit
SCENE = room100(pillar=False)
STEPS = 10
WITHOUT = ["--without", ",".join(f"cam{i}" for i in range(2, 9))]


@pytest.fixture
def base(tmp_path):
    (tmp_path / "scene.yaml").write_text(scene_to_yaml(SCENE))
    rng = np.random.default_rng(1)
    write_table(tmp_path / "bearings.parquet", observe(SCENE, walk(STEPS, rng), rng), Provenance("detect"))
    return [
        "track", str(tmp_path / "bearings.parquet"), "--scene", str(tmp_path / "scene.yaml"), "--particles", "200",
        "-o", str(tmp_path / "tracks.parquet"),
    ]  # fmt: skip


@pytest.mark.parametrize("policy", ["greedy", "brute-force", "fixed", "random", "closest", "all"])
def test_every_policy_writes_what_it_selected(policy, base, tmp_path, capsys):
    diagnostics = tmp_path / "d.parquet"
    model = "weak" if policy == "brute-force" else "perspective"
    args = ["--select", policy, "--count", "3", "--every", "2", "--select-model", model]
    assert run([*base, *args, "--diagnostics", str(diagnostics), "--json"]) == ExitCode.DONE
    said = json.loads(capsys.readouterr().out)
    table = read_table(diagnostics, Diagnostics)
    cameras = 8 if policy == "all" else 3
    assert {len(s.split(",")) for s in table.selected} == {cameras}
    np.testing.assert_array_equal(table.n_looked, cameras)
    assert np.isfinite(table.predicted_mse).sum() == STEPS / 2
    assert said["selections"] == STEPS / 2
    assert said["bytes_of_all_cameras"] == 8 * STEPS * 18
    assert said["bytes"] == 18 * cameras * STEPS + 4 * (said["messages"] - cameras * STEPS)
    assert said["bytes_saved"] == pytest.approx(1 - said["bytes"] / said["bytes_of_all_cameras"])


def test_the_order_of_fixed_cameras(base, tmp_path):
    diagnostics = tmp_path / "d.parquet"
    args = ["--select", "fixed", "--count", "2", "--select-order", "cam8,cam3,cam1", "--diagnostics", str(diagnostics)]
    assert run([*base, *args, "-q"]) == ExitCode.DONE
    assert set(read_table(diagnostics, Diagnostics).selected.tolist()) == {"cam3,cam8"}


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["--count", "3"], "--select; add it"),
        (["--select-model", "weak"], "--select; add it"),
        (["--select", "best"], "best"),
        (["--select", "greedy", "--count", "0"], "0"),
        (["--select", "greedy", "--every", "0"], "0"),
        (["--select", "greedy", "--count", "9"], "9 cameras of 8; select fewer"),
        (["--select", "greedy", "--select-order", "cam1"], "--select fixed"),
        (["--select", "fixed", "--count", "1", "--select-order", "cam9"], "no camera 'cam9'"),
        (["--select", "fixed", "--count", "3", "--select-order", "cam1,cam2"], "2 usable cameras, want 3"),
        (["--select", "greedy", "--count", "2", *WITHOUT], "2 cameras of 1"),
    ],
)
def test_what_does_not_fit_is_one_line(args, said, base, tmp_path, capsys):
    assert run([*base, *args]) == ExitCode.USAGE
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert said in error
    assert not (tmp_path / "tracks.parquet").exists()
