"""Heads of pages of Parquet: the short way to read them against the general one, and sizes that cannot be."""

from __future__ import annotations

import re
from random import Random

import pytest

from occlog.io.files.tables import pages
from occlog.io.files.tables.pages import DICTIONARY, Page, read_head
from occlog.io.files.tables.thrift import BINARY, FALSE, I32, STRUCT, TRUE, Field, MalformedError, Struct, written


def head(
    kind: int, sizes: tuple[int, int], values: int, *, crc: int | None = None, long: bytes | None = None
) -> Struct:
    """The head of a page of data, with its check sum and the largest of its values as statistics."""
    data: Struct = {n: Field(I32, value) for n, value in ((1, values), (2, 0), (3, 3), (4, 3))}
    if long is not None:
        data[5] = Field(STRUCT, {1: Field(BINARY, long)})
    return with_sizes(kind, sizes, crc) | {5: Field(STRUCT, data)}


def with_sizes(kind: int, sizes: tuple[int, int], crc: int | None) -> Struct:
    fields = {1: Field(I32, kind), 2: Field(I32, sizes[0]), 3: Field(I32, sizes[1])}
    return fields if crc is None else fields | {4: Field(I32, crc)}


def dictionary(sizes: tuple[int, int], crc: int | None, is_sorted: bool | None) -> Struct:
    """The head of a page with what others refer to."""
    told: Struct = {1: Field(I32, 5), 2: Field(I32, 0)}
    if is_sorted is not None:
        told[3] = Field(TRUE if is_sorted else FALSE, is_sorted)
    return with_sizes(DICTIONARY, sizes, crc) | {7: Field(STRUCT, told)}


@pytest.mark.parametrize("general", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_heads_are_read_as_they_are_written(seed: int, general: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    random = Random(seed)
    if general:
        monkeypatch.setattr(pages, "_USUAL", re.compile(b"(?!)"))
    for _ in range(500):
        sizes = random.getrandbits(random.randint(1, 31)), random.getrandbits(random.randint(1, 31))
        values, before = random.getrandbits(random.randint(1, 31)), bytes(random.randint(0, 9))
        crc = random.choice([None, random.getrandbits(31), -random.getrandbits(31)])
        long = random.choice([None, b"", bytes(random.choices(range(256), k=random.randint(0, 300)))])
        made = written(head(0, sizes, values, crc=crc, long=long))
        assert read_head(before + made + b"\x15\x00", len(before)) == Page(0, *sizes, values, len(before + made))
        made = written(dictionary(sizes, crc, random.choice([None, True, False])))
        assert read_head(before + made, len(before)) == Page(DICTIONARY, *sizes, 0, len(before + made))


def test_most_heads_are_read_in_the_short_way(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pages, "Reader", lambda *_: pytest.fail("a head that was read in the long way"))
    for crc in (None, 5, -5):
        for long in (None, b"", b"12345678", bytes(32)):
            assert read_head(written(head(0, (5, 6), 7, crc=crc, long=long))).values == 7
        for is_sorted in (None, True, False):
            assert read_head(written(dictionary((5, 6), crc, is_sorted))).kind == DICTIONARY


@pytest.mark.parametrize("long", [None, b"largest"])
@pytest.mark.parametrize(("sizes", "values"), [((-1, 5), 5), ((5, -1), 5), ((5, 5), -1)])
def test_sizes_below_0_are_no_head(sizes: tuple[int, int], values: int, long: bytes | None) -> None:
    with pytest.raises(MalformedError, match="below 0"):
        read_head(written(head(0, sizes, values, long=long)))


def test_a_head_without_its_sizes_is_none() -> None:
    for missing in (1, 2, 3):
        fields = {n: Field(I32, 5) for n in (1, 2, 3) if n != missing}
        with pytest.raises(MalformedError, match="without its sizes"):
            read_head(written(fields))
