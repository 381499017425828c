"""Boxes of MP4 and QuickTime files (ISO/IEC 14496-12), read with every length checked."""

from __future__ import annotations

import mmap
import struct
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ..columns import Ints
from .video_container import BrokenContainerError, Span, unpack


class Samples(NamedTuple):
    """Sample table of the video track, in the order of decoding; times in ticks of `scale` per second."""

    scale: int
    time: Ints
    duration: Ints
    offset: Ints
    size: Ints


def boxes(data: mmap.mmap, start: int, stop: int) -> Iterator[Span]:
    """Boxes between two bytes: the spans of their content."""
    while start + 8 <= stop:
        size, kind = struct.unpack_from(">I4s", data, start)
        head = 8
        if size == 1:
            (size,) = unpack(data, ">Q", start + 8)
            head = 16
        elif size == 0:
            size = stop - start
        if size < head or not all(32 <= c < 127 or c == 0xA9 for c in kind):
            raise BrokenContainerError(start, f"a box of {size} bytes named {box_name(kind)}")
        yield Span(kind, start + head, start + size)
        start += size


def box_name(kind: bytes) -> str:
    """The name of a box as printable text."""
    return kind.decode("ascii", "backslashreplace")


def find_box(data: mmap.mmap, span: Span, *path: bytes) -> Span | None:
    """The first box with this path of names inside a span, None if there is none."""
    for kind in path:
        found = next((b for b in boxes(data, span.start, min(span.stop, len(data))) if b.kind == kind), None)
        if found is None:
            return None
        span = found
    return span


def need_box(data: mmap.mmap, span: Span, *path: bytes) -> Span:
    """The first box with this path of names; BrokenContainerError if there is none."""
    found = find_box(data, span, *path)
    if found is None:
        raise BrokenContainerError(span.start, f"box {'/'.join(box_name(p) for p in path)} is missing")
    return found


def ticks_per_second(data: mmap.mmap, box: Span) -> int:
    """Ticks per second of an mdhd or mvhd box."""
    scale = unpack(data, ">I", box.start + (20 if data[box.start] else 12))[0]
    if scale < 1:
        raise BrokenContainerError(box.start, "a time scale of 0")
    return scale


def read_table(data: mmap.mmap, box: Span | None, width: int, dtype: str, head: int = 4) -> Ints:
    """(n, width) entries of a table box with a count, as int64; no rows where the box is missing."""
    if box is None:
        return np.zeros((0, width), dtype=np.int64)
    (count,) = unpack(data, ">I", box.start + head)
    first = box.start + head + 4
    if first + count * width * np.dtype(dtype).itemsize > min(box.stop, len(data)):
        raise BrokenContainerError(box.start, f"table {box_name(box.kind)} of {count} entries is longer than its box")
    return np.frombuffer(data, dtype, count * width, first).astype(np.int64).reshape(count, width)
