"""`occlog simulate` on files: what the recording holds, exit codes, one-line errors."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import EXAMPLES

import occlog
from occlog.cli.main import run
from occlog.errors import ExitCode, OutputError, UsageError
from occlog.io.files.tables.parquet import read_table
from occlog.io.formats.scenes.scene import read_scene
from occlog.io.recording.reader import open_recording
from occlog.io.recording.writer import RecordingWriter
from occlog.records.tables import Bearings, Doa, Reads, TagTracks, Truth, TruthBoxes
from occlog.simulate.config import ObserveConfig, RenderConfig, WorldConfig
from occlog.simulate.render.people import render
from occlog.simulate.request import SceneRequest
from occlog.simulate.run import make_setup
from occlog.simulate.stage import simulate_truth

pytestmark = pytest.mark.jit

ROOM = """
occlog_scene: 1
room: [[0, 0], [6, 0], [6, 5], [0, 5]]
cameras:
  - {name: a, position: [0.2, 0.2, 1.5], yaw_deg: 40, focal_px: 60, image_size_px: [96, 72], rate_hz: 5}
  - {name: b, position: [5.8, 0.2, 1.5], yaw_deg: 140, focal_px: 60, image_size_px: [96, 72]}
microphone_arrays:
  - {name: mic, position: [3, 0, 1], sigma_deg: 3}
"""


@pytest.fixture
def room(tmp_path: Path) -> Path:
    path = tmp_path / "room.yaml"
    path.write_text(ROOM)
    return path


def simulate(scene: Path, out: Path, *args: str) -> int:
    return run(["simulate", str(scene), "-o", str(out), *args])


def asked(**values: Any) -> SceneRequest:
    return SceneRequest(output=Path("x.mcap"), **values)


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_the_recording_holds_a_walk_and_the_bearings_of_every_camera(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Everything is checked against the scene by plain geometry; limits are five standard deviations."""
    source, out = EXAMPLES / "room100.yaml", tmp_path / "r.mcap"
    assert simulate(source, out, "--steps", "300", "--occluders", "5", "--seed", "3", "--json") == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    recording, scene = open_recording(out), read_scene(source)
    truth, seen = recording.read(Truth), recording.read(Bearings)
    assert summary["steps"] == 300
    assert summary["bearings"] == len(seen) == 300 * 8
    assert summary["seen"] == int(seen.seen.sum())
    # A target and five occluders, at each of the steps, inside the room
    assert len(truth) == 300 * (1 + 5)
    assert sorted(set(zip(truth.role.tolist(), truth.target_id.tolist(), strict=True)))[-1] == ("target", 0)
    low, high = scene.surroundings.min(axis=0), scene.surroundings.max(axis=0)
    assert ((truth.x >= low[0]) & (truth.x <= high[0]) & (truth.y >= low[1]) & (truth.y <= high[1])).all()
    assert np.isnan(truth.z).all()
    # It walks a unit a step, with noise of 0.33 on each axis
    target = truth.take(truth.target_id == 0)
    assert np.hypot(np.diff(target.x), np.diff(target.y)).max() < 1.0 + 5 * 0.33 * 2**0.5
    for camera in scene.cameras:
        rows = seen.take(seen.sensor == camera.name)
        assert rows.t_ns.tolist() == target.t_ns.tolist()
        right = np.arctan2(target.y - camera.ground[1], target.x - camera.ground[0])
        off = (rows.bearing - right + np.pi) % (2 * np.pi) - np.pi
        assert (np.abs(off[rows.seen]) < 5 * rows.sigma[rows.seen]).all()
        # Where it is outside the field of view it is not seen, nor does anything stand for a bearing
        aside = np.abs((right - camera.yaw + np.pi) % (2 * np.pi) - np.pi)
        assert not rows.seen[aside > 0.5 * camera.fov].any()
        assert np.isnan(rows.u_px[~rows.seen]).all()
    assert recording.scene is not None
    assert [c.name for c in recording.scene.cameras] == [c.name for c in scene.cameras]
    made = recording.provenance
    assert (made.command, made.seed) == ("simulate", 3)
    assert made.parameters["world"]["occluders"] == 5
    assert made.inputs[0][0] == "room100.yaml"


def test_the_same_seed_gives_the_same_bytes(room: Path, tmp_path: Path) -> None:
    args = ["--seconds", "1.2", "--occluders", "2", "--render", "--bearings"]
    for name, more in (("a", ["--workers", "1"]), ("b", ["--workers", "3"]), ("c", ["--seed", "1"])):
        assert simulate(room, tmp_path / f"{name}.mcap", *args, *more) == ExitCode.DONE
    assert digest(tmp_path / "a.mcap") == digest(tmp_path / "b.mcap")
    assert digest(tmp_path / "a.mcap") != digest(tmp_path / "c.mcap")


def test_video_boxes_and_appearance(room: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "r.mcap"
    args = ["--seconds", "2", "--targets", "2", "--occluders", "1", "--render", "--seed", "4", "--json"]
    assert simulate(room, out, *args, "--image-noise", "0.5", "--texture", "0.2") == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    scene, world = read_scene(room), WorldConfig.in_unit("m")
    setup = make_setup(scene, asked(seconds=2.0, world={"targets": 2, "occluders": 1}, render=True))
    assert setup.world.steps == 21
    assert setup.world.wall_clearance == world.wall_clearance
    config = RenderConfig(noise=0.5, texture=0.2, diameter=world.diameter)
    want = list(render(scene, simulate_truth(scene, setup.world, 4), config, 4))
    recording = open_recording(out)
    frames = list(recording.frames())
    assert len(frames) == len(want) == summary["frames"] == 11 + 21
    for frame, drawn in zip(frames, want, strict=True):
        assert (frame.t_ns, frame.sensor, frame.index) == (drawn.t_ns, drawn.sensor, drawn.index)
        assert (frame.decode() == drawn.image).all()
    boxes = recording.read(TruthBoxes)
    assert boxes.t_ns.tolist() == np.repeat([w.t_ns for w in want], [len(w.boxes) for w in want]).tolist()
    assert np.isin(boxes.target_id, [-1, 0, 1, 2]).all()
    observations = json.loads(recording.attachment("appearance.json") or b"")
    assert [x["target_id"] for x in observations] == [0, 1]
    assert all(len(x["appearance"]) == 72 and sum(x["appearance"]) == pytest.approx(1) for x in observations)
    assert not recording.has(Bearings)
    assert len(recording.read(Doa)) == 42


def test_video_files_next_to_the_recording_hold_the_same_frames(
    room: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    png, ffv1 = tmp_path / "png.mcap", tmp_path / "ffv1.mcap"
    args = ["--seconds", "1", "--occluders", "1", "--render", "--fps", "7", "--json"]
    assert simulate(room, png, *args) == ExitCode.DONE
    assert simulate(room, ffv1, *args, "--store", "ffv1") == ExitCode.DONE
    large, small = (json.loads(line)["video_bytes"] for line in capsys.readouterr().out.splitlines())
    assert small < 0.8 * large
    a, b = (list(open_recording(p).frames()) for p in (png, ffv1))
    assert len(a) == len(b) == 16
    for x, y in zip(a, b, strict=True):
        assert (x.t_ns, x.sensor, x.index) == (y.t_ns, y.sensor, y.index)
        assert (x.decode() == y.decode()).all()
    before = {p.name: digest(p) for p in tmp_path.glob("ffv1*")}
    assert sorted(before) == ["ffv1.a.avi", "ffv1.b.avi", "ffv1.mcap"]
    assert simulate(room, ffv1, *args, "--store", "ffv1") == ExitCode.EXISTS
    ffv1.unlink()
    assert simulate(room, ffv1, *args, "--store", "ffv1") == ExitCode.EXISTS  # its videos are still there
    assert simulate(room, ffv1, *args, "--store", "ffv1", "--overwrite") == ExitCode.DONE
    assert {p.name: digest(p) for p in tmp_path.glob("ffv1*")} == before


def test_video_files_appear_with_the_recording_or_not_at_all(
    room: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: RecordingWriter) -> None:
        raise OutputError("the disk is full")

    monkeypatch.setattr(RecordingWriter, "_finish", full)
    args = ["--steps", "2", "--render", "--store", "ffv1", "-q"]
    assert simulate(room, tmp_path / "r.mcap", *args) == ExitCode.BAD_INPUT
    assert sorted(p.name for p in tmp_path.iterdir()) == ["room.yaml"]


def test_rates_of_world_and_cameras(room: Path, tmp_path: Path) -> None:
    out = tmp_path / "r.mcap"
    assert simulate(room, out, "--steps", "41", "--rate", "20", "--fps", "4", "-q") == ExitCode.DONE
    recording = open_recording(out)
    assert len(recording.read(Truth)) == 41
    rows = recording.read(Bearings)
    assert [int((rows.sensor == s).sum()) for s in ("a", "b")] == [9, 9]
    assert recording.scene is not None
    assert [c.rate_hz for c in recording.scene.cameras] == [4.0, 4.0]


def test_a_recording_can_be_the_scene(room: Path, tmp_path: Path) -> None:
    first, second = tmp_path / "1.mcap", tmp_path / "2.mcap"
    assert simulate(room, first, "--steps", "5") == ExitCode.DONE
    assert simulate(first, second, "--steps", "5") == ExitCode.DONE
    assert (open_recording(first).read(Truth).x == open_recording(second).read(Truth).x).all()


@pytest.mark.parametrize(
    ("args", "code", "says"),
    [
        (["--seconds", "3", "--steps", "4"], ExitCode.USAGE, "--seconds and --steps both state"),
        (["--identical-clothes"], ExitCode.USAGE, "--identical-clothes applies to video; add --render"),
        (["--store", "ffv1"], ExitCode.USAGE, "--store applies to video"),
        (["--image-noise", "2"], ExitCode.USAGE, "--image-noise applies to video"),
        (["--miss-probability", "1.5"], ExitCode.USAGE, "--miss-probability"),
        (["--occluders", "5000"], ExitCode.BAD_INPUT, "use fewer or smaller objects, or a larger room"),
        (["--redirect-probability", "nan"], ExitCode.USAGE, "nan is not a finite number"),
        (["--fps", "nan"], ExitCode.USAGE, "nan is not a finite number"),
        (["--rate", "1e12"], ExitCode.USAGE, "--rate"),
    ],
)
def test_bad_options_are_one_line_and_leave_no_file(
    args: list[str], code: int, says: str, room: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "r.mcap"
    assert simulate(room, out, *args) == code
    error = capsys.readouterr().err
    assert says in error
    assert error.count("\n") == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["room.yaml"]


def test_a_scene_that_cannot_be_rendered_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "r.mcap"
    assert simulate(EXAMPLES / "room100.yaml", out, "--render") == ExitCode.BAD_INPUT
    assert "camera cam1 has no image size; give image_size_px" in capsys.readouterr().err
    assert not out.exists()


def test_readers_read_tags_and_methods_of_tags_track_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = tmp_path / "tags.mcap"
    options = [
        "--no-bearings",
        "--targets",
        "2",
        "--seconds",
        "8",
        "--read-false-alarm-probability",
        "0",
        "--read-detection-probability",
        "1",
    ]
    assert run(["simulate", str(EXAMPLES / "readers.yaml"), "-o", str(recording), *options, "--json"]) == ExitCode.DONE
    reads = open_recording(recording).read(Reads)
    assert json.loads(capsys.readouterr().out)["reads"] == len(reads) > 0
    # Twice a second, by up to twelve readers
    assert set((reads.t_ns - reads.t_ns[0]) % 500_000_000) == {0}
    assert set(reads.target_id.tolist()) == {0, 1}
    assert run(["track", str(recording), "--method", "virtual", "-o", str(tmp_path / "tags.parquet")]) == ExitCode.DONE
    tracks = read_table(tmp_path / "tags.parquet", TagTracks)
    assert set(tracks.target_id.tolist()) == {0, 1}
    # Twelve readers with ranges of 3 m locate a tag within 1 m on average.
    truth = open_recording(recording).read(Truth)
    steps = np.rint((tracks.t_ns - truth.t_ns[0]) / 1e8).astype(np.int64)
    rows = 2 * steps + tracks.target_id
    assert np.hypot(tracks.x - truth.x[rows], tracks.y - truth.y[rows]).mean() < 1.0


def test_options_of_readers_want_a_scene_with_readers(room: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--read-power applies to readers of tags, but the scene has none"):
        make_setup(read_scene(room), asked(reads={"power": -50.0}))


def test_exit_code_7_for_an_output_that_exists(room: Path, tmp_path: Path) -> None:
    out = tmp_path / "r.mcap"
    out.write_bytes(b"mine")
    assert simulate(room, out, "--steps", "3") == ExitCode.EXISTS
    assert out.read_bytes() == b"mine"
    assert simulate(room, out, "--steps", "3", "--overwrite") == ExitCode.DONE
    assert simulate(tmp_path / "none.yaml", tmp_path / "x.mcap") == ExitCode.BAD_INPUT


def test_defaults_follow_the_length_unit_and_rendering(room: Path) -> None:
    scene = read_scene(EXAMPLES / "room100.yaml")
    setup = make_setup(scene, asked(world={"occluders": 40}))
    assert setup.world == WorldConfig(occluders=40)
    assert setup.observe == ObserveConfig(diameter=3.33)
    assert setup.render is None
    people = make_setup(read_scene(room), asked(render=True, world={"diameter": 0.6}))
    assert people.observe is None
    assert people.world.wall_clearance == pytest.approx(0.3)
    with pytest.raises(UsageError):
        make_setup(scene, asked(rendering={"shadows": False}))


def test_in_python_a_room_of_people_has_no_other_objects() -> None:
    with pytest.raises(UsageError, match="all people of this scene are targets"):
        occlog.simulate(kind="people", occluders=1)
    with pytest.raises(UsageError, match="choose one that has it: walkers, paths"):
        occlog.simulate(kind="people", seconds=3.0)
