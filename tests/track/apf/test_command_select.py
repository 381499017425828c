"""Selection of cameras with `occlog track`: options, columns, summary, one-line errors."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from tracker_scenes import observe, room100, walk

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import read_provenance, read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.records.tables import Diagnostics, Tracks

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
        "track",
        str(tmp_path / "bearings.parquet"),
        "--scene",
        str(tmp_path / "scene.yaml"),
        "--particles",
        "200",
        "-o",
        str(tmp_path / "tracks.parquet"),
    ]


@pytest.mark.parametrize("policy", ["greedy", "brute-force", "fixed", "random", "closest", "all"])
def test_every_policy_writes_what_it_selected(policy, base, tmp_path, capsys):
    diagnostics = tmp_path / "d.parquet"
    model = "weak" if policy == "brute-force" else "perspective"
    args = [
        "--select",
        policy,
        "--n-cameras",
        "3",
        "--selection-interval",
        "2",
        "--select-model",
        model,
        "--max-blind-scans",
        "0",
    ]
    assert run([*base, *args, "--diagnostics", str(diagnostics), "--json"]) == ExitCode.DONE
    stdout = json.loads(capsys.readouterr().out)
    table = read_table(diagnostics, Diagnostics)
    cameras = 8 if policy == "all" else 3
    assert {len(s.split(",")) for s in table.selected} == {cameras}
    np.testing.assert_array_equal(table.n_observing, cameras)
    assert np.isfinite(table.predicted_mse).sum() == STEPS / 2
    stdout = stdout["network"]
    assert stdout["selections"] == STEPS / 2
    assert stdout["bytes_all_cameras"] == 8 * STEPS * 18
    assert stdout["bytes"] == 18 * cameras * STEPS + 4 * (stdout["messages"] - cameras * STEPS)
    assert stdout["share_saved"] == pytest.approx(1 - stdout["bytes"] / stdout["bytes_all_cameras"])


def test_the_order_of_fixed_cameras(base, tmp_path):
    diagnostics = tmp_path / "d.parquet"
    args = [
        "--select",
        "fixed",
        "--n-cameras",
        "2",
        "--camera-order",
        "cam8,cam3,cam1",
        "--diagnostics",
        str(diagnostics),
    ]
    assert run([*base, *args, "-q"]) == ExitCode.DONE
    assert set(read_table(diagnostics, Diagnostics).selected.tolist()) == {"cam3,cam8"}


@pytest.mark.parametrize(
    ("args", "reported"),
    [
        (["--n-cameras", "3"], "--select; add it"),
        (["--selection-interval", "2"], "--select; add it"),
        (["--max-blind-scans", "2"], "--select; add it"),
        (["--select", "greedy", "--max-blind-scans", "-1"], "--max-blind-scans"),
        (["--camera-order", "cam1"], "--select; add it"),
        (["--select"], "'--select' requires an argument"),
        (["--select", "greedy", "--n-cameras", "-1"], "--n-cameras"),
        (["--select", "greedy", "--n-cameras", "two"], "'two'"),
        (["--select", "greedy", "--selection-interval", "nan"], "'--selection-interval': nan is not a finite number"),
        (["--select", "greedy", "--selection-interval", "inf"], "'--selection-interval': inf is not a finite number"),
        (["--select", "greedy", "--selection-interval", "-3"], "'--selection-interval'"),
        (["--select", "greedy", "--select-model", "flat"], "'flat' is not one of 'perspective', 'weak'"),
        (["--select", "fixed", "--camera-order", "cam1,cam2"], "2 usable cameras, and 4 "),
        (["--select", "fixed", "--n-cameras", "2", "--camera-order", "cam1,cam1"], "1 usable cameras, and 2 "),
        (["--select", "greedy", "--cameras", "cam1,cam2,cam3"], "--n-cameras 3 or less"),
        (["--window", "nan"], "'--window': nan is not a finite number"),
        (["--select-model", "weak"], "--select; add it"),
        (["--select", "best"], "best"),
        (["--select", "greedy", "--n-cameras", "0"], "0"),
        (["--select", "greedy", "--selection-interval", "0"], "0"),
        (["--select", "greedy", "--n-cameras", "9"], "--n-cameras 8 or less"),
        (["--select", "greedy", "--camera-order", "cam1"], "--select fixed"),
        (["--select", "fixed", "--n-cameras", "1", "--camera-order", "cam9"], "no camera 'cam9'"),
        (["--select", "fixed", "--n-cameras", "3", "--camera-order", "cam1,cam2"], "2 usable cameras, and 3 "),
        (["--select", "greedy", "--n-cameras", "2", *WITHOUT], "--n-cameras 1 or less"),
    ],
)
def test_what_does_not_fit_is_one_line(args, reported, base, tmp_path, capsys):
    assert run([*base, *args]) == ExitCode.USAGE
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert reported in error
    assert not (tmp_path / "tracks.parquet").exists()


def test_without_a_count_there_are_four(base, tmp_path, capsys):
    assert run([*base, "--select", "greedy", "--max-blind-scans", "0", "--json"]) == ExitCode.DONE
    stdout = json.loads(capsys.readouterr().out)
    stdout = stdout["network"]
    assert stdout["selections"] == STEPS / 5
    reports = 4 * STEPS
    assert stdout["bytes"] == 18 * reports + 4 * (stdout["messages"] - reports)


def test_too_many_subsets_are_refused(tmp_path, capsys):
    many = replace(SCENE, cameras=tuple(replace(SCENE.cameras[i % 8], name=f"c{i}") for i in range(30)))
    (tmp_path / "scene.yaml").write_text(scene_to_yaml(many))
    rng = np.random.default_rng(1)
    write_table(tmp_path / "bearings.parquet", observe(many, walk(3, rng), rng), Provenance("detect"))
    args = [
        "track",
        str(tmp_path / "bearings.parquet"),
        "--scene",
        str(tmp_path / "scene.yaml"),
        "--particles",
        "50",
        "-o",
        str(tmp_path / "tracks.parquet"),
        "--select",
        "brute-force",
    ]
    assert run([*args, "--n-cameras", "8"]) == ExitCode.USAGE
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "5852925 subsets, limit 50000; use greedy" in error
    assert not (tmp_path / "tracks.parquet").exists()
    assert run([*args, "--n-cameras", "2", "-q"]) == ExitCode.DONE


def test_the_selection_is_in_the_provenance_and_runs_are_alike(base, tmp_path):
    args = ["--select", "random", "--n-cameras", "2", "--selection-interval", "3", "--seed", "5", "-q"]
    tables = []
    for name in ("a", "b"):
        assert run([*base, *args, "--overwrite", "--diagnostics", str(tmp_path / name)]) == ExitCode.DONE
        tables.append((tmp_path / name).read_bytes())
    assert tables[0] == tables[1]
    assert read_provenance(tmp_path / "a").parameters["selection"] == {
        "policy": "random",
        "max_blind_scans": 1,
        "n_cameras": 2,
        "selection_interval": 3.0,
        "model": "perspective",
        "camera_order": [],
    }


def test_selecting_all_writes_the_track_without_selection(base, tmp_path):
    assert run([*base, "-q"]) == ExitCode.DONE
    plain = read_table(tmp_path / "tracks.parquet", Tracks)
    assert run([*base, "-q", "--overwrite", "--select", "all"]) == ExitCode.DONE
    selected = read_table(tmp_path / "tracks.parquet", Tracks)
    for column in Tracks.columns():
        np.testing.assert_array_equal(getattr(selected, column.name), getattr(plain, column.name))
