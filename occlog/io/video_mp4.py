"""Frames of an MP4 or QuickTime file: sample tables (ISO/IEC 14496-12), also of fragmented files."""

from __future__ import annotations

import mmap
from fractions import Fraction

import numpy as np

from ..columns import Bools, Ints
from .video_container import MAX_FRAMES, BrokenContainerError, Container, Span, cut_short, unknown_frames, unpack
from .video_mp4_boxes import Samples, box_name, boxes, find_box, need_box, read_table, ticks_per_second
from .video_mp4_fragments import read_fragments

_TOP = (b"ftyp", b"moov", b"mdat", b"free", b"skip", b"wide", b"styp", b"sidx", b"moof", b"pnot")


def recognised(data: mmap.mmap) -> bool:
    """Whether the file begins like an MP4 or QuickTime file."""
    return len(data) >= 8 and data[4:8] in _TOP


def parse(data: mmap.mmap) -> Container:
    """The video frames of the file and what is wrong with it."""
    problems: list[tuple[str, str]] = []
    top: list[Span] = []
    try:
        for box in boxes(data, 0, len(data)):
            top.append(box)
            if box.stop > len(data):
                problems.append(cut_short(len(data), box.stop, f"box {box_name(box.kind)}"))
    except BrokenContainerError as bad:
        problems.append((f"byte {bad.byte}", f"{bad.what}; no box of an MP4 file begins there"))
    moov = next((b for b in top if b.kind == b"moov"), None)
    if moov is None:
        problems.append(
            ("moov", "the index (box moov) is missing; the file was cut or its recorder was stopped before the end")
        )
        return unknown_frames("mp4", *problems)
    try:
        return _container(data, moov, [b for b in top if b.kind == b"moof"], problems)
    except BrokenContainerError as bad:
        return unknown_frames("mp4", *problems, (f"byte {bad.byte}", f"the index (box moov) is damaged: {bad.what}"))


def _container(data: mmap.mmap, moov: Span, moofs: list[Span], problems: list[tuple[str, str]]) -> Container:
    trak, track_id = _video_track(data, moov)
    samples = _sample_table(data, trak)
    if moofs:
        samples = _join(samples, read_fragments(data, moov, moofs, track_id, samples.scale))
    order = np.argsort(samples.time, kind="stable")
    time = samples.time[order]
    broken = (samples.offset + samples.size)[order] > len(data)
    shown = _edited(data, moov, trak, samples, time)
    if shown is None or not len(time):
        return unknown_frames("mp4", *problems)
    time, broken = time[shown], broken[shown]
    pts = _ticks_to_ns(time - time[0], samples.scale) if len(time) else time
    mean = float(np.median(samples.duration)) if len(samples.duration) else 0.0
    rate = Fraction(samples.scale, int(mean)).limit_denominator(1001) if mean >= 1 else None
    return Container("mp4", pts, broken, True, rate, tuple(problems))


def _video_track(data: mmap.mmap, moov: Span) -> tuple[Span, int]:
    for trak in (b for b in boxes(data, moov.start, min(moov.stop, len(data))) if b.kind == b"trak"):
        hdlr = find_box(data, trak, b"mdia", b"hdlr")
        if hdlr is not None and data[hdlr.start + 8 : hdlr.start + 12] == b"vide":
            tkhd = need_box(data, trak, b"tkhd")
            version = data[tkhd.start]
            return trak, unpack(data, ">I", tkhd.start + (20 if version else 12))[0]
    raise BrokenContainerError(moov.start, "it names no video track")


def _sample_table(data: mmap.mmap, trak: Span) -> Samples:
    scale = ticks_per_second(data, need_box(data, trak, b"mdia", b"mdhd"))
    stbl = need_box(data, trak, b"mdia", b"minf", b"stbl")
    size = _sizes(data, need_box(data, stbl, b"stsz"))
    n = len(size)
    duration = _runs(read_table(data, find_box(data, stbl, b"stts"), 2, ">i4"), n)
    shift = _runs(read_table(data, find_box(data, stbl, b"ctts"), 2, ">i4"), n)
    time = np.concatenate([[0], np.cumsum(duration)[:-1]]).astype(np.int64) + shift if n else shift
    return Samples(scale, time, duration, _offsets(data, stbl, size), size)


def _sizes(data: mmap.mmap, stsz: Span) -> Ints:
    uniform, count = unpack(data, ">II", stsz.start + 4)
    if uniform:
        if count > MAX_FRAMES:
            raise BrokenContainerError(stsz.start, f"{count} samples announced")
        return np.full(count, uniform, dtype=np.int64)
    return read_table(data, stsz, 1, ">u4", head=8)[:, 0]


def _runs(table: Ints, n: int) -> Ints:
    """Values of a run-length table for n samples; 0 beyond its end."""
    out = np.zeros(n, dtype=np.int64)
    at = 0
    for count, value in table.tolist():
        out[at : at + max(count, 0)] = value
        at += max(count, 0)
        if at >= n:
            break
    return out


def _offsets(data: mmap.mmap, stbl: Span, size: Ints) -> Ints:
    """(n,) place of every sample in the file."""
    chunks = read_table(data, find_box(data, stbl, b"stco"), 1, ">u4")[:, 0]
    if not len(chunks):
        chunks = read_table(data, find_box(data, stbl, b"co64"), 1, ">u8")[:, 0]
    stsc = read_table(data, find_box(data, stbl, b"stsc"), 3, ">u4")
    first = np.append(stsc[:, 0] - 1, len(chunks))
    per_chunk = np.zeros(len(chunks), dtype=np.int64)
    for n, entry in enumerate(stsc):
        per_chunk[max(first[n], 0) : max(first[n + 1], 0)] = entry[1]
    if int(per_chunk.sum()) < len(size):
        if len(size) and not len(chunks):
            raise BrokenContainerError(stbl.start, "the places of the samples are missing")
        per_chunk[-1:] += len(size) - int(per_chunk.sum())
    if per_chunk.max(initial=0) > MAX_FRAMES:
        raise BrokenContainerError(stbl.start, f"{int(per_chunk.max())} samples in one chunk")
    chunk_of = np.repeat(np.arange(len(chunks)), np.minimum(per_chunk, len(size)))[: len(size)]
    start = np.concatenate([[0], np.cumsum(size)[:-1]]) if len(size) else np.zeros(0, dtype=np.int64)
    new = np.flatnonzero(np.diff(chunk_of, prepend=-1))
    base = np.repeat(start[new], np.diff(np.append(new, len(size)))) if len(new) else start
    return np.asarray(chunks[chunk_of] + start - base, dtype=np.int64)


def _edited(data: mmap.mmap, moov: Span, trak: Span, samples: Samples, time: Ints) -> Bools | None:
    """Which samples, in the order of time, the edit list shows; None for an edit list that cuts and joins."""
    elst = find_box(data, trak, b"edts", b"elst")
    if elst is None:
        return np.ones(len(time), dtype=np.bool_)
    entries = (
        read_table(data, elst, 5, ">i4")[:, [1, 3]] if data[elst.start] else read_table(data, elst, 3, ">i4")[:, [0, 1]]
    )
    played = entries[entries[:, 1] >= 0]
    if len(played) != 1:
        return np.ones(len(time), dtype=np.bool_) if not len(played) else None
    scale = ticks_per_second(data, need_box(data, moov, b"mvhd"))
    start = int(played[0, 1])
    length = int(played[0, 0]) * samples.scale / scale
    stop = start + length if length > 0 else np.inf
    return np.asarray((time >= start) & (time < stop), dtype=np.bool_)


def _ticks_to_ns(ticks: Ints, scale: int) -> Ints:
    whole, rest = np.divmod(ticks, scale)
    return np.asarray(whole * 1_000_000_000 + (rest * 1_000_000_000 + scale // 2) // scale, dtype=np.int64)


def _join(a: Samples, b: Samples) -> Samples:
    return Samples(a.scale, *(np.concatenate([x, y]) for x, y in zip(a[1:], b[1:], strict=True)))
