"""Frame list of a Matroska or WebM file: the blocks of its clusters, verified by sizes and check sums.

Also replaces FFmpeg's random track UIDs in WebM files by fixed ones, so that equal images give equal bytes.
"""

from __future__ import annotations

import math
import mmap
import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Ints
from occlog.io.files.timing.frame_times import MAX_RATE_DENOMINATOR

from .container import (
    MAX_FRAMES,
    SPHERE,
    STEREO,
    BrokenContainerError,
    Container,
    Faults,
    cut_short,
    let_go,
    mirror_of,
    unknown_frames,
)

EBML, SEGMENT, INFO, TRACKS, CLUSTER, CRC32 = 0x1A45DFA3, 0x18538067, 0x1549A966, 0x1654AE6B, 0x1F43B675, 0xBF
TICK, DURATION = 0x2AD7B1, 0x4489
ENTRY, NUMBER, TYPE, FRAME_NS, CODEC, TRACK_SCALE = 0xAE, 0xD7, 0x83, 0x23E383, 0x86, 0x23314F
VIDEO, PROJECTION, YAW, ROLL = 0xE0, 0x7670, 0x7673, 0x7675
PROJECTED, VIEWS = 0x7671, 0x53B8
CLUSTER_TIME, SIMPLE_BLOCK, GROUP, BLOCK, REFERENCE = 0xE7, 0xA3, 0xA0, 0xA1, 0xFB
KEY_FLAG = 0x80
"""Flag of a simple block that holds a key frame; another block holds one if it refers to none."""
BLOCK_HEAD = b"\x81\0\0"
"""Beginning of a block of track 1 at the time of its cluster, before its flags."""
SMALLEST_SCALE = 0.01
LATEST = 2**62
"""Time of a frame [ns], at most."""
CLUSTER_MARK = CLUSTER.to_bytes(4, "big")
_LEVEL1 = {INFO, TRACKS, CLUSTER, 0x114D9B74, 0x1C53BB6B, 0x1254C367, 0x1043A770, 0x1941A469, 0xEC, CRC32}


class Element(NamedTuple):
    """An EBML element: identifier, its first byte, and first byte and end of its content (None: not stated)."""

    id: int
    head: int
    start: int
    stop: int | None


@dataclass
class _MkvScan:
    """What is known of a Matroska file so far: video track, times of its frames [ticks], and faults."""

    tick_ns: int = 1_000_000
    duration: float = 0.0  # ticks
    track: int | None = None
    frame_ns: int = 0
    scale: float = 1.0  # of the track's ticks
    codec: bytes = b""
    undone: str = ""
    tracks: int = 0
    mirror: str = ""  # a rectangular projection seen from behind
    ticks: list[int] = field(default_factory=list)
    first_key: int | None = None  # ticks of the first key frame
    problems: Faults = field(default_factory=Faults)


def recognised(data: mmap.mmap) -> bool:
    """Whether a file begins like a Matroska or WebM file."""
    return data[:4] == EBML.to_bytes(4, "big")


def parse(data: mmap.mmap) -> Container:
    """Frame list of a Matroska or WebM file, with its faults; damage does not raise."""
    found = _MkvScan()
    try:
        header = element(data, 0, len(data))
        segment = element(data, header.stop or len(data), len(data))
        if segment.id != SEGMENT:
            raise BrokenContainerError(segment.head, "the segment is missing")
        if segment.stop is not None and segment.stop > len(data):
            found.problems.append(cut_short(len(data), segment.stop, "segment"))
        _segment(data, segment.start, min(segment.stop or len(data), len(data)), found)
    except BrokenContainerError as bad:
        found.problems.append((f"byte {bad.byte}", f"damaged: {bad.what}"))
    if found.track is None:
        return unknown_frames("matroska", *found.problems, ("header", "no video track is named"))
    return _container(found)


def element(data: mmap.mmap, at: int, stop: int) -> Element:
    """Parse the EBML element at byte `at`; BrokenContainerError if it is invalid, or `at` is not before `stop`."""
    if at >= min(stop, len(data)):
        raise BrokenContainerError(at, "the data ends here")
    first = data[at]
    width = 9 - first.bit_length()
    if not first or width > 4 or at + width >= len(data):
        raise BrokenContainerError(at, "no element begins here")
    ident = int.from_bytes(data[at : at + width], "big")
    offset = at + width
    length = 9 - data[offset].bit_length()
    if not data[offset] or offset + length > len(data):
        raise BrokenContainerError(at, "an element without a size")
    size = int.from_bytes(data[offset : offset + length], "big") & ((1 << (7 * length)) - 1)
    start = offset + length
    return Element(ident, at, start, None if size == (1 << (7 * length)) - 1 else start + size)


def children(data: mmap.mmap, start: int, stop: int) -> Iterator[Element]:
    """Yield the consecutive EBML elements from byte `start` up to `stop`.

    BrokenContainerError if one is invalid, of unknown size, or ends after `stop`.
    """
    at = start
    while at < stop:
        child = element(data, at, stop)
        if child.stop is None or child.stop > stop:
            raise BrokenContainerError(at, "an element is longer than the element that contains it")
        yield child
        at = child.stop


def _segment(data: mmap.mmap, start: int, stop: int, found: _MkvScan) -> None:
    at, done = start, 0
    while at < stop:
        done = let_go(data, at, done)
        try:
            part = element(data, at, stop)
            if part.id not in _LEVEL1:
                raise BrokenContainerError(at, f"an unknown element 0x{part.id:x}")
            at = _part(data, part, stop, found)
        except BrokenContainerError as bad:
            again = data.find(CLUSTER_MARK, max(bad.byte, at) + 1, stop)
            found.problems.append(
                (
                    f"byte {bad.byte}",
                    f"damaged: {bad.what}" + ("" if again < 0 else f"; readable again at byte {again}"),
                )
            )
            at = again if again >= 0 else stop


def _part(data: mmap.mmap, part: Element, stop: int, found: _MkvScan) -> int:
    """Parse one top-level element, add what it holds to `found`, and return the byte after it.

    Args:
        data: the file.
        part: the element.
        stop: byte before which it ends at the latest.
        found: updated.
    """
    end = part.stop
    if end is not None and end > stop:
        if part.id != CLUSTER:
            return stop  # the missing end has been reported already
        end = stop
    if end is not None and part.id != CLUSTER:
        _check_sum(data, part, end, found)
    if part.id == CLUSTER:
        after = _cluster(data, part.start, stop if end is None else end, found, open_end=end is None)
        if end is not None and part.stop == end:
            _check_sum(data, part, end, found)
        return after
    if end is None:
        raise BrokenContainerError(part.head, "an element of unknown size")
    if part.id == INFO:
        _info(data, part.start, end, found)
    elif part.id == TRACKS and found.track is None:
        _tracks(data, part.start, end, found)
    return end


def _check_sum(data: mmap.mmap, part: Element, end: int, found: _MkvScan) -> None:
    """Verify the CRC-32 at the beginning of an element for the content after it, if there is one.

    It is described in RFC 8794, section 11.3.1. A wrong one is added to the faults in `found`.

    Args:
        data: the mapped file.
        part: the element.
        end: byte after the element.
        found: faults so far, extended here.
    """
    if data[part.start : part.start + 2] != b"\xbf\x84" or end - part.start < 6:
        return
    (stated,) = struct.unpack_from("<I", data, part.start + 2)
    with memoryview(data) as view, view[part.start + 6 : end] as content:
        if zlib.crc32(content) == stated:
            return
    name = "cluster" if part.id == CLUSTER else "header or index"
    found.problems.append((f"bytes {part.head}-{end}", f"wrong check sum of this {name}: its content has changed"))


def _uint(data: mmap.mmap, e: Element) -> int:
    return int.from_bytes(data[e.start : min(e.stop or e.start, e.start + 8)], "big")


def _float(data: mmap.mmap, e: Element, otherwise: float) -> float:
    layout = {4: ">f", 8: ">d"}.get((e.stop or e.start) - e.start)
    return struct.unpack_from(layout, data, e.start)[0] if layout is not None else otherwise


def _info(data: mmap.mmap, start: int, stop: int, found: _MkvScan) -> None:
    for e in children(data, start, stop):
        if e.id == TICK:
            found.tick_ns = max(_uint(data, e), 1)
        elif e.id == DURATION:
            found.duration = _float(data, e, 0.0)


def _tracks(data: mmap.mmap, start: int, stop: int, found: _MkvScan) -> None:
    for entry in (e for e in children(data, start, stop) if e.id == ENTRY):
        values = {e.id: e for e in children(data, entry.start, entry.stop or stop)}
        if NUMBER in values and TYPE in values and _uint(data, values[TYPE]) == 1:
            found.tracks += 1
            if found.tracks > 1:
                continue
            found.track = _uint(data, values[NUMBER])
            found.frame_ns = _uint(data, values[FRAME_NS]) if FRAME_NS in values else 0
            scale = _float(data, values[TRACK_SCALE], 1.0) if TRACK_SCALE in values else 1.0
            found.scale = scale if SMALLEST_SCALE <= scale < np.inf else 1.0
            found.codec = data[values[CODEC].start : values[CODEC].stop or 0] if CODEC in values else b""
            yaw, roll = (
                sum(_float(data, e, 0.0) for e in _below(data, entry, (VIDEO, PROJECTION, axis)))
                for axis in (YAW, ROLL)
            )
            if abs(yaw) == 180.0:
                x, y = (round(part(math.radians(roll)), 6) for part in (math.cos, math.sin))
                found.mirror = mirror_of(-x, y, y, x)
            ways = {SPHERE: (VIDEO, PROJECTION, PROJECTED), STEREO: (VIDEO, VIEWS)}
            found.undone = next(
                (how for how, path in ways.items() if any(_uint(data, e) for e in _below(data, entry, path))), ""
            )


def _cluster(data: mmap.mmap, start: int, stop: int, found: _MkvScan, *, open_end: bool) -> int:
    """Add the times of the frames in a cluster from byte `start` up to `stop` to `found`; return the byte after it.

    `open_end`: the size of the cluster is unknown, and the next top-level element ends it. BrokenContainerError for an
    invalid or truncated block.
    """
    at, base = start, 0
    while at < stop:
        e = element(data, at, stop)
        if open_end and e.id in _LEVEL1 - {CRC32, 0xEC}:
            return at
        if e.stop is None or e.stop > stop:
            raise BrokenContainerError(
                at, "the file ends in this block" if stop == len(data) else "a block is too long"
            )
        if e.id == CLUSTER_TIME:
            base = _uint(data, e)
        elif e.id == SIMPLE_BLOCK:
            _block(data, e, base, found)
        elif e.id == GROUP:
            parts = list(children(data, e.start, e.stop))
            is_key = all(inner.id != REFERENCE for inner in parts)
            for inner in (each for each in parts if each.id == BLOCK):
                _block(data, inner, base, found, is_key=is_key)
        at = e.stop
    return at


def _block(data: mmap.mmap, e: Element, base: int, found: _MkvScan, *, is_key: bool | None = None) -> None:
    """Add the time of a block to `found`, if it is of the video track and its picture is not marked invisible.

    Args:
        data: the file.
        e: the block.
        base: time of its cluster [ticks].
        found: updated.
        is_key: it holds a key frame; None: by its flags.
    """
    stop = e.stop or e.start
    if e.start + 4 > stop or not data[e.start]:
        raise BrokenContainerError(e.head, "a block without a header")
    width = 9 - data[e.start].bit_length()
    track = int.from_bytes(data[e.start : e.start + width], "big") & ((1 << (7 * width)) - 1)
    if track != found.track or e.start + width + 3 >= stop:
        return
    shift, flags, first = struct.unpack_from(">hBB", data, e.start + width)
    hidden = flags & 0x08 or (found.codec == b"V_VP8" and not first >> 4 & 1)
    if not hidden:
        found.ticks.append(int(base / found.scale) + shift if found.scale != 1 else base + shift)
        if found.first_key is None and (flags & KEY_FLAG if is_key is None else is_key):
            found.first_key = found.ticks[-1]


def _container(found: _MkvScan) -> Container:
    # Whole numbers, as FFmpeg has them; the pictures get their times
    tick_ns = max(int(found.tick_ns * found.scale), 1) if found.scale != 1 else found.tick_ns
    if max(map(abs, found.ticks), default=0) * tick_ns > LATEST:
        return unknown_frames("matroska", *found.problems, ("clusters", "times of frames beyond 2^62 ns"))
    ticks = np.array([tick * tick_ns for tick in sorted(found.ticks)], dtype=np.int64)
    rate = Fraction(NS, found.frame_ns).limit_denominator(MAX_RATE_DENOMINATOR) if found.frame_ns else None
    pts, broken, first = _fill_grid(ticks, found)
    origin = int(ticks[0]) - first if len(ticks) else 0
    # A file in which no block is marked as a key frame does not state where decoding begins
    key = 0 if found.first_key is None else int(np.searchsorted(pts, found.first_key * tick_ns - origin))
    return Container(
        "matroska",
        pts,
        broken,
        True,
        rate,
        tuple(found.problems),
        first_ns=first,
        origin_ns=origin,
        first_key=key,
        mirror=found.mirror,
        undone=found.undone,
        tracks=found.tracks,
    )


def _fill_grid(times: Ints, found: _MkvScan) -> tuple[Ints, Bools, int]:
    """Times of all frames; in a damaged file with a constant frame rate including the missing ones.

    Args:
        times: (m,) increasing times of the frames that are there [ns].
        found: has frame interval, duration and faults.

    Returns:
        (n,) times after the first frame [ns], (n,) mask of missing frames, and the time of the first frame that is
            there [ns].
    """
    step, slack = found.frame_ns, 1.5 * found.tick_ns
    none = np.zeros(len(times), dtype=np.bool_)
    origin = int(times[0]) if len(times) else 0
    # A frame that is not in a file without damage was never recorded: it is not missing.
    if step <= 2 * slack or not len(times) or not found.problems:
        return times - origin, none, 0
    if origin > step:
        origin = 0  # the first frames are among the lost ones
    number = np.round((times - origin) / step).astype(np.int64)
    off_grid = (np.abs(times - origin - number * step) > slack).any() or (np.diff(number) < 1).any()
    length = found.duration * found.tick_ns / step
    n = max(int(number[-1]) + 1, round(length) if 0 < length < MAX_FRAMES else 0)
    if off_grid or number[0] < 0 or n > MAX_FRAMES:
        return times - int(times[0]), none, 0
    grid = np.arange(n, dtype=np.int64) * step
    grid[number] = times - origin
    missing = np.ones(n, dtype=np.bool_)
    missing[number] = False
    return grid, missing, int(grid[number[0]])


TAGS, TAG, TARGETS = 0x1254C367, 0x7373, 0x63C0
TRACK_UID, TAG_TRACK_UID = 0x73C5, 0x63C5


def number_tracks(path: Path) -> None:
    """Set the track UIDs of a WebM file, which are random, to 1, 2, ... in place, also in its tags.

    Other files are unchanged. Not for Matroska files, in which FFmpeg adds check sums. A damaged file is changed only
    up to the damage.
    """
    with path.open("r+b") as file:
        if not path.stat().st_size:
            return
        with mmap.mmap(file.fileno(), 0) as data:
            if not recognised(data):
                return
            try:
                _number(data)
            except BrokenContainerError:
                return  # whoever checks the file describes the fault of it


def _number(data: mmap.mmap) -> None:
    segment = element(data, element(data, 0, len(data)).stop or len(data), len(data))
    if segment.id != SEGMENT:
        return
    numbers: dict[int, int] = {}
    for path in ((TRACKS, ENTRY, TRACK_UID), (TAGS, TAG, TARGETS, TAG_TRACK_UID)):
        for uid in _below(data, segment, path):
            stop = uid.stop or uid.start
            old = int.from_bytes(data[uid.start : stop], "big")
            # 0 in tags represents all tracks
            new = numbers.setdefault(old, len(numbers) + 1) if old else 0
            data[uid.start : stop] = new.to_bytes(stop - uid.start, "big")


def _below(data: mmap.mmap, parent: Element, path: Sequence[int]) -> Iterator[Element]:
    """Yield the EBML elements below `parent` at a path of identifiers, outermost first."""
    for child in children(data, parent.start, len(data) if parent.stop is None else parent.stop):
        if child.id == path[0]:
            yield from _below(data, child, path[1:]) if len(path) > 1 else [child]
