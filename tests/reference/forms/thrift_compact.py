"""Structs of Thrift's compact protocol, read and written: for Parquet files with another footer.

A struct is a dictionary of its fields, id to (type, value), so that unknown fields go through unchanged.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from occlog.io.files.tables.sizes import (
    BINARY,
    BYTE,
    DOUBLE,
    FALSE,
    I16,
    I32,
    I64,
    LIST,
    SET,
    STRUCT,
    TRUE,
    CompactReader,
    MalformedError,
)


class Field(NamedTuple):
    """A value with its type; lists are a pair of the type of the items and the items."""

    kind: int
    value: Any


Struct = dict[int, Field]


class Structs(CompactReader):
    """Reads whole structs."""

    def __init__(self, data: bytes, at: int = 0) -> None:
        super().__init__(data, len(data))
        self.at = at

    def struct(self) -> Struct:
        """The struct that begins here."""
        return {number: Field(kind, self._value(kind, in_list=False)) for number, kind in self.fields()}

    def _value(self, kind: int, *, in_list: bool) -> Any:
        if kind in (TRUE, FALSE):
            return self._byte() == TRUE if in_list else kind == TRUE
        if kind == BYTE:
            return self._byte()
        if kind in (I16, I32, I64):
            return self._zigzag()
        if kind in (DOUBLE, BINARY):
            size = 8 if kind == DOUBLE else self._varint()
            self._pass(size)
            return self.data[self.at - size : self.at]
        if kind in (LIST, SET):
            of, count = self._list_head()
            return of, [self._value(of, in_list=True) for _ in range(count)]
        if kind == STRUCT:
            return self.struct()
        raise MalformedError(f"a value of the unknown type {kind}")


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
