"""What the guard of the MCAP library refuses, at its limits."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from mcap.writer import CompressionType, Writer

from occlog.errors import InputError
from occlog.io.files.limits import RECORDING_MAGIC
from occlog.io.recording.chunks import MAX_CHUNK_BYTES
from occlog.io.recording.mcap_errors import FOOTER_BYTES, open_mcap, read_attachment

NOTE = b"what the attachment says"


def recording(path: Path, compression: CompressionType = CompressionType.ZSTD, *, crcs: bool = True) -> bytes:
    """A recording of one message in one chunk, with an attachment."""
    with path.open("wb") as file:
        writer = Writer(file, compression=compression, enable_crcs=crcs)
        writer.start()
        channel = writer.register_channel("/x", "json", writer.register_schema("s", "jsonschema", b"{}"))
        writer.add_message(channel, 1, b"{}" * 50, 1)
        writer.add_attachment(2, 2, "note", "text/plain", NOTE)
        writer.finish()
    return path.read_bytes()


def messages(path: Path) -> int:
    with open_mcap(path) as (reader, _):
        return sum(1 for _ in reader.iter_messages())


def patched(path: Path, data: bytes, at: int, new: bytes) -> Path:
    path.write_bytes(data[:at] + new + data[at + len(new) :])
    return path


@pytest.mark.parametrize("compression", list(CompressionType))
def test_each_known_compression_is_read(tmp_path: Path, compression: CompressionType) -> None:
    path = tmp_path / "r.mcap"
    recording(path, compression)
    assert messages(path) == 1


def test_another_compression_is_refused_with_its_place(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    data = recording(path, crcs=False)
    patched(path, data, data.rindex(b"zstd"), b"brot")
    with pytest.raises(InputError, match=r"chunk at byte \d+: unknown compression 'brot'"):
        messages(path)


def test_a_chunk_may_declare_so_many_bytes_and_no_more(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    data = recording(path, crcs=False)
    declared = data.rindex(b"zstd") + 4 + 8  # behind the compressed size of the index entry
    with open_mcap(patched(path, data, declared, struct.pack("<Q", MAX_CHUNK_BYTES))) as (_, summary):
        assert summary is not None
    refused = f"unpacks to {MAX_CHUNK_BYTES + 1} bytes or more; the limit is {MAX_CHUNK_BYTES}"
    with pytest.raises(InputError, match=refused):
        messages(patched(path, data, declared, struct.pack("<Q", MAX_CHUNK_BYTES + 1)))


def test_the_shortest_file_with_both_marks_is_not_called_truncated(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    footer = struct.pack("<BQQQI", 2, 20, 0, 0, 0)
    assert len(footer) == FOOTER_BYTES
    path.write_bytes(RECORDING_MAGIC + footer + RECORDING_MAGIC)
    with pytest.raises(InputError, match="damaged MCAP file: a record of kind 2 at byte 8, where there can be none"):
        messages(path)
    path.write_bytes(RECORDING_MAGIC + footer[1:] + RECORDING_MAGIC)
    with pytest.raises(InputError, match=f"truncated: the MCAP end mark is missing after {2 * 8 + 28} bytes"):
        messages(path)
    path.write_bytes(b"x" + RECORDING_MAGIC[1:] + footer + RECORDING_MAGIC)
    with pytest.raises(InputError, match="does not begin with the MCAP mark"):
        messages(path)


def test_an_index_that_begins_behind_the_end_or_has_changed_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    data = recording(path)
    start = len(data) - 8 - 20  # of the footer's content: where the index begins
    with pytest.raises(InputError, match=f"begin at byte {len(data) + 1} of {len(data)}; .*salvage it"):
        messages(patched(path, data, start, struct.pack("<Q", len(data) + 1)))
    (begins,) = struct.unpack_from("<Q", data, start)
    with pytest.raises(InputError, match=f"the index from byte {begins} on has a wrong check sum; .*salvage it"):
        messages(patched(path, data, begins + 12, bytes([data[begins + 12] ^ 1])))


def test_an_attachment_is_read_if_its_check_sum_is_right(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    data = recording(path)
    with open_mcap(path) as (_, summary):
        assert summary is not None
        (entry,) = summary.attachment_indexes
    with path.open("rb") as file:
        assert read_attachment(path, file, entry.offset, entry.length) == NOTE
    changed = patched(path, data, data.index(NOTE), b"W")
    with changed.open("rb") as file, pytest.raises(InputError, match=f"attachment at byte {entry.offset}: wrong check"):
        read_attachment(path, file, entry.offset, entry.length)
