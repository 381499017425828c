"""Structures of Thrift in its compact protocol, in which Parquet writes the heads of pages and its footer.

A structure is read as a dictionary of its fields, number to (kind, value), and written from one: fields that nobody
knows go through unchanged.  Source: the compact protocol of Apache Thrift.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from typing import Any, NamedTuple

TRUE, FALSE, BYTE, I16, I32, I64, DOUBLE, BINARY, LIST, SET, MAP, STRUCT = range(1, 13)
MAX_DEPTH = 16
MAX_ITEMS = 1_000_000
VARINT = rb"[\x80-\xff]{0,9}[\x00-\x7f]"
"""A number, as an expression: of what is always written alike, one match takes a tenth of the time of a `Reader`."""
SHORT = rb"(?:[\x18\x28\x38\x48\x58](?:%b)|[\x16\x26\x36]%b|[\x11\x12\x21\x22])*\x00" % (
    b"|".join(re.escape(bytes([size])) + b".{%d}" % size for size in range(33)),
    VARINT,
)
"""A structure of texts of up to 32 bytes, numbers of 64 bits and truths, as statistics are, behind its head."""


class Field(NamedTuple):
    """A value with its kind; lists are a pair of the kind of the items and the items."""

    kind: int
    value: Any


Struct = dict[int, Field]


class MalformedError(ValueError):
    """Bytes that are no structure."""


class Reader:
    """Reads structures from bytes.

    Attributes:
        data: the bytes.
        at: where it reads next.
        left: how many bytes it will look at, those of texts left out; MalformedError for more.
    """

    def __init__(self, data: bytes | memoryview, at: int = 0, left: int = sys.maxsize) -> None:
        """Begin to read at a byte."""
        self.data, self.at, self.left = memoryview(data), at, left

    def struct(self, depth: int = 0) -> Struct:
        """The structure that begins here; MalformedError if there is none."""
        return {number: Field(kind, self._value(kind, depth, in_list=False)) for number, kind in self.fields()}

    def fields(self) -> Iterator[tuple[int, int]]:
        """Number and kind of each field of the structure that begins here; each is read, or skipped, before the next.

        This is how a long structure is read without keeping all of it.  MalformedError for a field that comes twice:
        which of them counts is not defined.
        """
        number = 0
        while (head := self._byte()) != 0:
            before, step = number, head >> 4
            number = number + step if step else self._zigzag()
            if number <= before and before:
                raise MalformedError("fields that do not ascend")
            yield number, head & 15

    def long(self, kind: int) -> int:
        """The number of 64 bits that stands here; MalformedError where the field is of another kind."""
        if kind != I64:
            raise MalformedError("another kind of value where a number of 64 bits should stand")
        return self._zigzag()

    def items(self, kind: int, of: int) -> range:
        """The numbers of the items of the list that begins here; each is read, or skipped, before the next.

        MalformedError where the field is no list of items of the kind `of`.
        """
        if kind != LIST:
            raise MalformedError("another kind of value where a list should stand")
        found, count = self._list_head()
        if found != of and count:
            raise MalformedError("a list of another kind of items")
        return range(count)

    def skip(self, kind: int, depth: int = 0, *, in_list: bool = False) -> None:
        """Pass over a value."""
        if depth > MAX_DEPTH:
            raise MalformedError("values within values without end")
        if kind in (I16, I32, I64):
            self._varint()
        elif kind == BINARY:
            self._pass(self._varint())
        elif kind == STRUCT:
            for _, each in self.fields():
                self.skip(each, depth + 1)
        elif kind in (LIST, SET):
            of, count = self._list_head()
            for _ in range(count):
                self.skip(of, depth + 1, in_list=True)
        elif kind == DOUBLE:
            self._pass(8)
        elif kind == BYTE or (in_list and kind in (TRUE, FALSE)):
            self._pass(1)
        elif kind not in (TRUE, FALSE):
            raise MalformedError(f"a value of the unknown kind {kind}")

    def text(self, kind: int) -> bytes:
        """The bytes that stand here; MalformedError where the field is of another kind."""
        if kind != BINARY:
            raise MalformedError("another kind of value where a text should stand")
        return self._bytes(self._varint())

    def _pass(self, count: int) -> None:
        if count > len(self.data) - self.at:
            raise MalformedError("the bytes end too early")
        self.at += count

    def _list_head(self) -> tuple[int, int]:
        head = self._byte()
        count = head >> 4 if head >> 4 != 15 else self._varint()
        if count > min(MAX_ITEMS, len(self.data) - self.at):
            raise MalformedError("a list of more items than there are bytes")
        return head & 15, count

    def _byte(self) -> int:
        if self.at >= len(self.data):
            raise MalformedError("the bytes end too early")
        if self.left <= 0:
            raise MalformedError("more values than a file of its size can have")
        self.left -= 1
        self.at += 1
        return self.data[self.at - 1]

    def _varint(self) -> int:
        value = shift = 0
        while True:
            byte = self._byte()
            value |= (byte & 127) << shift
            if byte < 128:
                return value
            shift += 7
            if shift > 63:
                raise MalformedError("a number of more than 64 bits")

    def _zigzag(self) -> int:
        value = self._varint()
        return (value >> 1) ^ -(value & 1)

    def _bytes(self, count: int) -> bytes:
        self._pass(count)
        return bytes(self.data[self.at - count : self.at])

    def _value(self, kind: int, depth: int, *, in_list: bool) -> Any:
        if depth > MAX_DEPTH:
            raise MalformedError("values within values without end")
        if kind in (TRUE, FALSE):
            return self._byte() == TRUE if in_list else kind == TRUE
        if kind == BYTE:
            return self._byte()
        if kind in (I16, I32, I64):
            return self._zigzag()
        if kind == DOUBLE:
            return self._bytes(8)
        if kind == BINARY:
            return self._bytes(self._varint())
        if kind in (LIST, SET):
            of, count = self._list_head()
            return of, [self._value(of, depth + 1, in_list=True) for _ in range(count)]
        if kind == STRUCT:
            return self.struct(depth + 1)
        raise MalformedError(f"a value of the unknown kind {kind}")


def from_varint(varint: bytes) -> int:
    """The number with a sign that some bytes are, which are all that it has."""
    value = 0
    for byte in reversed(varint):
        value = value << 7 | byte & 127
    return value >> 1 ^ -(value & 1)


def written(fields: Struct) -> bytes:
    """A structure as bytes."""
    out = bytearray()
    _put_struct(out, fields)
    return bytes(out)


def _put_struct(out: bytearray, fields: Struct) -> None:
    before = 0
    for number in sorted(fields):
        kind, value = fields[number]
        if kind in (TRUE, FALSE):
            kind = TRUE if value else FALSE
        if number - before <= 15:
            out.append((number - before) << 4 | kind)
        else:
            out.append(kind)
            _put_varint(out, _zigzagged(number))
        before = number
        if kind not in (TRUE, FALSE):
            _put(out, kind, value)
    out.append(0)


def _put(out: bytearray, kind: int, value: Any) -> None:
    if kind in (TRUE, FALSE):
        out.append(TRUE if value else FALSE)
    elif kind == BYTE:
        out.append(value)
    elif kind in (I16, I32, I64):
        _put_varint(out, _zigzagged(value))
    elif kind == DOUBLE:
        out += value
    elif kind == BINARY:
        _put_varint(out, len(value))
        out += value
    elif kind in (LIST, SET):
        of, items = value
        out.append(min(len(items), 15) << 4 | of)
        if len(items) >= 15:
            _put_varint(out, len(items))
        for item in items:
            _put(out, of, item)
    else:
        _put_struct(out, value)


def _zigzagged(value: int) -> int:
    return (value << 1) ^ (value >> 63)


def _put_varint(out: bytearray, value: int) -> None:
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    out.append(value)
