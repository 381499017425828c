"""Samples of fragmented MP4 files: what recorders write that want to survive a power cut."""

from __future__ import annotations

import mmap

import numpy as np

from .video_container import MAX_FRAMES, BrokenContainerError, Span, unpack
from .video_mp4_boxes import Samples, boxes, find_box, need_box


def read_fragments(data: mmap.mmap, moov: Span, moofs: list[Span], track_id: int, scale: int) -> Samples:
    """Samples of the movie fragments."""
    defaults = _track_defaults(data, moov, track_id)
    parts: list[tuple[int, int, int, int]] = []
    clock = 0
    for moof in (m for m in moofs if m.stop <= len(data)):
        for traf in (b for b in boxes(data, moof.start, moof.stop) if b.kind == b"traf"):
            tfhd = need_box(data, traf, b"tfhd")
            if unpack(data, ">I", tfhd.start + 4)[0] != track_id:
                continue
            clock = _fragment(data, moof, traf, tfhd, defaults, clock, parts)
    table = np.array(parts, dtype=np.int64).reshape(-1, 4)
    return Samples(scale, *table.T)


def _track_defaults(data: mmap.mmap, moov: Span, track_id: int) -> tuple[int, int]:
    """Default duration and size of a fragment's samples."""
    mvex = find_box(data, moov, b"mvex")
    for trex in boxes(data, mvex.start, mvex.stop) if mvex is not None else ():
        if trex.kind == b"trex" and unpack(data, ">I", trex.start + 4)[0] == track_id:
            return unpack(data, ">II", trex.start + 12)  # type: ignore[return-value]
    return 0, 0


def _fragment(
    data: mmap.mmap,
    moof: Span,
    traf: Span,
    tfhd: Span,
    defaults: tuple[int, int],
    clock: int,
    parts: list[tuple[int, int, int, int]],
) -> int:
    """Append (time, duration, offset, size) of the samples of one track fragment; time after it."""
    flags = unpack(data, ">I", tfhd.start)[0] & 0xFFFFFF
    at = tfhd.start + 8
    base = moof.start - 8
    if flags & 0x1:
        (base,) = unpack(data, ">Q", at)
        at += 8
    at += 4 if flags & 0x2 else 0
    duration, size = defaults
    if flags & 0x8:
        (duration,) = unpack(data, ">I", at)
        at += 4
    if flags & 0x10:
        (size,) = unpack(data, ">I", at)
    tfdt = find_box(data, traf, b"tfdt")
    if tfdt is not None:
        (clock,) = unpack(data, ">Q" if data[tfdt.start] else ">I", tfdt.start + 4)
    for trun in (b for b in boxes(data, traf.start, traf.stop) if b.kind == b"trun"):
        clock, base = _run(data, trun, (duration, size), clock, base, parts)
    return clock


def _run(
    data: mmap.mmap,
    trun: Span,
    defaults: tuple[int, int],
    clock: int,
    base: int,
    parts: list[tuple[int, int, int, int]],
) -> tuple[int, int]:
    flags, count = unpack(data, ">II", trun.start)
    flags &= 0xFFFFFF
    at = trun.start + 8
    offset = base
    if flags & 0x1:
        offset = base + unpack(data, ">i", at)[0]
        at += 4
    at += 4 if flags & 0x4 else 0
    fields = [bit for bit in (0x100, 0x200, 0x400, 0x800) if flags & bit]
    if at + 4 * len(fields) * count > trun.stop or len(parts) + count > MAX_FRAMES:
        raise BrokenContainerError(trun.start, f"a fragment of {count} samples is longer than its box")
    for _ in range(count):
        values = dict(zip(fields, unpack(data, f">{len(fields)}i", at), strict=True))
        at += 4 * len(fields)
        duration, size = values.get(0x100, defaults[0]), values.get(0x200, defaults[1])
        parts.append((clock + values.get(0x800, 0), duration, offset, size))
        clock += duration
        offset += size
    return clock, offset
