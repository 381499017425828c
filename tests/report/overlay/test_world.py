"""Tracks of the world over the video: where cameras should see them, the plan next to the images, trails, limits."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.io.frames.codec import encode_image
from occlog.io.recording.writer import RecordingWriter
from occlog.records.declared.views import ViewTracks
from occlog.records.scene import Camera, Scene, camera_rotation
from occlog.records.tables import Diagnostics, Tracks, Truth
from occlog.report.drawing import DARK, TARGET_COLOURS
from occlog.report.overlay.draw import BAR, WHITE, colour_of
from occlog.report.overlay.plan import Trails

NS, SIZE = 10**9, (200, 150)
MADE = Provenance("track")
ROOM = np.array([[0.0, 0.0], [6.0, 0.0], [6.0, 4.5], [0.0, 4.5]])


def view_tracks_of(times: list[int], sensor: str) -> ViewTracks:
    """An ellipse around (20, 25) in each frame."""
    n = len(times)
    numbers = {"x_px": 20.0, "y_px": 25.0, "a_px": 4.0, "b_px": 10.0, "rho": 0.0, "similarity": np.nan, "ess": np.nan}
    numbers |= {"cov_xx_px": 1.0, "cov_xy_px": 0.0, "cov_yy_px": 1.0}
    words = {"likelihood_mode": "box", "counterpart": "", "neighbours": "", "assisting_views": "", "lifecycle": ""}
    values = {name: [value] * n for name, value in (numbers | words).items()}
    return ViewTracks.of(t_ns=times, sensor=[sensor] * n, frame=list(range(n)), target_id=[3] * n, **values)


def camera(name: str, x: float, yaw: float) -> Camera:
    place, turn = np.array([x, 2.0, 2.0]), camera_rotation(yaw, -0.2, 0.0)
    return Camera(name, place, turn, np.full(2, 120.0), np.array([99.5, 74.5]), image_size=SIZE, fov=1.4)


CAMERAS = (camera("east", 6.0, np.pi), camera("west", 0.0, 0.0))
PLACES = np.array([[2.5, 2.0], [2.7, 2.1], [2.9, 2.2]])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A run folder: two cameras at a grey wall, a target that the western one does not see, and its true place."""
    image = encode_image(np.full((*SIZE[::-1], 3), 90, dtype=np.uint8), "png", 0)
    with RecordingWriter(tmp_path / "recording.mcap", Scene(CAMERAS, room=ROOM), MADE) as out:
        for k in range(3):
            for each in CAMERAS:
                out.image(each.name, k * NS // 5, k, image, "png")
        x, y = PLACES[-1]
        out.table(Truth.of(t_ns=[2 * NS // 5], target_id=[5], role=["target"], x=[x + 1], y=[y], z=[np.nan]))
    covariance = {"cov_xx": [0.01] * 3, "cov_xy": [0.0] * 3, "cov_yy": [0.01] * 3}
    t_ns, target = [k * NS // 5 for k in range(3)], [5] * 3
    nothing = {name: [np.nan] * 3 for name in ("vx", "vy")}
    tracks = Tracks.of(t_ns=t_ns, target_id=target, x=PLACES[:, 0], y=PLACES[:, 1], **covariance, **nothing)
    write_table(tmp_path / "tracks.parquet", tracks, MADE, length_unit="m")
    words = {name: [""] * 3 for name in ("fallback", "selected", "quality_flags")}
    numbers = {name: [np.nan] * 3 for name in ("ess", "log_likelihood", "predicted_mse")}
    seen = Diagnostics.of(
        t_ns=t_ns, target_id=target, n_observing=[2] * 3, n_detected=[1] * 3, n_available=[2] * 3,
        cameras=["east,west"] * 3,
        seen_by=["east"] * 3, **words, **numbers,
    )  # fmt: skip
    write_table(tmp_path / "diagnostics.parquet", seen, MADE, length_unit="m")
    return tmp_path


def frame(folder: Path, *args: str, tracks: str = "", number: int = 2) -> np.ndarray:
    words = ["report", str(folder / tracks), "--recording", str(folder / "recording.mcap"), "--overwrite", "-q"]
    output = ["--frame", str(number), "--png", str(folder / "p.png"), "--scale", "1"]
    assert run([*words, *output, *args]) == ExitCode.DONE
    return cv2.imread(str(folder / "p.png"))


def holds(picture: np.ndarray, colour: tuple[int, int, int], within: int = 40) -> int:
    return int((np.abs(picture.astype(int) - colour).max(axis=2) < within).sum())


def cells(picture: np.ndarray) -> list[np.ndarray]:
    """The images of both cameras, and what follows."""
    width = SIZE[0] + 4
    return [picture[BAR:, k * width : k * width + SIZE[0]] for k in range(3)]


def test_a_body_stands_where_the_camera_sees_it_and_is_dashed_where_it_does_not(folder: Path) -> None:
    east, west, _ = cells(frame(folder, "--trail", "0"))
    marked = []
    for image, each in zip((east, west), CAMERAS, strict=True):
        middle = each.project(np.array([[*PLACES[2], 0.0], [*PLACES[2], 1.7]]))
        rows, columns = np.nonzero(np.abs(image.astype(int) - colour_of(0)).max(axis=2) < 40)
        low = rows > middle[1, 1] + 20  # below the number
        assert abs(columns[low].mean() - middle[0, 0]) < 4
        assert abs(rows.max() - middle[0, 1]) < 12
        marked.append(low.sum() / (middle[0, 1] - middle[1, 1]))
    assert marked[1] < 0.75 * marked[0]


def test_the_plan_shows_the_target_its_way_and_its_true_place(folder: Path) -> None:
    plans = [
        cells(frame(folder, "--truth", str(folder / "recording.mcap"), *more))[2] for more in ((), ("--trail", "0"))
    ]
    scale = 0.88 * min(SIZE[0] / 6.0, SIZE[1] / 4.5)
    x, y = 99.5 + scale * (PLACES[2, 0] - 3.0), 74.5 - scale * (PLACES[2, 1] - 2.25)
    assert holds(plans[0][round(y) - 2 : round(y) + 3, round(x) - 2 : round(x) + 3], colour_of(0)) > 15
    true = plans[0][round(y) - 4 : round(y) + 5, round(x + scale) - 4 : round(x + scale) + 5]
    assert holds(true, WHITE, 90) > 5
    assert (plans[0] != plans[1]).any()  # the trail


def test_without_a_room_the_plan_is_around_the_tracks(folder: Path) -> None:
    alone = Scene((camera("east", 30.0, np.pi),))
    (folder / "alone.yaml").write_text(scene_to_yaml(alone))
    picture = frame(folder, "--scene", str(folder / "alone.yaml"), "--camera", "east")
    plan = picture[BAR:, SIZE[0] + 4 :]
    scale = 0.88 * SIZE[0] / (30.0 - PLACES[0, 0])
    x, y = 99.5 + scale * (PLACES[2, 0] - 0.5 * (PLACES[0, 0] + 30.0)), 74.5 - scale * 0.1
    assert holds(plan[round(y) - 2 : round(y) + 3, round(x) - 2 : round(x) + 3], colour_of(0)) > 15


def test_colours_are_those_of_the_report_in_the_dark() -> None:
    for index in range(8):
        text = DARK[TARGET_COLOURS[index % len(TARGET_COLOURS)]]
        assert "#{:02x}{:02x}{:02x}".format(*reversed(colour_of(index))) == text


def test_the_plan_can_be_left_out_and_needs_no_run_folder(folder: Path) -> None:
    picture = frame(folder, "--no-plan", tracks="tracks.parquet")
    assert picture.shape == (BAR + SIZE[1], 2 * SIZE[0] + 4, 3)
    assert holds(picture, colour_of(0)) > 50


def test_large_images_are_made_smaller_until_all_fit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image = encode_image(np.zeros((1500, 3000), dtype=np.uint8), "png", 0)
    with RecordingWriter(tmp_path / "r.mcap", Scene(CAMERAS, room=ROOM), MADE) as out:
        for each in CAMERAS:
            out.image(each.name, 0, 0, image, "png")
    write_table(tmp_path / "v.parquet", view_tracks_of([0], "east"), MADE)
    words = ["report", str(tmp_path / "v.parquet"), "--recording", str(tmp_path / "r.mcap"), "--json"]
    assert run([*words, "--frame", "0", "--png", str(tmp_path / "p.png")]) == ExitCode.DONE
    assert json.loads(capsys.readouterr().out)["scale"] == pytest.approx(0.64)
    assert cv2.imread(str(tmp_path / "p.png")).shape[1] <= 3840 + 4


def test_trails_follow_the_feet_and_end_with_the_target() -> None:
    trails = Trails(1.0)
    rows = view_tracks_of([0], "east")
    assert trails.ways(rows, 0) == []
    (way,) = trails.ways(rows, NS // 2)
    np.testing.assert_allclose(way.points, [[20.0, 35.0]] * 2)  # the lowest point of its ellipse
    assert trails.ways(rows.take(slice(0, 0)), NS) == []
    (late,) = trails.ways(rows, NS + NS // 2)
    assert len(late.points) == 2  # the first is older than a second


def test_tracks_of_the_world_need_cameras_that_are_placed(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with RecordingWriter(folder / "bare.mcap", None, MADE) as out:
        out.image("east", 0, 0, encode_image(np.zeros((8, 8), dtype=np.uint8), "png", 0), "png")
    words = ["report", str(folder / "tracks.parquet"), "--recording", str(folder / "bare.mcap")]
    assert run([*words, "--frame", "0", "--png", str(folder / "p.png")]) == ExitCode.USAGE
    assert "name a scene with --scene" in capsys.readouterr().err
    assert not (folder / "p.png").exists()


def test_an_mp4_says_that_browsers_may_not_play_it(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["report", str(folder), "--recording", str(folder / "recording.mcap"), "--scale", "1"]
    assert run([*words, "--video", str(folder / "o.mp4")]) == ExitCode.DONE
    assert "browsers may not play" in capsys.readouterr().err
    assert run([*words, "--video", str(folder / "o.webm")]) == ExitCode.DONE
    assert capsys.readouterr().err == ""
