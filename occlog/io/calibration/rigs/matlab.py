"""Arrays of numbers in MATLAB files of the versions 4 to 7, after the format that MathWorks describes (MAT-File).

Read here and not by SciPy, whose reader a damaged file of a few hundred bytes can make crash.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from occlog.array_types import Floats

HEAD = 128
"""Bytes before the first element of a file from version 5 on."""
ORDERS = {b"IM": "<", b"MI": ">"}
"""Order of bytes by the end of that head."""
COMPRESSED, MATRIX = 15, 14
TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Types of stored numbers; those of small whole numbers are smaller than their array's."""
NUMBERS = range(6, 16)
"""Classes of arrays that hold numbers."""
COMPLEX = 0x0800
OLD_TYPES = ("f8", "f4", "i4", "i2", "u2", "u1")
"""Types of numbers in version 4."""
_OLD = 20
"""Bytes of the head of an array in version 4."""


class _Element(NamedTuple):
    kind: int
    data: bytes


def read_matlab(content: bytes, limit: int) -> dict[str, Floats | None]:
    """Arrays of a MATLAB file by name; None for what holds no real numbers: texts, structures, complex numbers.

    Args:
        content: of the file.
        limit: bytes to which it may unpack.

    Raises:
        ValueError, struct.error, zlib.error: it is damaged, or unpacks to more.
    """
    if 0 in content[:4]:
        return dict(_old(content))
    order = ORDERS.get(content[HEAD - 2 : HEAD])
    if order is None:
        raise ValueError("not a MATLAB file")
    found, left = {}, limit
    for element in _elements(content[HEAD:], order):
        part = element
        if element.kind == COMPRESSED:
            unpacker = zlib.decompressobj()
            data = unpacker.decompress(element.data, left + 1)
            left -= len(data)
            if left < 0:
                raise ValueError(f"unpacks to more than {limit} bytes")
            if not unpacker.eof:
                raise ValueError("ends within a compressed array")
            part = next(_elements(data, order), element)
        if part.kind != MATRIX:
            raise ValueError(f"an element of type {part.kind} where an array was expected")
        name, values = _matrix(part.data, order)
        if name:  # what has none is not a variable
            found[name] = values
    return found


def _elements(data: bytes, order: str) -> Iterator[_Element]:
    at = 0
    while at + 8 <= len(data):
        kind, length = struct.unpack_from(f"{order}II", data, at)
        if kind >> 16:  # up to four bytes in the place of the length
            kind, length = kind & 0xFFFF, kind >> 16
            if length > 4:
                raise ValueError(f"{length} bytes in an element of at most 4")
            yield _Element(kind, data[at + 4 : at + 4 + length])
            at += 8
            continue
        at += 8
        if at + length > len(data):
            raise ValueError("ends within an array")
        yield _Element(kind, data[at : at + length])
        at += length if kind == COMPRESSED else length + -length % 8


def _matrix(data: bytes, order: str) -> tuple[str, Floats | None]:
    """Name and values of an array."""
    parts = _elements(data, order)
    (flags,) = struct.unpack_from(f"{order}I", next(parts, _Element(0, b"")).data)
    sizes = next(parts, _Element(0, b""))
    if flags & 0xFF not in NUMBERS or flags & COMPLEX:
        # The name of an object stands where others have their sizes
        name = sizes if TYPES.get(sizes.kind) == "i1" else next(parts, _Element(0, b""))
        return name.data.decode("latin-1") or "", None
    shape = np.frombuffer(sizes.data, f"{order}i4").tolist()
    name, numbers = next(parts, _Element(0, b"")), next(parts, _Element(0, b""))
    if numbers.kind not in TYPES:
        raise ValueError(f"numbers of type {numbers.kind}")
    return name.data.decode("latin-1"), _shaped(np.frombuffer(numbers.data, order + TYPES[numbers.kind]), shape)


def _old(content: bytes) -> Iterator[tuple[str, Floats | None]]:
    """Arrays of a file of version 4."""
    at = 0
    while at < len(content):
        order = "<" if 0 <= struct.unpack_from("<i", content, at)[0] < 1000 else ">"
        kind, rows, columns, imaginary, length = struct.unpack_from(f"{order}5i", content, at)
        if order == ">" and not 1000 <= kind < 2000:
            raise ValueError(f"an array of type {kind}")
        numbers, text = kind % 100 // 10, kind % 10
        if kind % 1000 >= 100 or numbers >= len(OLD_TYPES) or min(rows, columns) < 0 or length < 1:
            raise ValueError(f"an array of type {kind} of {rows} x {columns}")
        at += _OLD
        name = content[at : at + length].rstrip(b"\0").decode("latin-1")
        at += length
        dtype = np.dtype(order + OLD_TYPES[numbers])
        size = rows * columns * dtype.itemsize
        real = content[at : at + size]
        at += size * (2 if imaginary else 1)
        if at > len(content):
            raise ValueError("ends within an array")
        yield name, None if text or imaginary else _shaped(np.frombuffer(real, dtype), [rows, columns])


def _shaped(values: NDArray[np.generic], shape: list[int]) -> Floats:
    """Numbers in the order of columns as an array; ValueError where they are not as many as it has."""
    if min(shape, default=-1) < 0:
        raise ValueError(f"an array of {shape}")
    return np.asarray(values, dtype=np.float64).reshape(shape, order="F")
