"""Functions and commands give the same bytes from the same files."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import pytest
from click.testing import CliRunner
from places import ROOT
from walk_frames import bearings_frame, stations_frame, truth_frame

import occlog
from occlog.cli.main import cli


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("walk")
    bearings_frame().to_csv(folder / "bearings.csv", index=False)
    stations_frame().to_csv(folder / "stations.csv", index=False)
    truth_frame().to_csv(folder / "truth.csv", index=False)
    return folder


def command(*args: object) -> str:
    made = CliRunner().invoke(cli, [str(a) for a in args], catch_exceptions=False)
    assert made.exit_code == 0, made.output
    return made.stdout


@pytest.mark.parametrize(("method", "setting"), [("fix", {}), ("ekf", {"process_noise_position": 1})])
def test_tracks_have_the_bytes_of_the_command(
    files: Path, tmp_path: Path, method: str, setting: dict[str, float]
) -> None:
    reported = [part for name, value in setting.items() for part in ("--set", f"{name}={value}")]
    bearings, stations = files / "bearings.csv", files / "stations.csv"
    out, filter_diagnostics = tmp_path / "tracks.parquet", tmp_path / "diagnostics.parquet"
    printed = command(
        "track",
        bearings,
        "--scene",
        stations,
        "--method",
        method,
        "-o",
        out,
        "--diagnostics",
        filter_diagnostics,
        "--json",
        *reported,
    )
    result = occlog.track(bearings, stations, method=method, **setting)
    result.tracks.save(tmp_path / "mine.parquet")
    result["diagnostics"].save(tmp_path / "fared.parquet")
    assert (tmp_path / "mine.parquet").read_bytes() == out.read_bytes()
    assert (tmp_path / "fared.parquet").read_bytes() == filter_diagnostics.read_bytes()
    content = json.loads(printed)
    assert {**content, "losses": None, "tracks": None} == {**result.summary, "losses": None, "tracks": None}


def test_figures_are_those_of_the_command(files: Path, tmp_path: Path) -> None:
    tracks, out = tmp_path / "tracks.parquet", tmp_path / "errors.parquet"
    command("track", files / "bearings.csv", "--scene", files / "stations.csv", "--method", "fix", "-o", tracks)
    printed = command("evaluate", tracks, "--truth", files / "truth.csv", "--errors", out, "--json")
    found = occlog.evaluate(tracks, files / "truth.csv")
    result = json.loads(printed)
    assert all(result[name] == value for name, value in found.metrics.items() if value == value)
    found["errors"].save(tmp_path / "mine.parquet")
    assert (tmp_path / "mine.parquet").read_bytes() == out.read_bytes()


def test_recordings_have_the_bytes_of_the_command(tmp_path: Path) -> None:
    scene = ROOT / "examples/room.yaml"
    out = tmp_path / "walk.mcap"
    command("simulate", scene, "-o", out, "--steps", 20, "--occluders", 2, "--seed", 4)
    recording = occlog.simulate(scene, steps=20, occluders=2, seed=4)
    assert recording.source.read_bytes() == out.read_bytes()
    assert recording["truth"].to_pandas().equals(occlog.open(out)["truth"].to_pandas())
    bearings = tmp_path / "bearings.parquet"
    command("detect", out, "-o", bearings)
    occlog.detect(out).bearings.save(tmp_path / "mine.parquet")
    assert (tmp_path / "mine.parquet").read_bytes() == bearings.read_bytes()


def test_pages_have_the_bytes_of_the_command(files: Path, tmp_path: Path) -> None:
    tracks, page = tmp_path / "tracks.parquet", tmp_path / "page.html"
    command("track", files / "bearings.csv", "--scene", files / "stations.csv", "--method", "fix", "-o", tracks)
    command("report", tracks, "--truth", files / "truth.csv", "-o", page)
    assert occlog.report(tracks, truth=files / "truth.csv").html == page.read_text(encoding="utf-8")


def test_frames_in_memory_give_the_rows_of_their_files(files: Path) -> None:
    of_files = occlog.track(files / "bearings.csv", files / "stations.csv", method="fix")
    in_memory = occlog.track(bearings_frame(), stations_frame(), method="fix")
    assert in_memory.tracks.to_pandas().equals(of_files.tracks.to_pandas())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figures = occlog.evaluate(in_memory, truth_frame()).metrics
    assert figures["rmse_m"] == occlog.evaluate(of_files.tracks, files / "truth.csv").metrics["rmse_m"]
