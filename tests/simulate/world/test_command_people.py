"""`occlog simulate --scene people`: everybody has a box in every frame, all are alike, views see all of the walk."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.recording.reader import open_recording
from occlog.records.tables import Truth, TruthBoxes
from occlog.simulate.world.people_room import CAMERAS, CLEARANCE, SIDE, people_apart, people_room

pytestmark = pytest.mark.jit

SMALL = ["--frames", "3", "--size", "96x72", "--people", "3", "--texture", "0"]


def simulate(out: Path, *args: str) -> int:
    return run(["simulate", "--scene", "people", "-o", str(out), *args])


def test_the_recording_holds_everybody_in_every_frame(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "p.mcap"
    assert simulate(out, *SMALL, "--views", "4", "--seed", "2", "--json") == ExitCode.DONE
    assert json.loads(capsys.readouterr().out)["frames"] == 12
    recording = open_recording(out)
    boxes, truth, scene = recording.read(TruthBoxes), recording.read(Truth), recording.scene
    assert scene is not None
    assert recording.cameras == ("view1", "view2", "view3", "view4")
    assert (truth.role == "target").all()
    for camera in scene.cameras:
        seen = boxes.take(boxes.sensor == camera.name)
        assert seen.target_id.tolist() == 3 * [0, 1, 2]
        assert ((seen.visible >= 0) & (seen.visible <= 1)).all()
        pixels = camera.project(np.column_stack([truth.x, truth.y, truth.z]))
        assert (np.abs(pixels[:, 0] - seen.left_px - 0.5 * seen.width_px) < 0.5 * seen.width_px).all()
    observations = json.loads(recording.attachment("appearance.json") or b"")
    assert [one["appearance"] for one in observations] == 3 * [observations[0]["appearance"]]
    assert recording.provenance.parameters["render"]["identical_targets"]
    first = boxes.take(boxes.frame == 0)
    assert (first.visible == 1.0).all()


def test_the_same_bytes_for_any_number_of_workers_and_video_without_colours(tmp_path: Path) -> None:
    digests = []
    for n, more in enumerate((["--workers", "1"], ["--workers", "3"], ["--grey"])):
        assert simulate(tmp_path / f"{n}.mcap", *SMALL, "--views", "2", *more) == ExitCode.DONE
        digests.append(hashlib.sha256((tmp_path / f"{n}.mcap").read_bytes()).hexdigest())
    assert digests[0] == digests[1] != digests[2]
    colours, grey = (next(iter(open_recording(tmp_path / f"{n}.mcap").frames())).decode() for n in (1, 2))
    assert (grey == grey[..., :1]).all()
    assert np.abs(grey[..., 0] - colours @ [0.114, 0.587, 0.299]).max() <= 0.5


def test_all_views_hold_all_people_who_keep_off_the_walls() -> None:
    low, high = CLEARANCE, SIDE - CLEARANCE
    points = np.array([[x, y, z] for x in (low, high) for y in (low, high) for z in (0.0, 1.9)])
    for size in ((640, 480), (320, 240), (640, 360)):
        for camera in people_room(len(CAMERAS), size, 25.0).cameras:
            pixels = camera.project(points)
            assert ((pixels > 0) & (pixels < np.array(size) - 1)).all(), camera.name


@pytest.mark.parametrize("seed", range(4))
def test_no_one_hides_another_at_the_start(seed: int) -> None:
    scene = people_room(3, (320, 240), 25.0)
    places = people_apart(scene, 4, seed)
    assert ((places > CLEARANCE) & (places < SIDE - CLEARANCE)).all()
    turns = np.linspace(0, 2 * np.pi, 40)
    rim = np.column_stack([0.3 * np.cos(turns), 0.3 * np.sin(turns)])
    for camera in scene.cameras:
        covered = []
        for position in places:
            body = np.concatenate([np.column_stack([position + rim, np.full(40, z)]) for z in (0.0, 0.9, 1.8)])
            pixels = camera.project(body)
            covered.append((pixels.min(axis=0), pixels.max(axis=0)))
        for i, (low, high) in enumerate(covered):
            for other_low, other_high in covered[:i]:
                assert (high < other_low).any() or (other_high < low).any()


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["--balls", "3"], "--balls is an option of --scene balls, not of --scene people"),
        (["--fps", "nan"], "nan is not a finite number"),
        (["--fps", "1e-9"], "is not in the range"),
        (
            ["--identical-clothes"],
            "--identical-clothes is an option of SCENE, SCENE --paths FILE, not of --scene people",
        ),
        (["--people", "12", "--frames", "1"], "or let them overlap in the first frame (--overlapping)"),
        (["--size", "32x32"], "people: width is 32, must be at least 64"),
    ],
)
def test_options_of_other_scenes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], args: list[str], words: str
) -> None:
    assert simulate(tmp_path / "x.mcap", *args) == ExitCode.USAGE
    assert words in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
