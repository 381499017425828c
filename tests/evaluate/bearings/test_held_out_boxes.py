"""Boxes of a camera that tracks of everybody, made without it, predict."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from occlog.array_types import Floats
from occlog.cli.main import run
from occlog.errors import ExitCode, InputError
from occlog.evaluate.bearings.held_out import held_out_box_metrics
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.records.declared.people import PeopleTracks
from occlog.records.tables import Boxes

NS = 1_000_000_000
YAML = """
occlog_scene: 1
cameras:
  - {name: east, position: [0, 0, 1], yaw_deg: 0, focal_px: 500, image_size_px: [1000, 600]}
  - {name: west, position: [40, 0, 1], yaw_deg: 180, focal_px: 500, image_size_px: [1000, 600]}
"""
SCENE = scene_from_yaml(YAML, "scene")
FRAMES = 20


def tracks(*positions: tuple[float, float], height: float = 2.0) -> PeopleTracks:
    """People who stand at these places."""
    n = FRAMES * len(positions)
    t = np.repeat(np.arange(FRAMES), len(positions))
    x, y = np.tile(np.array(positions, dtype=np.float64).reshape(-1, 2), (FRAMES, 1)).T
    nan, one = np.full(n, np.nan), np.ones(n)
    return PeopleTracks.of(
        t_ns=t * NS,
        target_id=np.tile(np.arange(len(positions), dtype=np.int32), FRAMES),
        x=x,
        y=y,
        vx=nan,
        vy=nan,
        cov_xx=one,
        cov_xy=0 * one,
        cov_yy=one,
        height=height * one,
    )


def boxes(positions: list[tuple[float, float]], down: float = 0.0, sensor: str = "east") -> Boxes:
    """Boxes of people 2 m high at these places, moved down by some pixels, in every frame of the camera."""
    parts = []
    camera = next(c for c in SCENE.cameras if c.name == sensor)
    corners: list[Floats] = []
    for x, y in positions:
        feet, head = camera.project(np.array([[x, y, 0.0], [x, y, 2.0]]))
        corners.append(np.array([feet[0] - 20.0, head[1] + down, 40.0, feet[1] - head[1]]))
    for frame in range(FRAMES):
        parts += [(frame, k, *corner) for k, corner in enumerate(corners)]
    frame, box, left, top, width, height = np.array(parts, dtype=np.float64).T
    return Boxes.of(
        t_ns=frame.astype(np.int64) * NS,
        sensor=np.full(len(frame), sensor),
        frame=frame.astype(np.int64),
        box=box.astype(np.int32),
        target_id=np.full(len(frame), -1, np.int32),
        left_px=left,
        top_px=top,
        width_px=width,
        height_px=height,
        confidence=np.full(len(frame), np.nan),
    )


def figures(found: Boxes, people: PeopleTracks, **more: float) -> dict[str, float]:
    return held_out_box_metrics(people, found, SCENE, EvaluateConfig(held_out=("east",), **more))  # type: ignore[arg-type]


def test_boxes_of_people_who_are_tracked_are_predicted() -> None:
    got = figures(boxes([(10.0, 1.0), (10.0, -2.0), (20.0, 0.0)]), tracks((10.0, 1.0), (10.0, -2.0)))
    assert got["held_out_boxes"] == 3 * FRAMES
    assert got["held_out_boxes_share"] == got["held_out_boxes_feet_share"] == pytest.approx(2 / 3)
    assert got["held_out_boxes_precision"] == 1.0
    assert got["held_out_boxes_median_px"] == pytest.approx(0.0, abs=1e-9)
    # People who stand still are where they are at other times, too
    assert got["held_out_boxes_share_chance"] == pytest.approx(2 / 3)


def test_a_track_predicts_one_box_only() -> None:
    got = figures(boxes([(10.0, 1.0), (10.0, 1.2)]), tracks((10.0, 1.1)))
    assert got["held_out_boxes_share"] == pytest.approx(0.5)


def test_a_box_is_predicted_up_to_the_gate() -> None:
    people = tracks((10.0, 1.0))
    for down, share in ((99.9, 1.0), (100.1, 0.0)):
        assert figures(boxes([(10.0, 1.0)], down), people)["held_out_boxes_share"] == share
    assert figures(boxes([(10.0, 1.0)], 60.0), people, held_out_gate_px=50.0)["held_out_boxes_share"] == 0.0


def test_tracks_outside_the_image_or_behind_the_camera_are_not_expected() -> None:
    got = figures(boxes([(10.0, 1.0)]), tracks((10.0, 1.0), (10.0, 30.0), (-10.0, 1.0)))
    assert got["held_out_boxes_precision"] == 1.0
    assert figures(boxes([(10.0, 1.0)]), tracks((10.0, 1.0), (20.0, 0.0)))["held_out_boxes_precision"] == 0.5


def test_without_a_track_nothing_is_predicted() -> None:
    got = figures(boxes([(10.0, 1.0)]), tracks())
    assert got["held_out_boxes_share"] == 0.0
    assert np.isnan(got["held_out_boxes_precision"])


def test_a_track_without_a_height_is_of_a_person_of_ordinary_height() -> None:
    got = figures(boxes([(10.0, 1.0)]), tracks((10.0, 1.0), height=np.nan))
    assert got["held_out_boxes_median_px"] == pytest.approx(500 * 0.15 / 10)


def test_a_camera_that_is_not_there_is_named() -> None:
    with pytest.raises(InputError, match="north: no camera of this name with a pose is in the scene"):
        held_out_box_metrics(tracks((1, 1)), boxes([(10.0, 1.0)]), SCENE, EvaluateConfig(held_out=("north",)))
    with pytest.raises(InputError, match="no row of the held-out camera 'west'"):
        held_out_box_metrics(tracks((1, 1)), boxes([(10.0, 1.0)]), SCENE, EvaluateConfig(held_out=("west",)))


def test_the_command_reads_boxes_or_views(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write_table(Path("t.parquet"), tracks((10.0, 1.0)), Provenance("test"))
    write_table(Path("b.parquet"), boxes([(10.0, 1.0), (20.0, 3.0)]), Provenance("test"))
    Path("s.yaml").write_text(YAML)
    asked = ["evaluate", "t.parquet", "--views", "b.parquet", "--scene", "s.yaml"]
    assert run([*asked, "--held-out", "east", "--json", "-q"]) == ExitCode.DONE
    assert json.loads(capsys.readouterr().out)["held_out_boxes_share"] == pytest.approx(0.5)
    assert run([*asked, "--held-out", "east", "-q"]) == ExitCode.DONE
    assert "boxes predicted" in capsys.readouterr().out
    assert run(asked) == ExitCode.USAGE
    made = Provenance("track", {"sensors": ["east", "west"]})
    write_table(Path("t.parquet"), tracks((10.0, 1.0)), made, overwrite=True)
    assert run([*asked, "--held-out", "east"]) == ExitCode.BAD_INPUT
    assert "was made with east" in capsys.readouterr().err
