"""`occlog report --video` on files: all frames in step, pictures of one frame, one-line errors, nothing left behind."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.files.inputs import hash_inputs
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.io.frames.codec import encode_image
from occlog.io.frames.writer import SHOWN
from occlog.io.recording.reader import open_recording
from occlog.io.recording.writer import RecordingWriter
from occlog.records.declared.views import Failures, ViewTracks
from occlog.records.losses import Loss
from occlog.records.scene import Scene
from occlog.records.tables import Truth, TruthBoxes
from occlog.report.overlay.draw import ALARM, BAR, colour_of
from occlog.simulate.balls.config import BallsConfig
from occlog.simulate.balls.motion import ball_cameras, ball_ellipses
from occlog.simulate.balls.video import BallsFrame, balls_boxes, balls_scene

N, SIZE = 6, (96, 64)
CONFIG = BallsConfig(frames=N, width=96, height=64, balls=2, radius=10.0)
PLACES = np.array([[[k - 20.0, k - 20.0, 30.0], [25.0, 20.0 - k, 34.0]] for k in range(N)])
STEP = 100_000_000


def tracks_of(times: list[int]) -> ViewTracks:
    """The true outlines as tracks; target 0 helps itself over views, the targets touch each other."""
    parts = []
    for k, t in enumerate(times):
        for camera in ball_cameras(CONFIG):
            x, y, a, b, rho = ball_ellipses(camera, PLACES[k], 10.0).T
            other = "view2" if camera.name == "view1" else "view1"
            parts.append(
                ViewTracks.of(
                    t_ns=[t] * 2,
                    sensor=[camera.name] * 2,
                    frame=[k] * 2,
                    target_id=[0, 1],
                    x_px=x,
                    y_px=y,
                    a_px=a,
                    b_px=b,
                    rho=rho,
                    cov_xx_px=[1.0] * 2,
                    cov_xy_px=[0.0] * 2,
                    cov_yy_px=[1.0] * 2,
                    similarity=[np.nan] * 2,
                    ess=[np.nan] * 2,
                    likelihood_mode=["bmct"] * 2,
                    counterpart=[""] * 2,
                    neighbours=["1", "0"],
                    assisting_views=[other, ""],
                    lifecycle=[""] * 2,
                )
            )
    return ViewTracks.concat(parts)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A recording of two views of a plain wall, its tracks, and failures of one frame."""
    scene = balls_scene(CONFIG, 10.0)
    times = [k * STEP for k in range(N)]
    data = encode_image(np.full((*SIZE[::-1], 3), 90, dtype=np.uint8), "png", 0)
    with RecordingWriter(tmp_path / "r.mcap", scene, Provenance("simulate")) as writer:
        for k, t in enumerate(times):
            outlines = np.stack([ball_ellipses(c, PLACES[k], 10.0) for c in scene.cameras])
            for boxes in balls_boxes(BallsFrame(k, (), outlines, np.ones((2, 2))), scene.cameras, t):
                writer.table(boxes)
            for camera in scene.cameras:
                writer.image(camera.name, t, k, data, "png")
    write_table(tmp_path / "t.parquet", tracks_of(times), Provenance("track"))
    failures = Failures.of(
        t_ns=[2 * STEP] * 2,
        sensor=["view1"] * 2,
        frame=[2] * 2,
        target_id=[0, 1],
        kind=["label", "position"],
        other_id=[1, -1],
        cause=["", ""],
        visible=[1.0, 1.0],
    )
    write_table(tmp_path / "f.parquet", failures, Provenance("evaluate"))
    return tmp_path


def report(folder: Path, *args: str) -> int:
    return run(["report", str(folder / "t.parquet"), "--recording", str(folder / "r.mcap"), *args])


def frames_of(path: Path) -> list[np.ndarray]:
    video, out = cv2.VideoCapture(str(path)), []
    while (got := video.read())[0]:
        out.append(got[1])
    return out


def holds(picture: np.ndarray, colour: tuple[int, int, int], within: int = 40) -> int:
    """Pixels of about a colour."""
    return int((np.abs(picture.astype(int) - colour).max(axis=2) < within).sum())


@pytest.mark.parametrize("suffix", ["avi", "mp4", "webm"])
def test_the_video_has_a_picture_for_each_frame(folder: Path, capsys: pytest.CaptureFixture[str], suffix: str) -> None:
    out = folder / f"o.{suffix}"
    truth = str(folder / "r.mcap")
    assert report(folder, "--truth", truth, "--video", str(out), "--scale", "2", "--json") == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    assert (summary["frames"], summary["fps"], summary["tracks"], summary["truth"]) == (N, 10.0, 24, 24)
    pictures = frames_of(out)
    assert len(pictures) == N
    assert pictures[0].shape == (BAR + 128, 2 * 192 + 4, 3)
    for k in range(2):
        assert holds(pictures[3], colour_of(k), 70) > 100


def test_a_picture_of_one_frame_shows_the_estimates_where_they_are(folder: Path) -> None:
    assert report(folder, "--frame", "2", "--png", str(folder / "p.png"), "--scale", "1") == ExitCode.DONE
    picture = cv2.imread(str(folder / "p.png"))
    assert picture.shape == (BAR + 64, 2 * 96 + 4, 3)
    for view, camera in enumerate(ball_cameras(CONFIG)):
        x, y, a, _, _ = ball_ellipses(camera, PLACES[2, 0], 10.0)
        for dx, dy in ((a, 0.0), (-a, 0.0), (0.0, a)):
            row, col = round(BAR + y + dy), round(x + dx + view * 100)
            assert holds(picture[row - 1 : row + 2, col - 1 : col + 2], colour_of(0)) > 0
        x, y = ball_ellipses(camera, PLACES[2, 1], 10.0)[:2]  # dashed, so not everywhere on its rim
        row, col = round(BAR + y), round(x + view * 100)
        assert holds(picture[row - 11 : row + 12, col - 11 : col + 12], colour_of(1)) > 40
    # The epipolar line of target 0 is level and reaches the left edge of both views
    row = round(BAR + ball_ellipses(ball_cameras(CONFIG)[0], PLACES[2, 0], 10.0)[1])
    assert holds(picture[row - 1 : row + 2, :3], colour_of(0), 60) > 0
    assert holds(picture, ALARM) == 0


def test_failures_are_red_in_their_frame_only(folder: Path) -> None:
    args = ["--failures", str(folder / "f.parquet"), "--truth", str(folder / "r.mcap"), "--overwrite"]
    red = []
    for k in (1, 2, 3):
        assert report(folder, *args, "--frame", str(k), "--png", str(folder / "p.png")) == ExitCode.DONE
        red.append(holds(cv2.imread(str(folder / "p.png")), ALARM))
    assert red[0] == red[2] == 0
    assert red[1] > 200


def test_trackers_with_numbers_of_their_own_leave_the_truth_white(folder: Path) -> None:
    args = ["--truth", str(folder / "r.mcap"), "--frame", "2", "--png", str(folder / "p.png"), "--overwrite"]
    white = []
    for births in ("initial", "detections"):
        made = Provenance("track", {"births": births})
        write_table(folder / "t.parquet", tracks_of([k * STEP for k in range(N)]), made, overwrite=True)
        assert report(folder, *args) == ExitCode.DONE
        white.append(holds(cv2.imread(str(folder / "p.png")), (255, 255, 255)))
    assert white[1] > white[0] + 100


def test_truth_alone_one_camera_and_some_frames(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording, out = str(folder / "r.mcap"), folder / "o.avi"
    args = ["--recording", recording, "--truth", recording, "--video", str(out), "--camera", "view2"]
    assert run(["report", *args, "--frames", "1:4", "--fps", "5", "--scale", "1", "--json"]) == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    assert (summary["frames"], summary["fps"], summary["cameras"]) == (3, 5.0, ["view2"])
    assert [p.shape for p in frames_of(out)] == 3 * [(BAR + 64, 96, 3)]


def test_the_same_input_gives_the_same_bytes(folder: Path) -> None:
    for suffix in SHOWN:
        one, two = folder / f"a{suffix}", folder / f"b{suffix}"
        for path in (one, two):
            assert report(folder, "--video", str(path)) == ExitCode.DONE
        assert one.read_bytes() == two.read_bytes()


def test_images_in_which_no_one_was_found_are_shown(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    empty = tracks_of([0]).take(np.zeros(0, dtype=np.int64))
    write_table(folder / "t.parquet", empty, Provenance("track"), overwrite=True)
    assert report(folder, "--video", str(folder / "o.avi"), "--json") == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    assert (summary["frames"], summary["tracks"]) == (N, 0)
    assert len(frames_of(folder / "o.avi")) == N


def test_views_that_end_early_or_are_slower_keep_their_last_picture(tmp_path: Path) -> None:
    data = encode_image(np.full((64, 96, 3), 90, dtype=np.uint8), "png", 0)
    with RecordingWriter(tmp_path / "r.mcap", Scene(), Provenance("ingest")) as writer:
        for k in range(8):
            writer.image("a", k * STEP, k, data, "png")
            if k % 3 == 1:
                writer.image("b", k * STEP + 7, k // 3, data, "png")
    nan = [np.nan]
    boxes = TruthBoxes.of(
        t_ns=[0],
        sensor=["a"],
        frame=[0],
        box=[-1],
        target_id=[-1],
        left_px=nan,
        top_px=nan,
        width_px=nan,
        height_px=nan,
        confidence=nan,
    )
    write_table(tmp_path / "t.parquet", boxes, Provenance("ingest"))
    out = tmp_path / "o.avi"
    args = ["--recording", str(tmp_path / "r.mcap"), "--truth", str(tmp_path / "t.parquet"), "--video", str(out)]
    assert run(["report", *args, "--scale", "1"]) == ExitCode.DONE
    pictures = frames_of(out)
    assert len(pictures) == 8
    assert pictures[0][BAR:, 100:].max() < 20  # view b has not begun
    assert pictures[7][BAR:, 100:].min() > 60


def cut_images(folder: Path, lost: tuple[int, ...]) -> Path:
    """A recording of one camera, some of whose images are cut, and its true boxes."""
    data = encode_image(np.full((64, 96, 3), 90, dtype=np.uint8), "png", 0)
    nan, zero = [np.nan] * N, np.zeros(N, dtype=int)
    edges = dict.fromkeys(("left_px", "top_px", "width_px", "height_px", "confidence"), nan)
    with RecordingWriter(folder / "cut.mcap", Scene(), Provenance("ingest")) as writer:
        for k in range(N):
            writer.image("a", k * STEP, k, data[: len(data) // 2] if k in lost else data, "png")
    times = np.arange(N) * STEP
    boxes = TruthBoxes.of(t_ns=times, sensor=["a"] * N, frame=np.arange(N), box=zero - 1, target_id=zero - 1, **edges)
    write_table(folder / "boxes.parquet", boxes, Provenance("ingest"), overwrite=True)
    return folder / "cut.mcap"


def test_an_image_that_is_damaged_is_lost_and_the_others_are_drawn(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One ended the command, and with it the run."""
    recording = cut_images(tmp_path, (0, 3))
    args = ["report", "--recording", str(recording), "--truth", str(tmp_path / "boxes.parquet"), "--json"]
    out = tmp_path / "o.avi"
    assert run([*args, "--scale", "2", "--video", str(out)]) == ExitCode.LOSSY
    result = json.loads(capsys.readouterr().out)
    assert result["frames"] == N
    assert [(loss["place"], loss["count"]) for loss in result["losses"]] == [("frame 0", 1), ("frame 3", 1)]
    pictures = frames_of(out)
    assert len(pictures) == N
    middles = [picture[BAR + 20 : BAR + 60].mean() for picture in pictures]
    assert [middle > 60 for middle in middles] == [k not in (0, 3) for k in range(N)]
    assert run([*args, "--video", str(out), "--frames", "1:3", "--overwrite"]) == ExitCode.DONE
    picture = ["--png", str(tmp_path / "p.png")]
    assert run([*args, *picture, "--frame", "3"]) == ExitCode.LOSSY
    assert run([*args, *picture, "--frame", "4", "--overwrite"]) == ExitCode.DONE
    capsys.readouterr()
    recording.unlink()
    cut_images(tmp_path, tuple(range(N)))
    assert run([*args[:-1], "--video", str(tmp_path / "none.avi")]) == ExitCode.BAD_INPUT
    assert "no image of camera a can be decoded" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("args", "code", "words"),
    [
        (["t", "--video", "o.avi"], ExitCode.USAGE, "--recording is missing; give it"),
        (["t"], ExitCode.USAGE, "no output: give -o (the page), or --recording with --video or --frame"),
        (["R", "--video", "o.avi"], ExitCode.USAGE, "nothing to draw"),
        (["t", "R", "--frame", "1", "--png", "o.png", "--scale", "nan"], ExitCode.USAGE, "nan is not a finite number"),
        (["t", "R", "--video", "o.avi", "--fps", "nan"], ExitCode.USAGE, "nan is not a finite number"),
        (["t", "R"], ExitCode.USAGE, "no output: give -o (the page), or --recording with --video or --frame"),
        (["t", "R", "-o", "p.html", "--errors", "t.parquet"], ExitCode.USAGE, "their page does not show this"),
        (["t", "R", "--frame", "1"], ExitCode.USAGE, "--png and --frame belong together"),
        (["t", "R", "--video", "o.mov"], ExitCode.USAGE, "o.mov: a video can be .avi or .mp4"),
        (
            ["t", "R", "--video", "o.avi", "-o", "p.html"],
            ExitCode.USAGE,
            "-o is an option of a page, TRACKS OTHER (two runs side by side), not of --recording with --video",
        ),
        (["t", "R", "--video", "o.avi", "--camera", "view9"], ExitCode.BAD_INPUT, "no video of camera 'view9'"),
        (["t", "R", "--video", "o.avi", "--frames", "50:60"], ExitCode.BAD_INPUT, "has no frame in 50:60"),
        (["t", "R", "--frame", "50", "--png", "o.png"], ExitCode.BAD_INPUT, "camera view1 has no frame 50"),
        (["f", "R", "--video", "o.avi"], ExitCode.BAD_INPUT, "f.parquet"),
        (["late", "R", "--video", "o.avi"], ExitCode.BAD_INPUT, "give the recording that these tracks are of"),
        (["t", "R", "--truth", "bare.mcap", "--video", "o.avi"], ExitCode.BAD_INPUT, "bare.mcap: holds no true boxes"),
        (["t", "--recording", "bare.mcap", "--video", "o.avi"], ExitCode.BAD_INPUT, "holds no video to draw over"),
        (["t", "--recording", "no.mcap", "--video", "o.avi"], ExitCode.BAD_INPUT, "no.mcap: no such file"),
    ],
)
def test_what_cannot_be_drawn_is_reported_in_one_line(
    folder: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    args: list[str],
    code: ExitCode,
    words: str,
) -> None:
    monkeypatch.chdir(folder)
    write_table(folder / "late.parquet", tracks_of([10**12 + k for k in range(N)]), Provenance("track"))
    with RecordingWriter(folder / "bare.mcap", None, Provenance("ingest")) as writer:
        writer.table(Truth.of(t_ns=[0], target_id=[0], role=["target"], x=[0.0], y=[0.0], z=[0.0]))
    before = sorted(p.name for p in folder.iterdir())
    names = {"t": ["t.parquet"], "f": ["f.parquet"], "late": ["late.parquet"], "R": ["--recording", "r.mcap"]}
    given = [part for arg in args for part in names.get(arg, [arg])]
    assert run(["report", *given]) == code
    error = capsys.readouterr().err
    assert words in error
    assert "Traceback" not in error
    assert sorted(p.name for p in folder.iterdir()) == before


def test_tracks_of_another_recording_are_reported(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    used, other = folder / "r.mcap", folder / "other.mcap"
    other.write_bytes(b"another recording")
    # Of tracks of a table of regions the recording is not known
    for name, of in (("t", used), ("u", other), ("v", folder / "f.parquet")):
        made = Provenance("track", {"births": "initial"}, 0, hash_inputs([of]))
        write_table(folder / f"{name}.parquet", tracks_of([k * STEP for k in range(N)]), made, overwrite=True)
        args = ["--recording", str(used), "--frame", "1", "--png", str(folder / f"{name}.png")]
        assert run(["report", str(folder / f"{name}.parquet"), *args]) == ExitCode.DONE
        assert ("was made from another file" in capsys.readouterr().err) == (name == "u")


def test_nothing_is_replaced_unasked(folder: Path) -> None:
    (folder / "o.avi").write_bytes(b"mine")
    assert report(folder, "--video", str(folder / "o.avi")) == ExitCode.EXISTS
    assert (folder / "o.avi").read_bytes() == b"mine"
    assert open_recording(folder / "r.mcap").cameras == ("view1", "view2")


def test_what_was_lost_of_the_tracks_and_failures_is_reported(folder, capsys):
    losses = Loss("view1", "frame 4", "cut short", 1), Loss("view2", "frame 5", "cut short", 1)
    times = [k * STEP for k in range(N)]
    write_table(folder / "t.parquet", tracks_of(times), Provenance("track", losses=losses[:1]), overwrite=True)
    failures = read_table(folder / "f.parquet", Failures)
    write_table(folder / "f.parquet", failures, Provenance("evaluate", losses=losses), overwrite=True)
    args = ["--failures", str(folder / "f.parquet"), "--frame", "1", "--png", str(folder / "o.png")]
    assert report(folder, *args) == ExitCode.DONE
    stderr = [line for line in capsys.readouterr().err.splitlines() if "lost earlier" in line]
    assert stderr == [f"occlog: lost earlier: {loss}" for loss in losses]
