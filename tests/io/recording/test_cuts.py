"""Every message that is complete before a cut comes back, however the chunks are packed."""

from __future__ import annotations

import json
import os
import struct
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from occlog.io.recording.chunks import chunk_head
from occlog.io.recording.salvage.records import recover_block_tail
from occlog.io.recording.salvage.recover import recover_recording

CUTS = 200 if os.environ.get("HYPOTHESIS_PROFILE") == "explore" else 20
CHUNK = 100_000
MESSAGE, IN_CHUNK = 5, 6
KINDS = (CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD)


def recording(path: Path, compression: CompressionType) -> list[bytes]:
    """Chunks of bearings, which pack well, and now and then of noise, which does not; data of all messages."""
    rng, sent = np.random.default_rng(4), []
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=CHUNK, compression=compression)
        writer.start()
        schema = writer.register_schema("occlog.Bearings", "jsonschema", b"{}")
        channel = writer.register_channel("/bearings/a", "json", schema)
        for n in range(1500):
            noise = rng.bytes(1500).hex() if n % 20 == 0 else ""
            sent.append(json.dumps({"t_ns": n, "sensor": "a", "bearing": [rng.random()], "x": noise}).encode())
            writer.add_message(channel, n, sent[-1], n, n)
        writer.finish()
    return sent


def by_libraries(data: bytes) -> int:
    """How many messages are complete in the bytes that the libraries unpack of a cut file."""
    at, count = 8, 0
    while at + 9 <= len(data):
        code, length = struct.unpack_from("<BQ", data, at)
        if code == IN_CHUNK:
            body = data[at + 9 : at + 9 + length]
            try:
                head = chunk_head(body)
            except (struct.error, UnicodeDecodeError):
                return count
            packed = body[head.begin :]
            if head.compression == "zstd":
                records = zstandard.ZstdDecompressor().decompressobj().decompress(packed)
            else:
                records = lz4.frame.LZ4FrameDecompressor().decompress(packed) if head.compression else packed
            begin = 0
            while begin + 9 <= len(records):
                inner, size = struct.unpack_from("<BQ", records, begin)
                begin += 9 + size
                count += inner == MESSAGE and begin <= len(records)
        at += 9 + length
    return count


@pytest.mark.parametrize("compression", KINDS, ids=lambda kind: kind.name)
def test_what_is_complete_before_a_cut_comes_back(compression: CompressionType, tmp_path: Path) -> None:
    path, cut, out = tmp_path / "r.mcap", tmp_path / "cut.mcap", tmp_path / "out.mcap"
    sent = recording(path, compression)
    data = path.read_bytes()
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    first, last = (summary.chunk_indexes[n] for n in (0, -1))
    begin, end = (chunk.chunk_start_offset + chunk.chunk_length for chunk in (first, last))
    more = 0
    for place in np.random.default_rng(5).integers(begin, end, CUTS):
        cut.write_bytes(data[:place])
        recover_recording(cut, out, overwrite=True)
        with out.open("rb") as file:
            got = [m.data for _, _, m in make_reader(file).iter_messages(log_time_order=False)]
        assert got == sent[: len(got)]
        complete = by_libraries(data[:place])
        assert len(got) >= complete
        more += len(got) - complete
    # The library gives whole blocks of LZ4; half a block is lost by it at a cut.  All else it gives is all there is.
    assert (more > 40 * CUTS) == (compression is CompressionType.LZ4)
    assert more >= 0


def test_sequences_are_unpacked_up_to_the_last_byte_of_a_cut_block() -> None:
    block = b"\x52hello\x05\x00" + b"\x1f!\x01\x00\x04" + b"\x10?"
    whole = b"hello" + b"hellohe"[:6] + b"!" + b"!" * 23 + b"?"
    frame = lz4.frame.compress(b"", store_size=False)[:7] + struct.pack("<I", len(block) + 1)
    lengths = [0, 0, 1, 2, 3, 4, 5, 5, 11, 11, 12, 12, 31, 35, 35, 36]
    for cut, length in enumerate(lengths):
        assert recover_block_tail(frame + block[:cut], b"", 100) == whole[:length], cut
    assert recover_block_tail(frame + block, b"", 8) == b"hellohel"
    assert recover_block_tail(frame + b"\x00\x09\x00", b"abc", 100) == b""  # goes back beyond the beginning


@pytest.mark.parametrize("linked", [True, False])
def test_a_cut_frame_is_unpacked_from_its_beginning_on(linked: bool) -> None:
    text = b"".join(b'{"t_ns": %d, "bearing": [%d]}' % (n, n * n % 997) for n in range(6000))
    frame = lz4.frame.compress(text, block_linked=linked, content_checksum=True, block_checksum=True)
    before = 0
    for cut in range(100, len(frame), 1999):
        whole = bytes(lz4.frame.LZ4FrameDecompressor().decompress(frame[:cut]))
        found = whole + recover_block_tail(frame[:cut], whole, len(text))
        assert text.startswith(found)
        assert len(found) > before
        before = len(found)
