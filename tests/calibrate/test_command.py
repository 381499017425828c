"""`occlog calibrate` through the command line: cameras that are off, without poses, late, and what is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from walking_people import cameras, frames, write

from occlog.array_types import Floats
from occlog.calibrate.adjustment import DRIFT, LATE, PARAMETERS, Observations
from occlog.calibrate.config import CalibrateConfig
from occlog.calibrate.from_people import _clock_findings, _scene
from occlog.calibrate.stage import Calibrated, CameraResult, calibrate
from occlog.cli.main import run
from occlog.core.geometry.camera import angles_from_rotation
from occlog.errors import ExitCode, InputError
from occlog.io.formats.calibration.common import CalibrationOptions
from occlog.io.formats.calibration.reader import read_calibration
from occlog.io.formats.scenes.scene import read_scene
from occlog.records.scene import Camera, Scene

pytestmark = pytest.mark.jit


def rough() -> list[Camera]:
    """The cameras, off by 3 degrees and 0.3 m each."""
    rng = np.random.default_rng(8)
    return [
        replace(
            c,
            position=c.position + rng.normal(0.0, 0.3, 3),
            rotation=cv2.Rodrigues(rng.normal(0.0, 0.05, 3))[0] @ c.rotation,
        )
        for c in cameras()
    ]


def relative_errors(found: list[Camera]) -> tuple[float, float]:
    """Largest errors of positions [m] and orientations [rad] after a similarity in the plane."""
    ours, true = (np.array([complex(*c.position[:2].tolist()) for c in each]) for each in (found, cameras()))
    m = ((true - true.mean()) * np.conj(ours - ours.mean())).sum() / (np.abs(ours - ours.mean()) ** 2).sum()
    back = cv2.Rodrigues(np.array([0.0, 0.0, float(np.angle(m))]))[0]
    away = np.abs(m * (ours - ours.mean()) - (true - true.mean()))
    pairs = zip(found, cameras(), strict=True)
    turned = [np.abs((back @ a.rotation).T @ b.rotation - np.eye(3)).max() for a, b in pairs]
    return float(away.max()), float(max(turned))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording with rough poses."""
    folder = tmp_path_factory.mktemp("calibrate")
    assert run(["ingest", "-q", "-o", str(folder / "walk.mcap"), *write(folder, rough())]) == ExitCode.DONE
    return folder


def test_rough_poses_are_corrected(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Relative to each other to 4 cm and half a degree; the file says how sure."""
    asked = ["calibrate", str(folder / "walk.mcap"), "-o", str(folder / "scene.yaml"), "--json"]
    assert run([*asked, "--max-clock-offset", "0", "--set", "rounds=1"]) == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    scene = read_scene(folder / "scene.yaml")
    found, common, whole = list(scene.cameras), scene.common_noise, summary["sigma_all_cameras"]
    position, angle = relative_errors(found)
    before = relative_errors(rough())
    assert common is not None
    assert common.center == pytest.approx(np.mean([c.ground for c in found], axis=0))
    stated = (common.position, np.degrees(common.yaw), common.scale)
    assert stated == pytest.approx((whole["x"], whole["yaw_deg"], whole["scale"]), abs=1e-4)
    assert position < 0.04 < before[0]
    assert angle < 0.01 < before[1]
    assert summary["plausible"] is True
    assert set(summary["cameras"]) == {"cam0", "cam1", "cam2"}
    assert all(0.0 < each["sigma_yaw_deg"] < 1.0 for each in summary["cameras"].values())
    assert all(camera.sigma_position > 0.0 for camera in found)


def test_a_calibration_of_another_program_is_written(folder: Path, tmp_path: Path) -> None:
    """COLMAP's model has the cameras that were found."""
    asked = ["calibrate", "-q", str(folder / "walk.mcap"), "--max-clock-offset", "0", "--set", "rounds=0"]
    assert run([*asked, "-o", str(tmp_path / "colmap")]) == ExitCode.DONE
    found = list(read_calibration([tmp_path / "colmap"], "auto", CalibrationOptions("m")).cameras)
    before, after = relative_errors(rough()), relative_errors(found)
    assert after[0] < 0.1 < before[0]
    assert after[1] < 0.02 < before[1]
    assert run([*asked, "-o", str(tmp_path / "colmap")]) == ExitCode.EXISTS


def test_late_clocks_are_found_without_poses() -> None:
    """A clock 0.4 s late and one 0.3 s ahead, with intrinsics alone."""
    late = np.array([0.0, 0.4, -0.3])
    stated = [replace(c, placed=False) for c in cameras()]
    found = calibrate(frames(late), Scene(tuple(stated)), stated, CalibrateConfig(max_clock_offset=1.0, rounds=1))
    offsets: Floats = np.array([each.late_s for each in found.cameras])
    np.testing.assert_allclose(offsets, late, atol=0.02)
    position, angle = relative_errors([each.camera for each in found.cameras])
    assert position < 0.05
    assert angle < 0.01
    assert not np.isfinite(found.sigma_frame[:3]).any()


@pytest.fixture(scope="module")
def unknown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of cameras of which the size of the images alone is known."""
    folder = tmp_path_factory.mktemp("unknown")
    boxes = write(folder, rough())[:2]
    asked = ["ingest", "-q", "-o", str(folder / "walk.mcap"), *boxes, "--fps", "5", "--allow-uncalibrated"]
    assert run([*asked, "--image-size", "1280x720"]) == ExitCode.DONE
    return folder


def focal_errors(found: list[Camera]) -> list[float]:
    """Relative errors of focal lengths."""
    return [abs(float(a.focal_px[0] / b.focal_px[0]) - 1.0) for a, b in zip(found, cameras(), strict=True)]


def test_image_sizes_alone(unknown: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Lenses, poses relative to each other, and what is known of the focal lengths."""
    asked = ["calibrate", str(unknown / "walk.mcap"), "-o", str(tmp_path / "scene.yaml"), "--json"]
    assert run([*asked, "--max-clock-offset", "0", "--set", "rounds=1"]) == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    scene = read_scene(tmp_path / "scene.yaml")
    found, common = list(scene.cameras), scene.common_noise
    assert common is not None
    assert (common.position, common.yaw) == (0.0, 0.0)
    position, angle = relative_errors(found)
    assert position < 0.05
    assert angle < 0.01
    assert max(focal_errors(found)) < 0.02
    assert summary["plausible"] is True
    assert set(summary["sigma_all_cameras"]) == {"scale"}


@pytest.mark.drawn
def test_marked_points_and_a_picture(unknown: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Six points of the floor, marked to a pixel, give poses in their coordinates, and focal lengths."""
    rng, floor = np.random.default_rng(4), np.array([[2, 2], [8, 2.5], [7, 6], [3, 6], [5, 4], [4, 2]])
    lines = ["camera,u,v,x,y"]
    for camera in cameras():
        marks = camera.project(np.column_stack([floor, np.zeros(6)])) + rng.normal(0.0, 1.0, (6, 2))
        lines += [f"{camera.name},{u:.1f},{v:.1f},{x},{y}" for (u, v), (x, y) in zip(marks, floor, strict=True)]
    (tmp_path / "clicked.csv").write_text("\n".join(lines) + "\n")
    asked = ["calibrate", str(unknown / "walk.mcap"), "-o", str(tmp_path / "scene.yaml"), "--json"]
    asked += ["--points", str(tmp_path / "clicked.csv"), "--picture", str(tmp_path / "seen.png")]
    assert run([*asked, "--max-clock-offset", "0", "--set", "rounds=0"]) == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    found = list(read_scene(tmp_path / "scene.yaml").cameras)
    for one, true in zip(found, cameras(), strict=True):
        yaw = angles_from_rotation(one.rotation)[0] - angles_from_rotation(true.rotation)[0]
        # Marks of six points leave 0.13 m open, mostly along the axis of the camera
        assert np.abs(one.position - true.position).max() < 0.25
        assert abs(np.degrees(yaw)) < 1.0
    assert max(focal_errors(found)) < 0.03
    assert {each["points"] for each in summary["marked_points"].values()} == {6}
    assert all(0.0 < each["residual_px"] < 2.0 for each in summary["marked_points"].values())
    image = cv2.imread(str(tmp_path / "seen.png"))
    height, width = image.shape[:2]
    assert (width, height) == (1100, 3 * 340)
    # The grid of each camera on the left, feet there and in the plot on the right
    yellow, blue = (
        (np.abs(image.astype(np.int64) - colour) < 40).all(axis=2).reshape(3, 340, 2, 550).sum(axis=(1, 3))
        for colour in ([0, 176, 255], [192, 112, 0])
    )
    assert (yellow[:, 0] > 100).all()
    assert (yellow[:, 1] == 0).all()
    assert (blue[:, 0] > 1000).all()
    assert (blue[:, 1] > 0).all()


def test_one_camera_is_refused(folder: Path, tmp_path: Path) -> None:
    """Cameras are calibrated against each other."""
    asked = ["calibrate", str(folder / "walk.mcap"), "-o", str(tmp_path / "s.yaml"), "--cameras", "cam0"]
    assert run(asked) == ExitCode.BAD_INPUT
    assert not (tmp_path / "s.yaml").exists()


def test_cameras_without_common_people_are_refused() -> None:
    """Boxes of other times in each camera."""
    stated = cameras()[:2]
    apart = [f for f in frames(np.zeros(3)) if f.detections.camera == (0 if f.detections.t_ns < 15e9 else 1)]
    with pytest.raises(InputError):
        calibrate(apart, Scene(tuple(stated)), stated, CalibrateConfig(max_clock_offset=0.5))


def test_long_recordings_are_used_from_their_beginning(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """600 boxes of 1,700 are enough; a note says so."""
    monkeypatch.setattr("occlog.calibrate.from_people.MAX_BOXES", 600)
    asked = ["calibrate", str(folder / "walk.mcap"), "-o", str(tmp_path / "s.yaml"), "--set", "rounds=0"]
    assert run([*asked, "--max-clock-offset", "0"]) == ExitCode.DONE
    assert "note: the first 60" in capsys.readouterr().err
    assert relative_errors(list(read_scene(tmp_path / "s.yaml").cameras))[0] < 0.1


def test_drift_is_stated_and_written() -> None:
    """A reference clock, one that drifts, and one that may: findings, and the clocks of the scene."""
    sigma = np.zeros((3, PARAMETERS))
    sigma[1:, LATE], sigma[1, DRIFT] = 0.001, 5e-6
    late, drift = [0.0, -0.2, 0.0], [0.0, 60.0, 0.0]
    found = Calibrated(
        [CameraResult(c, True, s, a, d, 100, 1.0) for c, s, a, d in zip(cameras(), sigma, late, drift, strict=True)],
        4, 1.7, np.zeros(4), 0.0j, np.zeros((0, 0)), 1.0, True, Observations(*[np.zeros(0)] * 7), np.zeros((0, 4)), [],
    )  # fmt: skip
    checks = [each.id for each in _clock_findings(found)]
    assert checks == ["clock-offset-found", "clock-drift-found", "clock-drift-undetermined"]
    scene = _scene(Scene(tuple(cameras())), found, placed=True)
    assert [(clock.offset_ns, clock.drift_ppm) for clock in scene.clocks] == [(-200_000_000, 60.0)]
