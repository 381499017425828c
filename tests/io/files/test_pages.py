"""Heads of pages of Parquet: the short way to read them against the general one, and sizes that cannot be."""

from __future__ import annotations

from random import Random

import pytest

from occlog.io.files.tables.pages import Page, read_head
from occlog.io.files.tables.thrift import BINARY, I32, STRUCT, Field, MalformedError, Struct, written


def head(kind: int, sizes: tuple[int, int], values: int, *, crc: int | None = None, long: bytes | None = None) -> bytes:
    """The head of a page of data, with its check sum and the largest of its values as statistics."""
    data: Struct = {n: Field(I32, value) for n, value in ((1, values), (2, 0), (3, 3), (4, 3))}
    if long is not None:
        data[5] = Field(STRUCT, {1: Field(BINARY, long)})
    fields = {1: Field(I32, kind), 2: Field(I32, sizes[0]), 3: Field(I32, sizes[1])}
    fields |= {} if crc is None else {4: Field(I32, crc)}
    return written({**fields, 5: Field(STRUCT, data)})


@pytest.mark.parametrize("seed", range(3))
def test_heads_are_read_as_they_are_written(seed: int) -> None:
    random = Random(seed)
    for _ in range(500):
        sizes = random.getrandbits(random.randint(1, 31)), random.getrandbits(random.randint(1, 31))
        values, before = random.getrandbits(random.randint(1, 31)), bytes(random.randint(0, 9))
        crc = random.choice([None, random.getrandbits(31), -random.getrandbits(31)])
        long = random.choice([None, b"", bytes(random.choices(range(256), k=random.randint(0, 300)))])
        made = head(0, sizes, values, crc=crc, long=long)
        assert read_head(before + made + b"\x15\x00", len(before)) == Page(0, *sizes, values, len(before + made))


@pytest.mark.parametrize("long", [None, b"largest"])
@pytest.mark.parametrize(("sizes", "values"), [((-1, 5), 5), ((5, -1), 5), ((5, 5), -1)])
def test_sizes_below_0_are_no_head(sizes: tuple[int, int], values: int, long: bytes | None) -> None:
    with pytest.raises(MalformedError, match="below 0"):
        read_head(head(0, sizes, values, long=long))


def test_a_head_without_its_sizes_is_none() -> None:
    for missing in (1, 2, 3):
        fields = {n: Field(I32, 5) for n in (1, 2, 3) if n != missing}
        with pytest.raises(MalformedError, match="without its sizes"):
            read_head(written(fields))
