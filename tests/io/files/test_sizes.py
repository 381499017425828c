"""Sizes that a footer and page headers state, against what the library says, and ones that cannot be."""

from __future__ import annotations

import base64
import io
import json
from pathlib import Path
from random import Random

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from apart import check_apart
from pyarrow.parquet import encryption
from random_tables import random_table
from thrift_compact import Field, Structs, written

from occlog.cli.main import run
from occlog.errors import ExitCode, InputError
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables import sizes
from occlog.io.files.tables.parquet import arrow_batches
from occlog.io.files.tables.sizes import (
    BINARY,
    CHUNK,
    COLUMNS,
    I32,
    I64,
    LIST,
    PATH,
    ROW_GROUPS,
    STRUCT,
    Chunk,
    CompactReader,
    MalformedError,
    Page,
    RowGroupSizes,
    read_groups,
    read_page,
)
from occlog.io.files.tables.table_writer import write_table
from occlog.records.tables import Tracks

HISTOGRAMS = 16
"""The field of a column's description with how often values are none."""


def columns(random: np.random.Generator, rows: int) -> dict[str, pa.Array]:
    texts = np.array(["", "a", "north", "a" * 16, "b" * 32, "c" * 33, "d" * 200])
    return {
        "t_ns": pa.array(np.sort(random.integers(0, 1 << 62, rows))),
        "x": pa.array(random.normal(size=rows)),
        "small": pa.array(random.integers(0, 9, rows).astype(np.int32)),
        "yes": pa.array(random.random(rows) < 0.5),
        "sensor": pa.array(texts[random.integers(0, len(texts), rows)]),
        "missing": pa.array(random.normal(size=rows), mask=random.random(rows) < 0.3),
        "none": pa.nulls(rows, pa.float32()),
        "list": pa.array([[1.0] * n for n in random.integers(0, 4, rows)], pa.list_(pa.float64())),
        "pair": pa.StructArray.from_arrays([pa.array(np.zeros(rows)), pa.array(np.ones(rows))], ["a", "b"]),
    }


WRITTEN = [
    {},
    {"compression": "none", "use_dictionary": False},
    {"compression": "zstd", "write_statistics": False},
    {"data_page_version": "2.0", "write_page_index": True, "write_page_checksum": True},
    {"version": "1.0", "use_byte_stream_split": ["x"], "use_dictionary": ["sensor"]},
    {"row_group_size": 7, "store_schema": False},
]


def write(path: Path, rows: int, options: dict[str, object], seed: int = 1) -> None:
    pq.write_table(pa.table(columns(np.random.default_rng(seed), rows)), path, **options)


def by_library(path: Path) -> list[list[Chunk]]:
    reported, groups = pq.read_metadata(path), []
    for group in map(reported.row_group, range(reported.num_row_groups)):
        chunks = []
        for column in map(group.column, range(group.num_columns)):
            begin = column.data_page_offset
            if column.has_dictionary_page and (0 < column.dictionary_page_offset < begin or not begin):
                begin = column.dictionary_page_offset
            name = column.path_in_schema.split(".")[0]
            chunks.append(Chunk(name, begin, begin + column.total_compressed_size))
        groups.append(chunks)
    return groups


def groups_in(path: Path) -> list[RowGroupSizes]:
    with path.open("rb") as file:
        return read_groups(path, file, path.stat().st_size)


@pytest.mark.parametrize("options", WRITTEN)
@pytest.mark.parametrize("rows", [0, 1, 100])
def test_columns_are_where_the_library_finds_them(tmp_path: Path, rows: int, options: dict[str, object]) -> None:
    write(path := tmp_path / "t.parquet", rows, options)
    assert [group.chunks for group in groups_in(path)] == by_library(path)


@pytest.mark.parametrize("seed", range(4))
def test_a_damaged_footer_is_an_error_or_describes_chunks_in_the_file(tmp_path: Path, seed: int) -> None:
    write(path := tmp_path / "t.parquet", 30, WRITTEN[seed], seed)
    whole, random, refused = path.read_bytes(), Random(seed), 0
    begin = len(whole) - 8 - int.from_bytes(whole[-8:-4], "little")
    for _ in range(400):
        data = bytearray(whole)
        for _ in range(random.choice([1, 1, 1, 3])):
            data[random.randrange(begin, len(data) - 8)] = random.choice([random.randrange(256), random.randrange(32)])
        path.write_bytes(data)
        try:
            found = groups_in(path)
        except (MalformedError, InputError):  # the latter of a field that says that the file is encrypted
            refused += 1
        else:
            assert all(0 <= chunk.begin <= chunk.end <= len(whole) for group in found for chunk in group.chunks)
    assert 10 < refused < 400


def page(unpacked: int, packed: int, values: int, *, long: bytes | None = None, dictionary: bool = False) -> bytes:
    """A page header with a check sum, and the largest of its values as statistics."""
    head = {n: Field(I32, value) for n, value in ((1, values), (2, 0), (3, 3), (4, 3))}
    if long is not None:
        head[5] = Field(STRUCT, {1: Field(BINARY, long)})
    fields = {1: Field(I32, 0), 2: Field(I32, unpacked), 3: Field(I32, packed), 4: Field(I32, -5)}
    return written(fields | {7 if dictionary else 5: Field(STRUCT, head)})


def test_page_headers_are_read_as_they_are_written() -> None:
    random = Random(1)
    for _ in range(300):
        unpacked, packed, values = (random.getrandbits(random.randint(1, 31)) for _ in range(3))
        long = random.choice([None, b"", bytes(random.choices(range(256), k=random.randint(0, 300)))])
        made = page(unpacked, packed, values, long=long)
        assert read_page(made + b"\x15\x00") == Page(unpacked, packed, values, len(made))
        made = page(unpacked, packed, values, dictionary=True)
        assert read_page(made) == Page(unpacked, packed, 0, len(made))


@pytest.mark.parametrize("stated", [(-1, 5, 5), (5, -1, 5), (5, 5, -1)])
def test_statedbelow_0_are_no_page_header(stated: tuple[int, int, int]) -> None:
    with pytest.raises(MalformedError, match="without its sizes"):
        read_page(page(*stated))


@pytest.mark.parametrize("missing", [2, 3])
def test_a_page_header_without_its_statedis_none(missing: int) -> None:
    with pytest.raises(MalformedError, match="without its sizes"):
        read_page(written({n: Field(I32, 5) for n in (1, 2, 3) if n != missing}))


def changed(data: bytes, number: int, field: Field, *, column: int = 2) -> bytes:
    """A Parquet file with another field in the description of a column."""
    length = int.from_bytes(data[-8:-4], "little")
    reported = Structs(data, len(data) - 8 - length).struct()
    reported[ROW_GROUPS].value[1][0][COLUMNS].value[1][column][CHUNK].value[number] = field
    end = written(reported)
    return data[: -8 - length] + end + len(end).to_bytes(4, "little") + b"PAR1"


def tracks() -> bytes:
    out = io.BytesIO()
    times = np.arange(20) * 1_000_000_000
    table = {"t_ns": times, "target_id": np.ones(20, np.int32), "x": times / 1e9, "y": times / 2e9}
    pq.write_table(pa.table(table), out, use_dictionary=["target_id"])
    return out.getvalue()


SHORT = Field(STRUCT, {2: Field(LIST, (I64, [])), 3: Field(LIST, (I64, [20]))})
"""How often a value is none, for one level of two: the library ends the process where this is asked for."""


@pytest.mark.parametrize("column", [0, 3])
def test_statistics_that_do_not_fit_are_one_line(tmp_path: Path, column: int) -> None:
    path = tmp_path / "t.parquet"
    path.write_bytes(changed(tracks(), HISTOGRAMS, SHORT, column=column))
    done = check_apart("doctor", path)
    if done.code == ExitCode.DONE:  # a library that does not read these statistics
        assert "nothing found" in done.output
        return
    assert done.code == ExitCode.BAD_INPUT
    assert f"{path}: cannot be read: damaged or not a Parquet file" in done.output


def test_times_of_a_table_are_reported_whatever_its_statistics_are(tmp_path: Path) -> None:
    write_table(tmp_path / "ours.parquet", random_table(Tracks, 50, 1), Provenance("track"))
    rows = pq.read_table(tmp_path / "ours.parquet")
    pq.write_table(rows, path := tmp_path / "plain.parquet")
    path.write_bytes(changed(path.read_bytes(), HISTOGRAMS, SHORT, column=0))
    done = check_apart("info", path, "--json")
    assert json.loads(done.output.strip())["time_ns"] == [rows["t_ns"][0].as_py(), rows["t_ns"][-1].as_py()]


@pytest.mark.parametrize(
    ("number", "field", "reason"),
    [
        (sizes.PACKED, Field(I64, -1), "without its name, its size or its position"),
        (sizes.PACKED, Field(I64, 1 << 40), "beyond the end"),
        (sizes.PACKED, Field(I32, 5), "where a number is expected"),
        (sizes.DATA_PAGE, Field(I64, (1 << 63) - 1), "beyond the end"),
        (PATH, Field(LIST, (BINARY, [])), "without its name"),
        (PATH, Field(LIST, (I64, [5])), "items of another type"),
        (PATH, Field(BINARY, b"x"), "where a list is expected"),
    ],
)
def test_columns_that_cannot_be(tmp_path: Path, number: int, field: Field, reason: str) -> None:
    path = tmp_path / "t.parquet"
    path.write_bytes(changed(tracks(), number, field))
    with pytest.raises(MalformedError, match=reason):
        groups_in(path)


def of(groups: int, **reported: int) -> bytes:
    """A footer of groups of one row and 100 columns of no bytes, if nothing else is stated."""
    chunk = {PATH: Field(LIST, (BINARY, [b"a"])), sizes.PACKED: Field(I64, 0), sizes.DATA_PAGE: Field(I64, 4)}
    column = {CHUNK: Field(STRUCT, chunk | {1: Field(I32, 1)})}
    counts = {
        sizes.GROUP_BYTES: Field(I64, reported.get("unpacked", 0)),
        sizes.GROUP_ROWS: Field(I64, reported.get("each", 1)),
    }
    group = {COLUMNS: Field(LIST, (STRUCT, [column] * 100)), **counts}
    rows = Field(I64, reported.get("rows", groups))
    end = written({sizes.NUM_ROWS: rows, ROW_GROUPS: Field(LIST, (STRUCT, [group] * groups))})
    return b"PAR1" + end + (len(end) + reported.get("longer", 0)).to_bytes(4, "little") + b"PAR1"


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (of(2, rows=3), "3 rows, but row groups with 2 rows in all"),
        (of(2, each=-1), "without its sizes"),
        (of(2, unpacked=-1), "without its sizes"),
        (of(2, longer=99), "longer than the file"),
        (of(11), "more columns than a file of its size can have"),
    ],
)
def test_groups_that_cannot_be(tmp_path: Path, data: bytes, reason: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sizes, "FREE_CHUNKS", 1000)
    path = tmp_path / "t.parquet"
    path.write_bytes(of(10))
    assert [len(group.chunks) for group in groups_in(path)] == [100] * 10
    path.write_bytes(data)
    with pytest.raises(MalformedError, match=reason):
        groups_in(path)


def test_a_reader_decodes_no_more_bytes_than_it_may() -> None:
    data = written({1: Field(LIST, (I64, [5] * 10)), 2: Field(BINARY, b"a" * 100)})
    CompactReader(data, left=15).skip(STRUCT)
    with pytest.raises(MalformedError, match="more values than"):
        CompactReader(data, left=14).skip(STRUCT)
    with pytest.raises(MalformedError, match="more than 64 bits"):
        CompactReader(bytes([0x16]) + b"\xff" * 99 + b"\0\0", left=1000).skip(STRUCT)


@pytest.mark.parametrize(
    "data",
    [b"", b"\x15", b"\x19\xfc\xff\xff\xff\x7f", b"\x1c" * 100, b"\x1d\x00", b"\x15" + b"\xff" * 20, b"\x19" * 5000],
)
def test_bytes_that_are_no_struct_are_refused(data: bytes) -> None:
    with pytest.raises(MalformedError):
        CompactReader(data, left=len(data)).skip(STRUCT)


def test_a_field_that_comes_twice_is_refused() -> None:
    once = written({3: Field(I64, 5)})[:-1]
    with pytest.raises(MalformedError, match="do not ascend"):
        Structs(once + bytes([I64, 6, 14, 0])).struct()
    assert Structs(once + bytes([I64, 8, 14, 0])).struct() == {3: Field(I64, 5), 4: Field(I64, 7)}


class Keys(encryption.KmsClient):
    """Keys that are no secrets."""

    def wrap_key(self, key_bytes: bytes, master_key_identifier: str) -> bytes:
        return base64.b64encode(key_bytes)

    def unwrap_key(self, wrapped_key: bytes, master_key_identifier: str) -> bytes:
        return base64.b64decode(wrapped_key)


@pytest.mark.parametrize("plain_footer", [True, False])
def test_encrypted_files_say_that_they_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], plain_footer: bool
) -> None:
    path, rows = tmp_path / "a.parquet", pa.table({"t_ns": [1], "x": [2.0]})
    reported = encryption.EncryptionConfiguration("a", column_keys={"b": ["x"]}, plaintext_footer=plain_footer)
    factory = encryption.CryptoFactory(lambda _: Keys())
    properties = factory.file_encryption_properties(encryption.KmsConnectionConfig(), reported)
    with pq.ParquetWriter(path, rows.schema, encryption_properties=properties) as writer:
        writer.write_table(rows)
    assert run(["info", str(path)]) == ExitCode.BAD_INPUT
    assert "a.parquet: is encrypted (Parquet), and occlog takes no keys; write it" in capsys.readouterr().err


def test_the_first_version_of_feather_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.feather"
    path.write_bytes(b"FEA1" + bytes(40) + b"\x20\0\0\0FEA1")
    assert run(["info", str(path)]) == ExitCode.BAD_INPUT
    assert "a.feather: is in version 1 of Feather, which is not read; write it as Parquet" in capsys.readouterr().err


@pytest.mark.parametrize("options", WRITTEN)
def test_a_table_of_others_without_rows_is_read(tmp_path: Path, options: dict[str, object]) -> None:
    """Such a file has a group without rows, whose columns have dictionaries and no pages of data."""
    write(path := tmp_path / "t.parquet", 0, options)
    assert [batch.num_rows for batch in arrow_batches(path)] in ([], [0])
