"""`occlog evaluate` in space on files: directions of arrival next to bearings, and the options of the bound."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.recording.reader import open_recording
from occlog.records.tables import Bound, Doa, Errors, Tracks, Truth

SCENE = """
occlog_scene: 1
room: [[0, 0], [12, 0], [12, 8], [0, 8]]
room_height: 3
cameras:
  - {name: eye, position: [0, 0, 2.5], yaw_deg: 35, focal_px: 450, image_size_px: [640, 480], noise:
  {measurement_noise_px: 2}}
microphone_arrays:
  - {name: wall, position: [0.2, 7.5, 1.8], sigma_deg: 2, rate_hz: 10, pitch_deg: 20, yaw_deg: -45}
  - {name: ceiling, position: [11.5, 4, 2.8], sigma_deg: 2, rate_hz: 10}
"""
FULL = ["evaluate", "tracks.parquet", "--truth", "r.mcap", "--bearings", "r.mcap", "--json"]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of one walker 1.5 m above the floor, and tracks in space that are 0.3 m too high."""
    folder = tmp_path_factory.mktemp("space")
    (folder / "scene.yaml").write_text(SCENE)
    args = [
        "simulate",
        str(folder / "scene.yaml"),
        "-o",
        str(folder / "r.mcap"),
        "--seconds",
        "4",
        "--object-height",
        "1.5",
        "-q",
    ]
    assert run(args) == 0
    recording = open_recording(folder / "r.mcap")
    true, n = recording.read(Truth), len(recording.read(Truth))
    tracks = Tracks.of(
        t_ns=true.t_ns,
        target_id=true.target_id,
        x=true.x,
        y=true.y,
        z=true.z + 0.3,
        **dict.fromkeys(("vx", "vy", "vz"), np.full(n, np.nan)),
        **dict.fromkeys(("cov_xx", "cov_yy", "cov_zz"), np.full(n, 0.01)),
        **dict.fromkeys(("cov_xy", "cov_xz", "cov_yz"), np.zeros(n)),
    )
    write_table(folder / "tracks.parquet", tracks, Provenance("test"))
    write_table(folder / "doa.parquet", recording.read(Doa), Provenance("test"))
    return folder


def figures(args: list[str], capsys: pytest.CaptureFixture[str]) -> dict[str, float]:
    assert run(args) == ExitCode.DONE
    return dict(json.loads(capsys.readouterr().out))


def test_directions_of_the_recording_are_used_along_with_its_bearings(
    made: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.chdir(made)
    outputs = ["--errors", str(tmp_path / "errors.parquet"), "--bound", str(tmp_path / "bound.parquet")]
    m = figures([*FULL, *outputs], capsys)
    assert m["rmse_z_m"] == pytest.approx(0.3)
    assert m["rmse_space_m"] == pytest.approx(0.3)
    assert m["nees_space_mean"] == pytest.approx(9.0)
    assert {f"detected_sensor_{name}" for name in ("eye", "wall", "ceiling")} <= set(m)
    assert m["bound_ratio_space"] == pytest.approx(0.3 / m["bound_rmse_space_m"])
    assert m["bound_rmse_space_m"] < 0.25
    np.testing.assert_allclose(read_table(tmp_path / "errors.parquet", Errors).error_z, 0.3)
    bound = read_table(tmp_path / "bound.parquet", Bound)
    assert np.isfinite(bound.bound_space).all()
    assert bound.n_detected.max() == 3


def test_directions_in_a_file_of_their_own(
    made: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(made)
    beside = figures([*FULL, "--doa", "doa.parquet"], capsys)
    assert beside == figures(FULL, capsys)
    alone = figures(["evaluate", "tracks.parquet", "--truth", "r.mcap", "--doa", "doa.parquet", "--json"], capsys)
    assert alone["bound_rmse_space_m"] > beside["bound_rmse_space_m"]
    assert "detected_sensor_eye" not in alone


def test_options_of_the_bound(made: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(made)
    ground = figures([*FULL, "--bound-dimension", "ground"], capsys)
    assert "bound_rmse_space_m" not in ground
    assert ground["rmse_space_m"] == pytest.approx(0.3)
    space = figures(FULL, capsys)
    assert space["bound_rmse_m"] < ground["bound_rmse_m"]  # elevations tell of the ground too, once heights settle
    known = figures([*FULL, "--prior-z", "1e-6", "--process-noise", "0"], capsys)
    assert known["bound_rmse_z_m"] < 1.1e-3


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--prior-z", "0"], "prior-z"),
        (["--bound-dimension", "planes"], "bound-dimension"),
    ],
)
def test_bad_options(
    made: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], more: list[str], words: str
) -> None:
    monkeypatch.chdir(made)
    assert run([*FULL, *more]) == ExitCode.USAGE
    assert words in capsys.readouterr().err


def test_truth_without_heights_is_refused_in_one_line(
    made: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.chdir(made)
    true = open_recording(made / "r.mcap").read(Truth)
    columns = {c.name: getattr(true, c.name) for c in Truth.columns()}
    flat = Truth.of(**{**columns, "z": np.full(len(true), np.nan)})
    write_table(tmp_path / "flat.parquet", flat, Provenance("test"))
    args = ["evaluate", "--truth", str(tmp_path / "flat.parquet"), "--bearings", "r.mcap", "--bound-dimension", "space"]
    assert run(args) == ExitCode.BAD_INPUT
    err = capsys.readouterr().err.strip()
    assert "target 0 has no height" in err
    assert "\n" not in err


def test_labels_want_directions(
    made: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(made)
    assert run([*FULL, "--doa-labels"]) == ExitCode.BAD_INPUT  # there are directions, none with an identity
    assert "none of" in capsys.readouterr().err
