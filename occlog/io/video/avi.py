"""Frame list of an AVI file: the header's counts compared with the chunks that exist.

AVI has no time stamps: the time of a frame follows from its number. So the numbers of readable chunks are determined
here, also after a damaged section.
"""

from __future__ import annotations

import mmap
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

from occlog.array_types import Bools, Ints
from occlog.io.files.timing.frame_times import frames_to_ns

from .container import (
    MAX_FRAMES,
    BrokenContainerError,
    ByteRange,
    Container,
    Faults,
    cut_short,
    let_go,
    unknown_frames,
    unpack,
)

EMPTY = -1
MIN_RATE, MAX_RATE = 0.01, 1e6
NO_RATE = "it states no frame rate"
LATEST_START = 3600
"""A stream that is stated to begin later [s] is decoded from 0 on."""
PALETTE = b"pc"
_LISTS = (b"RIFF", b"LIST")


def recognised(data: mmap.mmap) -> bool:
    """Whether a file begins like an AVI file."""
    return len(data) >= 12 and data[:4] == b"RIFF" and data[8:12] == b"AVI "


@dataclass(frozen=True, slots=True)
class _Stream:
    """Header of an AVI video stream.

    Attributes:
        number: of the stream in the file.
        rate: frames per second.
        first: number of its first packet.
        announced: number of frames.
        largest: size of the largest frame [bytes].
    """

    number: int
    rate: Fraction
    first: int
    announced: int
    largest: int


@dataclass
class _AviScan:
    """Parts of an AVI file found so far: header, index and lists of frames, and its faults."""

    chunks: list[tuple[int, int]] = field(default_factory=list)  # (position, bytes) of the video stream's chunks
    problems: Faults = field(default_factory=Faults)
    header: ByteRange | None = None
    index: ByteRange | None = None
    movies: list[ByteRange] = field(default_factory=list)


def parse(data: mmap.mmap) -> Container:
    """Frame list of an AVI file, with its faults; damage does not raise."""
    found = _AviScan()
    try:
        _walk_top(data, found)
    except BrokenContainerError as bad:
        found.problems.append((f"byte {bad.byte}", f"{bad.what}; no part of an AVI file begins there"))
    try:
        if found.header is None:
            raise BrokenContainerError(12, "the header is missing")
        stream = _video_stream(data, found.header)
    except BrokenContainerError as bad:
        return unknown_frames("avi", *found.problems, (f"byte {bad.byte}", f"the header is damaged: {bad.what}"))
    return _container(data, found, stream)


def _walk_top(data: mmap.mmap, found: _AviScan) -> None:
    for riff in _chunks(data, 0, len(data), padded=True):
        if riff.kind != b"RIFF":
            raise BrokenContainerError(riff.start - 8, f"a part named {riff.kind!r}")
        if riff.stop > len(data):
            found.problems.append(cut_short(len(data), riff.stop, "RIFF list"))
        for part in _chunks(data, riff.start + 4, min(riff.stop, len(data))):
            name = data[part.start : part.start + 4] if part.kind == b"LIST" else part.kind
            if name == b"hdrl":
                found.header = part
            elif name == b"movi":
                found.movies.append(part)
            elif name == b"idx1":
                found.index = part


def _chunks(data: mmap.mmap, start: int, stop: int, *, padded: bool = False) -> Iterator[ByteRange]:
    """Yield the chunks from byte `start` up to `stop`, which may end beyond the end of the file.

    `padded`: zeros after the first chunk end them. BrokenContainerError at a byte at which no chunk begins.
    """
    first = start
    while start + 8 <= stop:
        kind = data[start : start + 4]
        if padded and start > first and kind == bytes(4):
            return
        (size,) = unpack(data, "<I", start + 4)
        if not _is_name(kind):
            raise BrokenContainerError(start, f"a part named {kind!r}")
        # A recorder that was stopped leaves a size of 0 in its open lists: they reach to the end.
        end = stop if kind in _LISTS and size == 0 else start + 8 + size
        yield ByteRange(kind, start + 8, end)
        start = end + (size & 1)


def _is_name(kind: bytes) -> bool:
    return len(kind) == 4 and all(32 <= c < 127 for c in kind)


def _video_stream(data: mmap.mmap, header: ByteRange) -> _Stream:
    """Header of the first video stream; `header` is the byte range of the list of streams.

    BrokenContainerError if there is none, or its frame rate is impossible.
    """
    number = period_us = 0
    for part in _chunks(data, header.start + 4, min(header.stop, len(data))):
        if part.kind == b"avih":
            (period_us,) = unpack(data, "<I", part.start)
        if part.kind != b"LIST" or data[part.start : part.start + 4] != b"strl":
            continue
        strh = next((c for c in _chunks(data, part.start + 4, part.stop) if c.kind == b"strh"), None)
        if strh is not None and data[strh.start : strh.start + 4] == b"vids":
            scale, rate, first, length, largest = unpack(data, "<IIIII", strh.start + 20)
            if not scale * rate and period_us:
                scale, rate = period_us, 10**6  # as FFmpeg does
            if not scale * rate:
                raise BrokenContainerError(strh.start, f"{NO_RATE} ({rate}/{scale})")
            if not MIN_RATE <= rate / scale <= MAX_RATE:
                raise BrokenContainerError(strh.start, f"a frame rate of {rate}/{scale}")
            first = first if first <= LATEST_START * rate // scale else 0
            return _Stream(number, Fraction(rate, scale), first, length, largest)
        number += 1
    raise BrokenContainerError(header.start, "it names no video stream")


def _container(data: mmap.mmap, found: _AviScan, stream: _Stream) -> Container:
    number, offset, size = _numbered_chunks(data, found, f"{stream.number:02d}".encode()).T
    announced, rate = stream.announced, stream.rate
    last = int(number.max(initial=-1)) + 1
    if announced > max(MAX_FRAMES, last):
        found.problems.append(("header", f"{announced} frames announced; that cannot be"))
        announced = last
    if announced == 0 and last:
        found.problems.append(("header", "it was never completed (its recorder was stopped)"))
    n = max(announced, last)
    broken = np.ones(n, dtype=np.bool_)
    broken[number] = offset + size > len(data)
    # An empty chunk represents a frame that the recorder dropped: it takes its time, and has no picture.
    shown = np.ones(n, dtype=np.bool_)
    shown[number[size == 0]] = False
    kept = np.flatnonzero(shown)
    packets = np.where(shown[number], np.searchsorted(kept, number), EMPTY)
    pts = frames_to_ns(kept, rate.limit_denominator(10**6))
    largest = (stream.largest, int(size.max(initial=0)))
    steps = kept if len(kept) < n else None
    return Container(
        "avi",
        pts,
        broken[kept],
        False,
        rate,
        tuple(found.problems),
        packets,
        first_packet=stream.first,
        steps=steps,
        largest=largest,
    )


def _is_frame(kind: bytes, tag: bytes) -> bool:
    """Whether a chunk of the name `kind` (4 bytes, such as 00dc) holds a frame of the stream `tag` (2 bytes).

    Palettes are no frames.
    """
    return kind[:2] == tag and kind[2:] != PALETTE


def _numbered_chunks(data: mmap.mmap, found: _AviScan, tag: bytes) -> Ints:
    """(n, 3) frame number, byte and size of the readable chunks of a stream, in the order of the file.

    Chunks are numbered in sequence. After damage the index gives the number of the next chunk that is found at its
    indexed position; without an index, numbering ends there.

    Args:
        data: the file.
        found: its parts; faults are added.
        tag: first 2 bytes of the names of the stream's chunks.
    """
    out = array("q")
    index: tuple[Ints, Ints] | None = None
    number = done = 0
    for movie in found.movies:
        at = movie.start + 4
        stop = min(movie.stop, len(data))
        while at + 8 <= stop:
            done = let_go(data, at, done)
            kind, size = data[at : at + 4], unpack(data, "<I", at + 4)[0]
            if _is_name(kind) and (kind == b"LIST" or at + 8 + size <= movie.stop):
                if _is_frame(kind, tag):
                    out.extend((number, at + 8, size))
                    number += 1
                at += 12 if kind == b"LIST" else 8 + size + (size & 1)
                continue
            if index is None:
                index = _index(data, found, tag)
            resume = max(np.searchsorted(index[0], at, "right"), np.searchsorted(index[1], number))
            where = f"byte {at}"
            if resume == len(index[0]):
                found.problems.append((where, "damaged; frames behind it cannot be given a number and are skipped"))
                return np.array(out, dtype=np.int64).reshape(-1, 3)
            at, number = int(index[0][resume]), int(index[1][resume])
            found.problems.append((where, f"damaged up to byte {at}"))
    return np.array(out, dtype=np.int64).reshape(-1, 3)


def _index(data: mmap.mmap, found: _AviScan, tag: bytes) -> tuple[Ints, Ints]:
    """First byte and frame number, (n,) each and increasing, of a stream's chunks that are at their indexed position.

    Empty without an index. `tag` are the first 2 bytes of the names of the stream's chunks.
    """
    none = np.zeros(0, dtype=np.int64)
    if found.index is None or not found.movies:
        return none, none
    size = max(min(found.index.stop, len(data)) - found.index.start, 0) // 16 * 16
    entry = np.dtype([("name", "S4"), ("flags", "<u4"), ("place", "<u4"), ("size", "<u4")])
    table = np.frombuffer(data, entry, size // 16, found.index.start)
    table = table[_are_frames(table["name"], tag)]
    if not len(table):
        return none, none
    # Offsets count from the word `movi`, or in some files from the beginning.
    base = found.movies[0].start if table["place"][0] < found.movies[0].start else 0
    offset = table["place"].astype(np.int64) + base
    number = np.flatnonzero(offset + 8 <= len(data))
    head = np.dtype([("name", "S4"), ("size", "<u4")])
    there = np.ndarray(len(data) - 7, head, data, strides=1)[offset[number]]  # a head may begin at any byte
    number = number[_are_frames(there["name"], tag) & (there["size"] == table["size"][number])]
    last = np.maximum.accumulate(offset[number])
    number = number[np.diff(last, prepend=-1) > 0]
    return offset[number], number


def _are_frames(names: np.ndarray, tag: bytes) -> Bools:
    return np.char.startswith(names, tag) & ~np.char.endswith(names, PALETTE)
