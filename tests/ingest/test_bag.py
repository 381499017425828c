"""`occlog ingest` and `info` of bags: topics, clocks, poses, lens models, damage, refusals."""

from __future__ import annotations

import json
import math
import re
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("rosbags")
import ros1_bags
import ros_bags as ros
import zstandard
from ros_bags import START, STEP, Row

from occlog.array_types import NS
from occlog.cli.main import run
from occlog.core.geometry.camera import rotation_from_angles
from occlog.errors import ExitCode
from occlog.io.files.inputs import verdicts_of_file
from occlog.io.recording.reader import McapRecording, open_recording
from occlog.records.tables import Boxes, Doa, Truth
from occlog.records.verdicts import Check

IMAGE, RAW, INFO = "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
TF = "tf2_msgs/msg/TFMessage"
SCENE = """occlog_scene: 1
room: [[0, 0], [4, 0], [4, 3], [0, 3]]
cameras:
- {name: front, position: [0, 0, 2], yaw_deg: 30, focal_px: 50, image_size_px: [64, 48]}
microphone_arrays:
- {name: odas, position: [2, 3], yaw_deg: 90}
"""


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    return ros.write_mcap(tmp_path / "walk.mcap", ros.two_cameras())


def ingest(source: Path | Sequence[Path], *options: str) -> tuple[int, Path]:
    sources = [source] if isinstance(source, Path) else list(source)
    out = sources[0].parent / "recording.out.mcap"
    return run(["ingest", *map(str, sources), "-o", str(out), "--overwrite", *options]), out


def made(source: Path | Sequence[Path], *options: str, code: int = ExitCode.DONE) -> McapRecording:
    found, out = ingest(source, *options)
    assert found == code
    return open_recording(out)


def refused(capsys: pytest.CaptureFixture[str], source: Path, *options: str, code: int = ExitCode.USAGE) -> str:
    capsys.readouterr()
    assert ingest(source, *options)[0] == code
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "error:" in line]
    return line


def times(recording: McapRecording, camera: str) -> list[int]:
    return [(f.t_ns - START) // 10**6 for f in recording.frames([camera])]


def test_a_bag_becomes_a_recording_with_calibrated_cameras(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = made(bag)
    assert recording.cameras == ("cam_back", "cam_front")
    assert times(recording, "cam_front") == [50 * k for k in range(6)]
    scene = recording.scene
    assert scene is not None
    back = scene.camera("cam_back")
    assert np.allclose(back.position, [4, 0, 2])
    assert np.allclose(np.degrees(back.yaw), 150)
    assert np.allclose([*back.focal_px, *back.principal_px], [50, 50, 31.5, 23.5])
    # The compressed images are those of the bag, to the last byte.
    first = next(recording.frames(["cam_front"]))
    sent = cv2.imdecode(np.frombuffer(ros.compressed(0, "", ros.picture(0)).data, np.uint8), cv2.IMREAD_COLOR)
    assert np.array_equal(first.decode(), sent)
    stderr = capsys.readouterr().err
    assert "world 'map', m, right-handed, 2 cameras at cam_back (4.00, 0.00, 2.00)" in stderr
    assert "camera cam_back: 6 frames, times from header stamps of /cam_back/image_raw/compressed" in stderr


def test_topics_are_named_by_options_or_a_file(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = made(bag, "--topic", "west=/cam_front/image_raw/compressed")
    assert recording.cameras == ("west",)
    (bag.parent / "map.yaml").write_text("east: [/cam_back/image_raw/compressed, /cam_front/camera_info]\n")
    recording = made(bag, "--topics", str(bag.parent / "map.yaml"))
    assert recording.cameras == ("east",)
    assert "has no such topic; it has: /cam_back/camera_info" in refused(capsys, bag, "--topic", "a=/b")
    text = refused(capsys, bag, "--topic", "/cam_front/image_raw/compressed")
    assert "lacks the name of its camera" in text
    both = ("--topic", "a=/cam_front/image_raw/compressed", "--topic", "a=/cam_back/image_raw/compressed")
    assert "a already has images in /cam_front" in refused(capsys, bag, *both)


def test_the_clock_is_that_of_the_headers_or_of_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = ros.write_mcap(tmp_path / "late.mcap", ros.two_cameras(delay_ns=2 * 10**9))
    assert times(made(bag), "cam_front")[0] == 0
    assert "recorded 2 to 2 s after its header stamps; the header stamps are used" in capsys.readouterr().err
    assert times(made(bag, "--timestamp-source", "log"), "cam_front")[0] == 2000
    blank = [(t, k, log, _restamped(m) if k == IMAGE else m) for t, k, log, m in ros.two_cameras()]
    assert times(made(ros.write_mcap(tmp_path / "blank.mcap", blank)), "cam_front")[0] == 3
    assert "its headers have no time; the times of recording are used" in capsys.readouterr().err


def clocks_of(
    path: Path, change: Callable[[str, float], float], recorder: Callable[[float], float] = lambda _: 0.0
) -> list[Check]:
    """Findings of clocks, of two cameras and a recorder with times that are changed by those since the start [s]."""
    rows: list[Row] = []
    for k in range(150):
        t_s = 4 * k * STEP / NS
        for name in ("front", "back"):
            message = ros.compressed(START + round((t_s + change(name, t_s)) * NS), name, ros.picture(k))
            log = START + round((t_s + recorder(t_s)) * NS) + 3_000_000
            rows.append((f"/cam_{name}/image_raw/compressed", IMAGE, log, message))
    ids = ("clock-jump", "clock-drift", "stamps-late", "stamps-since-boot", "recorder-clock")
    out = path / "out.mcap"
    run(["ingest", str(ros.write_mcap(path / "b.mcap", rows)), "-o", str(out), "--allow-uncalibrated", "--overwrite"])
    return [check for verdict in verdicts_of_file(out) for check in verdict.checks if check.id in ids]


@pytest.mark.parametrize(
    ("change", "id", "figure", "size"),
    [
        (lambda t: 6.3 * (t > 11.0), "clock-jump", "jump_s", 6.3),
        (lambda t: -6.3 * (t > 11.0), "clock-jump", "jump_s", -6.3),
        (lambda t: -1.69e9 * (t > 11.0), "clock-jump", "jump_s", -1.69e9),
        (lambda t: 0.004 * t, "clock-drift", "ppm", 4000.0),
        (lambda _: 37.0, "stamps-late", "low_s", -37.0),
    ],
)
def test_faults_of_the_clock_of_a_camera_are_named_with_their_size(
    tmp_path: Path, change: Callable[[float], float], id: str, figure: str, size: float
) -> None:
    (found,) = clocks_of(tmp_path, lambda name, t: change(t) if name == "back" else 0.0)
    assert (found.id, found.sensors) == (id, ("cam_back",))
    assert found.figures[figure] == pytest.approx(size, rel=0.01)


def test_a_clock_that_all_topics_differ_from_alike_is_that_of_the_recorder(tmp_path: Path) -> None:
    assert clocks_of(tmp_path, lambda *_: 0.0) == []
    for recorder, size in ((lambda t: 0.004 * t, 4000.0), (lambda t: 6.3 * (t > 11.0), 6.3)):
        (found,) = clocks_of(tmp_path, lambda *_: 0.0, recorder)
        assert (found.id, found.severity) == ("recorder-clock", "note")
        assert found.figures["size"] == pytest.approx(size, rel=0.01)


def _restamped(message: object) -> object:
    return ros.make(
        IMAGE,
        header=ros.header(0, message.header.frame_id),  # type: ignore[attr-defined]
        format="jpeg",
        data=message.data,  # type: ignore[attr-defined]
    )


def test_frames_whose_stamps_go_back_are_lost(tmp_path: Path) -> None:
    rows = ros.two_cameras()
    late = ("/cam_front/image_raw/compressed", IMAGE, START + 10**10, ros.compressed(START, "f", ros.picture(9)))
    recording = made(ros.write_mcap(tmp_path / "b.mcap", [*rows, late]), code=ExitCode.LOSSY)
    assert len(times(recording, "cam_front")) == 6
    assert [(loss.place, loss.count) for loss in recording.losses] == [("/cam_front/image_raw/compressed", 1)]


def test_split_bags_are_one_and_a_file_that_is_missing_is_a_loss(tmp_path: Path) -> None:
    rows = ros.two_cameras(8)
    folder = tmp_path / "bag"
    folder.mkdir()
    half = len(rows) // 2
    ros.write_mcap(folder / "bag_0.mcap", rows[:half])
    ros.write_mcap(folder / "bag_1.mcap", rows[half:])
    assert len(times(made(folder), "cam_front")) == 8
    ros.write_metadata(folder, ["bag_0.mcap", "bag_1.mcap"], {"/cam_front/image_raw/compressed": 8})
    assert len(times(made(folder), "cam_front")) == 8
    (folder / "bag_1.mcap").unlink()
    recording = made(folder, code=ExitCode.LOSSY)
    assert len(times(recording, "cam_front")) == 4
    assert [loss.place for loss in recording.losses] == ["whole file", "/cam_front/image_raw/compressed"]
    assert recording.losses[1].count == 4


def test_metadata_that_count_too_few_messages_are_warned_of(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "bag"
    folder.mkdir()
    ros.write_mcap(folder / "bag_0.mcap", ros.two_cameras(8))
    topic = "/cam_front/image_raw/compressed"
    ros.write_metadata(folder, ["bag_0.mcap"], {topic: 5})
    recording = made(folder)
    assert (len(times(recording, "cam_front")), recording.losses) == (8, ())
    assert f"note: topic {topic}: metadata.yaml counts 5 messages, and there are 8" in capsys.readouterr().err


def test_a_file_that_is_cut_off_is_used_as_far_as_it_goes(tmp_path: Path) -> None:
    cut = ros.write_mcap(tmp_path / "cut.mcap", ros.two_cameras(), chunk_size=1500)
    whole = cut.read_bytes()
    cut.write_bytes(whole[: len(whole) // 3])
    recording = made(cut, code=ExitCode.LOSSY)
    found = times(recording, "cam_front")
    assert 0 < len(found) < 6
    assert found == [50 * k for k in range(len(found))]
    assert any("truncated" in loss.what for loss in recording.losses)
    assert any("ends" in loss.what for loss in recording.losses)


def test_a_damaged_chunk_is_lost_and_the_rest_is_used(tmp_path: Path) -> None:
    bag = ros.write_mcap(tmp_path / "b.mcap", ros.two_cameras(8), chunk_size=1500)
    data = bytearray(bag.read_bytes())
    data[len(data) // 2 - 500] ^= 0xFF
    bag.write_bytes(data)
    recording = made(bag, code=ExitCode.LOSSY)
    assert 4 <= len(times(recording, "cam_front")) < 8 or 4 <= len(times(recording, "cam_back")) < 8
    assert any("damaged chunk" in loss.what for loss in recording.losses)


def test_bags_are_unpacked_that_are_compressed_as_files_or_message_by_message(tmp_path: Path, bag: Path) -> None:
    packed = tmp_path / "walk.mcap.zstd"
    packed.write_bytes(zstandard.ZstdCompressor().compress(bag.read_bytes()))
    assert len(times(made(packed), "cam_front")) == 6
    base = tmp_path / "each.db3"
    ros.write_db3(base, ros.two_cameras())
    import sqlite3

    with sqlite3.connect(base) as rows:
        for number, data in rows.execute("SELECT id, data FROM messages").fetchall():
            packed_data = zstandard.ZstdCompressor().compress(data)
            rows.execute("UPDATE messages SET data = ? WHERE id = ?", (packed_data, number))
    rows.close()
    assert len(times(made(base), "cam_front")) == 6


def test_sqlite_bags_are_read_and_their_damage_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    base = ros.write_db3(tmp_path / "bag.db3", ros.two_cameras(20))
    assert len(times(made(base), "cam_back")) == 20
    data = base.read_bytes()
    base.write_bytes(data[: len(data) // 2])
    recording = made(base, code=ExitCode.LOSSY)
    assert 0 < len(times(recording, "cam_back")) < 20
    assert "damaged SQLite file" in recording.losses[0].what
    base.write_bytes(data[:20] + b"\xff" * 300)
    assert "not a ROS 2 bag that can be read" in refused(capsys, base, code=ExitCode.BAD_INPUT)


def rig(*rows: Row, tf: object | None = None, info: object | None = None, topic: str = "/cam/image_raw") -> list[Row]:
    """A bag of one camera in the frame `cam_optical`, at (1, 2, 3) in `map`, with yaw 45 and pitch -20 degrees."""
    turn = rotation_from_angles(math.radians(45), math.radians(-20), 0.0)
    pose = ros.transforms(START, ("map", "cam_optical", (1, 2, 3), turn))
    image = ros.raw(START, "cam_optical", ros.picture(3), "bgr8")
    return [
        ("/tf_static", TF, START, tf or pose),
        ("/cam/camera_info", INFO, START, info or ros.camera_info(START, "cam_optical")),
        (topic, RAW, START, image),
        *rows,
    ]


def test_poses_follow_the_chain_of_frames_to_the_world(tmp_path: Path) -> None:
    # map -> mast (yaw 90) -> cam_link (x forward) -> cam_optical (z forward), as drivers publish it.
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    optical = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    chain = ros.transforms(
        START,
        ("map", "mast", (1, 2, 0), turn),
        ("mast", "cam_link", (0.5, 0, 3), np.eye(3)),
        ("cam_link", "cam_optical", (0, 0.1, 0), optical),
    )
    recording = made(ros.write_mcap(tmp_path / "b.mcap", rig(tf=chain)))
    assert recording.scene is not None
    (camera,) = recording.scene.cameras
    assert np.allclose(camera.position, [0.9, 2.5, 3])
    assert np.allclose(np.degrees(camera.yaw), 90)
    # In the mast's frame it points along x.
    recording = made(ros.write_mcap(tmp_path / "b.mcap", rig(tf=chain)), "--world-frame", "mast")
    assert recording.scene is not None
    assert np.allclose(recording.scene.cameras[0].position, [0.5, 0.1, 3])


@pytest.mark.parametrize(("frames", "named"), [("ab" * 3, True), ("aaaaab", False), ("", False)])
def test_a_topic_with_the_messages_of_two_sensors_is_reported(tmp_path: Path, frames: str, named: bool) -> None:
    """A frame of few messages, or none in headers, is that of no other sensor."""
    rows: list[Row] = [
        ("/cam/image_raw", RAW, START + n * STEP, ros.raw(START + n * STEP, frame, ros.picture(n), "bgr8"))
        for n, frame in enumerate(frames or [""] * 6, start=1)
    ]
    code, out = ingest(ros.write_mcap(tmp_path / "b.mcap", rig(*rows)))
    assert code == ExitCode.DONE
    reported = [check.text for each in verdicts_of_file(out) for check in each.checks if check.id == "topic-frames"]
    assert [("/cam/image_raw" in text, "('a' 3, 'b' 3, " in text) for text in reported] == [(True, True)] * named


def test_a_calibration_that_changes_is_reported(tmp_path: Path) -> None:
    """A camera that zoomed kept its first calibration without a word."""
    same, other = (ros.camera_info(START + STEP, "cam_optical") for _ in "ab")
    other.k[0] *= 2
    again = [
        ("/cam/camera_info", INFO, START + n * STEP, reported) for n, reported in ((1, same), (2, other), (3, other))
    ]
    assert not made(ros.write_mcap(tmp_path / "b.mcap", rig(again[0]))).losses
    recording = made(ros.write_mcap(tmp_path / "b.mcap", rig(*again)), code=ExitCode.LOSSY)
    (loss,) = recording.losses
    assert (loss.place, loss.count) == ("/cam/camera_info", 2)
    assert (
        "calibrations differ from the first one, which was taken for all images; the first: fx 50, then 100"
        in loss.what
    )


def test_a_camera_that_moves_in_the_world_is_refused_unless_the_world_moves_with_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    turn = rotation_from_angles(0.0, 0.0, 0.0)
    moving = [
        ("/tf", TF, START + k * STEP, ros.transforms(START, ("odom", "base_link", (k * 0.3, 0, 0), np.eye(3))))
        for k in range(4)
    ]
    still = ros.transforms(START, ("base_link", "cam_optical", (0, 0, 1.5), turn))
    bag = ros.write_mcap(tmp_path / "b.mcap", [*rig(tf=still), *moving])
    recording = made(bag)
    assert "world 'base_link', m" in capsys.readouterr().err
    assert recording.scene is not None
    assert np.allclose(recording.scene.cameras[0].position, [0, 0, 1.5])
    text = refused(capsys, bag, "--world-frame", "odom", code=ExitCode.BAD_INPUT)
    assert "frame 'cam_optical' moves in 'odom': 'base_link' in 'odom' by 0.9 m" in text
    assert "no such frame; it has: base_link, cam_optical, odom" in refused(capsys, bag, "--world-frame", "map")


def test_two_static_poses_of_a_camera_are_refused_with_both(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An old launch file that also runs; noise of a localisation, and the same again, are no second pose."""
    base = rig()
    turn = rotation_from_angles(math.radians(45), math.radians(-20), 0.0)
    for move, code in ((0.01, ExitCode.DONE), (1.5, ExitCode.BAD_INPUT)):
        again = ros.transforms(START + 1, ("map", "cam_optical", (1, 2 + move, 3), turn))
        bag = ros.write_mcap(tmp_path / "b.mcap", [base[0], ("/tf_static", TF, START + 1, again), *base[1:]])
        assert ingest(bag)[0] == code
    text = capsys.readouterr().err
    assert (
        "camera cam: frame 'cam_optical' has different static transforms in 'map': at (1, 2, 3) and (1, 3.5, 3)" in text
    )


def test_exchanged_parents_and_children_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tf = ros.transforms(START, *((f"{name}_optical", "map", (1, 2, 3), np.eye(3)) for name in ("other", "cam")))
    text = refused(capsys, ros.write_mcap(tmp_path / "b.mcap", rig(tf=tf)), code=ExitCode.BAD_INPUT)
    assert "frame 'cam_optical' is only a parent in the transforms of the bag (of 'map'); if parent and child" in text


def test_frames_with_the_axes_of_a_body_are_asked_about(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    body = ros.transforms(START, ("map", "cam", (0, 0, 2), np.eye(3)))
    rows = [(t, k, n, ros.raw(START, "cam", ros.picture(0), "bgr8") if k == RAW else m) for t, k, n, m in rig(tf=body)]
    bag = ros.write_mcap(tmp_path / "b.mcap", rows)
    assert "the z axis of its frame 'cam' points up" in refused(capsys, bag)
    recording = made(bag, "--camera-axes", "body")
    assert recording.scene is not None
    assert np.allclose(np.degrees([recording.scene.cameras[0].yaw]), 0)


def test_a_camera_without_pose_or_calibration_is_refused_with_the_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    unplaced = ros.write_mcap(tmp_path / "a.mcap", rig()[1:])
    text = refused(capsys, unplaced, code=ExitCode.BAD_INPUT)
    assert "a.mcap: camera cam: has no calibration (the transforms of the bag (/tf, /tf_static) do not give" in text
    assert "the pose of the camera's frame 'cam_optical')" in text
    assert made(unplaced, "--allow-uncalibrated").cameras == ("cam",)
    (tmp_path / "scene.yaml").write_text(SCENE)
    scene = made(unplaced, "--scene", str(tmp_path / "scene.yaml"), "--topic", "front=/cam/image_raw").scene
    assert scene is not None
    assert np.allclose(scene.camera("front").focal_px, 50)
    unknown = ros.write_mcap(tmp_path / "b.mcap", rig(info=ros.camera_info(START, "cam_optical", k=np.zeros(9))))
    assert "/cam/camera_info states that it is not calibrated" in refused(capsys, unknown, code=ExitCode.BAD_INPUT)


def test_rectified_images_take_the_projection_and_the_rectifying_rotation(tmp_path: Path) -> None:
    turn = cv2.Rodrigues(np.array([0.0, 0.1, 0.0]))[0]
    p = np.array([60.0, 0, 30, 0, 0, 60, 22, 0, 0, 0, 1, 0])
    info = ros.camera_info(START, "cam_optical", d=np.array([-0.3, 0.1, 0, 0, 0]), r=turn.reshape(-1), p=p)
    recording = made(ros.write_mcap(tmp_path / "b.mcap", rig(info=info, topic="/cam/image_rect")))
    assert recording.scene is not None
    (camera,) = recording.scene.cameras
    assert np.allclose([*camera.focal_px, *camera.principal_px], [60, 60, 30, 22])
    assert not camera.distortion.any()
    raw_pose = rotation_from_angles(math.radians(45), math.radians(-20), 0.0)
    # ROS: X_rect = R X_raw, so that a world point projects as P R X_raw.
    point = np.array([[5.0, 5.5, 1.2]])
    seen = p.reshape(3, 4)[:, :3] @ turn @ raw_pose.T @ (point[0] - [1, 2, 3])
    assert np.allclose(camera.project(point)[0], seen[:2] / seen[2])


def test_the_right_camera_of_a_stereo_pair_in_the_frame_of_the_left_one_is_shifted(tmp_path: Path) -> None:
    p = np.array([50.0, 0, 31.5, -50 * 0.2, 0, 50, 23.5, 0, 0, 0, 1, 0])
    rows = rig(topic="/left/image_rect")
    rows[1] = ("/left/camera_info", INFO, START, ros.camera_info(START, "cam_optical"))
    right = ros.camera_info(START, "cam_optical", p=p)
    rows += [("/right/camera_info", INFO, START, right), ("/right/image_rect", RAW, START, rows[2][3])]
    scene = made(ros.write_mcap(tmp_path / "b.mcap", rows)).scene
    assert scene is not None
    shift = scene.camera("right").position - scene.camera("left").position
    assert np.allclose(scene.camera("left").rotation.T @ shift, [0.2, 0, 0])


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [
        ("rational_polynomial", [0.2, -0.1, 0.001, 0.0005, 0.01, 0.25, -0.09, 0.02]),
        (
            "rational_polynomial",
            [0.2, -0.1, 0.001, 0.0005, 0.01, 0.25, -0.09, 0.02, 0.003, -0.001, 0.002, 0.001, 0.02, 0.01],
        ),
        ("equidistant", [-0.02, 0.01, 0.0, 0.0]),
    ],
)
def test_other_lens_models_are_those_of_opencv(tmp_path: Path, model: str, coefficients: list[float]) -> None:
    info = ros.camera_info(START, "cam_optical", distortion_model=model, d=np.array(coefficients))
    scene = made(ros.write_mcap(tmp_path / "b.mcap", rig(info=info))).scene
    assert scene is not None
    (camera,) = scene.cameras
    k = np.array([[50.0, 0, 31.5], [0, 50.0, 23.5], [0, 0, 1]])
    points = np.array([[x, y, 1.0] for x in (-0.5, 0.0, 0.4) for y in (-0.35, 0.1, 0.38)])
    if model == "equidistant":
        wanted = cv2.fisheye.projectPoints(points[None], np.zeros(3), np.zeros(3), k, np.array(coefficients))[0]
    else:
        wanted = cv2.projectPoints(points, np.zeros(3), np.zeros(3), k, np.array(coefficients))[0]
    found = camera.project(points @ camera.rotation.T + camera.position)
    assert np.abs(found - wanted.reshape(-1, 2)).max() < 1e-6


def test_binning_of_a_bag_scales_the_camera_and_images_of_the_whole_sensor_contradict_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Images of 64 x 48 px of a sensor of 128 x 96, and a CameraInfo of 64 x 48 with binning and images of 64 x 48."""
    k = np.array([100.0, 0, 63.5, 0, 100.0, 47.5, 0, 0, 1])
    info = ros.camera_info(START, "cam_optical", width=128, height=96, k=k, binning_x=2, binning_y=2)
    scene = made(ros.write_mcap(tmp_path / "b.mcap", rig(info=info))).scene
    assert "images of 64 x 48 px of a sensor of 128 x 96 (binning 2 x 2" in capsys.readouterr().err
    assert scene is not None
    (camera,) = scene.cameras
    assert camera.image_size == (64, 48)
    assert np.allclose([*camera.focal_px, *camera.principal_px], [50, 50, 31.5, 23.5])
    other = ros.camera_info(START, "cam_optical", binning_x=2, binning_y=2)
    text = refused(capsys, ros.write_mcap(tmp_path / "c.mcap", rig(info=other)), code=ExitCode.BAD_INPUT)
    assert "states binning (2, 2) and roi (0, 0, 0, 0), so images of 32 x 24 px, but they have 64 x 48" in text


def test_lens_models_that_are_not_known_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = ros.camera_info(START, "cam_optical", distortion_model="fov", d=np.array([0.9]))
    text = refused(capsys, ros.write_mcap(tmp_path / "c.mcap", rig(info=other)), code=ExitCode.BAD_INPUT)
    assert "distortion model fov; only plumb_bob, " in text


def test_true_positions_boxes_and_sounds_are_taken_as_they_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "scene.yaml").write_text(SCENE)
    turn = cv2.Rodrigues(np.array([0.0, 0.0, math.pi / 2]))[0]
    tf = ros.transforms(START, ("map", "lab", (1, 0, 0), turn), ("map", "x_optical", (0, 0, 1), np.eye(3)))
    rows: list[Row] = [("/tf_static", TF, START, tf)]
    for k in range(3):
        t = START + k * STEP
        rows.append(("/mocap", "geometry_msgs/msg/PoseStamped", t, ros.pose(t, "lab", (1, 0.5 * k, 0.9))))
        boxes = [(10.0 + k, 5.0, 8.0, 20.0, 0.75, "person", "t7")] if k != 1 else []
        rows.append(("/yolo", "vision_msgs/msg/Detection2DArray", t, ros.detections(t, *boxes)))
        heard = [(4, 0.0, 1.0, 0.0, 0.5), (0, 0.0, 0.0, 0.0, 0.0)] if k != 1 else [(0, 0.0, 0.0, 0.0, 0.0)]
        rows.append(("/odas/sst", "odas_ros_msgs/msg/OdasSstArrayStamped", t, ros.sounds(t, *heard)))
    bag = ros.write_mcap(tmp_path / "b.mcap", rows)
    options = ("--scene", str(tmp_path / "scene.yaml"), "--topic", "front=/yolo", "--topic", "3=/mocap")
    recording = made(bag, *options, "--world-frame", "map")
    truth = recording.read(Truth)
    # x_map = 1 - y_lab, y_map = x_lab
    assert np.allclose(np.column_stack([truth.x, truth.y, truth.z]), [[1 - 0.5 * k, 1, 0.9] for k in range(3)])
    assert truth.target_id.tolist() == [3, 3, 3]
    found = recording.read(Boxes)
    assert found.frame.tolist() == [0, 1, 2]
    assert found.box.tolist() == [0, -1, 0]
    assert np.allclose(found.left_px, [10, np.nan, 12], equal_nan=True)
    assert np.allclose(found.confidence, [0.75, np.nan, 0.75], equal_nan=True)
    assert found.target_id.tolist() == [0, -1, 0]
    doa = recording.read(Doa)
    assert np.allclose(np.degrees(doa.azimuth), [-180, -180])
    assert doa.source_id.tolist() == [4, 4]
    assert "name it by the number of its" in refused(capsys, bag, *options[:2], "--topic", "person=/mocap")


def test_a_choice_of_frames_cuts_images_boxes_and_true_positions(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "scene.yaml").write_text(SCENE)
    rows: list[Row] = []
    for k in range(6):
        t = START + k * STEP
        # Positions come twice as often as frames, and before the first image
        rows.append(("/mocap", "geometry_msgs/msg/PoseStamped", t - STEP // 2, ros.pose(t - STEP // 2, "", (k, 1, 1))))
        rows.append(("/mocap", "geometry_msgs/msg/PoseStamped", t, ros.pose(t, "", (k + 0.5, 1, 1))))
        rows.append(("/front/image", IMAGE, t, ros.compressed(t, "", ros.picture(k))))
        rows.append(("/yolo", "vision_msgs/msg/Detection2DArray", t, ros.detections(t, (5, 5, 8, 20, 0.5, "a", ""))))
    bag = ros.write_mcap(tmp_path / "b.mcap", rows)
    topics = ("--topic", "front=/front/image", "--topic", "front=/yolo", "--topic", "0=/mocap")
    scene = ("--scene", str(tmp_path / "scene.yaml"))
    cut = made(bag, *scene, *topics, "--frames", "2:4")
    # Frames 2 and 3, half a frame wider at both ends
    assert cut.read(Truth).x.tolist() == [2.0, 2.5, 3.0, 3.5, 4.0]
    assert times(cut, "front") == [100, 150]
    assert cut.read(Boxes).frame.tolist() == [2, 3]
    assert "7 of 12 true positions are of other frames than 2:4, and skipped" in capsys.readouterr().err
    boxes = made(bag, *scene, *topics[2:], "--frames", "2:4")
    assert boxes.read(Truth).x.tolist() == [2.0, 2.5, 3.0, 3.5, 4.0]
    assert len(made(bag, *scene, *topics).read(Truth)) == 12


def test_boxes_of_several_classes_are_chosen_from(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "scene.yaml").write_text(SCENE)
    both = ros.detections(START, (1, 1, 5, 5, 0.5, "person", ""), (2, 2, 5, 5, 0.5, "chair", ""))
    bag = ros.write_mcap(tmp_path / "b.mcap", [("/yolo", "vision_msgs/msg/Detection2DArray", START, both)])
    options = ("--scene", str(tmp_path / "scene.yaml"), "--topic", "front=/yolo")
    assert "'person', 'chair'; choose one (--class NAME)" in refused(capsys, bag, *options, code=ExitCode.BAD_INPUT)
    assert made(bag, *options, "--class", "person").read(Boxes).left_px.tolist() == [1.0]


def test_info_lists_topics_and_what_would_be_taken(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["info", str(bag)]) == ExitCode.DONE
    out = capsys.readouterr().out
    assert "topic     /cam_back/camera_info: 6 x sensor_msgs/msg/CameraInfo (cdr), 19.8 Hz" in out
    assert "taken     camera cam_front: /cam_front/image_raw/compressed, calibration /cam_front/camera_info" in out
    assert f"command   occlog ingest {bag} -o recording.mcap" in out
    assert run(["info", str(bag), "--json"]) == ExitCode.DONE
    assert json.loads(capsys.readouterr().out)["topics"][0]["messages"] == 6


def test_a_bag_without_anything_to_take_says_what_it_holds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = ros.make("std_msgs/msg/String", data="hello")
    bag = ros.write_mcap(tmp_path / "b.mcap", [("/chatter", "std_msgs/msg/String", START, text)])
    assert "holds no topic of images, boxes or directions" in refused(capsys, bag, code=ExitCode.BAD_INPUT)
    nothing = tmp_path / "empty"
    nothing.mkdir()
    assert "holds no .mcap or .db3 file" in refused(capsys, nothing, code=ExitCode.BAD_INPUT)


def test_options_that_a_bag_does_not_take_are_refused(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "of the bag, which has its times" in refused(capsys, bag, "--fps", "cam_front=10")
    assert "a bag has its own times" in refused(capsys, bag, "--start-time", "2024-05-01T12:00:00Z")
    assert "omit --fps" in refused(capsys, bag, "--fps", "10")
    assert "only videos can be linked to" in refused(capsys, bag, "--store", "link")
    out = bag.parent / "x.mcap"
    assert run(["ingest", "-o", str(out), "--doa", "a=b", "--topic", "a=/b"]) == ExitCode.USAGE
    assert "apply to a bag" in capsys.readouterr().err
    shutil.copy(bag, out)
    assert run(["ingest", str(out), "-o", str(out), "--overwrite"]) == ExitCode.USAGE


def test_other_commands_say_that_a_bag_is_ingested_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "scene.yaml").write_text(SCENE)
    folder = tmp_path / "bag"
    folder.mkdir()
    rows = ros.two_cameras(1)
    for source in (folder, ros.write_mcap(folder / "b.mcap", rows), ros.write_db3(tmp_path / "b.db3", rows)):
        out, scene = tmp_path / "out.parquet", str(tmp_path / "scene.yaml")
        assert run(["track", str(source), "--scene", scene, "-o", str(out)]) == ExitCode.BAD_INPUT
        assert re.search(
            "convert a bag of another program by `occlog ingest`|make a recording of", capsys.readouterr().err
        )


def test_a_recording_of_occlog_is_no_bag(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its offset was taken out a second time, by the scene that it holds; its tables and losses were left out."""
    scene = bag.parent / "scene.yaml"
    scene.write_text(SCENE)
    once, again = bag.parent / "once.mcap", bag.parent / "again.mcap"
    offset = ["--clock-offset", "cam_front=0.5s"]
    assert run(["ingest", str(bag), "-o", str(once), "-q", *offset]) == ExitCode.DONE, capsys.readouterr().err
    cut = bag.parent / "cut.mcap"
    cut.write_bytes(once.read_bytes()[:-100])
    for path in (once, cut):
        assert run(["ingest", str(path), "--scene", str(once), "-o", str(again)]) == ExitCode.BAD_INPUT
        assert (
            f"{path.name}: is an occlog recording; ingest would drop its tables and losses" in capsys.readouterr().err
        )
    assert not again.exists()


def clocks(header_s: Sequence[float], log_s: Sequence[float], kind: str, folder: Path) -> Path:
    """A bag of one camera with these times of its images, and of recording [s after START], in this order."""
    rows = rig()[:2]
    for k, (stamp, recorded) in enumerate(zip(header_s, log_s, strict=True)):
        image = ros.compressed(START + round(stamp * 1e9), "cam_optical", ros.picture(k))
        rows.append(("/cam/image_raw", IMAGE, START + round(recorded * 1e9), image))
    if kind == "mcap":
        return ros.write_mcap(folder / "b.mcap", rows, chunk_size=1 << 22)
    (folder / f"b.{kind}").unlink(missing_ok=True)
    return ros1_bags.write_bag(folder / "b.bag", rows) if kind == "bag" else ros.write_db3(folder / "b.db3", rows)


@pytest.mark.parametrize("kind", ["mcap", "bag", "db3"])
def test_a_clock_that_is_set_back_is_reported_with_place_and_size_and_nothing_is_sorted(
    tmp_path: Path, kind: str
) -> None:
    """H4, case c06: messages of one chunk of MCAP were sorted, so that the last images came first, without a word."""
    times_s = [0.05 * k - (30 if k >= 20 else 0) for k in range(30)]
    recording = made(clocks(times_s, times_s, kind, tmp_path), code=ExitCode.LOSSY)
    assert times(recording, "cam") == [50 * k for k in range(20)]
    (loss,) = recording.losses
    assert loss.count == 10
    assert "go back, by up to 29.9 s, the first after message 19, recorded 2023-11-14T22:12:51" in loss.what
    # The recorder's clock alone: the headers are right, and so is the order of the file
    recording = made(clocks([0.05 * k for k in range(30)], times_s, kind, tmp_path))
    assert times(recording, "cam") == [50 * k for k in range(30)]


def test_messages_that_overtook_others_are_put_in_order_with_a_word(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    order = [0.05 * k for k in (0, 1, 3, 2, 4, 5, 7, 6)]
    assert times(made(clocks(order, order, "mcap", tmp_path)), "cam") == [50 * k for k in range(8)]
    assert "/cam/image_raw: 2 messages of b.mcap were up to 0.05 s out of order" in capsys.readouterr().err


def test_stamps_that_count_from_the_start_of_a_device_are_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """H7, case c08."""
    recorded = [0.05 * k for k in range(4)]
    made(clocks([s + 60 - START / 1e9 for s in recorded], recorded, "mcap", tmp_path))
    err = capsys.readouterr().err
    assert "count from another epoch" in err
    assert "s before recording (times since a start); the header stamps are used" in err
    assert "--timestamp-source header or log" in err
