"""Check sums of tables: every byte is covered, other programs read the file, and files without them are read."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from random_tables import random_table

from occlog.errors import InputError
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.check_sums import BLOCK, MARK, Checked
from occlog.io.files.tables.header import describe, read_provenance
from occlog.io.files.tables.parquet import read_table
from occlog.io.files.tables.table_writer import write_table
from occlog.records.losses import Loss
from occlog.records.tables import Bearings

MADE = Provenance("detect", {"method": "em"}, 7, (("a.mcap", "00"),), (Loss("cam1", "frame 3", "lost", 1),))
ROWS = 5000


@pytest.fixture(scope="module")
def raw(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The bytes of a table of several blocks."""
    path = tmp_path_factory.mktemp("whole") / "t.parquet"
    write_table(path, random_table(Bearings, ROWS), MADE)
    return path.read_bytes()


def footer_at(raw: bytes) -> int:
    return len(raw) - 8 - int(struct.unpack("<I", raw[-8:-4])[0])


def read(path: Path) -> object:
    return describe(path), read_table(path, Bearings).bearing.tobytes()


def test_a_table_has_several_blocks_and_others_read_it(raw: bytes, tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    path.write_bytes(raw)
    with Checked(path) as file:
        assert file.trailer is not None
        assert len(file.trailer.sums) == -(-file.trailer.end // BLOCK) > 2
        assert bytes(file.read()) == raw
    assert pq.read_table(path, page_checksum_verification=True).num_rows == ROWS


def test_every_bit_of_the_trailer_and_of_the_end_counts(raw: bytes, tmp_path: Path) -> None:
    path, at = tmp_path / "t.parquet", footer_at(raw)
    path.write_bytes(raw)
    good = read(path)
    first = raw.rindex(MARK, 0, raw.rindex(MARK))
    for byte in [*range(first, at), *range(len(raw) - 8, len(raw))]:
        for bit in range(8):
            flipped = bytearray(raw)
            flipped[byte] ^= 1 << bit
            path.write_bytes(flipped)
            with pytest.raises(InputError) as caught:
                assert read(path) != good
            assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("place", "words"),
    [(lambda raw: footer_at(raw) + 100, "its footer, with units and provenance,"), (lambda _: BLOCK + 9, "a block")],
)
def test_what_is_damaged_is_named(raw: bytes, tmp_path: Path, place, words: str) -> None:
    path, at = tmp_path / "t.parquet", place(raw)
    path.write_bytes(raw[:at] + bytes([raw[at] ^ 4]) + raw[at + 1 :])
    with pytest.raises(InputError, match=f"damaged: {words} at byte .*wrong check sum.*; copy it again"):
        read(path)


def test_only_blocks_that_are_read_are_tried(raw: bytes, tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    path.write_bytes(raw[: BLOCK + 9] + bytes([raw[BLOCK + 9] ^ 4]) + raw[BLOCK + 10 :])
    with Checked(path) as file:
        assert bytes(file.read(BLOCK)) == raw[:BLOCK]
        with pytest.raises(InputError, match=f"a block at byte {BLOCK}"):
            file.read(1)


def test_tables_without_check_sums_are_read_with_those_of_pages(raw: bytes, tmp_path: Path) -> None:
    path, old = tmp_path / "t.parquet", tmp_path / "old.parquet"
    path.write_bytes(raw)
    pq.write_table(pq.read_table(path), old, write_page_checksum=True)
    with Checked(old) as file:
        assert file.trailer is None
    assert np.array_equal(read_table(old, Bearings).bearing, read_table(path, Bearings).bearing, equal_nan=True)
    assert read_provenance(old).losses == MADE.losses
    data = bytearray(old.read_bytes())
    data[len(data) // 2] ^= 1
    old.write_bytes(data)
    with pytest.raises(InputError, match="damaged"):
        read_table(old, Bearings)


def test_a_table_without_rows_has_check_sums(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    write_table(path, random_table(Bearings, 0), MADE)
    assert MARK in path.read_bytes()
    assert read_provenance(path) == MADE
