"""`occlog simulate --paths` and what arrays hear, on files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from places import EXAMPLES

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.recording.reader import open_recording
from occlog.records.tables import Bearings, Doa, Truth, TruthBoxes
from occlog.simulate.config import START_NS

SCENE = """
occlog_scene: 1
room: [[0, 0], [6, 0], [6, 5], [0, 5]]
static_occluders: [{name: pillar, polygon: [[5, 4], [5.5, 4], [5.5, 4.5], [5, 4.5]]}]
cameras:
  - {name: a, position: [0.2, 0.2, 1.5], yaw_deg: 40, focal_px: 60, image_size_px: [96, 72]}
microphone_arrays:
  - {name: mic, position: [3, 0, 1], sigma_deg: 3}
"""
PATHS = """
occlog_paths: 1
seconds: 3
rate_hz: 5
targets:
- {id: 4, position: [1, 1, 1.2], velocity: [1, 0.5], segments: [{from_s: 1, until_s: 2, lateral: 1}]}
- {id: 9, position: [4, 4], from_s: 1, until_s: 2, silent: [[1.5, 3]]}
- {id: 2, role: occluder, position: [1, 4]}
"""


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    scene, paths = tmp_path / "scene.yaml", tmp_path / "paths.yaml"
    scene.write_text(SCENE)
    paths.write_text(PATHS)
    return scene, paths


def simulate(files: tuple[Path, Path], out: Path, *args: str) -> int:
    return run(["simulate", str(files[0]), "--paths", str(files[1]), "-o", str(out), *args])


def seconds(t_ns: np.ndarray) -> list[float]:
    return ((t_ns - START_NS) * 1e-9).round(6).tolist()


def test_a_recording_of_scripted_targets(
    files: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "r.mcap"
    assert simulate(files, out, "--label-doa", "--json") == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    assert (summary["steps"], summary["seconds"], summary["targets"], summary["occluders"]) == (16, 3.0, 2, 1)
    recording = open_recording(out)
    truth = recording.read(Truth)
    assert np.unique(truth.target_id).tolist() == [2, 4, 9]
    assert seconds(truth.t_ns[truth.target_id == 9]) == [1.0, 1.2, 1.4, 1.6, 1.8, 2.0]
    assert (truth.z[truth.target_id == 4] == 1.2).all()
    assert np.isnan(truth.z[truth.target_id == 9]).all()
    assert set(truth.role[truth.target_id == 2]) == {"occluder"}
    seen = recording.read(Bearings)
    assert (np.bincount(seen.target_id, minlength=10)[[4, 9]] == 16).all()  # a frame without it is a row all the same
    assert not seen.seen[(seen.target_id == 9) & (seen.t_ns < START_NS + 10**9)].any()
    doa = recording.read(Doa)
    assert seconds(doa.t_ns[doa.source_id == 9]) == [1.0, 1.2, 1.4]
    assert (doa.source_id == 4).sum() == 16
    assert np.isnan(doa.elevation[doa.source_id == 9]).all()
    assert recording.provenance.inputs[1][0] == "paths.yaml"
    assert recording.provenance.parameters["sound"]["label_doa"] is True


def test_options_go_before_the_file_and_the_same_gives_the_same(files: tuple[Path, Path], tmp_path: Path) -> None:
    a, b = tmp_path / "a.mcap", tmp_path / "b.mcap"
    args = [
        "--rate",
        "2",
        "--steps",
        "9",
        "--object-height",
        "1",
        "--false-alarm-rate",
        "0.5",
        "--silence",
        "2,1",
        "--seed",
        "5",
    ]
    assert simulate(files, a, *args) == simulate(files, b, *args) == ExitCode.DONE
    assert a.read_bytes() == b.read_bytes()
    truth = open_recording(a).read(Truth)
    assert seconds(np.unique(truth.t_ns)) == np.arange(0, 4.1, 0.5).tolist()
    assert (truth.z[truth.target_id == 9] == 1.0).all()
    assert (open_recording(a).read(Doa).source_id == -1).all()


@pytest.mark.jit
def test_video_of_scripted_people(files: tuple[Path, Path], tmp_path: Path) -> None:
    out = tmp_path / "r.mcap"
    assert simulate(files, out, "--render", "--texture", "0") == ExitCode.DONE
    recording = open_recording(out)
    boxes = recording.read(TruthBoxes)
    assert {4, 9} <= set(boxes.target_id.tolist()) <= {-1, 2, 4, 9}
    assert set(seconds(boxes.t_ns[boxes.target_id == 9])) <= {1.0, 1.2, 1.4, 1.6, 1.8, 2.0}
    observations = json.loads(recording.attachment("appearance.json") or b"")
    assert [x["target_id"] for x in observations] == [4, 9]
    assert len(list(recording.frames())) == 16


@pytest.mark.parametrize(
    ("args", "code", "message"),
    [
        (["--targets", "2"], ExitCode.USAGE, "--targets is an option of SCENE, not of SCENE --paths FILE"),
        (["--speed", "2"], ExitCode.USAGE, "--speed is an option of SCENE, --scene people, not of SCENE --paths FILE"),
        (["--steps", "2", "--seconds", "3"], ExitCode.USAGE, "--seconds and --steps both state"),
        (["--silence", "3"], ExitCode.USAGE, "--silence 3: must be 2 numbers"),
        (["--silence", "3,0"], ExitCode.USAGE, "--silence 3,0: must be two mean times above 0 s"),
        (["--render", "--seconds", "6"], ExitCode.BAD_INPUT, "target 4 is outside the room at"),
        (["--paths", "none.yaml"], ExitCode.BAD_INPUT, "none.yaml"),
    ],
)
def test_what_does_not_fit(
    files: tuple[Path, Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    args: list[str],
    code: int,
    message: str,
) -> None:
    assert simulate(files, tmp_path / "r.mcap", *args) == code
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1 or code == ExitCode.USAGE
    assert "Traceback" not in error
    assert not (tmp_path / "r.mcap").exists()


def test_units_and_arrays_must_be_there(
    files: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files[1].write_text("length_unit: ft\n" + PATHS)
    assert simulate(files, tmp_path / "r.mcap") == ExitCode.BAD_INPUT
    assert "its length unit is ft, the scene's m" in capsys.readouterr().err
    for option in (["--label-doa"], ["--false-alarm-rate", "1"], ["--silence", "1,1"]):
        args = ["simulate", str(EXAMPLES / "room.yaml"), "-o", str(tmp_path / "r.mcap"), *option]
        assert run(args) == ExitCode.USAGE
        assert "applies to microphone arrays, but the scene has none" in capsys.readouterr().err


def heard(out: Path, sensor: str, source: int) -> tuple[float, float]:
    doa = open_recording(out).read(Doa)
    t = seconds(doa.t_ns[(doa.sensor == sensor) & (doa.source_id == source)])
    return t[0], t[-1]


def test_the_examples_meet_the_printed_times(tmp_path: Path) -> None:
    out = tmp_path / "field.mcap"
    args = ["--paths", str(EXAMPLES / "lee_field_paths.yaml"), "--label-doa", "-o", str(out)]
    assert run(["simulate", str(EXAMPLES / "lee_field.yaml"), *args]) == ExitCode.DONE
    assert [heard(out, "mic", k) for k in (1, 2, 3)] == [(25.0, 200.0), (0.0, 174.0), (63.0, 187.0)]
    out = tmp_path / "space.mcap"
    args = ["--paths", str(EXAMPLES / "lee_space_paths.yaml"), "-o", str(out)]
    assert run(["simulate", str(EXAMPLES / "lee_space.yaml"), *args]) == ExitCode.DONE
    truth = open_recording(out).read(Truth)
    phi = np.degrees(np.arctan2(np.hypot(truth.x, truth.y), truth.z))
    assert phi[[1, 12, 13, -1]].round(2).tolist() == pytest.approx([48.24, 45.42, 44.96, 28.07], abs=0.02)


def test_the_room_of_the_examples_meets_what_can_be_met(tmp_path: Path) -> None:
    out = tmp_path / "room.mcap"
    args = ["--paths", str(EXAMPLES / "lee_room_paths.yaml"), "--label-doa", "-o", str(out), "--no-bearings"]
    assert run(["simulate", str(EXAMPLES / "lee_room.yaml"), *args]) == ExitCode.DONE
    assert heard(out, "A1", 1) == pytest.approx((0.0, 15.0), abs=0.05)
    assert heard(out, "A2", 1) == pytest.approx((11.0, 19.0), abs=0.05)
    assert heard(out, "A1", 3) == pytest.approx((16.0, 19.0), abs=0.05)
    assert heard(out, "A2", 3)[0] == pytest.approx(13.0, abs=0.005)
    doa = open_recording(out).read(Doa)
    quiet = (doa.source_id == 1) & (doa.t_ns >= START_NS + 5 * 10**9) & (doa.t_ns < START_NS + 7 * 10**9)
    assert not quiet.any()
