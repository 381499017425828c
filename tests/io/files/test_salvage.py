"""What is whole in a cut or damaged table comes back, and nothing else does."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from random_tables import random_table

from occlog.cli.main import run
from occlog.errors import ExitCode, InputError
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables import table_writer
from occlog.io.files.tables.header import read_header, read_provenance
from occlog.io.files.tables.parquet import read_table
from occlog.io.files.tables.salvage.marks import GROUP, group_of, marks
from occlog.io.files.tables.salvage.table import recover_table
from occlog.io.files.tables.table_writer import TableWriter, write_table
from occlog.io.files.tables.thrift import MalformedError, Reader, written
from occlog.io.files.times.utc import utc
from occlog.records.columns import Table
from occlog.records.losses import Loss
from occlog.records.tables import TABLES, WIDER, Bearings, Tracks

T0, STEP, GROUPS, ROWS = 1_700_000_000_000_000_000, 10_000_000, 5, 400
BEFORE = Loss("cam", "frame 3", "cut", 2)


def rows(group: int) -> Bearings:
    """Rows of a group: numbers that no dictionary makes smaller, labels, flags and NaN."""
    rng = np.random.default_rng(group)
    n = group * ROWS + np.arange(ROWS)
    seen = rng.random(ROWS) < 0.8
    value = np.where(seen, rng.uniform(-3, 3, ROWS), np.nan)
    return Bearings.of(
        t_ns=T0 + n * STEP, sensor=[f"cam{k % 3}" for k in n], target_id=np.zeros(ROWS, int), seen=seen, bearing=value,
        sigma=np.where(seen, 0.1, np.nan), u_px=value, sigma_px=np.where(seen, 2.0, np.nan),
        score=np.full(ROWS, np.nan),
    )  # fmt: skip


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A table of five groups of rows."""
    path = tmp_path_factory.mktemp("whole") / "b.parquet"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(table_writer, "ROWS_PER_GROUP", ROWS)
        with TableWriter(path, Bearings, Provenance("detect", {}, 1, (), (BEFORE,)), length_unit="ft") as out:
            for k in range(GROUPS):
                out.write(rows(k))
    return path


def ends(data: bytes) -> list[int]:
    """Where the marks of the groups end."""
    return [mark.behind for mark in marks(data) if mark.kind == GROUP]


def alike(a: Bearings, b: Bearings) -> bool:
    return len(a) == len(b) and all(
        np.array_equal(getattr(a, c.name), getattr(b, c.name), equal_nan=c.kind.startswith("f")) for c in a.columns()
    )


def salvaged(tmp_path: Path, data: bytes) -> tuple[Bearings, tuple[Loss, ...]]:
    (tmp_path / "bad.parquet").write_bytes(data)
    found = recover_table(tmp_path / "bad.parquet", tmp_path / "good.parquet", overwrite=True)
    table = read_table(tmp_path / "good.parquet", Bearings)
    assert (found.rows, found.losses) == (len(table), read_provenance(tmp_path / "good.parquet").losses)
    return table, found.losses


def test_a_table_is_read_as_before_by_other_programs(whole: Path) -> None:
    told = pq.ParquetFile(whole)
    assert told.metadata.num_row_groups == GROUPS
    assert told.read().num_rows == GROUPS * ROWS


def test_a_whole_table_comes_back_whole(whole: Path, tmp_path: Path) -> None:
    found = recover_table(whole, tmp_path / "same.parquet")
    assert found == (GROUPS * ROWS, (T0, T0 + (GROUPS * ROWS - 1) * STEP), (BEFORE,))
    assert alike(read_table(tmp_path / "same.parquet", Bearings), read_table(whole, Bearings))


def test_all_groups_before_a_cut_come_back_wherever_it_is(whole: Path, tmp_path: Path) -> None:
    data, stops = whole.read_bytes(), ends(whole.read_bytes())
    for cut in np.random.default_rng(0).integers(1, len(data), 100).tolist():
        groups = sum(stop <= cut for stop in stops)
        if not groups:
            with pytest.raises(InputError, match=r"bad\.parquet: "):
                salvaged(tmp_path, data[:cut])
            continue
        table, losses = salvaged(tmp_path, data[:cut])
        assert alike(table, Bearings.concat([rows(k) for k in range(groups)]))
        assert losses[:2] == (BEFORE, Loss("bad.parquet", "its end", losses[1].what))
        assert losses[-1].place == f"after {utc(T0 + (groups * ROWS - 1) * STEP)}"


def test_no_flipped_bit_is_read_as_data(whole: Path, tmp_path: Path) -> None:
    data = whole.read_bytes()
    rng = np.random.default_rng(1)
    lost = 0
    for at, bit in zip(rng.integers(0, len(data), 150).tolist(), rng.integers(0, 8, 150).tolist(), strict=True):
        bad = bytearray(data)
        bad[at] ^= 1 << bit
        try:
            table, losses = salvaged(tmp_path, bytes(bad))
        except InputError:
            continue
        kept = [k for k in range(GROUPS) if T0 + k * ROWS * STEP in table.t_ns]
        assert alike(table, Bearings.concat([rows(k) for k in kept]))
        counted = sum(loss.count for loss in losses[1:])
        assert counted == ROWS * (GROUPS - len(kept)) or losses[1].place == "its end"
        lost += len(kept) < GROUPS
    assert lost > 50


@pytest.mark.parametrize("at", [4, 6, 12, 40, 400])
def test_all_rows_come_back_where_the_mark_at_the_beginning_is_damaged(whole: Path, tmp_path: Path, at: int) -> None:
    data = bytearray(whole.read_bytes())
    data[at] ^= 1
    table, losses = salvaged(tmp_path, bytes(data))
    assert alike(table, Bearings.concat([rows(k) for k in range(GROUPS)]))
    assert losses == (BEFORE,)


def test_rows_that_are_lost_are_counted_with_their_times(whole: Path, tmp_path: Path) -> None:
    data = bytearray(whole.read_bytes())
    third = [group_of(mark) for mark in marks(data) if mark.kind == GROUP][2]
    data[third.at + 100] ^= 1
    for damaged in (data, data[:-5]):  # with and without a footer
        _, losses = salvaged(tmp_path, bytes(damaged))
        lost = next(loss for loss in losses if "check sum" in loss.what)
        assert (lost.count, lost.place) == (ROWS, "2023-11-14T22:13:27.990Z to 2023-11-14T22:13:32.000Z")


def test_rows_of_neighbouring_groups_are_added_up(whole: Path, tmp_path: Path) -> None:
    data = bytearray(whole.read_bytes())
    for group in [group_of(mark) for mark in marks(data) if mark.kind == GROUP][1:3]:
        data[group.at + 100] ^= 1
    for damaged in (data, data[:-5]):  # with and without a footer
        table, losses = salvaged(tmp_path, bytes(damaged))
        assert len(table) == (GROUPS - 2) * ROWS
        assert [loss.count for loss in losses if "check sum" in loss.what] == [2 * ROWS]


def test_the_command_says_what_is_lost(whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cut, out = tmp_path / "cut.parquet", tmp_path / "whole.parquet"
    cut.write_bytes(whole.read_bytes()[: ends(whole.read_bytes())[1] + 10])
    assert run(["recover", str(cut), "-o", str(out), "--json"]) == ExitCode.LOSSY
    told = capsys.readouterr()
    assert json.loads(told.out)["rows"] == 2 * ROWS
    assert "cut.parquet: after 2023-11-14T22:13:27.990Z: rows up to its end, if there were more" in told.err
    assert read_header(out).length_unit == "ft"
    assert run(["recover", str(cut), "-o", str(tmp_path / "x.parquet"), "--video", "a=b.avi"]) == ExitCode.USAGE
    (tmp_path / "foreign.parquet").write_bytes(b"PAR1" + bytes(1000))
    assert run(["recover", str(tmp_path / "foreign.parquet"), "-o", str(tmp_path / "x.parquet")]) == ExitCode.BAD_INPUT
    assert "neither its end nor its beginning says what it holds" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["doctor", "info"])
def test_a_table_without_its_end_names_what_salvages_it(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    cut, foreign = tmp_path / "cut.parquet", tmp_path / "foreign.parquet"
    cut.write_bytes(whole.read_bytes()[:-200])
    pq.write_table(pq.read_table(whole).replace_schema_metadata(None), foreign)
    foreign.write_bytes(foreign.read_bytes()[:-200])
    for path, words in (
        (cut, "salvage what is left by `occlog recover`, or make it again"),
        (foreign, "make it again"),
    ):
        assert run([command, str(path)]) == ExitCode.BAD_INPUT
        told = "".join(capsys.readouterr())
        assert words in told
        assert ("recover" in told) == (path == cut)


def test_structures_go_through_unchanged(whole: Path) -> None:
    data = whole.read_bytes()
    (length,) = struct.unpack_from("<I", data, len(data) - 8)
    footer = data[-8 - length : -8]
    assert written(Reader(footer).struct()) == footer


@pytest.mark.parametrize(
    "data",
    [b"", b"\x15", b"\x19\xfc\xff\xff\xff\x7f", b"\x1c" * 100, b"\x1d\x00", b"\x15" + b"\xff" * 20, b"\x19" * 5000],
)
def test_bytes_that_are_no_structure_are_refused(data: bytes) -> None:
    with pytest.raises(MalformedError):
        Reader(data).struct()


@pytest.mark.parametrize("name", sorted(TABLES))
@pytest.mark.parametrize("length", [0, 5])
def test_a_table_of_each_kind_comes_back_without_its_footer(name: str, length: int, tmp_path: Path) -> None:
    table = random_table(TABLES[name], 6)
    if name == "views":
        table = replace(table, embedding=np.ones((6, length), np.float32))
    elif length:
        pytest.skip("has no lists of any length")
    path = tmp_path / "t.parquet"
    write_table(path, table, Provenance("test"))
    kept = path.read_bytes()
    path.write_bytes(kept[:-30])
    assert recover_table(path, tmp_path / "again.parquet").rows == 6
    again, whole = read_table(tmp_path / "again.parquet", TABLES[name]), table.sorted()
    for c in table.columns():
        a, b = getattr(again, c.name), getattr(whole, c.name)
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("kind", WIDER, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("lost", [0, 30], ids=["whole", "without its footer"])
def test_columns_that_few_files_have_come_back(kind: type[Table], lost: int, tmp_path: Path) -> None:
    table = random_table(kind, 6)
    path = tmp_path / "t.parquet"
    write_table(path, table, Provenance("test"))
    kept = path.read_bytes()
    path.write_bytes(kept[: len(kept) - lost])
    recover_table(path, tmp_path / "again.parquet")
    again, whole = read_table(tmp_path / "again.parquet", kind), table.sorted()
    for c in table.columns():
        np.testing.assert_array_equal(getattr(again, c.name), getattr(whole, c.name))
    assert pq.read_schema(tmp_path / "again.parquet").names == [c.name for c in kind.columns()]


def test_a_column_that_no_table_has_is_told_as_a_loss(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    write_table(path, random_table(Tracks, 6), Provenance("test"))
    rows = pq.read_table(path)
    pq.write_table(rows.append_column("mood", pa.array(["merry"] * 6)), path)
    found = recover_table(path, tmp_path / "again.parquet")
    assert [(loss.place, loss.what) for loss in found.losses] == [
        ("column mood", "is left out: tracks of this version has no such column")
    ]
