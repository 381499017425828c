"""Small Parquet and Arrow files that unpack to gigabytes: each is refused in one line, and memory stays as it was."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from apart import check_apart
from random_tables import random_table
from thrift_compact import Field, Struct, Structs, written

from occlog.cli.main import run
from occlog.errors import ExitCode, InputError
from occlog.io.external.source import ArrowMessageHeader, messages
from occlog.io.files.limits import FREE_BYTES, FREE_ROWS, check_declared_size
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables import arrow as arrow_columns
from occlog.io.files.tables import parquet, sizes
from occlog.io.files.tables import parquet as vectors
from occlog.io.files.tables.parquet import batches, opened_table, read_table
from occlog.io.files.tables.sizes import BINARY, I32, I64, LIST, STRUCT
from occlog.io.files.tables.table_writer import write_table
from occlog.records.tables import Bearings, Views

BIG = 1 << 30
ROWS = 50


def columns(rows: int) -> dict[str, np.ndarray]:
    zeros = np.zeros(rows)
    return {"t_ns": zeros.astype(np.int64), "target_id": zeros.astype(np.int32), "x": zeros, "y": zeros}


def tracks(rows: int) -> pa.Table:
    return pa.table(columns(rows) | {"t_ns": np.arange(rows)})


def bearings(names: pa.Array) -> pa.Table:
    rows = len(names)
    return pa.table({"t_ns": np.arange(rows), "sensor": names, "azimuth_rad": np.zeros(rows)})


def long_name(rows: int, characters: int) -> pa.Array:
    return pa.DictionaryArray.from_arrays(pa.array(np.zeros(rows, np.int32)), pa.array(["a" * characters]))


def with_large_pages(table: pa.Table, size: int) -> bytes:
    """A table as Parquet whose pages, but for those of times, unpack to `size` zeros; its footer does not say so."""
    out = io.BytesIO()
    pq.write_table(table, out, compression="zstd", use_dictionary=False, write_statistics=False)
    data = out.getvalue()
    length = int.from_bytes(data[-8:-4], "little")
    footer = Structs(data[-8 - length : -8]).struct()
    zeros = pa.Codec("zstd").compress(bytes(size), asbytes=True)
    made = bytearray(b"PAR1")
    for column in footer[4].value[1][0][1].value[1]:
        reported = column[3].value
        reader = Structs(data, reported[9].value)
        head = reader.struct()
        body = data[reader.at : reader.at + head[3].value]
        if reported[3].value[1] != [b"t_ns"]:
            head[2], head[3], body = Field(I32, size), Field(I32, len(zeros)), zeros
        page = written(head) + body
        reported[9], reported[7], column[2] = Field(I64, len(made)), Field(I64, len(page)), Field(I64, len(made))
        made += page
    end = written(footer)
    return bytes(made) + end + len(end).to_bytes(4, "little") + b"PAR1"


def as_parquet(table: pa.Table) -> bytes:
    out = io.BytesIO()
    pq.write_table(table, out, compression="zstd", write_statistics=False, dictionary_pagesize_limit=BIG)
    return out.getvalue()


def as_arrow(table: pa.Table, *, stream: bool = False, rows: int | None = None) -> bytes:
    out = io.BytesIO()
    options = pa.ipc.IpcWriteOptions(compression="zstd")
    with (pa.ipc.new_stream if stream else pa.ipc.new_file)(out, table.schema, options=options) as writer:
        writer.write_table(table, rows)
    return out.getvalue()


LONG = 2_000_000
CASES: dict[str, tuple[str, Callable[[], bytes], str]] = {
    "pages": ("t.parquet", lambda: with_large_pages(tracks(ROWS), BIG), "unpacks to more than 134217728 bytes"),
    "text for every row": ("t.parquet", lambda: as_parquet(bearings(long_name(1000, LONG))), f"a text of {LONG}"),
    "Arrow": ("t.arrow", lambda: as_arrow(pa.table(columns(10_000_000))), "declares 10000000 rows in a file of"),
    "Arrow stream": (
        "t.arrow",
        lambda: as_arrow(pa.table(columns(10_000_000)), stream=True),
        "declares 10000000 rows in a file",
    ),
    "Arrow, text for every row": ("t.arrow", lambda: as_arrow(bearings(long_name(1000, LONG))), f"a text of {LONG}"),
    "Arrow, rows of nothing": (
        "t.arrow",
        lambda: as_arrow(pa.table({name: pa.nulls(2 * 10**9) for name in ("t_ns", "target_id", "x", "y")})),
        "declares 2000000000 rows in a file of",
    ),
    "Arrow, batches that unpack much together": (
        "t.arrow",
        lambda: as_arrow(pa.table(columns(3) | {"unused": ["a" * 120_000_000] * 3}), rows=1),
        "declares 240000",
    ),
    "Arrow, columns that nobody needs": (
        "t.arrow",
        lambda: as_arrow(pa.table({f"unused{n}": np.zeros(FREE_ROWS) for n in range(15)} | columns(FREE_ROWS))),
        "bytes at once in a file of",
    ),
}


@pytest.mark.parametrize(("name", "make", "words"), CASES.values(), ids=CASES)
def test_memory_stays_as_it_was(tmp_path: Path, name: str, make: Callable[[], bytes], words: str) -> None:
    path, out = tmp_path / name, tmp_path / "out.csv"
    path.write_bytes(make())
    assert path.stat().st_size < 400_000
    for arguments in (["export", path, "-o", out], ["doctor", path]):
        outcome = check_apart(*arguments)
        assert outcome.code == ExitCode.BAD_INPUT
        assert words in outcome.output
    assert not out.exists()


def one_long_list(rows: int, numbers: int) -> pa.Array:
    return pa.ListArray.from_arrays(
        pa.array([0] + [numbers] * rows, pa.int32()), pa.array(np.zeros(numbers, np.float32))
    )


@pytest.mark.parametrize("name", ["ours.parquet", "others.parquet", "others.arrow"])
def test_one_long_list_among_many_rows_is_not_one_for_each(tmp_path: Path, name: str) -> None:
    path, rows, numbers = tmp_path / name, 3000, 1_000_000
    write_table(tmp_path / "v.parquet", random_table(Views, rows, 1), Provenance("test"))
    whole = pq.read_table(tmp_path / "v.parquet")
    table = whole.set_column(
        whole.schema.names.index("embedding"), whole.schema.field("embedding"), one_long_list(rows, numbers)
    )
    table = table if name == "ours.parquet" else table.replace_schema_metadata(None)
    if name.endswith("arrow"):
        path.write_bytes(as_arrow(table))
    else:
        pq.write_table(table, path, compression="zstd")
    outcome = check_apart("export", path, "-o", tmp_path / "o.csv")
    assert (outcome.code, outcome.output.strip().count("\n")) == (ExitCode.BAD_INPUT, 0)
    assert f"a list of {numbers} numbers among {rows} rows" in outcome.output


def test_vectors_are_read_in_parts_of_few_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lists = pa.array([[1.0, 2.0], [], [3.0, 4.0]], pa.list_(pa.float32()))
    batch = pa.record_batch({"a": lists, "b": pa.array([1, 2, 3])})
    monkeypatch.setattr(vectors, "NUMBERS_AT_ONCE", 4)
    assert [len(part) for part in vectors.in_parts(tmp_path, 100, [batch, batch.select(["b"])])] == [2, 1, 3]
    fixed = pa.FixedSizeListArray.from_arrays(pa.array(np.zeros(9)), 3)
    assert [len(part) for part in vectors.in_parts(tmp_path, 100, [pa.record_batch({"a": fixed})])] == [1, 1, 1]
    monkeypatch.setattr(arrow_columns, "MAX_NUMBERS", 5)
    (column,) = (c for c in Views.columns() if c.name == "embedding")
    with pytest.raises(InputError, match="a list of 2 numbers among 5 rows, most of which have none"):
        arrow_columns.vectors(column, pa.array([[1.0, 2.0], [], [], [], []], pa.list_(pa.float32())))


@pytest.mark.parametrize("order", ["back", "at one time"])
def test_rows_that_are_held_to_be_put_in_order_have_a_limit(tmp_path: Path, order: str) -> None:
    """A million rows whose names take 800 bytes each."""
    path, rows = tmp_path / "t.parquet", 1_000_000
    names = pa.DictionaryArray.from_arrays(
        pa.array(np.arange(rows) % 7, pa.int32()), pa.array([f"{n}" * 200 for n in range(7)])
    )
    times = np.arange(rows)[::-1] // 10 if order == "back" else np.zeros(rows, np.int64)
    path.write_bytes(as_parquet(pa.table({"t_ns": times, "sensor": names, "azimuth_rad": np.zeros(rows)})))
    outcome = check_apart("export", path, "-o", tmp_path / "o.csv")
    assert (outcome.code, outcome.output.strip().count("\n")) == (ExitCode.BAD_INPUT, 0)
    assert "unsorted rows, or rows of one time" in outcome.output


def test_texts_of_our_tables_take_no_more_than_their_file_may(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = replace(random_table(Bearings, 1000, 1), sensor=np.full(1000, "a" * 100))
    write_table(path := tmp_path / "b.parquet", made, Provenance("test"))
    assert read_table(path, Bearings).sensor.tolist() == made.sensor.tolist()
    monkeypatch.setattr(parquet, "max_decompressed_bytes", lambda _: 399_999)
    with pytest.raises(InputError, match=r"b\.parquet: texts need more than 399999 bytes in a file of"):
        read_table(path, Bearings)


def with_footer(change: Callable[[Struct], None], rows: int = ROWS) -> bytes:
    """Tracks as Parquet, whose footer is changed."""
    data = as_parquet(tracks(rows))
    length = int.from_bytes(data[-8:-4], "little")
    footer = Structs(data[-8 - length : -8]).struct()
    change(footer)
    end = written(footer)
    return data[: -8 - length] + end + len(end).to_bytes(4, "little") + b"PAR1"


def of_no_columns(footer: Struct) -> None:
    group = footer[4].value[1][0]
    bare = {**group, 1: Field(LIST, (STRUCT, [{2: Field(I64, 0)}] * 900_000))}
    footer[4] = Field(LIST, (STRUCT, [bare] * 3))


def of_many_parts(footer: Struct) -> None:
    part = {1: Field(I32, 2), 3: Field(I32, 1), 4: Field(BINARY, b"a")}
    footer[2] = Field(LIST, (STRUCT, [{4: Field(BINARY, b"s"), 5: Field(I32, 900_000)}] + [part] * 900_000))


def of_many_names(footer: Struct) -> None:
    footer[5] = Field(LIST, (STRUCT, [{1: Field(BINARY, b"a"), 2: Field(BINARY, b"b")}] * 900_000))


def of_one_group_again(footer: Struct) -> None:
    footer[4] = Field(LIST, (STRUCT, footer[4].value[1] * 200))
    footer[3] = Field(I64, ROWS * 200)


FOOTERS = {
    "columns without a description": (of_no_columns, "more columns than a file of its size can have"),
    "schema": (of_many_parts, "900001 columns, with nested ones; at most 50000 are read"),
    "entries": (of_many_names, "more values than a file of its size can have"),
    "groups that share their bytes": (of_one_group_again, "its columns have more bytes than the file"),
}


@pytest.mark.parametrize(("change", "words"), FOOTERS.values(), ids=FOOTERS)
def test_footers_take_no_more_memory_than_their_file_may(
    tmp_path: Path, change: Callable[[Struct], None], words: str
) -> None:
    path = tmp_path / "t.parquet"
    path.write_bytes(with_footer(change))
    outcome = check_apart("info", path)
    assert (outcome.code, outcome.output.strip().count("\n")) == (ExitCode.BAD_INPUT, 0)
    assert words in outcome.output


def test_all_groups_together_unpack_to_no_more_than_their_file_may(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "t.parquet", tmp_path / "t.csv"
    rows = pa.table(columns(20_000) | {"t_ns": np.arange(20_000), "target_id": np.arange(20_000) % 7})
    pq.write_table(rows, path, compression="zstd", use_dictionary=False, row_group_size=1000)
    unpacked = 20_000 * 32
    for free, code in ((unpacked, ExitCode.DONE), (unpacked // 2, ExitCode.BAD_INPUT)):
        monkeypatch.setattr(sizes, "max_decompressed_bytes", lambda _, free=free: free + 20 * 4 * 64)
        assert run(["export", str(path), "-o", str(out), "--overwrite"]) == code
    assert "column t_ns unpacks to more than 325120 bytes" in capfd.readouterr().err


def test_all_groups_together_have_no_more_numbers_than_their_file_may(tmp_path: Path) -> None:
    """Each of 40 groups of one row has two million zeros, in a kilobyte."""
    path, zeros = tmp_path / "v.parquet", pa.array(np.zeros(2_000_000, np.float32))
    lists = pa.ListArray.from_arrays(pa.array([0, len(zeros)], pa.int32()), zeros)
    rows = pa.table({"t_ns": [1], "target_id": pa.array([1], pa.int32()), "x": [0.0], "y": [0.0], "z": lists})
    with pq.ParquetWriter(path, rows.schema, compression="zstd", data_page_size=1 << 26) as writer:
        for _ in range(40):
            writer.write_table(rows)
    with opened_table(path) as file, pytest.raises(InputError, match="column z unpacks to more than"):
        for _ in batches(file, 10, ["z"]):
            pass


def test_pages_as_large_as_their_file_may_have_are_read(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path, table = tmp_path / "t.parquet", tracks(200_000)
    pq.write_table(table, path, compression="zstd", row_group_size=200_000, data_page_size=1 << 26)
    assert run(["export", str(path), "-o", str(tmp_path / "t.csv")]) == ExitCode.DONE, capfd.readouterr().err
    # A head of a page with long statistics is looked for in more bytes
    words = pa.array([f"{n:03}" + "b" * 180 for n in range(200)])
    pq.write_table(bearings(words), path, use_dictionary=False, store_schema=False)
    assert run(["export", str(path), "-o", str(tmp_path / "b.csv")]) == ExitCode.DONE, capfd.readouterr().err


def test_the_limits_of_promises() -> None:
    path = Path("t.parquet")
    check_declared_size(path, 10, FREE_ROWS, FREE_BYTES)
    for rows, unpacked, words in ((FREE_ROWS + 1, 0, "1000001 rows"), (0, FREE_BYTES + 1, f"{FREE_BYTES + 1} bytes")):
        with pytest.raises(InputError, match=f"t.parquet: declares {words}.* in a file of 10 bytes"):
            check_declared_size(path, 10, rows, unpacked)
    check_declared_size(path, 10**6, 20 * 10**6, 10**9)
    with pytest.raises(InputError, match="20000001 rows"):
        check_declared_size(path, 10**6, 20 * 10**6 + 1, 0)


@pytest.mark.parametrize("compression", [None, "lz4", "zstd"])
@pytest.mark.parametrize("kind", ["file", "stream"])
def test_messages_say_what_the_library_unpacks(tmp_path: Path, kind: str, compression: str | None) -> None:
    names = pa.array(["left", "right"] * 4000).dictionary_encode()
    table = bearings(names)
    path = tmp_path / "t.arrow"
    options = pa.ipc.IpcWriteOptions(compression=compression)
    with (pa.ipc.new_file if kind == "file" else pa.ipc.new_stream)(path, table.schema, options=options) as writer:
        writer.write_table(table, max_chunksize=5000)
    found = [one for one in messages(path) if one != ArrowMessageHeader(0, 0)]
    assert [one.rows for one in found if one.rows] == [5000, 3000]
    if compression is None:
        assert {one.unpacked for one in found} == {0}
        return
    batches = [one.unpacked for one in found if one.rows]
    assert batches == [5000 * (8 + 4 + 8), 3000 * (8 + 4 + 8)]
    (dictionary,) = [one.unpacked for one in found if not one.rows]
    assert dictionary == len("leftright") + 4 * 3


def refused(path: Path, data: bytes) -> bool:
    """Whether heads of messages are refused as damaged, and by no other error."""
    path.write_bytes(data)
    try:
        assert min((min(one) for one in messages(path)), default=0) >= 0
    except ValueError:
        return True
    return False


def test_damaged_heads_of_messages_are_errors(tmp_path: Path) -> None:
    path = tmp_path / "t.arrow"
    of_file, of_stream = (as_arrow(bearings(long_name(100, 5)), stream=stream) for stream in (False, True))
    assert all(refused(path, of_file[:length]) for length in range(7, len(of_file), 7))
    for data in (of_file, of_stream):
        flipped = [data[:at] + bytes([data[at] ^ 0xFF]) + data[at + 1 :] for at in range(0, len(data), 3)]
        assert any(refused(path, each) for each in flipped)
