"""`occlog evaluate --frames` on everything but tracks in images, and summaries of many targets."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.io.recording.writer import RecordingWriter
from occlog.records.tables import APPEARANCE_BINS, Bearings, Tracks, Truth, TruthBoxes, Views

NS = 1_000_000_000
FRAMES = 10
SCENE = """
occlog_scene: 1
cameras:
  - {name: east, position: [-10, 0], yaw_deg: 0, focal_px: 100, fov_deg: 90, image_size_px: [320, 240]}
"""


def walkers(people: int, error: float) -> tuple[Truth, Tracks]:
    """People who stand 3 m apart; tracks are right in the first six of ten seconds, then `error` beside."""
    t = np.repeat(np.arange(FRAMES), people)
    k = np.tile(np.arange(people, dtype=np.int32), FRAMES)
    x, nan = 3.0 * k.astype(np.float64), np.full(len(t), np.nan)
    off = np.where(t < 6, 0.0, error)
    one = np.ones(len(t))
    place = {"t_ns": t * NS, "target_id": k}
    truth = Truth.of(**place, x=x, y=np.zeros(len(t)), z=nan, role=np.full(len(t), "target"))
    tracks = Tracks.of(**place, x=x, y=off, vx=nan, vy=nan, cov_xx=one, cov_xy=0 * one, cov_yy=one)
    return truth, tracks


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A recording with the truth of two people, and their tracks."""
    truth, tracks = walkers(2, 0.5)
    with RecordingWriter(tmp_path / "w.mcap", scene_from_yaml(SCENE, "scene"), Provenance("test")) as writer:
        writer.table(truth)
    write_table(tmp_path / "w.parquet", tracks, Provenance("test"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def figures(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, float]:
    assert run(["evaluate", *arguments, "--json", "-q"]) == ExitCode.DONE
    return json.loads(capsys.readouterr().out)  # type: ignore[no-any-return]


def test_frames_of_tracks_on_the_ground_are_times_of_the_truth(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ("w.parquet", "--truth", "w.mcap")
    whole = figures(capsys, *asked)
    early, late = figures(capsys, *asked, "--frames", "0:6"), figures(capsys, *asked, "--frames", "6:10")
    assert (whole["frames"], early["frames"], late["frames"]) == (10, 6, 4)
    assert (early["rmse_m"], late["rmse_m"]) == pytest.approx((0.0, 0.5))
    assert (early["objects"], late["estimates"]) == (12, 8)
    # A range that ends after the last frame ends with it; one that begins there is empty
    assert figures(capsys, *asked, "--frames", "9:99")["frames"] == 1
    assert run(["evaluate", *asked, "--frames", "10:11"]) == ExitCode.BAD_INPUT
    assert "there are 10 of them" in capsys.readouterr().err


def test_frames_of_bearings_without_a_truth_are_times_of_the_bearings(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    n = FRAMES
    nan = np.full(n, np.nan)
    bearings = Bearings.of(
        t_ns=np.arange(n) * NS,
        sensor=np.full(n, "east"),
        target_id=np.full(n, -1, np.int32),
        seen=np.ones(n, dtype=np.bool_),
        u_px=np.zeros(n),
        sigma_px=np.ones(n),
        bearing=np.zeros(n),
        sigma=np.full(n, 0.01),
        score=nan,
    )
    write_table(folder / "b.parquet", bearings, Provenance("test"))
    scene = folder / "scene.yaml"
    scene.write_text(SCENE)
    asked = ("w.parquet", "--bearings", "b.parquet", "--scene", "scene.yaml", "--held-out", "east")
    whole, part = figures(capsys, *asked), figures(capsys, *asked, "--frames", "0:6")
    assert (whole["held_out_frames"], part["held_out_frames"]) == (20, 12)


def test_frames_of_views_have_the_numbers_of_their_camera(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Frames 100 to 109; views are right in the first six."""
    n = FRAMES
    base = {"t_ns": np.arange(n) * NS, "sensor": np.full(n, "east"), "frame": 100 + np.arange(n)}
    size = {"width_px": np.full(n, 20.0), "height_px": np.full(n, 40.0), "top_px": np.full(n, 10.0)}
    boxes = TruthBoxes.of(
        **base,
        **size,
        box=np.zeros(n, np.int32),
        target_id=np.zeros(n, np.int32),
        left_px=np.full(n, 50.0),
        confidence=np.full(n, np.nan),
    )
    left = np.where(np.arange(n) < 6, 50.0, 200.0)
    one = np.ones(n)
    views = Views.of(
        **base,
        **size,
        cluster=np.zeros(n, np.int32),
        x_px=left + 10.0,
        y_px=30.0 * one,
        cov_xx_px=one,
        cov_xy_px=0.0 * one,
        cov_yy_px=one,
        left_px=left,
        area_px=800.0 * one,
        bearing=0.0 * one,
        sigma=one,
        u_px=0.0 * one,
        sigma_px=one,
        confidence=one,
        similarity=np.nan * one,
        target_id=np.full(n, -1, np.int32),
        appearance=np.full((n, APPEARANCE_BINS), np.nan, np.float32),
    )
    write_table(folder / "boxes.parquet", boxes, Provenance("test"))
    write_table(folder / "views.parquet", views, Provenance("test"))
    asked = ("--views", "views.parquet", "--truth", "boxes.parquet")
    assert figures(capsys, *asked)["views_recall"] == pytest.approx(0.6)
    assert figures(capsys, *asked, "--frames", "100:106")["views_recall"] == 1.0
    assert figures(capsys, *asked, "--frames", "106:110")["views_recall"] == 0.0
    assert run(["evaluate", *asked, "--frames", "0:10"]) == ExitCode.BAD_INPUT
    assert "no true box is in them" in capsys.readouterr().err


def test_a_tracker_with_numbers_of_its_own_is_paired_by_distance(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tracks = walkers(2, 0.5)[1]
    columns = {c.name: getattr(tracks, c.name) for c in Tracks.columns()}
    order = np.lexsort((1 - tracks.target_id, tracks.t_ns))
    turned = {name: column[order] for name, column in (columns | {"target_id": 1 - tracks.target_id}).items()}
    for name, made in (("a", {"births": "detections"}), ("b", {})):
        write_table(folder / f"{name}.parquet", Tracks.of(**turned), Provenance("track", made))
    assert figures(capsys, "a.parquet", "--truth", "w.mcap")["error_max_m"] == pytest.approx(0.5)
    assert figures(capsys, "b.parquet", "--truth", "w.mcap")["error_max_m"] > 2.9
    assert figures(capsys, "a.parquet", "--truth", "w.mcap", "--match", "id")["error_max_m"] > 2.9


@pytest.mark.parametrize(("people", "shown"), [(10, 10), (11, 0)])
def test_targets_beyond_ten_are_in_the_file_alone(
    people: int, shown: int, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth, tracks = walkers(people, 0.5)
    with RecordingWriter(folder / "many.mcap", scene_from_yaml(SCENE, "scene"), Provenance("test")) as writer:
        writer.table(truth)
    write_table(folder / "many.parquet", tracks, Provenance("test"))
    asked = ("many.parquet", "--truth", "many.mcap")
    reported = figures(capsys, *asked, "-o", "m.json", "--fail-if", "rmse_target_3>9")
    assert sum("_target_" in name for name in reported) == 7 * shown
    assert sum("_target_" in name for name in json.loads(Path("m.json").read_text())) == 7 * people
    assert run(["evaluate", *asked, "-q"]) == ExitCode.DONE
    text = capsys.readouterr().out
    assert ("and 1 targets with a smaller RMSE" in text) == (not shown)


def test_the_numbers_of_people_over_time_are_a_table(folder: Path) -> None:
    asked = ["evaluate", "w.parquet", "--truth", "w.mcap", "--counts", "c.parquet", "-q"]
    assert run(asked) == ExitCode.DONE
    assert run(asked) == ExitCode.EXISTS
    assert run(["info", "c.parquet"]) == ExitCode.DONE
