"""Small MCAP files whose chunks come to gigabytes, or to millions of records: each is refused in one line."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import pytest
import zstandard
from apart import check_apart

from occlog.errors import ExitCode, InputError
from occlog.io.files.limits import RECORDING_MAGIC
from occlog.io.recording.chunks import FREE_RECORDS, MAX_CHUNK_BYTES, DecompressionCount
from occlog.io.recording.mcap_errors import open_mcap

EMPTY = b'{"t_ns":1,"sensor":"a","target_id":[],"azimuth_rad":[],"sigma_rad":[],"visible":[]}'


def record(code: int, data: bytes) -> bytes:
    return struct.pack("<BQ", code, len(data)) + data


def text(word: str) -> bytes:
    return struct.pack("<I", len(word)) + word.encode()


HEAD = RECORDING_MAGIC + record(1, text("") + text("x"))
TYPES = record(3, struct.pack("<H", 1) + text("occlog.Bearings") + text("jsonschema") + struct.pack("<I", 2) + b"{}")
TYPES += record(4, struct.pack("<HH", 1, 1) + text("/bearings/a") + text("json") + struct.pack("<I", 0))


def message(data: bytes) -> bytes:
    return record(5, struct.pack("<HIQQ", 1, 0, 1, 1) + data)


def chunk(records: bytes) -> bytes:
    packed = zstandard.ZstdCompressor().compress(records)
    head = struct.pack("<QQQI", 1, 1, len(records), 0) + text("zstd") + struct.pack("<Q", len(packed))
    return record(6, head + packed)


def whole(body: bytes, summary: bytes = b"") -> bytes:
    out = HEAD + body + record(15, struct.pack("<I", 0))
    return out + summary + record(2, struct.pack("<QQI", len(out) if summary else 0, 0, 0)) + RECORDING_MAGIC


def indexed(one: bytes, times: int, messages: int, unpacked: int) -> bytes:
    """A recording of one chunk that its index lists so many times."""
    topics = struct.pack("<HQ", 1, 1)
    entry = struct.pack("<QQQQI", 1, 1, len(HEAD + TYPES), len(one), len(topics)) + topics + struct.pack("<Q", 0)
    entry = record(8, entry + text("zstd") + struct.pack("<QQ", len(one) - 61, unpacked))
    reported = struct.pack("<QHIIIIQQI", messages, 1, 1, 0, 0, times, 1, 1, 10) + struct.pack("<HQ", 1, messages)
    return whole(TYPES + one, TYPES + entry * times + record(11, reported))


def many(one: bytes) -> bytes:
    return one * (MAX_CHUNK_BYTES // len(one))


RECORDS = f"more records than {FREE_RECORDS} and one for each 2 compressed bytes"
CASES: dict[str, tuple[Callable[[], bytes], str]] = {
    "zeros": (lambda: whole(chunk(many(bytes(9)))), RECORDS),
    "records of others": (lambda: whole(chunk(many(record(0x80, b"")))), RECORDS),
    "messages": (lambda: whole(TYPES + chunk(many(message(EMPTY)))), RECORDS),
    "messages with an index": (lambda: indexed(chunk(many(message(b""))), 1, 4 * 10**6, MAX_CHUNK_BYTES), RECORDS),
    "chunks": (lambda: whole(TYPES + chunk(message(bytes(MAX_CHUNK_BYTES - 31))) * 3), "unpack to more than"),
}


@pytest.mark.parametrize(("make", "words"), CASES.values(), ids=CASES)
@pytest.mark.parametrize("command", ["info", "recover"])
def test_chunks_come_to_no_more_than_their_file_allows(
    tmp_path: Path, make: Callable[[], bytes], words: str, command: str
) -> None:
    path, out = tmp_path / "a.mcap", tmp_path / "out.mcap"
    path.write_bytes(make())
    assert path.stat().st_size < 40_000
    outcome = check_apart(command, path, *(["-o", out] if command == "recover" else []))
    assert (outcome.code, outcome.output.strip().count("\n")) == (ExitCode.BAD_INPUT, 0)
    assert words in outcome.output
    assert not out.exists()


def test_a_chunk_that_is_listed_many_times_is_read_once(tmp_path: Path) -> None:
    path, records = tmp_path / "a.mcap", message(EMPTY) * 3
    path.write_bytes(indexed(chunk(records), 1000, 3, len(records)))
    with open_mcap(path) as (reader, summary):
        assert summary.statistics is not None
        assert summary.statistics.chunk_count == 1
        assert len(list(reader.iter_messages())) == 3


def test_honest_files_may_have_as_many_records_as_they_hold(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(bytes(1000))
    small = message(b"")
    DecompressionCount(path).add(0, small * FREE_RECORDS)
    DecompressionCount(path).add(20, small * (FREE_RECORDS + 10))
    with pytest.raises(InputError, match=RECORDS):
        DecompressionCount(path).add(20, small * (FREE_RECORDS + 11))
    # Of several chunks together
    growth = DecompressionCount(path)
    growth.add(0, small * (FREE_RECORDS - 10))
    growth.add(10**6, small * 1000)
    growth.add(0, small * 10)
    with pytest.raises(InputError, match=RECORDS):
        growth.add(0, small)
    # Times and numbers that rise make messages of nothing larger than the least that is allowed
    rising = b"".join(record(5, struct.pack("<HIQQ", 1, n, 10**7 * n, 10**7 * n)) for n in range(100_000))
    assert len(chunk(rising)) > 2 * 100_000


@pytest.mark.parametrize(("rows", "words"), [(5_000_000, "has 55000051 bytes"), (2_000_000, "more than 1000000 rows")])
def test_rows_of_one_time_are_not_read_without_end(tmp_path: Path, rows: int, words: str) -> None:
    zeros, roles = ",".join(["0"] * rows), ",".join(['""'] * rows)
    told_rows = f'{{"t_ns":1,"target_id":[{zeros}],"role":[{roles}],"x":[{zeros}],"y":[{zeros}],"z":[{zeros}]}}'
    types = record(3, struct.pack("<H", 1) + text("occlog.Truth") + text("jsonschema") + struct.pack("<I", 2) + b"{}")
    types += record(4, struct.pack("<HH", 1, 1) + text("/truth") + text("json") + struct.pack("<I", 0))
    path = tmp_path / "a.mcap"
    path.write_bytes(whole(types + chunk(message(told_rows.encode()))))
    assert path.stat().st_size < 20_000
    outcome = check_apart("export", path, "-o", tmp_path / "a.csv")
    assert (outcome.code, outcome.output.strip().count("\n")) == (ExitCode.BAD_INPUT, 0)
    assert words in outcome.output


def test_damage_behind_damage_does_not_take_the_square_of_its_places(tmp_path: Path) -> None:
    head = struct.pack("<QQQI", 1, 1, 10, 0) + text("zstd") + struct.pack("<Q", 3)
    path = tmp_path / "a.mcap"
    path.write_bytes(HEAD + (record(6, head + b"abc") + struct.pack("<BQ", 7, 1 << 50)) * 12_000)
    assert check_apart("recover", path, "-o", tmp_path / "r.mcap").code == ExitCode.BAD_INPUT
