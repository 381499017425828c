"""`occlog simulate --scene balls`: what the recording holds, any number of workers, one-line errors."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from places import ROOT

from occlog.cli.main import run
from occlog.errors import ExitCode, OutputError
from occlog.io.recording.reader import open_recording
from occlog.io.recording.writer import RecordingWriter
from occlog.records.tables import Truth, TruthBoxes
from occlog.simulate.balls.config import BallsConfig
from occlog.simulate.balls.video import render_balls

pytestmark = pytest.mark.jit

SMALL = ["--frames", "5", "--size", "64x48", "--balls", "3", "--radius", "6"]
CONFIG = BallsConfig(frames=5, width=64, height=48, balls=3, radius=6.0)


def simulate(out: Path, *args: str) -> int:
    return run(["simulate", "--scene", "balls", "-o", str(out), *args])


@pytest.mark.parametrize("store", ["png", "ffv1"])
def test_the_recording_holds_the_video_and_what_is_true(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], store: str
) -> None:
    out = tmp_path / "b.mcap"
    assert simulate(out, *SMALL, "--views", "3", "--seed", "4", "--store", store, "--json") == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    assert (summary["frames"], summary["targets"], summary["cameras"]) == (15, 3, 3)
    recording = open_recording(out)
    assert recording.cameras == ("view1", "view2", "view3")
    want = list(render_balls(replace(CONFIG, views=3), 4))
    for frame in recording.frames():
        assert (frame.decode() == want[frame.index].images[int(frame.sensor[-1]) - 1]).all()
    scene, truth, boxes = recording.scene, recording.read(Truth), recording.read(TruthBoxes)
    assert scene is not None
    assert scene.length_unit == "px"
    assert np.unique(np.diff(np.unique(boxes.t_ns))).tolist() == [40_000_000]
    assert len(truth) == 15
    for k, camera in enumerate(scene.cameras):
        seen = boxes.take(boxes.sensor == camera.name)
        assert seen.target_id.tolist() == 5 * [0, 1, 2]
        middle = np.column_stack([seen.left_px + 0.5 * seen.width_px, seen.top_px + 0.5 * seen.height_px])
        positions = camera.project(np.column_stack([truth.x, truth.y, truth.z]))
        np.testing.assert_allclose(middle, positions, atol=0.01)
        np.testing.assert_allclose(seen.width_px, 12.0, atol=0.01)
        assert np.array_equal(seen.visible, np.concatenate([f.share[k] for f in want]))
    assert recording.provenance.parameters["balls"]["radius"] == 6.0


def test_the_same_bytes_for_any_number_of_workers(tmp_path: Path) -> None:
    digests = []
    for n, more in enumerate((["--workers", "1"], ["--workers", "3"], ["--seed", "1"])):
        assert simulate(tmp_path / f"{n}.mcap", *SMALL, *more) == ExitCode.DONE
        digests.append(hashlib.sha256((tmp_path / f"{n}.mcap").read_bytes()).hexdigest())
    assert digests[0] == digests[1] != digests[2]


def test_variants_are_as_asked(tmp_path: Path) -> None:
    out = tmp_path / "v.mcap"
    args = [
        "--grey",
        "--collide",
        "--distance",
        "300",
        "--fps",
        "10",
        "--overlapping",
        "--background-clutter",
        "0",
        "--spin",
        "0",
    ]
    assert simulate(out, *SMALL, *args, "--ball-speed", "1", "--image-noise", "0") == ExitCode.DONE
    recording = open_recording(out)
    image = next(iter(recording.frames())).decode()
    assert image.shape == (48, 64, 3)
    assert (image == image[..., :1]).all()
    assert recording.time_ns is not None
    assert recording.time_ns[1] - recording.time_ns[0] == 400_000_000
    boxes = recording.read(TruthBoxes)
    assert boxes.width_px.std() > 0.05


def test_balls_that_hide_one_another_keep_their_boxes(tmp_path: Path) -> None:
    out = tmp_path / "h.mcap"
    args = ["--frames", "20", "--size", "64x48", "--balls", "8", "--radius", "8", "--overlapping"]
    assert simulate(out, *args) == ExitCode.DONE
    boxes = open_recording(out).read(TruthBoxes)
    assert len(boxes) == 20 * 2 * 8
    assert (boxes.visible >= 0).all()
    assert (boxes.visible <= 1).all()
    assert (boxes.visible < 0.3).any()


@pytest.mark.parametrize(
    ("args", "words"),
    [
        ([], "no scene: give SCENE (a file), or --scene balls or people"),
        (["--scene", "balls", "room.yaml"], "room.yaml: one argument too many for --scene balls"),
        (["--scene", "balls", "--people", "3"], "--people is an option of --scene people, not of --scene balls"),
        (["--scene", "balls", "--targets", "3"], "--targets is an option of SCENE, not of --scene balls"),
        (
            ["--scene", "balls", "--no-shadows"],
            "--no-shadows is an option of SCENE, SCENE --paths FILE, --scene people, not of --scene balls",
        ),
        (["--scene", "balls", "--paths", "p.yaml"], "--paths is an option of SCENE --paths FILE, not of --scene balls"),
        (["room.yaml", "--radius", "3"], "--radius is an option of --scene balls, not of SCENE"),
        (["room.yaml", "--views", "3"], "--views is an option of --scene balls, people, not of SCENE"),
        (["--scene", "balls", "--size", "10by4"], "'10by4': expected WIDTHxHEIGHT"),
        (["--scene", "balls", "--views", "7"], "7 is not in the range"),
    ],
)
def test_options_that_do_not_belong_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], args: list[str], words: str
) -> None:
    monkeypatch.chdir(ROOT / "examples")
    assert run(["simulate", *args, "-o", str(tmp_path / "x.mcap")]) == ExitCode.USAGE
    assert words in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["--radius", "200"], "does not fit into the box"),
        (
            ["--balls", "30", "--size", "64x48", "--radius", "8"],
            "take fewer or smaller ones, or let them overlap initially",
        ),
        (
            ["--balls", "100000", "--overlapping", "--collide"],
            "as balls that collide must; take fewer or smaller ones\n",
        ),
        (["--balls", "100000", "--overlapping"], "; take fewer\n"),
        (["--distance", "100"], "--distance 100: must be above 648, outside the box"),
        (["--fps", "nan"], "nan is not a finite number"),
        (["--fps", "1e12"], "is not in the range"),
        (["--fps", "1e-9"], "--fps"),
        (["--radius", "nan"], "nan is not a finite number"),
        (["--distance", "inf"], "inf is not a finite number"),
    ],
)
def test_balls_that_cannot_be(tmp_path: Path, capsys: pytest.CaptureFixture[str], args: list[str], words: str) -> None:
    out = tmp_path / "x.mcap"
    assert simulate(out, "--frames", "2", *args) == ExitCode.USAGE
    assert words in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_nothing_is_replaced_unasked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, video = tmp_path / "a.mcap", tmp_path / "a.view2.avi"
    video.write_bytes(b"mine")
    assert simulate(out, *SMALL, "--store", "ffv1") == ExitCode.EXISTS
    assert "a.view2.avi" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["a.view2.avi"]


def test_video_files_appear_with_the_recording_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: RecordingWriter) -> None:
        raise OutputError("the disk is full")

    out = tmp_path / "a.mcap"
    assert simulate(out, *SMALL, "--store", "ffv1") == ExitCode.DONE
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.mcap", "a.view1.avi", "a.view2.avi"]
    monkeypatch.setattr(RecordingWriter, "_finish", full)
    out = tmp_path / "b.mcap"
    assert simulate(out, *SMALL, "--store", "ffv1") == ExitCode.BAD_INPUT
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.mcap", "a.view1.avi", "a.view2.avi"]
