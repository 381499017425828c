"""Files of public bug reports that `ingest` reads, or refuses with what to do."""

from __future__ import annotations

from pathlib import Path

import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.recording.reader import open_recording


def test_coco_of_images_of_another_size_scales_the_calibration(
    shared_cases: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case, out = shared_cases / "v01-coco-other-size", tmp_path / "w.mcap"
    words = [w for name in ("left", "right") for w in ("--boxes", f"{case / name}.json")]
    words += [w for name in ("left", "right") for w in ("--calibration", f"{case / name}.yaml")]
    assert run(["ingest", "-o", str(out), *words, "--fps", "10"]) == ExitCode.DONE
    assert "frames of 640 x 360 px, calibrated for 1280 x 720: taken for scaled by 0.5" in capsys.readouterr().err
    scene = open_recording(out).scene
    assert scene is not None
    assert [camera.image_size for camera in scene.cameras] == [(640, 360)] * 2


def test_stamps_that_fall_back_to_1980_are_left_out_and_listed(shared_cases: Path, tmp_path: Path) -> None:
    out = tmp_path / "x.mcap"
    assert run(["ingest", str(shared_cases / "c07_gps_1980" / "b_1980"), "-o", str(out)]) == ExitCode.LOSSY
    (loss,) = open_recording(out).losses
    assert (loss.count, "time stamps repeat or go back" in loss.what) == (5, True)


def test_images_stated_to_be_video_are_refused_with_what_to_do(
    shared_cases: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = shared_cases / "c13_compressed_video" / "fox_video.mcap"
    assert run(["ingest", str(bag), "-o", str(tmp_path / "x.mcap")]) == ExitCode.BAD_INPUT
    said = capsys.readouterr().err
    assert "topic /left/image: video is stated to be h264, and its data are JPEG; record it as jpeg" in said
