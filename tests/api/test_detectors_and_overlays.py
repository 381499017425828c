"""Networks, fused tracks and overlays in Python have the bytes of the commands."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from detect_scenes import BLUE, RED, STEP_NS, camera, picture, scene
from people_in_groups import walk
from small_networks import mean_network, people_network

import occlog
from occlog.cli.main import cli
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.recording.writer import RecordingWriter
from occlog.records.tables import PeopleTracks

ROOM = scene(camera("a", 0.0, 0.0, 45.0), camera("b", 8.0, 0.0, 135.0))
NAMES = {"names": "{0: 'person', 1: 'dog', 2: 'cat'}", "task": "detect"}


def command(*args: object) -> None:
    made = CliRunner().invoke(cli, [str(a) for a in args], catch_exceptions=False)
    assert made.exit_code == 0, made.output


def same(table: occlog.Table, path: Path) -> bool:
    return table.path.read_bytes() == path.read_bytes()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of two people whom two cameras see, and networks."""
    made = tmp_path_factory.mktemp("room")
    people_network(made / "people.onnx", metadata=NAMES)
    mean_network(made / "reid.onnx")
    with RecordingWriter(made / "room.mcap", ROOM, Provenance("test")) as out:
        for k in range(3):
            for n, cam in enumerate(ROOM.cameras):
                people = [(2.5 + 0.1 * k, 4.0, RED), (5.5, 5.0 - 0.1 * k, BLUE)]
                data = cv2.imencode(".png", picture(cam, people, 100 * n + k))[1].tobytes()
                out.image(cam.name, k * STEP_NS, k, data, "png")
    return made


def test_networks_find_the_boxes_of_the_command(folder: Path, tmp_path: Path) -> None:
    recording, model, reid = folder / "room.mcap", folder / "people.onnx", folder / "reid.onnx"
    views, bearings = tmp_path / "v.parquet", tmp_path / "b.parquet"
    more = (
        "--embed",
        reid,
        "--embed-pixel-scaling",
        "unit",
        "--batch",
        2,
        "--min-confidence",
        0.4,
        "--class",
        "person",
    )
    command("detect", recording, "--onnx", model, "-o", views, "--bearings", bearings, *more)
    found = occlog.detect(
        recording,
        onnx=model,
        embed=reid,
        classes=["person"],
        bearings=True,
        embed_pixel_scaling="unit",
        batch=2,
        min_confidence=0.4,
    )
    assert same(found.views, views)
    assert same(found.bearings, bearings)
    assert found.summary["boxes"] == len(found.views) == 12
    with pytest.raises(occlog.InputError, match="no table 'bearings'"):
        _ = occlog.detect(recording, onnx=model).bearings


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (
            {"onnx": "m.onnx", "fuse": True},
            "fuse is not an argument of detector onnx; .*background, outlines, comp.*",
        ),
        (
            {"onnx": "m.onnx", "learn_background": False},
            "learn_background is not an argument of detector onnx; .*background, outlines, comp.*",
        ),
        (
            {"onnx": "m.onnx", "history": 3},
            "history is not an argument of detector onnx; .*background, outlines, comp.*",
        ),
        ({"head": "yolo"}, "head is not an argument of detector auto; leave it out, or choose .*: onnx"),
        (
            {"bearings": True},
            "bearings is not an argument of detector auto; leave it out, or choose .*: onnx",
        ),
        ({"method": "brigth"}, "no detector 'brigth'"),
    ],
)
def test_arguments_that_do_not_go_together_are_refused(given: dict[str, object], words: str) -> None:
    with pytest.raises(occlog.UsageError, match=words):
        occlog.detect("room.mcap", **given)  # type: ignore[arg-type]


def tracks_of(path: Path, tracks: PeopleTracks) -> Path:
    write_table(path, tracks, Provenance("track"), length_unit="m")
    return path


def test_fused_tracks_are_those_of_the_command(tmp_path: Path) -> None:
    times = np.arange(10) / 10
    east = tracks_of(tmp_path / "east.parquet", walk(0, times, (0, 0), (1, 0)))
    west = tracks_of(tmp_path / "west.parquet", walk(3, times, (0.02, 0), (1, 0)))
    out, events = tmp_path / "hall.parquet", tmp_path / "events.parquet"
    command("fuse", east, "--with", west, "-o", out, "--events", events, "--gate", 3)
    fused = occlog.fuse_tracks([east, occlog.read(west)], gate=3)
    assert same(fused.tracks, out)
    assert same(fused["events"], events)
    assert fused.summary["groups"]["tracks[1]"]["matched_pairs"] == 10
    away = tracks_of(tmp_path / "away.parquet", walk(3, times, (0, 7), (1, 0)))
    with pytest.warns(
        occlog.OcclogWarning, match=r"^tracks\[1\]: no person matches the tracks of the camera groups before it"
    ):
        occlog.fuse_tracks([east, occlog.read(away)])
    with pytest.raises(occlog.UsageError, match="two or more groups"):
        occlog.fuse_tracks([east])


def test_pictures_and_video_are_those_of_the_command(tmp_path: Path) -> None:
    recording = occlog.simulate(kind="balls", seed=1, frames=3, width=96, height=64, balls=2, radius=8)
    truth = recording.source
    drawn = ("--recording", truth, "--truth", truth, "--scale", 1)
    command("report", *drawn, "--frame", 1, "--png", tmp_path / "p.png", "--video", tmp_path / "v.avi")
    found = occlog.overlay(recording=recording, truth=recording, scale=1, frame=1, video=tmp_path / "mine.avi")
    assert found.png == (tmp_path / "p.png").read_bytes()
    assert (tmp_path / "mine.avi").read_bytes() == (tmp_path / "v.avi").read_bytes()
    assert found.summary["frames"] == 3
    assert "data:image/png;base64," in found._repr_html_()
    with pytest.raises(occlog.UsageError, match="nothing to draw"):
        occlog.overlay(recording=recording, frame=1)
    with pytest.raises(occlog.UsageError, match=r"no output: give video .*, frame"):
        occlog.overlay(recording=recording, truth=recording)
    with pytest.raises(occlog.SettingError, match=r"scale is 99.*at most 16"):
        occlog.overlay(recording=recording, truth=recording, frame=1, scale=99)
