"""`occlog.ingest`: the bytes of the command from the same files, names of sensors, notes, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import occlog
from occlog.cli.main import run
from occlog.errors import ExitCode

SCENE = """
occlog_scene: 1
room: [[0, 0], [20, 0], [20, 20], [0, 20]]
cameras:
  - {name: east, position: [0, 10], yaw_deg: 0, focal_px: 100, fov_deg: 90, image_size_px: [320, 240]}
  - {name: north, position: [10, 0], yaw_deg: 90, focal_px: 100, fov_deg: 90, image_size_px: [320, 240]}
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A scene of two cameras, boxes of each in MOTChallenge text, and true places."""
    (tmp_path / "scene.yaml").write_text(SCENE)
    for name in ("east", "north"):
        lines = [f"{frame},-1,{100 + frame},80,30,60,0.9" for frame in range(1, 6)]
        (tmp_path / f"{name}.txt").write_text("\n".join(lines))
    (tmp_path / "truth.csv").write_text("time,id,x,y\n" + "".join(f"{k / 5},0,{5 + k / 10},9\n" for k in range(5)))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def made(**more: Any) -> occlog.Recording:
    asked = {"boxes": {"east": "east.txt", "north": Path("north.txt")}, "truth": "truth.csv", "fps": 5}
    return occlog.ingest(**{**asked, "scene": "scene.yaml", **more})


@pytest.mark.parametrize(
    ("options", "settings"),
    [
        ((), {}),
        (("--frames", "1:4", "--score-type", "unknown"), {"frames": (1, 4), "score_type": "unknown"}),
        (("--frames", "east=1:4", "--frames", "north=0:3"), {"frames": {"east": (1, 4), "north": (0, 3)}}),
        (("--start-time", "east=0", "--start-time", "north=0.5"), {"start_time": {"east": 0, "north": "0.5"}}),
        (("--confidence-scale", "2", "--fps", "north=10"), {"confidence_scale": 2, "fps": {"east": 5, "north": 10.0}}),
        (("--confidence-scale", "2"), {"confidence_scale": "2"}),
        (("--start-time", "1", "--clock-offset", "east=-0.5"), {"start_time": 1, "clock_offset": {"east": -0.5}}),
    ],
)
def test_recordings_have_the_bytes_of_the_command(
    folder: Path, options: tuple[str, ...], settings: dict[str, Any]
) -> None:
    asked = ["ingest", "--boxes", "east=east.txt", "--boxes", "north=north.txt", "--truth", "truth.csv"]
    rate = ("--fps", "east=5") if "--fps" in options else ("--fps", "5")
    assert run([*asked, *rate, "--scene", "scene.yaml", "-o", "c.mcap", "-q", *options]) == ExitCode.DONE
    recording = made(**settings)
    assert recording.source.read_bytes() == (folder / "c.mcap").read_bytes()
    assert set(recording.tables) == {"boxes", "truth"}


def test_a_scene_in_memory_notes_and_the_output(folder: Path) -> None:
    recording = made(scene=occlog.read_scene("scene.yaml"), output="out.mcap")
    assert recording.source == Path("out.mcap")
    assert [s.name for s in recording.sensors] == ["east", "north"]
    assert recording.summary["rows"] == {"boxes": 10, "truth": 5}
    assert any(
        "cameras east, north: times from frame rate 5 fps (given)" in note for note in recording.summary["notes"]
    )  # type: ignore[attr-defined]
    with pytest.raises(occlog.OutputExistsError):
        made(output="out.mcap")
    before = (folder / "out.mcap").read_bytes()
    assert made(output="out.mcap", overwrite=True, fps=10).source.read_bytes() != before


def test_classes_are_one_name_or_several(folder: Path) -> None:
    rows = [f"{k},east,{kind},{100 + k},80,130,140,0.9\n" for k in range(5) for kind in ("person", "dog", "car")]
    (folder / "b.csv").write_text("frame,camera,class,left,top,right,bottom,confidence\n" + "".join(rows))
    for classes, count in (("person", 5), (["person", "dog"], 10), ("person,car", 10)):
        assert made(boxes="b.csv", classes=classes).summary["rows"] == {"boxes": count, "truth": 5}


def test_what_was_lost_is_a_warning(folder: Path) -> None:
    with (folder / "east.txt").open("a") as file:
        file.write("\n6,-1,900,80,30,60,0.9\n")
    with pytest.warns(occlog.OcclogWarning, match="input was lost: east"):
        recording = made()
    assert [loss.count for loss in recording.losses] == [1]


@pytest.mark.parametrize(
    ("asked", "error", "words"),
    [
        ({"fp": 5}, occlog.UsageError, "did you mean 'fps'"),
        ({"boxes": {"a b": "east.txt"}}, occlog.UsageError, "boxes: 'a b' is no name"),
        ({"boxes": "nope.txt"}, occlog.InputError, "nope.txt: no such file"),
        ({"frames": (4, 1)}, occlog.UsageError, r"frames: \(4, 1\)"),
        ({"image_size": (0, 4)}, occlog.UsageError, r"image_size: \(0, 4\)"),
        ({"jpeg_quality": 101}, occlog.SettingError, "at most 100"),
        ({"jpeg_quality": "ten"}, occlog.UsageError, "jpeg_quality"),
        ({"store": "gif"}, occlog.SettingError, "store"),
        ({"boxes": pd.DataFrame({"frame": [1]})}, occlog.UsageError, "boxes: a DataFrame in memory; give a path"),
        ({"boxes": {"east": np.zeros(3)}}, occlog.UsageError, "boxes: a ndarray in memory; give a path"),
        ({"topic": {"east": "/east"}}, occlog.UsageError, "give a bag"),
    ],
)
def test_what_cannot_be_is_refused(
    folder: Path, asked: dict[str, Any], error: type[occlog.OcclogError], words: str
) -> None:
    before = sorted(folder.iterdir())
    with pytest.raises(error, match=words):
        made(**asked, output="out.mcap")
    assert sorted(folder.iterdir()) == before
