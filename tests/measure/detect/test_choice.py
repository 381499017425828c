"""`occlog detect` without a method: the network of occlog, or background subtraction where that fits better."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from detect_scenes import BLUE, STEP_NS, camera, picture, scene, walk
from small_networks import mean_network

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance, hash_file
from occlog.io.files.tables.parquet import read_provenance, read_table
from occlog.io.recording.writer import RecordingWriter
from occlog.measure.detect.choice import DetectionProbe
from occlog.measure.networks.shipped import shipped_network
from occlog.records.scene import Camera
from occlog.records.tables import Bearings, Views

FILM = Path(__file__).parents[3] / "sample_data" / "pose2sim" / "cam03.mp4"
STEPS = 12
SIDE = 400
DRAWN = camera("drawn", 0.0, 0.0, 45.0)


@cache
def filmed() -> list[np.ndarray]:
    """Frames of a man on a treadmill, made smaller."""
    film, out = cv2.VideoCapture(str(FILM)), []
    for _ in range(STEPS):
        ok, image = film.read()
        assert ok
        scale = SIDE / min(image.shape[:2])
        out.append(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))
    assert out[0].shape[:2] == (HEIGHT, WIDTH)
    return out


HEIGHT, WIDTH = 706, 400
REAL = camera(
    "real",
    8.0,
    0.0,
    135.0,
    image_size=(WIDTH, HEIGHT),
    principal_px=np.array([WIDTH / 2, HEIGHT / 2]),
    focal_px=np.array([400.0, 400.0]),
)


def record(path: Path, *cameras: Camera, command: str = "test") -> Path:
    """A recording of drawn ellipses in one camera, and of real video in another."""
    with RecordingWriter(path, scene(*cameras), Provenance(command), overwrite=True) as out:
        for k in range(STEPS):
            for cam in cameras:
                people = [walk(STEPS)[k], (7.0, 1.5 + 0.15 * k, BLUE)]
                image = filmed()[k] if cam.name == "real" else picture(cam, people, k)
                out.image(cam.name, k * STEP_NS, k, cv2.imencode(".png", image)[1].tobytes(), "png")
    return path


def detect(source: Path, folder: Path, *args: str) -> int:
    folder.mkdir(exist_ok=True)
    out = ["-o", str(folder / "b.parquet"), "--views", str(folder / "v.parquet")]
    return run(["detect", str(source), *out, "--overwrite", "--json", *args])


pytestmark = pytest.mark.jit


@pytest.mark.parametrize(
    ("found", "moving", "background"),
    [(0, 3, True), (0, 2, False), (1, 9, False), (1, 11, True), (2, 20, False), (2, 24, True), (24, 24, False)],
)
def test_background_subtraction_needs_motion_that_the_network_does_not_know(
    found: int, moving: int, background: bool
) -> None:
    assert DetectionProbe(24, found, moving).background is background


@pytest.fixture(scope="module")
def real(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("real") / "r.mcap", REAL)


def test_people_of_real_video_are_found_by_the_network(
    real: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert detect(real, tmp_path) == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    digest = hash_file(shipped_network())
    assert (summary["method"], summary["network"]) == ("network", f"nanodet.onnx (sha256 {digest[:12]})")
    assert summary["min_confidence"] == 0.4
    views, rows = read_table(tmp_path / "v.parquet", Views), read_table(tmp_path / "b.parquet", Bearings)
    assert summary["regions"] == len(views) >= STEPS
    assert set(rows.target_id.tolist()) == {-1}
    assert (views.confidence >= 0.4).all()
    made = read_provenance(tmp_path / "v.parquet")
    assert dict(made.inputs)["nanodet.onnx"] == digest
    assert (made.parameters["method"], made.parameters["min_confidence"]) == ("network", 0.4)
    (verdict,) = made.judged
    (check,) = [each for each in verdict.checks if each.name == "detector"]
    assert digest[:12] in check.text
    assert check.figures == {"min_confidence": 0.4, "frames": STEPS, "detections": len(views)}


@pytest.mark.statistics
def test_one_network_for_one_camera_and_background_subtraction_for_another(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    both = record(tmp_path / "r.mcap", DRAWN, REAL)
    mean_network(tmp_path / "reid.onnx")
    assert detect(both, tmp_path / "both", "--embed", str(tmp_path / "reid.onnx")) == ExitCode.DONE
    captured = capsys.readouterr()
    assert json.loads(captured.out)["method"] == "network (real), background"
    assert "camera drawn: the network finds people in 0 of 12 frames, but regions of their size move in" in captured.err
    for name, method in (("drawn", "background"), ("real", "network")):
        only = detect(both, tmp_path / name, "--method", method, "--cameras", name)
        assert only == ExitCode.DONE
        for file, table in (("v.parquet", Views), ("b.parquet", Bearings)):
            whole, part = read_table(tmp_path / "both" / file, table), read_table(tmp_path / name / file, table)
            own = whole.take(whole.sensor == name)
            assert len(own) == len(part) > 0
            for column in table.columns():
                if column.name != "embedding":
                    np.testing.assert_array_equal(getattr(own, column.name), getattr(part, column.name))
    views = read_table(tmp_path / "both" / "v.parquet", Views)
    assert np.isfinite(views.embedding).all(axis=1).tolist() == (views.sensor == "real").tolist()


def test_a_simulated_recording_is_detected_in_as_with_background_subtraction(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = record(tmp_path / "r.mcap", DRAWN, command="simulate")
    assert detect(made, tmp_path / "auto") == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    assert (summary["method"], summary["reason"]) == ("background", "the recording is simulated")
    assert detect(made, tmp_path / "own", "--method", "background") == ExitCode.DONE
    for file in ("v.parquet", "b.parquet"):
        assert (tmp_path / "auto" / file).read_bytes() == (tmp_path / "own" / file).read_bytes()


def test_options_choose_the_detector_or_are_refused(
    real: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert detect(real, tmp_path, "--history", "300") == ExitCode.DONE
    assert json.loads(capsys.readouterr().out)["reason"] == "an option of it is given"
    for args, words in (
        (["--method", "network", "--history", "3"], "--history is an option of --method auto, background"),
        (
            ["--method", "background", "--tiles", "2x2"],
            "--tiles is an option of --onnx MODEL, --method auto, network",
        ),
        (["--history", "3", "--embed", "x.onnx"], "--embed is for boxes of a network, and background subtraction is"),
        (["--tiles", "2"], "expected 3x2 (columns x rows)"),
        (["--method", "em"], "no detector 'em'"),
    ):
        assert detect(real, tmp_path, *args) == ExitCode.USAGE
        assert words in capsys.readouterr().err
