"""Recordings: what goes in comes out, and damage is one clear line."""

from __future__ import annotations

import base64
import itertools
import json
import shutil
from pathlib import Path

import cv2
import jsonschema
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from occlog.errors import InputError
from occlog.io.files.provenance import Provenance, hash_file
from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.io.recording.reader import open_recording
from occlog.io.recording.rows import RECORDED, message_schema
from occlog.io.recording.writer import RecordingWriter
from occlog.records.losses import Loss
from occlog.records.tables import Bearings, Truth

SCENE = scene_from_yaml(
    """
occlog_scene: 1
cameras:
  - {name: a, position: [0, 0], yaw_deg: 45, focal_px: 70, fov_deg: 90}
  - {name: b, position: [9, 0], yaw_deg: 135, focal_px: 70, fov_deg: 90}
""",
    "scene",
)
PROVENANCE = Provenance("simulate", {"steps": 10}, 7, (), (Loss("cam", "frame 1", "cut", 2),))
T0 = 1_700_000_000_000_000_001


def image(n: int) -> np.ndarray:
    return np.random.default_rng(n).integers(0, 255, (24, 32, 3), dtype=np.uint8)


def png(n: int) -> bytes:
    return bytes(cv2.imencode(".png", image(n))[1])


def bearings(rows: int) -> Bearings:
    seen = np.arange(rows) % 3 > 0
    value = np.where(seen, 0.1, np.nan)
    return Bearings.of(
        t_ns=T0 + np.arange(rows) // 2 * 10**8,
        sensor=["a", "b"] * (rows // 2),
        target_id=np.zeros(rows, int),
        seen=seen,
        bearing=value,
        sigma=value,
        u_px=value,
        sigma_px=value,
        score=np.full(rows, np.nan),
    )


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "r.mcap"
    with RecordingWriter(path, SCENE, PROVENANCE) as writer:
        writer.attach("notes.txt", "text/plain", b"hello")
        writer.table(bearings(40))
        for i in range(8):
            for sensor in "ab":
                writer.image(sensor, T0 + i * 10**8, i + 5, png(i), "png")
    return path


def test_round_trip(path: Path) -> None:
    recording = open_recording(path)
    assert recording.cameras == ("a", "b")
    assert recording.provenance == PROVENANCE
    assert recording.losses == PROVENANCE.losses
    assert recording.attachment("notes.txt") == b"hello"
    assert recording.attachment("none") is None
    assert recording.scene is not None
    assert [c.name for c in recording.scene.cameras] == ["a", "b"]
    got, want = recording.read(Bearings), bearings(40)
    assert got.t_ns.tolist() == want.t_ns.tolist()
    assert np.array_equal(got.bearing, want.bearing, equal_nan=True)
    frames = [(f.t_ns, f.sensor, f.index, f.decode()) for f in recording.frames()]
    assert [f[:3] for f in frames[:3]] == [(T0, "a", 5), (T0, "b", 5), (T0 + 10**8, "a", 6)]
    assert all(np.array_equal(f[3], image(f[2] - 5)) for f in frames)
    assert len(list(recording.frames(["b"]))) == 8


def test_rows_of_one_time_stay_together(path: Path) -> None:
    chunks = list(open_recording(path).tables(Bearings, rows=3))
    assert len(chunks) > 5
    assert sum(len(c) for c in chunks) == 40
    for before, after in itertools.pairwise(chunks):
        assert before.t_ns[-1] < after.t_ns[0]


def test_same_content_same_bytes(tmp_path: Path, path: Path) -> None:
    again = tmp_path / "again.mcap"
    with RecordingWriter(again, SCENE, PROVENANCE) as writer:
        writer.attach("notes.txt", "text/plain", b"hello")
        writer.table(bearings(40))
        for i in range(8):
            for sensor in "ab":
                writer.image(sensor, T0 + i * 10**8, i + 5, png(i), "png")
    assert again.read_bytes() == path.read_bytes()


def test_viewers_find_their_messages(path: Path) -> None:
    with path.open("rb") as file:
        schemas = {c.topic: (s.name, s.encoding) for s, c, _ in make_reader(file).iter_messages() if s}
    assert schemas["/camera/a/image"] == ("foxglove.CompressedImage", "protobuf")
    assert schemas["/bearings/a"] == ("occlog.Bearings", "jsonschema")


def test_messages_fit_their_published_schema(path: Path) -> None:
    with path.open("rb") as file:
        found = [m.data for s, _, m in make_reader(file).iter_messages() if s and s.name == "occlog.Bearings"]
    for data in found:
        jsonschema.validate(json.loads(data), message_schema(Bearings))
    assert len(found) == 40


@pytest.mark.parametrize("table", RECORDED)
def test_message_schemas_are_valid(table: type) -> None:
    jsonschema.Draft202012Validator.check_schema(message_schema(table))


def read_all(path: Path) -> tuple[int, int]:
    recording = open_recording(path)
    recording.attachment("notes.txt")
    rows = recording.read(Bearings)
    images = [f.decode() for f in recording.frames()]
    assert all(np.array_equal(i, image(n // 2)) for n, i in enumerate(images))
    return len(rows), len(images)


def test_truncation_at_any_place_is_one_line(path: Path) -> None:
    raw = path.read_bytes()
    for cut in [*range(0, len(raw), 211), len(raw) - 1]:
        path.write_bytes(raw[:cut])
        with pytest.raises(InputError) as caught:
            read_all(path)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)


def test_flipped_bits_never_pass_as_data(path: Path) -> None:
    raw, rng = path.read_bytes(), np.random.default_rng(0)
    refused = 0
    for _ in range(200):
        data = bytearray(raw)
        data[rng.integers(len(data))] ^= 1 << rng.integers(8)
        path.write_bytes(data)
        try:
            assert read_all(path) == (40, 16)
        except InputError:
            refused += 1
    assert refused > 150


def external_table(
    path: Path, messages: list[tuple[str, int, bytes]], schema: str = "foxglove.CompressedImage"
) -> None:
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start()
        schema_id = writer.register_schema(schema, "jsonschema", b"{}")
        channels: dict[str, int] = {}
        for topic, t_ns, data in messages:
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "json", schema_id)
            writer.add_message(channels[topic], t_ns, data, t_ns)
        writer.finish()


def json_image(n: int, t_ns: int) -> bytes:
    stamp = {"sec": t_ns // 10**9, "nsec": t_ns % 10**9}
    return json.dumps({"timestamp": stamp, "data": base64.b64encode(png(n)).decode(), "format": "png"}).encode()


def test_recordings_of_others_have_sensor_time_and_names_from_topics(tmp_path: Path) -> None:
    path = tmp_path / "f.mcap"
    external_table(path, [("/hall/left", T0 + 500 + i, json_image(i, T0 + i * 1000)) for i in range(3)])
    recording = open_recording(path)
    assert recording.scene is None
    assert not recording.ours
    frames = list(recording.frames())
    assert [(f.t_ns, f.sensor, f.index) for f in frames] == [(T0 + i * 1000, "hall.left", i) for i in range(3)]
    assert np.array_equal(frames[2].decode(), image(2))


def test_an_index_that_leads_to_fewer_frames_than_it_counts_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "f.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("foxglove.CompressedImage", "jsonschema", b"{}")
        left, right = (writer.register_channel(f"/camera/{name}/image", "json", schema) for name in ("left", "right"))
        for i in range(4):
            writer.add_message(right if i % 2 else left, T0 + i, json_image(i, T0 + i), T0 + i)
        # The index behind the chunk says so, too
        behind = vars(writer)["_Writer__chunk_builder"].message_indices
        behind[left].records += behind.pop(right).records
        vars(writer)["_Writer__statistics"].channel_message_counts.update({left: 4, right: 0})
        writer.finish()
    with pytest.raises(InputError, match="counts 4 messages of /camera/left/image, and leads to 2; copy it again"):
        list(open_recording(path).frames(["left"]))


def test_time_stamps_that_repeat_are_named(tmp_path: Path) -> None:
    path = tmp_path / "f.mcap"
    external_table(path, [("/camera/a/image", T0 + i, json_image(i, T0 + i // 2 * 1000)) for i in range(4)])
    with pytest.raises(InputError, match=r"camera a: frame 1: time \S+Z does not come after"):
        list(open_recording(path).frames())


def test_messages_that_do_not_fit_are_named(tmp_path: Path) -> None:
    path = tmp_path / "f.mcap"
    external_table(path, [("/truth", T0, b'{"t_ns": 1, "x": [1.0]}')], "occlog.Truth")
    with pytest.raises(InputError, match=r"topic /truth: not a message of occlog.Truth"):
        open_recording(path).read(Truth)


def test_messages_of_older_recordings_lack_optional_columns(tmp_path: Path) -> None:
    path = tmp_path / "f.mcap"
    columns = b'"target_id": [3], "seen": [true], "bearing": [0.5], "sigma": [0.1], "u_px": [1.0], "sigma_px": [2.0]'
    external_table(
        path, [("/a/bearings", T0, b'{"t_ns": 1, "sensor": "a", %s, "score": [null]}' % columns)], "occlog.Bearings"
    )
    found = open_recording(path).read(Bearings)
    assert (found.bearing[0], found.cause[0], found.target_id[0]) == (0.5, "", 3)
    assert np.isnan(found.elevation[0])


def test_an_image_that_is_none_is_an_error_of_that_frame_alone(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    with RecordingWriter(path, None, PROVENANCE) as writer:
        writer.image("a", T0, 0, b"not a picture", "png")
        writer.image("a", T0 + 1, 1, png(1), "png")
    first, second = open_recording(path).frames()
    with pytest.raises(InputError, match="camera a: frame 0: not an image"):
        first.decode()
    assert np.array_equal(second.decode(), image(1))


def test_chunk_bombs_are_refused_before_they_unpack(tmp_path: Path) -> None:
    path = tmp_path / "bomb.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1 << 30, compression=CompressionType.ZSTD)
        writer.start()
        channel = writer.register_channel("/x", "json", writer.register_schema("s", "jsonschema", b"{}"))
        writer.add_message(channel, 1, bytes(600 * 1024 * 1024), 1)
        writer.finish()
    assert path.stat().st_size < 1_000_000
    with pytest.raises(InputError, match="unpacks to"):
        open_recording(path)


@pytest.fixture
def linked(tmp_path: Path) -> Path:
    video = tmp_path / "a.avi"
    out = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"FFV1"), 10.0, (32, 24))
    for i in range(6):
        out.write(image(i))
    out.release()
    path = tmp_path / "r.mcap"
    with RecordingWriter(path, SCENE, PROVENANCE) as writer:
        writer.video("a", "a.avi", hash_file(video))
        for i in (1, 2, 4):
            writer.video_frame("a", T0 + i, i)
    return path


def test_linked_video_gives_the_frames_of_its_numbers(linked: Path) -> None:
    frames = [(f.t_ns, f.index, f.decode()) for f in open_recording(linked).frames()]
    assert [f[:2] for f in frames] == [(T0 + 1, 1), (T0 + 2, 2), (T0 + 4, 4)]
    assert all(np.array_equal(f[2], image(f[1])) for f in frames)


def test_linked_video_that_changed_or_is_gone(linked: Path) -> None:
    video = linked.parent / "a.avi"
    raw = video.read_bytes()
    video.write_bytes(raw + b"x")
    with pytest.raises(InputError, match="content changed"):
        list(open_recording(linked).frames())
    video.unlink()
    with pytest.raises(InputError, match=r"a.avi: no such file; the video of camera a"):
        list(open_recording(linked).frames())


def test_ros_recordings_open(shared_data: Path, tmp_path: Path) -> None:
    files = sorted((shared_data / "rosbag2_mcap").glob("*.mcap"))
    for file in files:
        recording = open_recording(Path(shutil.copy(file, tmp_path)))
        assert recording.topics
        assert list(recording.frames()) == []
    assert len(files) == 20
