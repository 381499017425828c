"""`occlog ingest` and `info` of bags of ROS 1, and of MCAP files with messages of ROS 1."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")
import ros1_bags as ros1
import ros_bags as ros
from mcap.writer import Writer
from ros_bags import START, STEP, Row

from occlog.cli.main import run
from occlog.errors import ExitCode
from occlog.io.recording.reader import McapRecording, open_recording
from occlog.records.tables import Boxes, Truth

TF, INFO = "tf2_msgs/msg/TFMessage", "sensor_msgs/msg/CameraInfo"
BOXES, POSE = "vision_msgs/msg/Detection2DArray", "geometry_msgs/msg/PoseStamped"


def ingest(source: Path, *options: str) -> tuple[int, Path]:
    out = source.parent / "recording.out.mcap"
    return run(["ingest", str(source), "-o", str(out), "--overwrite", *options]), out


def made(source: Path, *options: str, code: int = ExitCode.DONE) -> McapRecording:
    found, out = ingest(source, *options)
    assert found == code
    return open_recording(out)


def small_log(frames: int = 5) -> list[Row]:
    """Boxes, calibrations and transforms of two cameras, and a true position; no images (A6)."""
    rows = [row for row in ros.two_cameras(frames) if row[1] in (TF, INFO)]
    for k in range(frames):
        t = START + k * STEP
        for name in ("front", "back"):
            box = (10.0 + k, 5.0, 8.0, 20.0, 0.75, "1", "7")
            rows.append((f"/cam_{name}/yolo/detections", BOXES, t, ros.detections(t, box)))
        rows.append(("/mocap", POSE, t, ros.pose(t, "map", (1 + 0.1 * k, 2, 0.9))))
    return rows


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_a_bag_of_ros_1_gives_the_recording_of_the_same_bag_of_ros_2(tmp_path: Path, compression: str) -> None:
    """Issue 46: images, calibrations and transforms."""
    rows = ros.two_cameras()
    one = made(ros1.write_bag(tmp_path / "walk.bag", rows, compression=compression))
    assert one.scene is not None
    cameras = [one.scene.camera(name) for name in ("cam_back", "cam_front")]
    frames = [(f.t_ns, f.sensor, f.decode().tobytes()) for f in one.frames()]
    two = made(ros.write_mcap(tmp_path / "walk.mcap", rows))
    assert two.scene is not None
    for camera in cameras:
        other = two.scene.camera(camera.name)
        assert np.array_equal(camera.position, other.position)
        assert np.array_equal(camera.rotation, other.rotation)
        assert np.array_equal(camera.focal_px, other.focal_px)
    assert frames == [(f.t_ns, f.sensor, f.decode().tobytes()) for f in two.frames()]
    assert len(frames) == 12


@pytest.mark.parametrize("kind", ["ros1", "mcap", "db3"])
def test_a_bag_of_boxes_calibrations_and_transforms_without_images_is_taken(
    tmp_path: Path, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """A6: such a bag was refused, with the command that `info` prints and with named topics."""
    rows = small_log()
    if kind == "ros1":
        bag = ros1.write_bag(tmp_path / "log.bag", rows)
    elif kind == "mcap":
        bag = ros.write_mcap(tmp_path / "log.mcap", rows)
    else:
        # Bags before ROS 2 Iron have no definitions, and those of vision_msgs are not of ROS itself
        bag = ros.write_mcap(tmp_path / "log.db3", rows)
    recording = made(bag, "--topic", "0=/mocap")
    assert recording.scene is not None
    assert sorted(c.name for c in recording.scene.cameras) == ["cam_back", "cam_front"]
    assert np.allclose(recording.scene.camera("cam_back").position, [4, 0, 2])
    found = recording.read(Boxes)
    assert sorted(set(found.sensor.tolist())) == ["cam_back", "cam_front"]
    assert found.left_px[found.sensor == "cam_front"].tolist() == [10, 11, 12, 13, 14]
    assert set(found.target_id.tolist()) == {7}
    truth = recording.read(Truth)
    assert np.allclose(truth.x, 1 + 0.1 * np.arange(5))
    assert (truth.t_ns - START).tolist() == [k * STEP for k in range(5)]
    capsys.readouterr()
    assert run(["info", str(bag)]) == ExitCode.DONE
    out = capsys.readouterr().out
    assert "taken     camera cam_front: boxes /cam_front/yolo/detections, calibration /cam_front/camera_info" in out
    assert f"command   occlog ingest {bag} -o recording.mcap" in out


def test_transforms_of_tf_before_tf2_are_read(tmp_path: Path) -> None:
    rows = [("/tf", "tf/msg/tfMessage", *row[2:]) if row[1] == TF else row for row in small_log()]
    scene = made(ros1.write_bag(tmp_path / "log.bag", rows)).scene
    assert scene is not None
    assert np.allclose(np.degrees(scene.camera("cam_back").yaw), 150)


def test_definitions_without_those_of_their_fields_are_completed_by_those_of_ros(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """H8: the fields' types of ROS itself are known, and the line says that they were not in the bag."""
    rows = ros.two_cameras()
    bag = ros1.write_bag(tmp_path / "nodefs.bag", rows, parts=False)
    assert made(bag).cameras == ("cam_back", "cam_front")
    err = capsys.readouterr().err
    assert "bag: /cam_back/camera_info: the bag does not define sensor_msgs/msg/RegionOfInterest, std_msgs/" in err
    path = tmp_path / "nodefs.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="test")
        channels: dict[str, int] = {}
        for topic, kind, t_ns, message in rows:
            if topic not in channels:
                text = ros.STORE.generate_msgdef(kind, ros_version=2)[0].split("=" * 80)[0]
                schema = writer.register_schema(kind, "ros2msg", text.encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], t_ns, ros.serialized((topic, kind, t_ns, message)), t_ns)
        writer.finish()
    assert made(path).cameras == ("cam_back", "cam_front")
    assert "/cam_back/image_raw/compressed: the bag does not define std_msgs/msg/Header; the" in capsys.readouterr().err
    # A type of no release of ROS: the reason is stated
    bag = ros1.write_bag(tmp_path / "own.bag", small_log(), parts=False)
    assert ingest(bag)[0] == ExitCode.BAD_INPUT
    assert "it does not define vision_msgs/msg/Detection2D" in capsys.readouterr().err


def test_messages_of_ros_1_in_mcap_are_read(tmp_path: Path) -> None:
    """As `mcap convert` writes them of a .bag."""
    path = tmp_path / "converted.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros1", library="test")
        channels: dict[str, int] = {}
        for row in ros.two_cameras():
            topic, kind, t_ns, _ = row
            if topic not in channels:
                schema = writer.register_schema(
                    kind.replace("/msg/", "/"), "ros1msg", ros1.STORE.generate_msgdef(kind)[0].encode()
                )
                channels[topic] = writer.register_channel(topic, "ros1", schema)
            writer.add_message(channels[topic], t_ns, ros1.serialized(row), t_ns)
        writer.finish()
    assert made(path).cameras == ("cam_back", "cam_front")


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_a_bag_of_a_killed_recorder_is_read_without_its_index(
    tmp_path: Path, compression: str, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = ros1.without_index(tmp_path / "walk.bag.active", ros.two_cameras(), compression)
    recording = made(bag, code=ExitCode.LOSSY)
    assert len(list(recording.frames(["cam_front"]))) == 6
    (loss,) = recording.losses
    assert "the recorder did not close the bag, and messages may be missing; read without its index" in str(loss)


def test_a_truncated_bag_gives_its_messages_up_to_the_end(tmp_path: Path) -> None:
    whole = ros1.write_bag(tmp_path / "walk.bag", ros.two_cameras(20)).read_bytes()
    cut = tmp_path / "cut.bag"
    counts = []
    for share in (0.4, 0.7, 0.999):
        cut.write_bytes(whole[: int(len(whole) * share)])
        recording = made(cut, code=ExitCode.LOSSY)
        counts.append(len(list(recording.frames(["cam_front"]))))
        assert any("cut.bag" in str(loss) for loss in recording.losses)
    assert counts[0] < counts[1] < counts[2] == 20


def test_damage_is_listed_and_the_other_chunks_are_read(tmp_path: Path) -> None:
    rows = ros.two_cameras(20)
    bag = ros1.write_bag(tmp_path / "walk.bag", rows, compression="bz2", chunk_size=8192)
    data = bytearray(bag.read_bytes())
    second = data.index(b"compression=bz2", data.index(b"compression=bz2") + 1)
    data[second + 100 : second + 120] = bytes(20)
    bag.write_bytes(data)
    recording = made(bag, code=ExitCode.LOSSY)
    assert 10 <= len(list(recording.frames(["cam_front"]))) < 20
    assert any("a damaged chunk was read up to its unpacked byte" in str(loss) for loss in recording.losses)
    # The header of a chunk: the next one is found by the index
    whole = bytearray(ros1.write_bag(tmp_path / "b.bag", rows, chunk_size=8192).read_bytes())
    second = whole.index(b"compression=none", whole.index(b"compression=none") + 1)
    whole[second - 8 : second] = b"\xff" * 8
    (tmp_path / "b.bag").write_bytes(whole)
    recording = made(tmp_path / "b.bag", code=ExitCode.LOSSY)
    assert 10 <= len(list(recording.frames(["cam_front"]))) < 20
    assert any("bytes were not read" in str(loss) for loss in recording.losses)


def test_every_cut_of_a_small_bag_is_read_or_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from occlog.errors import InputError
    from occlog.io.messages.bag import open_bag

    whole = ros1.write_bag(tmp_path / "log.bag", small_log(1)).read_bytes()
    cut = tmp_path / "cut.bag"
    last = 0
    for size in range(0, len(whole), 37):
        cut.write_bytes(whole[:size])
        try:
            with open_bag([cut]) as bag:
                count = len(list(bag.messages(set(bag.topics()))))
                assert count >= last
                assert bag.losses
                last = count
        except InputError as error:
            assert len(str(error)) < 160 + len(str(cut))
    assert last == 6


def test_bags_that_cannot_be_read_are_refused_with_the_remedy(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    old = tmp_path / "old.bag"
    old.write_bytes(b"#ROSBAG V1.2\n" + bytes(100))
    assert ingest(old)[0] == ExitCode.BAD_INPUT
    assert "old.bag: a bag of ROS 1 of version '1.2'; 2.0 is read; convert it: rosbag fix" in capsys.readouterr().err
    folder = tmp_path / "folder"
    folder.mkdir()
    bag = ros1.write_bag(folder / "walk.bag", ros.two_cameras(2))
    assert ingest(folder)[0] == ExitCode.BAD_INPUT
    assert "give its bags of ROS 1 as files:" in capsys.readouterr().err
    data = bag.read_bytes().replace(b"compression=none", b"compression=zstd")
    (tmp_path / "other.bag").write_bytes(data)
    assert ingest(tmp_path / "other.bag")[0] == ExitCode.BAD_INPUT
    assert "unknown compression 'zstd'" in capsys.readouterr().err
    for command in (["track", str(bag), "-o", str(tmp_path / "x.parquet")], ["detect", str(bag), "-o", "x.parquet"]):
        assert run(command) == ExitCode.BAD_INPUT
        assert (
            "is a bag of ROS 1; make a recording of it by `occlog ingest walk.bag -o OUT.mcap`"
            in capsys.readouterr().err
        )


def test_doctor_and_folders_know_bags_of_ros_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ros1.write_bag(tmp_path / "walk.bag", ros.two_cameras())
    assert run(["doctor", str(tmp_path)]) == ExitCode.DONE
    assert run(["info", str(tmp_path)]) == ExitCode.DONE
    assert "walk.bag  bag of another program, 1 file, 25 messages" in capsys.readouterr().out


def test_parts_of_a_split_bag_are_one_recording(tmp_path: Path) -> None:
    rows = ros.two_cameras(8)
    parts = [ros1.write_bag(tmp_path / f"walk_{n}.bag", rows[at : at + 17]) for n, at in enumerate((0, 17))]
    out = tmp_path / "out.mcap"
    assert run(["ingest", str(parts[1]), str(parts[0]), "-o", str(out)]) == ExitCode.DONE
    recording = open_recording(out)
    times = [(f.t_ns - START) // STEP for f in recording.frames(["cam_front"])]
    assert times == list(range(8))
    assert math.isclose(recording.scene.camera("cam_front").focal_px[0], 50)  # type: ignore[union-attr]
