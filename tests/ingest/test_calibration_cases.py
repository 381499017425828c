"""Calibrations that were once read wrongly, or refused: each with its right value, from files to the evaluation."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode

TWO = "--boxes left=left.csv --boxes right=right.csv --fps 10"
FOUR = f"{TWO} --boxes back=back.csv --boxes side=side.csv --image-size 1280x720"
THREE = "--boxes boxes.csv --calibration c0.yaml --calibration c1.yaml --calibration c2.yaml --fps 10"


def ingest(folder: Path, output: Path, options: str, monkeypatch: pytest.MonkeyPatch) -> ExitCode:
    monkeypatch.chdir(folder)
    truth = ["--truth", "truth.csv"] if (folder / "truth.csv").is_file() else []
    return ExitCode(run(["ingest", "-o", str(output), *options.split(), *truth]))


def beginning(case: Path, copy: Path, seconds: float = 10.0) -> Path:
    """A copy of a case with the first seconds of its boxes and its truth; their first column is a frame or a time."""
    shutil.copytree(case, copy)
    for path in copy.glob("*.csv"):
        head, *rows = path.read_text().splitlines(keepends=True)
        limit = seconds if head.startswith("time") else 10 * seconds
        path.write_text(head + "".join(row for row in rows if float(row.partition(",")[0]) < limit))
    return copy


@pytest.mark.parametrize(
    ("case", "options", "expected"),
    [
        ("v16-left-handed-world", f"{FOUR} --calibration P", "seems left-handed (Unity, MultiviewX)"),
        ("v17-fisheye-coefficients-without-flag", f"{TWO} --calibration calib", "state which: --lens-model fisheye"),
        ("v18-wide-fisheye", f"{TWO} --calibration calib", "more than 80 degrees off its axis; what lies beyond, 26%"),
        ("w04_calibration_of_other_size", THREE, "(factor 1.5); if images had that size, give --image-size 1280x720"),
    ],
)
def test_what_a_calibration_lacks_is_reported(
    shared_cases: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    case: str,
    options: str,
    expected: str,
) -> None:
    ingest(shared_cases / case, tmp_path / "w.mcap", options, monkeypatch)
    assert expected in capsys.readouterr().err


@pytest.mark.parametrize(
    ("case", "options", "idf1", "rmse"),
    [
        ("v04-ros-binning", f"{TWO} --calibration rosbin", 0.8, 0.08),
        ("v16-left-handed-world", f"{FOUR} --calibration P --mirror y", 1.0, 0.055),
        ("v17-fisheye-coefficients-without-flag", f"{TWO} --calibration calib --lens-model fisheye", 0.99, 0.065),
        ("v18-wide-fisheye", f"{TWO} --calibration calib", 0.99, 0.06),
        ("w04_calibration_of_other_size", f"{THREE} --image-size 1280x720", 1.0, 0.065),
        ("w06_rational_distortion", THREE, 0.99, 0.06),
    ],
)
def test_people_are_tracked_as_with_a_plain_calibration(
    shared_cases: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    case: str,
    options: str,
    idf1: float,
    rmse: float,
) -> None:
    recording, tracks = str(tmp_path / "w.mcap"), str(tmp_path / "t.parquet")
    folder = beginning(shared_cases / case, tmp_path / case)
    assert ingest(folder, tmp_path / "w.mcap", options, monkeypatch) == ExitCode.DONE
    assert run(["track", recording, "--method", "jipda", "-o", tracks]) == ExitCode.DONE
    capsys.readouterr()
    assert run(["evaluate", tracks, "--truth", recording, "--json"]) == ExitCode.DONE
    found = json.loads(capsys.readouterr().out)
    assert found["idf1"] >= idf1
    assert found["matched_rmse_m"] < rmse


def test_eight_coefficients_of_opencv_are_read(
    shared_cases: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = f"{TWO} --calibration r8"
    assert ingest(shared_cases / "v19-rational-lens-in-opencv-yaml", tmp_path / "w.mcap", options, monkeypatch) == 0
