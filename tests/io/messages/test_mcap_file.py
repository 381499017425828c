"""MCAP files of other programs: damage is a loss, bombs are not unpacked, real bags are read whole."""

from __future__ import annotations

import struct
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from occlog.io.messages.bag import is_bag, open_bag
from occlog.io.messages.mcap_file import McapFile
from occlog.io.recording.chunks import MAX_CHUNK_BYTES, unpacked


def write(path: Path, compression: CompressionType = CompressionType.ZSTD, *, chunks: bool = True) -> Path:
    """Messages 0 to 39 of two topics in turn, a chunk for every few, not in the order of time."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=200, compression=compression, use_chunking=chunks)
        writer.start()
        schema = writer.register_schema("s", "jsonschema", b"{}")
        channels = [writer.register_channel(topic, "json", schema) for topic in ("/a", "/b")]
        for k in range(40):
            writer.add_message(channels[k % 2], k ^ 2, b'{"n": %d, "text": "%s"}' % (k, b"x" * 20), k ^ 2)
        writer.finish()
    return path


@pytest.mark.parametrize("compression", list(CompressionType))
def test_messages_of_the_wanted_topics_come_whole(tmp_path: Path, compression: CompressionType) -> None:
    file = McapFile(write(tmp_path / "b.mcap", compression), "b")
    assert [(t.name, t.messages) for t in file.topics()] == [("/a", 20), ("/b", 20)]
    found = [message.log_ns for message in file.messages({"/a"})]
    assert sorted(found) == list(range(0, 40, 2))
    assert (file.span(), list(file.losses)) == ((0, 39), [])


def test_a_file_cut_anywhere_gives_what_is_whole_and_says_so(tmp_path: Path) -> None:
    data = write(tmp_path / "b.mcap").read_bytes()
    path, found = tmp_path / "cut.mcap", []
    for size in range(8, len(data), 97):
        path.write_bytes(data[:size])
        file = McapFile(path, "cut")
        file.topics()
        found.append(len(list(file.messages({"/a", "/b"}))))
        assert file.losses
    assert found == sorted(found)
    assert found[0] == 0
    assert found[-1] == 40


def test_messages_outside_chunks_are_read(tmp_path: Path) -> None:
    file = McapFile(write(tmp_path / "b.mcap", chunks=False), "b")
    assert len(list(file.messages({"/b"}))) == 20


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_chunk_that_would_unpack_to_too_much_is_refused_unpacked(compression: str) -> None:
    zeros = bytes(1000)
    data = zstandard.ZstdCompressor().compress(zeros) if compression == "zstd" else lz4.frame.compress(zeros)
    assert unpacked(data, compression, 1000) == zeros
    with pytest.raises(ValueError, match="the limit is"):
        unpacked(data, compression, MAX_CHUNK_BYTES + 1)
    with pytest.raises(ValueError, match="unknown compression 'brotli'"):
        unpacked(data, "brotli", 1000)


def test_a_record_longer_than_the_file_is_reported_with_its_place(tmp_path: Path) -> None:
    path = write(tmp_path / "b.mcap")
    data = bytearray(path.read_bytes())
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    at = summary.chunk_indexes[0].chunk_start_offset
    data[at + 1 : at + 9] = struct.pack("<Q", 10**15)
    path.write_bytes(data)
    file = McapFile(path, "b")
    assert list(file.messages({"/a"})) == []
    assert any(loss.place == f"byte {at}" for loss in file.losses)


def test_real_bags_of_rosbag2_hold_what_the_library_reads(shared_data: Path) -> None:
    paths = sorted((shared_data / "rosbag2_mcap").glob("*.mcap"))
    assert paths
    for path in paths:
        with path.open("rb") as file:
            wanted = [(c.topic, m.log_time, m.data) for _, c, m in make_reader(file).iter_messages()]
        with open_bag([path]) as bag:
            found = list(bag.messages(set(bag.topics())))
            assert sorted(found) == sorted(wanted), path.name
            assert bag.losses == []


def test_text_of_a_real_bag_is_decoded(shared_data: Path) -> None:
    pytest.importorskip("rosbags")
    from occlog.io.messages.kinds import decoder

    (path,) = (shared_data / "rosbag2_mcap").glob("*multiple_files_2.mcap")
    with open_bag([path]) as bag:
        decode = decoder(bag.topics()["/chatter"])
        texts = [decode(message.data).data for message in bag.messages({"/chatter"})]
    assert (len(texts), set(texts)) == (529, {"test"})


def test_a_folder_is_a_bag_if_it_holds_one(tmp_path: Path) -> None:
    assert not is_bag(tmp_path)
    write(tmp_path / "b.mcap")
    assert is_bag(tmp_path)
    assert is_bag(tmp_path / "b.mcap")
    (tmp_path / "b.txt").write_text("no")
    assert not is_bag(tmp_path / "b.txt")
