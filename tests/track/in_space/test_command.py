"""Tracking in space on files: arrays of different rates, labels, bad settings."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.tables.parquet import read_table
from occlog.records.tables import Diagnostics, Tracks

SCENE = """\
occlog_scene: 1
length_unit: m
room: [[0, 0], [8, 0], [8, 6], [0, 6]]
room_height: 3
microphone_arrays:
- {name: north, position: [4, 5.8, 2.5], yaw_deg: -90, pitch_deg: -20, sigma_deg: 2, rate_hz: 10}
- {name: west, position: [0.2, 3, 1.0], sigma_deg: 2, rate_hz: 4}
"""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("space")
    (folder / "scene.yaml").write_text(SCENE, encoding="utf-8")
    path = folder / "talk.mcap"
    command = [
        "simulate",
        folder / "scene.yaml",
        "-o",
        path,
        "--seconds",
        "12",
        "--object-height",
        "1.6",
        "--seed",
        "3",
        "-q",
    ]
    assert run([str(c) for c in command]) == 0
    return path


def track(recording: Path, out: Path, *options: str) -> int:
    return run(["track", str(recording), "-o", str(out), "-q", "--overwrite", "--particles", "500", *options])


@pytest.mark.jit
@pytest.mark.parametrize("method", ["direct3d", "pps"])
def test_arrays_of_two_rates_give_a_track_with_height(recording, tmp_path, capsys, method) -> None:
    out, reported = tmp_path / "t.parquet", tmp_path / "d.parquet"
    assert track(recording, out, "--method", method, "--diagnostics", str(reported)) == 0
    tracks = read_table(out, Tracks)
    assert len(tracks) == 145  # 121 times of one array, 49 of the other, 25 in common
    assert np.isfinite(tracks.z).all()
    assert (tracks.cov_zz > 0).all()
    late = tracks.t_ns > tracks.t_ns[0] + 2_000_000_000
    assert np.abs(tracks.z[late] - 1.6).max() < 0.8
    used = set(read_table(reported, Diagnostics).cameras.tolist())
    assert used == {"north", "west", "north,west"}
    capsys.readouterr()
    assert run(["evaluate", str(out), "--truth", str(recording), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["error_space_median_m"] < 0.4


@pytest.mark.jit
def test_same_seed_same_track_and_another_seed_another(recording, tmp_path) -> None:
    files = [tmp_path / f"{k}.parquet" for k in range(3)]
    for path, seed in zip(files, ("1", "1", "2"), strict=True):
        assert track(recording, path, "--method", "direct3d", "--seed", seed) == 0
    one, two, three = (read_table(path, Tracks) for path in files)
    np.testing.assert_array_equal(one.z, two.z)
    assert np.any(one.z != three.z)


@pytest.mark.parametrize(
    ("options", "code", "reported"),
    [
        (["--method", "direct3d", "--set", "likelihood=round"], ExitCode.USAGE, "one of product, cone"),
        (["--method", "pps", "--set", "likelihood=cone"], ExitCode.USAGE, "no setting 'likelihood'"),
        (["--method", "pps", "--set", "acceleration=1,2"], ExitCode.USAGE, "must be AX,AY,AZ"),
        (["--method", "direct3d", "--set", "start=1,2,3,4,5"], ExitCode.USAGE, "must be X,Y,SIGMA"),
        (["--method", "direct3d", "--set", "turn_plane=yx"], ExitCode.USAGE, "one of xy, yz, zx"),
    ],
)
def test_bad_settings_are_one_line(recording, tmp_path, capsys, options, code, reported) -> None:
    assert track(recording, tmp_path / "t.parquet", *options) == code
    error = capsys.readouterr().err
    assert reported in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("method", ["direct3d", "pps", "fix"])
def test_moving_occluders_are_refused(recording, tmp_path, capsys, method) -> None:
    command = ["track", str(recording), "-o", str(tmp_path / "t.parquet"), "-q", "--method", method]
    assert run([*command, "--occluders", str(recording)]) == ExitCode.USAGE
    error = capsys.readouterr().err
    assert f"--occluders is an option of --method apf, map, not of --method {method}" in error
    assert error.count("\n") == 1


@pytest.mark.jit
@pytest.mark.parametrize("method", ["direct3d", pytest.param("pps", marks=pytest.mark.statistics)])
def test_what_is_heard_later_lowers_the_error(recording, tmp_path, capsys, method) -> None:
    errors, times = {}, {}
    for name, options in {"filter": [], "all": ["--smooth"], "lag": ["--lag", "1"]}.items():
        out = tmp_path / f"{name}.parquet"
        assert track(recording, out, "--method", method, *options) == 0
        times[name] = read_table(out, Tracks).t_ns
        capsys.readouterr()
        assert run(["evaluate", str(out), "--truth", str(recording), "--json"]) == 0
        errors[name] = json.loads(capsys.readouterr().out)["rmse_m"]
    np.testing.assert_array_equal(times["all"], times["filter"])
    np.testing.assert_array_equal(times["lag"], times["filter"])
    assert errors["all"] < 0.85 * errors["filter"]
    assert errors["lag"] < 0.9 * errors["filter"]
