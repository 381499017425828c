from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from detect_scenes import BLUE, RED, STEP_NS, picture, scene, walk

from occlog.cli.main import run
from occlog.core.geometry.camera import wrap_angle
from occlog.errors import ExitCode
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.parquet import describe, read_provenance, read_table
from occlog.io.formats.calibration.reader import read_calibration
from occlog.io.recording.writer import RecordingWriter
from occlog.measure.regions.regions import histogram
from occlog.records.tables import Bearings, Boxes, Views

STEPS = 20
ROOM = scene()


def record(
    path: Path, change: Callable[[str, int, bytes], bytes] | None = None, appearance: bool = True, where: bool = True
) -> Path:
    """A recording of somebody in red who crosses the room, and of somebody in blue."""
    with RecordingWriter(path, ROOM if where else None, Provenance("test"), overwrite=True) as out:
        for k in range(STEPS):
            for n, cam in enumerate(ROOM.cameras):
                image = picture(cam, [walk(STEPS)[k], (7.0, 1.5 + 0.15 * k, BLUE)], 100 * n + k)
                data = cv2.imencode(".png", image)[1].tobytes()
                out.image(cam.name, k * STEP_NS, k, change(cam.name, k, data) if change else data, "png")
        if appearance:
            red = histogram(np.full((4, 4, 3), RED, dtype=np.uint8)).tolist()
            out.attach(
                "appearance.json", "application/json", json.dumps([{"target_id": 4, "appearance": red}]).encode()
            )
    return path


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("detect") / "room.mcap")


def detect(source: Path, folder: Path, *args: str) -> int:
    views = str(folder / "v.parquet")
    return run(["detect", str(source), "-o", str(folder / "b.parquet"), "--views", views, "-q", *args])


def errors(rows: Bearings) -> np.ndarray:
    """Errors of the bearings of the one in red, over their standard deviations."""
    out = []
    for i in np.flatnonzero(rows.seen):
        x, y, _ = walk(STEPS)[int(rows.t_ns[i] // STEP_NS)]
        cam = ROOM.camera(str(rows.sensor[i]))
        true = np.arctan2(y - cam.position[1], x - cam.position[0])
        out.append(wrap_angle(rows.bearing[i] - true) / rows.sigma[i])
    return np.array(out)


pytestmark = pytest.mark.jit  # whole recordings


def test_a_recording_becomes_bearings_and_views(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert detect(recording, tmp_path, "--json") == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    rows, views = read_table(tmp_path / "b.parquet", Bearings), read_table(tmp_path / "v.parquet", Views)
    assert summary["frames"] == summary["rows"] == len(rows) == 2 * STEPS
    assert summary["seen"] == rows.seen.sum() > 1.8 * STEPS
    assert summary["regions"] == len(views) > 3 * STEPS
    assert set(rows.target_id.tolist()) == {4}  # the attached appearance
    assert np.abs(errors(rows)).max() < 3
    made = read_provenance(tmp_path / "b.parquet")
    assert made.command == "detect"
    assert made.parameters["method"] == "background"
    assert made.parameters["targets"] == [4]
    assert describe(tmp_path / "b.parquet")["length_unit"] == "m"


def test_the_same_input_gives_the_same_bytes_for_any_number_of_workers(recording: Path, tmp_path: Path) -> None:
    for workers in ("1", "3"):
        (tmp_path / workers).mkdir()
        assert detect(recording, tmp_path / workers, "--workers", workers) == ExitCode.DONE
    for name in ("b.parquet", "v.parquet"):
        assert (tmp_path / "1" / name).read_bytes() == (tmp_path / "3" / name).read_bytes()


def test_a_target_can_be_shown_by_a_box(recording: Path, tmp_path: Path) -> None:
    cam = ROOM.camera("b")
    x, y, _ = walk(STEPS)[6]
    foot, head = cam.project(np.array([[x, y, 0.0], [x, y, 1.7]]))
    left, top = np.minimum(foot, head) - 6
    width, height = np.abs(foot - head) + 12
    assert detect(recording, tmp_path, "--target-box", f"9:b:6:{left},{top},{width},{height}") == ExitCode.DONE
    rows = read_table(tmp_path / "b.parquet", Bearings)
    assert set(rows.target_id.tolist()) == {9}
    assert rows.seen.sum() > 1.8 * STEPS
    assert np.abs(errors(rows)).max() < 3


def test_cameras_and_settings_can_be_chosen(recording: Path, tmp_path: Path) -> None:
    args = ("--cameras", "b", "--method", "components", "--background", "knn", "--no-shadows", "--history", "300")
    assert detect(recording, tmp_path, *args) == ExitCode.DONE
    assert set(read_table(tmp_path / "b.parquet", Bearings).sensor.tolist()) == {"b"}
    made = read_provenance(tmp_path / "b.parquet").parameters
    assert (made["method"], made["background"], made["shadows"], made["history"]) == ("components", "knn", False, 300)


def test_without_a_first_look_the_first_frames_give_no_rows(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert detect(recording, tmp_path, "--no-learn-background", "--warmup", "5", "--json") == ExitCode.DONE
    assert json.loads(capsys.readouterr().out)["warmup_frames"] == 10
    assert read_table(tmp_path / "b.parquet", Bearings).t_ns.min() == 5 * STEP_NS


def test_exit_code_3_for_frames_that_cannot_be_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    small = cv2.imencode(".png", np.zeros((30, 40, 3), dtype=np.uint8))[1].tobytes()

    def damage(sensor: str, k: int, data: bytes) -> bytes:
        if sensor == "a" and k in (7, 8):
            return small
        return data[: len(data) // 3] if sensor == "b" and k == 3 else data

    source = record(tmp_path / "bad.mcap", damage)
    assert detect(source, tmp_path) == ExitCode.LOSSY
    stderr = capsys.readouterr().err.splitlines()
    assert any("a: frames 7 to 8: image is 40 x 30 px" in line and "(2 lost)" in line for line in stderr)
    assert any("b: frame 3: the end mark of a PNG image is missing" in line for line in stderr)
    assert not any("Traceback" in line for line in stderr)
    assert [loss.count for loss in read_provenance(tmp_path / "b.parquet").losses] == [2, 1]
    assert read_provenance(tmp_path / "v.parquet").parameters["frames_left_out"] == {"a": [[7, 8]], "b": [[3, 3]]}
    assert len(read_table(tmp_path / "b.parquet", Bearings)) == 2 * STEPS - 3


def test_boxes_become_candidates(tmp_path: Path) -> None:
    boxes = Boxes.of(
        t_ns=[0, 0, STEP_NS],
        sensor=["a", "a", "a"],
        frame=[0, 0, 1],
        box=np.array([0, 1, -1], dtype=np.int32),
        target_id=np.full(3, -1, dtype=np.int32),
        left_px=[10.0, 60.0, np.nan],
        top_px=[20.0, 30.0, np.nan],
        width_px=[12.0, 14.0, np.nan],
        height_px=[40.0, 50.0, np.nan],
        confidence=[0.9, 0.8, np.nan],
    )
    with RecordingWriter(tmp_path / "boxes.mcap", ROOM, Provenance("test")) as out:
        out.table(boxes)
    assert detect(tmp_path / "boxes.mcap", tmp_path) == ExitCode.DONE
    rows = read_table(tmp_path / "b.parquet", Bearings)
    assert rows.seen.tolist() == [True, True, False]
    assert rows.target_id.tolist() == [-1, -1, -1]


@pytest.mark.parametrize("kind", ["boxes", "bearings"])
def test_cameras_are_chosen_without_images(tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str) -> None:
    one = np.ones(4)
    boxes = Boxes.of(
        t_ns=[0, 0, STEP_NS, STEP_NS],
        sensor=["a", "b", "a", "b"],
        frame=[0, 0, 1, 1],
        box=np.zeros(4, dtype=np.int32),
        target_id=np.full(4, -1, dtype=np.int32),
        left_px=20 * one,
        top_px=20 * one,
        width_px=12 * one,
        height_px=40 * one,
        confidence=0.9 * one,
    )
    with RecordingWriter(tmp_path / "boxes.mcap", ROOM, Provenance("test")) as out:
        out.table(boxes)
    assert detect(tmp_path / "boxes.mcap", tmp_path) == ExitCode.DONE
    source = tmp_path / "boxes.mcap"
    if kind == "bearings":
        source = tmp_path / "bearings.mcap"
        with RecordingWriter(source, ROOM, Provenance("test")) as out:
            out.table(read_table(tmp_path / "b.parquet", Bearings))
    (tmp_path / "b.parquet").unlink()
    (tmp_path / "v.parquet").unlink(missing_ok=True)
    assert detect(source, tmp_path, "--cameras", "b") == ExitCode.DONE
    assert read_table(tmp_path / "b.parquet", Bearings).sensor.tolist() == ["b", "b"]
    (tmp_path / "b.parquet").unlink()
    (tmp_path / "v.parquet").unlink(missing_ok=True)
    capsys.readouterr()
    assert detect(source, tmp_path, "--cameras", "b,z") == ExitCode.USAGE
    assert "no camera 'z'; there are a, b" in capsys.readouterr().err
    assert not (tmp_path / "b.parquet").exists()


@pytest.mark.parametrize(
    ("args", "code", "message"),
    [
        (("--cameras", "z"), ExitCode.USAGE, "no images of camera 'z'; there are images of a, b"),
        (("--target-box", "b:six:1,2,3,4"), ExitCode.USAGE, "expected CAM:FRAME:X,Y,W,H"),
        (("--target-box", "b:99:1,2,30,40"), ExitCode.BAD_INPUT, "no readable frame 99 of camera 'b'"),
        (("--target", "nowhere.json"), ExitCode.BAD_INPUT, "nowhere.json"),
        (("--bit-depth", "7"), ExitCode.USAGE, "--bit-depth"),
    ],
)
def test_bad_options_are_one_line_and_leave_no_file(
    recording: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    args: tuple[str, ...],
    code: ExitCode,
    message: str,
) -> None:
    assert detect(recording, tmp_path, *args) == code
    stderr = capsys.readouterr().err
    assert message in stderr
    assert "Traceback" not in stderr
    assert list(tmp_path.iterdir()) == []


def test_bad_appearances_are_reported(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for text in ("{", '[{"target_id": 1}]', '[{"target_id": 1, "appearance": [1, 2]}]'):
        (tmp_path / "t.json").write_text(text)
        assert detect(recording, tmp_path, "--target", str(tmp_path / "t.json")) == ExitCode.BAD_INPUT
        assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "b.parquet").exists()


def test_a_recording_without_a_scene_asks_for_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = record(tmp_path / "bare.mcap", where=False)
    assert detect(source, tmp_path) == ExitCode.USAGE
    assert "--scene" in capsys.readouterr().err


@pytest.mark.statistics
@pytest.mark.parametrize("up", [(), ("--up", "auto", "--ground-height", "0")])
def test_a_calibration_with_its_world_at_a_camera_is_detected_in(shared_data, tmp_path, capsys, up) -> None:
    """`caliscope_4cam` as it would be before its alignment; turned upright or not."""
    folder = shared_data / "caliscope_4cam/session_a"
    cameras = read_calibration([folder / "camera_array.toml"]).cameras
    base = cameras[1]
    tables = []
    for c in cameras:
        back = c.rotation.T @ base.rotation
        lines = [f'[cameras.{c.name}]\nname = "{c.name}"', f"size = {list(c.image_size or ())}"]
        matrix = [[c.focal_px[0], 0.0, c.principal_px[0]], [0.0, c.focal_px[1], c.principal_px[1]], [0.0, 0.0, 1.0]]
        lines += [f"matrix = {json.dumps(matrix)}", f"distortions = {c.distortion.tolist()}"]
        place = base.rotation.T @ (c.position - base.position)
        lines += [f"translation = {(-back @ place).tolist()}", f"rotation = {back.tolist()}"]
        tables.append("\n".join(lines))
    (tmp_path / "rig.toml").write_text("\n".join(tables) + "\n")
    videos = [v for k in range(4) for v in ("--video", f"cam_{k}={folder}/calibration/extrinsic/cam_{k}.mp4")]
    walk, bearings = str(tmp_path / "walk.mcap"), str(tmp_path / "b.parquet")
    source = ["--calibration", str(tmp_path / "rig.toml"), "--store", "link", "--frames", "0:8"]
    assert run(["ingest", "-o", walk, *videos, *source, *up]) == ExitCode.DONE
    assert ("seems not to be upright" in capsys.readouterr().err) is not bool(up)
    assert run(["detect", walk, "-o", bearings, "--method", "components"]) == ExitCode.DONE
    assert ("seems not to be upright" in capsys.readouterr().err) is not bool(up)
    assert read_table(Path(bearings), Bearings).seen.any()


def test_identities_of_boxes_become_targets(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    t_ns = np.repeat([0, STEP_NS, 2 * STEP_NS], 2)
    boxes = Boxes.of(
        t_ns=t_ns,
        sensor=["a", "b"] * 3,
        frame=t_ns // STEP_NS,
        box=np.zeros(6, dtype=np.int32),
        target_id=np.array([5, 5, 5, -1, 5, 5], dtype=np.int32),
        left_px=np.full(6, 60.0),
        top_px=np.full(6, 40.0),
        width_px=np.full(6, 12.0),
        height_px=np.full(6, 36.0),
        confidence=np.full(6, 0.9),
    )
    with RecordingWriter(tmp_path / "boxes.mcap", ROOM, Provenance("test")) as out:
        out.table(boxes)
    assert detect(tmp_path / "boxes.mcap", tmp_path, "--label-scope", "global") == ExitCode.DONE
    rows = read_table(tmp_path / "b.parquet", Bearings)
    assert rows.target_id.tolist() == [5, 5, 5, -1, 5, 5, 5]
    assert rows.seen.tolist() == [True, True, True, True, False, True, True]
    assert read_table(tmp_path / "v.parquet", Views).tracklet_id.tolist() == [5, 5, 5, -1, 5, 5]
    assert read_provenance(tmp_path / "b.parquet").parameters["label_scope"] == "global"


def test_in_images_no_one_has_an_identity(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert detect(recording, tmp_path, "--label-scope", "global") == ExitCode.USAGE
    assert "--label-scope makes targets of the identities of boxes" in capsys.readouterr().err
