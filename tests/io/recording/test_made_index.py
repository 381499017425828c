"""Recordings without an index, or with a part of one, are read as those that have it; damage in them is one line."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from detect_scenes import STEP_NS, picture, scene, walk
from evaluate_scenes import pixels, truth
from mcap.reader import NonSeekingReader
from mcap.writer import CompressionType, IndexType, Writer

from occlog.cli.main import run
from occlog.errors import ExitCode, InputError
from occlog.io.files.limits import RECORDING_MAGIC
from occlog.io.files.provenance import Provenance
from occlog.io.recording.chunks import MAX_CHUNK_BYTES
from occlog.io.recording.copy import copy_recording
from occlog.io.recording.mcap_errors import open_mcap
from occlog.io.recording.reader import open_recording
from occlog.io.recording.writer import RecordingWriter
from occlog.records.tables import Bearings, Truth

NOTHING: dict[str, Any] = {
    "index_types": IndexType.NONE,
    "use_statistics": False,
    "use_summary_offsets": False,
    "repeat_channels": False,
    "repeat_schemas": False,
}
WAYS: dict[str, dict[str, Any]] = {
    "nothing": NOTHING,
    "nothing, lz4": {**NOTHING, "compression": CompressionType.LZ4},
    "nothing, as it is": {**NOTHING, "compression": CompressionType.NONE},
    "no chunks": {**NOTHING, "use_chunking": False},
    "no chunks, statistics": {"use_chunking": False},
    "statistics alone": {**NOTHING, "use_statistics": True},
    "chunks alone": {"index_types": IndexType.CHUNK},
    "all but attachments": {"index_types": IndexType.ALL & ~IndexType.ATTACHMENT},
    "all but metadata": {"index_types": IndexType.ALL & ~IndexType.METADATA},
    "all but messages": {"index_types": IndexType.ALL & ~IndexType.MESSAGE},
    "no statistics": {"use_statistics": False},
    "no channels": {"repeat_channels": False},
    "no schemas": {"repeat_schemas": False},
}


def rewritten(source: Path, path: Path, **options: Any) -> Path:
    """The same records, as another writer would have written them."""
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start()
        schemas, channels = {0: 0}, {}
        with source.open("rb") as old:
            for attached in NonSeekingReader(old).iter_attachments():
                writer.add_attachment(
                    attached.create_time, attached.log_time, attached.name, attached.media_type, attached.data
                )
        with source.open("rb") as old:
            for schema, channel, m in NonSeekingReader(old).iter_messages(log_time_order=False):
                if schema is not None and schema.id not in schemas:
                    schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
                if channel.id not in channels:
                    channels[channel.id] = writer.register_channel(
                        channel.topic, channel.message_encoding, schemas[channel.schema_id], channel.metadata
                    )
                writer.add_message(channels[channel.id], m.log_time, m.data, m.publish_time, m.sequence)
        with source.open("rb") as old:
            for record in NonSeekingReader(old).iter_metadata():
                writer.add_metadata(record.name, record.metadata)
        writer.finish()
    return path


def small(path: Path, times: list[int], **options: Any) -> bytes:
    """A file of messages of two topics in turn, each saying its number."""
    with path.open("wb") as file:
        writer = Writer(file, **{**NOTHING, "chunk_size": 60, **options})
        writer.start()
        channels = [writer.register_channel(name, "json", 0) for name in ("/a", "/b")]
        for n, t_ns in enumerate(times):
            writer.add_message(channels[n % 2], t_ns, str(n).encode(), t_ns, n)
        writer.finish()
    return path.read_bytes()


def records_of(data: bytes) -> list[tuple[int, int, bytes]]:
    """(byte, code, content) of each record."""
    at, found = len(RECORDING_MAGIC), []
    while at < len(data) - len(RECORDING_MAGIC):
        code, length = struct.unpack_from("<BQ", data, at)
        found.append((at, code, data[at + 9 : at + 9 + length]))
        at += 9 + length
    return found


def read(path: Path, topics: list[str] | None = None, *, log_time_order: bool = True) -> list[tuple[int, str, str]]:
    with open_mcap(path) as (reader, _):
        return [
            (m.log_time, c.topic, m.data.decode())
            for _, c, m in reader.iter_messages(topics=topics, log_time_order=log_time_order)
        ]


def refusal(path: Path, data: bytes) -> str:
    path.write_bytes(data)
    with pytest.raises(InputError) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: ")
    return str(caught.value)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of images and rows: somebody crosses a room."""
    path, room, places = tmp_path_factory.mktemp("whole") / "r.mcap", scene(), walk(6)
    t, xy = np.arange(6) * STEP_NS / 1e9, np.array([position[:2] for position in places])
    with RecordingWriter(path, room, Provenance("test")) as out:
        for k, person in enumerate(places):
            for cam in room.cameras:
                data = cv2.imencode(".png", picture(cam, [person], k))[1].tobytes()
                out.image(cam.name, k * STEP_NS, k, data, "png")
        for cam in room.cameras:
            out.table(pixels(cam, t, 3.0 * np.arange(6) - 9.5))
        out.table(truth(t, xy))
    return path


@pytest.mark.parametrize("way", WAYS)
def test_what_is_read_does_not_depend_on_the_index(way: str, whole: Path) -> None:
    found = open_recording(rewritten(whole, whole.with_name("other.mcap"), **WAYS[way]))
    wanted = open_recording(whole)
    assert wanted.indexed
    assert not found.indexed
    assert found.scene is not None
    for name in ("topics", "provenance", "videos", "time_ns", "ours", "losses", "cameras"):
        assert getattr(found, name) == getattr(wanted, name), name
    for name in wanted.attachments:
        assert found.attachment(name) == wanted.attachment(name)
    for table in (Bearings, Truth):
        assert wanted.has(table) == found.has(table)
        ours, theirs = found.read(table), wanted.read(table)
        for column in table.columns():
            np.testing.assert_array_equal(getattr(ours, column.name), getattr(theirs, column.name))
    frames = [(f.t_ns, f.sensor, f.index, f.encoded) for f in wanted.frames()]
    assert [(f.t_ns, f.sensor, f.index, f.encoded) for f in found.frames()] == frames
    assert len(frames) > 10


def test_stages_take_a_recording_without_an_index_and_doctor_and_recover_say_so(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = rewritten(whole, tmp_path / "without.mcap", **NOTHING)
    for source, name in ((whole, "a"), (path, "b")):
        words = ["detect", str(source), "--method", "components", "-o", str(tmp_path / f"{name}.parquet"), "-q"]
        assert run(words) == ExitCode.DONE
    assert run(["diff", str(tmp_path / "a.parquet"), str(tmp_path / "b.parquet")]) == ExitCode.DONE
    assert run(["diff", str(whole), str(path)]) == ExitCode.DONE
    capsys.readouterr()
    assert run(["doctor", str(path)]) == ExitCode.DONE
    stdout = capsys.readouterr().out
    assert "no index" in stdout
    assert "occlog recover" in stdout
    assert run(["recover", str(path), "-o", str(tmp_path / "again.mcap")]) == ExitCode.DONE
    assert open_recording(tmp_path / "again.mcap").indexed
    assert run(["doctor", str(whole)]) == ExitCode.DONE
    assert "no index" not in capsys.readouterr().out


def test_a_copy_of_a_recording_without_an_index_is_whole(whole: Path, tmp_path: Path) -> None:
    source = open_recording(rewritten(whole, tmp_path / "without.mcap", **WAYS["no chunks"]))
    copied = copy_recording(source, tmp_path / "copy.mcap", {}, Provenance("test"))
    assert copied == sum(topic.messages for topic in open_recording(whole).topics)
    assert open_recording(tmp_path / "copy.mcap").attachments.keys() == source.attachments.keys()


TIMES = [50, 10, 40, 40, 20, 70, 60, 5, 40, 80]


@pytest.mark.parametrize("options", [{}, {"use_chunking": False}], ids=["chunks", "no chunks"])
def test_messages_come_in_the_order_of_time_or_of_the_file(tmp_path: Path, options: dict[str, Any]) -> None:
    path = tmp_path / "r.mcap"
    small(path, TIMES, **options)
    in_file = [(t_ns, f"/{'ab'[n % 2]}", str(n)) for n, t_ns in enumerate(TIMES)]
    assert read(path, log_time_order=False) == in_file
    assert read(path) == sorted(in_file, key=lambda each: each[0])
    assert read(path, ["/b"]) == [each for each in sorted(in_file, key=lambda each: each[0]) if each[1] == "/b"]
    assert read(path, ["/b"], log_time_order=False) == in_file[1::2]
    assert read(path, ["/c"]) == []


def test_messages_in_chunks_and_outside_are_all_read(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    small(path, [t_ns + 1 for t_ns in TIMES], use_chunking=False)
    loose = [m for _, code, m in records_of(path.read_bytes()) if code == 5]
    data = small(path, TIMES, enable_data_crcs=False)
    places = [at for at, code, _ in records_of(data) if code == 6] + [
        at for at, code, _ in records_of(data) if code == 15
    ]
    assert len(places) > 4
    # The loose messages go behind the second chunk
    packed = b"".join(struct.pack("<BQ", 5, len(m)) + m for m in loose)
    path.write_bytes(data[: places[2]] + packed + data[places[2] :])
    chunked = [(t_ns, f"/{'ab'[n % 2]}", str(n)) for n, t_ns in enumerate(TIMES)]
    outside = [(t_ns + 1, topic, text) for t_ns, topic, text in chunked]
    assert read(path) == sorted(chunked + outside, key=lambda each: each[0])
    in_file = read(path, log_time_order=False)
    assert sorted(in_file) == sorted(chunked + outside)
    begin = in_file.index(outside[0])
    assert in_file[begin : begin + len(outside)] == outside
    assert in_file[:begin] + in_file[begin + len(outside) :] == chunked
    with open_mcap(path) as (_, summary):
        assert summary.statistics is not None
        assert summary.statistics.message_count == 2 * len(TIMES)
        assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (5, 81)


def test_an_empty_file_holds_nothing(tmp_path: Path) -> None:
    small(tmp_path / "r.mcap", [])
    assert read(tmp_path / "r.mcap") == []
    assert open_recording(tmp_path / "r.mcap").time_ns is None


def test_each_flipped_bit_of_a_file_without_an_index_is_found(tmp_path: Path) -> None:
    """All of its data have a check sum; what comes behind them is of no consequence."""
    path = tmp_path / "r.mcap"
    for options in ({}, {"use_chunking": False}):
        data = small(path, TIMES, enable_data_crcs=True, **options)
        wanted = read(path)
        (end,) = (at for at, code, _ in records_of(data) if code == 15)
        for at in range(len(RECORDING_MAGIC), end):
            path.write_bytes(data[:at] + bytes([data[at] ^ (1 << at % 8)]) + data[at + 1 :])
            with pytest.raises(InputError):
                read(path)
        path.write_bytes(data)
        assert read(path) == wanted


def test_damage_is_reported_with_its_place(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    data = small(path, TIMES, enable_data_crcs=False)
    places = [(at, code) for at, code, _ in records_of(data)]
    chunk = next(at for at, code in places if code == 6)
    end = next(at for at, code in places if code == 15)
    changed = data[: end - 1] + bytes([data[end - 1] ^ 1]) + data[end:]
    assert "damaged MCAP file" in refusal(path, changed)
    longer = data[: chunk + 1] + struct.pack("<Q", len(data)) + data[chunk + 9 :]
    assert f"the record at byte {chunk} is stated to end at byte {chunk + 9 + len(data)} of {len(data)}" in refusal(
        path, longer
    )
    for code in (0, 2, 14, 38, 70):
        hidden = data[:chunk] + bytes([code]) + data[chunk + 1 :]
        assert f"a record of kind {code} at byte {chunk}, where there can be none" in refusal(path, hidden)
    footer = struct.pack("<BQQQI", 2, 20, 0, 0, 0)
    assert "a record of kind 2" in refusal(path, data[:end] + footer + RECORDING_MAGIC)


def test_a_file_that_holds_less_than_its_statistics_say_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    data = small(path, TIMES, use_statistics=True, enable_data_crcs=False, use_chunking=False)
    first, second = [at for at, code, _ in records_of(data) if code == 5][:2]
    footer = next(at for at, code, _ in records_of(data) if code == 2)
    start = struct.unpack_from("<Q", data, footer + 9)[0] - (second - first)
    ends = struct.pack("<QQI", start, 0, 0)
    less = data[:first] + data[second : footer + 9] + ends + data[footer + 9 + 20 :]
    assert "its index reports 10 records of the kind message, and there are 9" in refusal(path, less)


def loose_file(*records: tuple[int, bytes]) -> bytes:
    """An MCAP file of these records, without check sums or an index."""
    header = struct.pack("<II", 0, 0)
    body = [(1, header), *records, (15, struct.pack("<I", 0)), (2, struct.pack("<QQI", 0, 0, 0))]
    packed = b"".join(struct.pack("<BQ", code, len(data)) + data for code, data in body)
    return RECORDING_MAGIC + packed + RECORDING_MAGIC


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def channel(number: int, schema: int, topic: str) -> tuple[int, bytes]:
    return 4, struct.pack("<HH", number, schema) + text(topic) + text("json") + struct.pack("<I", 0)


def message(number: int, t_ns: int, data: bytes) -> tuple[int, bytes]:
    return 5, struct.pack("<HIQQ", number, 0, t_ns, t_ns) + data


def test_definitions_that_are_missing_or_contradict_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    path.write_bytes(loose_file(channel(1, 0, "/a"), channel(1, 0, "/a"), message(1, 7, b"x")))
    assert read(path) == [(7, "/a", "x")]
    reported = refusal(path, loose_file(channel(1, 0, "/a"), message(1, 7, b"x"), channel(1, 0, "/b")))
    assert "channel 1 is defined a second time, and otherwise" in reported
    assert "channel 2, which is not defined" in refusal(path, loose_file(channel(1, 0, "/a"), message(2, 7, b"x")))
    assert "channel 1 at byte 25 is of schema 3, which is not defined" in refusal(path, loose_file(channel(1, 3, "/a")))
    schema = (3, struct.pack("<H", 3) + text("s") + text("") + text(""))
    other = (3, struct.pack("<H", 3) + text("t") + text("") + text(""))
    assert "schema 3 is defined a second time" in refusal(path, loose_file(schema, schema, other))


def test_times_up_to_the_last_that_the_format_has_are_read(tmp_path: Path) -> None:
    path, last = tmp_path / "r.mcap", 2**64 - 1
    path.write_bytes(loose_file(channel(65535, 0, "/a"), message(65535, last, b"x"), message(65535, 0, b"y")))
    assert read(path) == [(0, "/a", "y"), (last, "/a", "x")]


def test_a_chunk_that_unpacks_to_too_much_is_refused_before_it_is(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    data = small(path, TIMES, enable_data_crcs=False, enable_crcs=False)
    chunk = next(at for at, code, _ in records_of(data) if code == 6)
    declared = data[: chunk + 25] + struct.pack("<Q", MAX_CHUNK_BYTES + 1) + data[chunk + 33 :]
    assert f"chunk at byte {chunk} unpacks to {MAX_CHUNK_BYTES + 1} bytes or more" in refusal(path, declared)


def test_a_file_that_changes_is_gone_through_again(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    small(path, TIMES)
    assert len(read(path)) == len(TIMES)
    small(path, TIMES[:-1])
    assert len(read(path)) == len(TIMES) - 1
