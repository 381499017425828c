"""Small files that would fill the memory: each is refused in one line before it does."""

from __future__ import annotations

import struct
from pathlib import Path

import lz4.frame
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import zstandard
from places import ROOT
from scipy.io import savemat

from occlog.cli.main import run
from occlog.errors import ExitCode, InputError
from occlog.io.files.limits import LONG_TEXT, MAX_TEXTS_BYTES, RECORDING_MAGIC, check_texts
from occlog.io.files.texts.csv_rows import MAX_CELL, CsvRows
from occlog.io.formats.boxes.columns import rows_of
from occlog.io.formats.calibration.common import MAX_BYTES
from occlog.io.messages import bag
from occlog.io.messages.bag import open_bag
from occlog.io.recording import chunks
from occlog.io.recording.chunks import unpacked
from occlog.io.recording.mcap_errors import open_mcap

TIME = 10**9
SCENE = str(ROOT / "examples/room.yaml")
LIMIT = 1 << 21
BOMB = 3 << 20


def record(code: int, data: bytes) -> bytes:
    return struct.pack("<BQ", code, len(data)) + data


def text(word: str) -> bytes:
    return struct.pack("<I", len(word)) + word.encode()


def mcap(
    path: Path, packed: bytes, compression: str, declared: int, indexed: tuple[str, int], *, topics: bool = True
) -> Path:
    """A recording of one chunk; the index states a compression and a size of its own, and what topics it has."""
    types = record(
        3, struct.pack("<H", 1) + text("occlog.Bearings") + text("jsonschema") + struct.pack("<I", 2) + b"{}"
    )
    types += record(4, struct.pack("<HH", 1, 1) + text("/bearings/a") + text("json") + struct.pack("<I", 0))
    head = RECORDING_MAGIC + record(1, text("") + text("x"))
    data = struct.pack("<QQQI", TIME, TIME, declared, 0) + text(compression) + struct.pack("<Q", len(packed)) + packed
    chunk = record(6, data)
    out = head + chunk + record(15, struct.pack("<I", 0))
    start = len(out)
    name, size = indexed
    offsets = struct.pack("<HQ", 1, 1) if topics else b""
    index = struct.pack("<QQQQI", TIME, TIME, len(head), len(chunk), len(offsets)) + offsets + struct.pack("<Q", 0)
    out += types + record(8, index + text(name) + struct.pack("<QQ", len(packed), size))
    out += record(11, struct.pack("<QHIIIIQQI", 1, 1, 1, 0, 0, 1, TIME, TIME, 10) + struct.pack("<HQ", 1, 1))
    path.write_bytes(out + record(2, struct.pack("<QQI", start, 0, 0)) + RECORDING_MAGIC)
    return path


def lz4_without_a_size(size: int) -> bytes:
    packer, block = lz4.frame.LZ4FrameCompressor(), bytes(1 << 20)
    parts = [packer.begin(0), *(packer.compress(block) for _ in range(size // len(block) + 1)), packer.flush()]
    return b"".join(parts)


def test_the_size_of_a_chunk_is_what_comes_out_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(chunks, "MAX_CHUNK_BYTES", LIMIT)
    zeros = bytes(BOMB)
    zstd, stated = zstandard.ZstdCompressor().compress(zeros), lz4.frame.compress(zeros)
    unstated = lz4_without_a_size(BOMB)
    small = zstandard.ZstdCompressor().compress(b"12345678")
    kinds = {
        "lz4 that states no size": (unstated, "lz4", 10, ("lz4", 10)),
        "lz4 that states its size": (stated, "lz4", 10, ("lz4", 10)),
        "lz4 that the index calls plain": (unstated, "lz4", 10, ("", 10)),
        "zstd that states its size": (zstd, "zstd", 10, ("zstd", 10)),
        "zstd that the index calls plain": (zstd, "zstd", 10, ("", 10)),
        "a chunk that states more": (small, "zstd", BOMB, ("zstd", 10)),
        "an index that states more": (small, "zstd", 8, ("zstd", BOMB)),
    }
    for name, given, topics in [(name, given, topics) for name, given in kinds.items() for topics in (True, False)]:
        path = mcap(tmp_path / "r.mcap", *given, topics=topics)
        code = run(["track", str(path), "--scene", SCENE, "-o", str(tmp_path / "t.parquet")])
        stderr = capfd.readouterr().err.splitlines()
        assert (code, len(stderr)) == (ExitCode.BAD_INPUT, 1), (name, stderr)
        # The chunk is gone through, and what the index states of it is not asked
        words = "damaged" if name == "an index that states more" else f"or more; the limit is {LIMIT}"
        assert words in stderr[0], (name, stderr)
        with pytest.raises(InputError), open_mcap(path):
            pass
    assert list(tmp_path.iterdir()) == [tmp_path / "r.mcap"]


def test_lz4_gives_no_byte_more_than_its_chunk_declares() -> None:
    with pytest.raises(ValueError, match="more than the 10 bytes that it declares"):
        unpacked(lz4_without_a_size(0), "lz4", 10)


def test_a_table_promises_no_more_rows_than_fit_into_it(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    good = pq.read_table(ROOT / "tests/golden/expected/simulated/bearings.parquet")
    ours, external_table = tmp_path / "r.parquet", tmp_path / "f.parquet"
    pq.write_table(good.take(pa.array(np.zeros(1_100_000, np.int32))), ours, compression="zstd")
    rows = pa.table(
        {"t": pa.array(np.zeros(1_100_000)), "sensor": pa.array(["a"]).take(pa.array(np.zeros(1_100_000, int)))}
    )
    pq.write_table(rows, external_table, compression="zstd")
    for path in (ours, external_table):
        code = run(["track", str(path), "--scene", SCENE, "-o", str(tmp_path / "t.parquet")])
        (line,) = capfd.readouterr().err.splitlines()
        assert code == ExitCode.BAD_INPUT
        assert "declares 1100000 rows" in line


@pytest.mark.parametrize("name", ["c.npz", "c.mat"])
def test_packed_arrays_unpack_to_what_a_calibration_may_have(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], name: str
) -> None:
    path, zeros = tmp_path / name, np.zeros((MAX_BYTES // 8 + 9, 1))
    if name == "c.npz":
        np.savez_compressed(path, P=zeros)
    else:
        savemat(path, {"P": zeros}, do_compression=True)
    assert path.stat().st_size < 100_000
    boxes = tmp_path / "a.csv"
    boxes.write_text("frame,left,top,width,height\n0,1,2,3,4\n")
    words = ["--boxes", f"a={boxes}", "--calibration", str(path), "--fps", "10", "-o", str(tmp_path / "r.mcap")]
    assert run(["ingest", *words]) == ExitCode.BAD_INPUT
    (line,) = capfd.readouterr().err.splitlines()
    assert f"unpacks to more than {MAX_BYTES} bytes" in line


def test_a_bag_unpacks_to_a_thousand_times_its_size_at_most(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bag, "MAX_CHUNK_BYTES", 0)
    path = tmp_path / "b.mcap.zstd"
    path.write_bytes(zstandard.ZstdCompressor().compress(RECORDING_MAGIC + bytes(1 << 22)))
    with pytest.raises(InputError, match="1000 times its size"):
        open_bag([path])


LONG = "a" * (10 * LONG_TEXT)
ROWS = MAX_TEXTS_BYTES // (4 * len(LONG)) + 1
"""As many rows as make a column of texts too large, if one of them is long: a file of some kilobytes."""


def test_a_long_text_does_not_make_every_row_as_long(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    zeros = np.zeros(ROWS, np.int64)
    sensor = pa.DictionaryArray.from_arrays(pa.array(zeros, pa.int32()), [LONG])
    columns = {"t_ns": np.arange(ROWS), "sensor": sensor, "azimuth": zeros.astype(float), "sigma": zeros + 0.1}
    path = tmp_path / "bearings.parquet"
    pq.write_table(pa.table(columns), path)
    assert run(["track", str(path), "--scene", SCENE, "-o", str(tmp_path / "x.parquet")]) == ExitCode.BAD_INPUT
    (line,) = capfd.readouterr().err.splitlines()
    assert f"a text of {len(LONG)} characters; shorten it to {MAX_CELL}" in line
    check_texts([LONG], ROWS - 1, "x")
    with pytest.raises(
        InputError, match=f"x: a text of {len(LONG)} characters, the memory of which each of {ROWS} rows takes"
    ):
        check_texts([LONG], ROWS, "x")
    check_texts([LONG[:LONG_TEXT]], 10**9, "x")


def test_labels_of_json_and_text_are_no_longer_than_those_of_tables(tmp_path: Path) -> None:
    def rows(length: int) -> CsvRows:
        return rows_of(tmp_path / "b.json", [(1, {"name": "b"}), (2, {"name": "a" * length})], "entry", ())

    assert rows(MAX_CELL).cells["name"].dtype == f"U{MAX_CELL}"
    with pytest.raises(InputError, match=f"b.json: entry 2: a cell of more than {MAX_CELL} characters"):
        rows(MAX_CELL + 1)
