"""Frame list of an MP4 or QuickTime file: its boxes and sample tables (ISO/IEC 14496-12), with every length checked.

The samples of the video track are in tables of the index (moov), and in fragmented files in fragments (moof) after it.
"""

from __future__ import annotations

import math
import mmap
import struct
from collections.abc import Iterator
from contextlib import suppress
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Ints

from .container import (
    MAX_FRAMES,
    SHEARED,
    SLACK,
    SPHERE,
    STEREO,
    BrokenContainerError,
    ByteRange,
    Container,
    cut_short,
    mirror_of,
    unknown_frames,
    unpack,
)

LATEST = 2**62
"""Time [ticks, ns] or position [bytes] of a sample, at most."""
USUAL_SPEED = 1 << 16
SMALLEST_FRAME = 8
"""Bytes."""
NO_VIDEO = "it names no video track"
ONE = 1 << 16
"""1 in a display matrix."""


class VideoSampleTable(NamedTuple):
    """Samples (frames) of the video track in decoding order, in columns (n,).

    Attributes:
        scale: ticks per second.
        time: presentation time [ticks].
        duration: [ticks].
        offset: first byte in the file.
        size: [bytes].
    """

    scale: int
    time: Ints
    duration: Ints
    offset: Ints
    size: Ints


def boxes(data: mmap.mmap, start: int, stop: int) -> Iterator[ByteRange]:
    """Yield the boxes from byte `start` up to `stop`, as ranges of their content.

    Ranges may end beyond the end of the file.

    BrokenContainerError at a byte at which no box begins.
    """
    stop = min(stop, len(data))
    while start + 8 <= stop:
        size, kind = struct.unpack_from(">I4s", data, start)
        head = 8
        if size == 1:
            (size,) = unpack(data, ">Q", start + 8)
            head = 16
        elif size == 0:
            size = stop - start
        if size < head or not all(32 <= c < 127 or c == 0xA9 for c in kind):
            raise BrokenContainerError(start, f"no box begins there (size {size} bytes, name {box_name(kind)})")
        yield ByteRange(kind, start + head, start + size)
        start += size


def box_name(kind: bytes) -> str:
    """Name of a box as printable text."""
    return kind.decode("ascii", "backslashreplace")


def find_box(data: mmap.mmap, span: ByteRange, *path: bytes) -> ByteRange | None:
    """First box at a path of names inside the range `span`, outermost name first; None if missing."""
    for kind in path:
        found = next((b for b in boxes(data, span.start, span.stop) if b.kind == kind), None)
        if found is None:
            return None
        span = found
    return span


def need_box(data: mmap.mmap, span: ByteRange, *path: bytes) -> ByteRange:
    """First box at a path of names inside the range `span`, outermost name first; BrokenContainerError if missing."""
    found = find_box(data, span, *path)
    if found is None:
        raise BrokenContainerError(span.start, f"box {'/'.join(box_name(p) for p in path)} is missing")
    return found


def ticks_per_second(data: mmap.mmap, box: ByteRange) -> int:
    """Time scale (ticks per second) in a box mdhd or mvhd; BrokenContainerError if it is 0."""
    scale = unpack(data, ">I", box.start + (20 if data[box.start] else 12))[0]
    if scale < 1:
        raise BrokenContainerError(box.start, "a time scale of 0")
    return scale


def read_table(data: mmap.mmap, box: ByteRange | None, width: int, dtype: str, head: int = 4) -> Ints:
    """(n, width) numbers of a table box that begins with the number of its entries, as int64.

    Args:
        data: the file.
        box: content of the box; None: missing, the table is empty.
        width: numbers in each entry.
        dtype: of the numbers in the file.
        head: number of bytes before the count.

    Raises:
        BrokenContainerError: the table is longer than its box.
    """
    if box is None:
        return np.zeros((0, width), dtype=np.int64)
    (count,) = unpack(data, ">I", box.start + head)
    first = box.start + head + 4
    if first + count * width * np.dtype(dtype).itemsize > min(box.stop, len(data)):
        raise BrokenContainerError(box.start, f"table {box_name(box.kind)} of {count} entries is longer than its box")
    return np.frombuffer(data, dtype, count * width, first).astype(np.int64).reshape(count, width)


def read_fragments(
    data: mmap.mmap, moov: ByteRange, moofs: list[ByteRange], track_id: int, scale: int
) -> VideoSampleTable:
    """Samples of a track in the movie fragments of a file, in the order of the file.

    Args:
        data: the file.
        moov: box with the defaults of the samples.
        moofs: the movie fragments.
        track_id: number of the track.
        scale: ticks per second.

    Raises:
        BrokenContainerError: a fragment is damaged.
    """
    defaults = _track_defaults(data, moov, track_id)
    found = _Mp4Fragments()
    clock = 0
    for moof in (m for m in moofs if m.stop <= len(data)):
        for traf in (b for b in boxes(data, moof.start, moof.stop) if b.kind == b"traf"):
            tfhd = need_box(data, traf, b"tfhd")
            if unpack(data, ">I", tfhd.start + 4)[0] != track_id:
                continue
            clock = _fragment(data, moof, traf, tfhd, defaults, clock, found)
    return VideoSampleTable(scale, *np.concatenate([np.zeros((0, 4), dtype=np.int64), *found.samples]).T)


def most_samples(data: mmap.mmap) -> int:
    """Maximum number of samples that are accepted in a file of this size."""
    return min(MAX_FRAMES, len(data) // SMALLEST_FRAME)


class _Mp4Fragments:
    """Samples of fragments so far: arrays (n, 4) of time and duration [ticks], offset and size [bytes].

    Their total number.
    """

    def __init__(self) -> None:
        self.samples: list[Ints] = []
        self.count = 0


def _track_defaults(data: mmap.mmap, moov: ByteRange, track_id: int) -> tuple[int, int]:
    """Default duration [ticks] and size [bytes] of the samples of a track in fragments; 0, 0 if not stated.

    They are in a box `trex` inside the box `moov`. `track_id` is the number of the track.
    """
    mvex = find_box(data, moov, b"mvex")
    for trex in boxes(data, mvex.start, mvex.stop) if mvex is not None else ():
        if trex.kind == b"trex" and unpack(data, ">I", trex.start + 4)[0] == track_id:
            return unpack(data, ">II", trex.start + 12)  # type: ignore[return-value]
    return 0, 0


def _fragment(
    data: mmap.mmap,
    moof: ByteRange,
    traf: ByteRange,
    tfhd: ByteRange,
    defaults: tuple[int, int],
    clock: int,
    found: _Mp4Fragments,
) -> int:
    """Add the samples of one track fragment to `found`; return the time after it [ticks].

    Args:
        data: the file.
        moof: movie fragment.
        traf: track fragment in it.
        tfhd: header of the track fragment.
        defaults: duration [ticks] and size [bytes] of samples.
        clock: time before it [ticks].
        found: updated.
    """
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
        clock, base = _run(data, trun, (duration, size), clock, base, found)
    return clock


def _run(
    data: mmap.mmap,
    trun: ByteRange,
    defaults: tuple[int, int],
    clock: int,
    base: int,
    found: _Mp4Fragments,
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
    if at + 4 * len(fields) * count > trun.stop or found.count + count > most_samples(data):
        raise BrokenContainerError(trun.start, f"a fragment of {count} frames is longer than its box (trun)")
    if not (abs(clock) < LATEST and abs(offset) < LATEST):
        raise BrokenContainerError(trun.start, "frames of a fragment (trun) have a time or position beyond 2^62")
    values = np.frombuffer(data, ">i4", len(fields) * count, at).reshape(count, len(fields)).astype(np.int64)

    def column(field: int, default: int) -> Ints:
        return values[:, fields.index(field)] if field in fields else np.full(count, default, dtype=np.int64)

    duration, size = column(0x100, defaults[0]), column(0x200, defaults[1])
    after, behind = clock + np.cumsum(duration), offset + np.cumsum(size)
    found.samples.append(np.column_stack([after - duration + column(0x800, 0), duration, behind - size, size]))
    found.count += count
    return (int(after[-1]), int(behind[-1])) if count else (clock, offset)


_TOP = (b"ftyp", b"moov", b"mdat", b"free", b"skip", b"wide", b"styp", b"sidx", b"moof", b"pnot")


def recognised(data: mmap.mmap) -> bool:
    """Whether a file begins like an MP4 or QuickTime file."""
    return len(data) >= 8 and data[4:8] in _TOP


def parse(data: mmap.mmap) -> Container:
    """Frame list of an MP4 or QuickTime file, with its faults; damage does not raise."""
    problems: list[tuple[str, str]] = []
    top: list[ByteRange] = []
    try:
        for box in boxes(data, 0, len(data)):
            if box.kind in (b"ftyp", b"moov", b"moof"):
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
    problems += _further_films(data, top)
    try:
        return _container(data, moov, [b for b in top if b.kind == b"moof"], problems)
    except BrokenContainerError as bad:
        if bad.what == NO_VIDEO:
            return unknown_frames("mp4", *problems, ("moov", "it has no video track, as a file of sound"))
        return unknown_frames("mp4", *problems, (f"byte {bad.byte}", f"the index (box moov) is damaged: {bad.what}"))


def _further_films(data: mmap.mmap, top: list[ByteRange]) -> Iterator[tuple[str, str]]:
    """Yield a fault (position, description) if whole files with frames of their own follow the first one.

    So they do after `cat a.mp4 b.mp4`. An index that is repeated without samples, as in segments of a stream, is none.

    Args:
        data: the file.
        top: its boxes ftyp, moov and moof, in order.
    """
    starts: list[int] = []
    frames, begin = 0, None
    for box in top[[b.kind for b in top].index(b"moov") + 1 :]:
        if box.kind == b"ftyp":
            begin = box.start - 8
        elif box.kind == b"moov" and begin is not None:
            with suppress(BrokenContainerError):
                count = len(_sample_table(data, _video_track(data, box)[0], []).size)
                starts += [begin] * (count > 0)
                frames += count
            begin = None
    if starts:
        at = starts[0]
        files = f"{len(starts)} more videos" if len(starts) > 1 else "another video"
        yield (
            f"byte {at}",
            f"{files} of {frames} frames, which are not read, from there on; cut the file there (head -c {at}, tail -c "
            f"+{at + 1}), and join the parts: ffmpeg -f concat -i LIST -c copy OUT.mp4",
        )


def _container(data: mmap.mmap, moov: ByteRange, moofs: list[ByteRange], problems: list[tuple[str, str]]) -> Container:
    trak, track_id, display = _video_track(data, moov)
    samples = _sample_table(data, trak, problems)
    if moofs:
        samples = _join(samples, read_fragments(data, moov, moofs, track_id, samples.scale))
    order = np.argsort(samples.time, kind="stable")
    time = samples.time[order]
    broken = (samples.offset + samples.size)[order] > len(data)
    shown = _edited(data, moov, trak, samples, time)
    if shown is None:
        problems.append(
            (
                "edit list",
                "it repeats or reorders parts, leaves some out or changes the speed; times are the decoder's, "
                "not those of recording: give time stamps or a frame rate",
            )
        )
    if shown is None or not len(time):
        return unknown_frames("mp4", *problems)
    time, broken = time[shown], broken[shown]
    if len(time) and int(time[-1] - time[0]) > LATEST // NS * samples.scale:
        raise BrokenContainerError(moov.start, "times of frames beyond 2^62 ns")
    pts = _ticks_to_ns(time - time[0], samples.scale) if len(time) else time
    lasting = samples.duration[samples.duration > 0]
    step = int(np.median(lasting)) if len(lasting) else 0
    rate = Fraction(samples.scale, step).limit_denominator(1001) if step else None
    return Container("mp4", pts, broken, True, rate, tuple(problems), **display._asdict())


class _Display(NamedTuple):
    """What a track header states of the display of its pictures: fields of `Container`."""

    mirror: str = ""
    pixel: float = 1.0
    undone: str = ""
    tracks: int = 1


def _video_track(data: mmap.mmap, moov: ByteRange) -> tuple[ByteRange, int, _Display]:
    """First video track (box trak) in the box `moov`, its number, and how its pictures are to be displayed.

    BrokenContainerError if there is no video track.
    """
    found: list[tuple[ByteRange, ByteRange]] = []
    for trak in (b for b in boxes(data, moov.start, moov.stop) if b.kind == b"trak"):
        hdlr = find_box(data, trak, b"mdia", b"hdlr")
        if hdlr is not None and data[hdlr.start + 8 : hdlr.start + 12] == b"vide":
            stsz = find_box(data, trak, b"mdia", b"minf", b"stbl", b"stsz")
            if not found or (stsz is not None and unpack(data, ">I", stsz.start + 8)[0] > 1):  # no preview
                found.append((trak, need_box(data, trak, b"tkhd")))
    if not found:
        raise BrokenContainerError(moov.start, NO_VIDEO)
    trak, tkhd = found[0]
    version = data[tkhd.start]
    track_id = unpack(data, ">I", tkhd.start + (20 if version else 12))[0]
    display = _display(data, trak, tkhd.start + (52 if version else 40))
    return trak, track_id, display._replace(tracks=len(found))


def _display(data: mmap.mmap, trak: ByteRange, at: int) -> _Display:
    """Display of the pictures of the track `trak` by the matrix and the size at byte `at` of its header.

    ISO/IEC 14496-12 sec. 6.2.2 and 8.3.2. FFmpeg takes rotations from the matrix, and no scale.
    """
    a, b, u, c, d, v, _, _, _, width, height = unpack(data, ">9i2I", at)
    across, down = math.hypot(a, b) / ONE, math.hypot(c, d) / ONE
    if not across * down:
        return _Display()
    mirror = mirror_of(a, b, c, d)
    stsd = find_box(data, trak, b"mdia", b"minf", b"stbl", b"stsd")
    coded = (0, 0) if stsd is None or stsd.start + 44 > stsd.stop else unpack(data, ">2H", stsd.start + 40)
    pixel = across / down * (width * coded[1] / (height * coded[0]) if all((width, height, *coded)) else 1.0)
    if u or v or abs(a * c + b * d) > SLACK * across * down * ONE**2:
        return _Display(undone=SHEARED)
    described = b"" if stsd is None else data[stsd.start : min(stsd.stop, len(data))]
    if b"sv3d" in described:  # Google's spherical video
        return _Display(mirror, pixel, SPHERE)
    if (at := described.find(b"st3d")) >= 0 and any(described[at + 8 : at + 9]):
        return _Display(mirror, pixel, STEREO)
    is_scaled = abs(across / down - 1.0) < SLACK < abs(across - 1.0)
    return _Display(mirror, pixel, f"scaled by {across:.3g}" if is_scaled else "")


def _sample_table(data: mmap.mmap, trak: ByteRange, problems: list[tuple[str, str]]) -> VideoSampleTable:
    scale = ticks_per_second(data, need_box(data, trak, b"mdia", b"mdhd"))
    stbl = need_box(data, trak, b"mdia", b"minf", b"stbl")
    size = _sizes(data, need_box(data, stbl, b"stsz"))
    n = len(size)
    lasting = read_table(data, find_box(data, stbl, b"stts"), 2, ">i4")
    timed = int(np.maximum(lasting[:, 0], 0).sum())
    if timed < n:
        problems.append((f"byte {stbl.start}", f"the table of times (stts) has those of {timed} of {n} samples"))
    duration = _runs(lasting, n)
    shift = _runs(read_table(data, find_box(data, stbl, b"ctts"), 2, ">i4"), n)
    time = np.concatenate([[0], np.cumsum(duration)[:-1]]).astype(np.int64) + shift if n else shift
    return VideoSampleTable(scale, time, duration, _offsets(data, stbl, size), size)


def _sizes(data: mmap.mmap, stsz: ByteRange) -> Ints:
    uniform, count = unpack(data, ">II", stsz.start + 4)
    if uniform:
        if count > most_samples(data):
            raise BrokenContainerError(stsz.start, f"{count} samples announced")
        return np.full(count, uniform, dtype=np.int64)
    return read_table(data, stsz, 1, ">u4", head=8)[:, 0]


def _runs(table: Ints, n: int) -> Ints:
    """Expand a run-length table (m, 2) of counts and values to n samples; 0 beyond its end."""
    out = np.zeros(n, dtype=np.int64)
    at = 0
    for count, value in table.tolist():
        out[at : at + max(count, 0)] = value
        at += max(count, 0)
        if at >= n:
            break
    return out


def _offsets(data: mmap.mmap, stbl: ByteRange, size: Ints) -> Ints:
    """(n,) first byte of every sample in the file.

    Args:
        data: the file.
        stbl: box with the sample tables.
        size: (n,) sizes of the samples [bytes].

    Raises:
        BrokenContainerError: the tables contradict each other.
    """
    chunks = read_table(data, find_box(data, stbl, b"stco"), 1, ">u4")[:, 0]
    if not len(chunks):
        chunks = read_table(data, find_box(data, stbl, b"co64"), 1, ">u8")[:, 0]
    stsc = read_table(data, find_box(data, stbl, b"stsc"), 3, ">u4")
    runs = np.diff(np.append(stsc[:, 0] - 1, len(chunks)))
    if len(stsc) and (stsc[0, 0] != 1 or (runs <= 0).any()):
        raise BrokenContainerError(
            stbl.start, "the table stsc is damaged: its numbers of chunks do not increase from 1"
        )
    per_chunk = np.repeat(stsc[:, 1], runs) if len(stsc) else np.zeros(len(chunks), dtype=np.int64)
    if int(per_chunk.sum()) < len(size):
        if len(size) and not len(chunks):
            raise BrokenContainerError(stbl.start, "the positions of the frames in the file are missing (stco, co64)")
        per_chunk[-1:] += len(size) - int(per_chunk.sum())
    if per_chunk.max(initial=0) > MAX_FRAMES:
        raise BrokenContainerError(stbl.start, f"{int(per_chunk.max())} frames in one chunk (stsc), limit {MAX_FRAMES}")
    chunk_of = np.repeat(np.arange(len(chunks)), np.minimum(per_chunk, len(size)))[: len(size)]
    start = np.concatenate([[0], np.cumsum(size)[:-1]]) if len(size) else np.zeros(0, dtype=np.int64)
    new = np.flatnonzero(np.diff(chunk_of, prepend=-1))
    base = np.repeat(start[new], np.diff(np.append(new, len(size)))) if len(new) else start
    return np.asarray(chunks[chunk_of] + start - base, dtype=np.int64)


def _edited(data: mmap.mmap, moov: ByteRange, trak: ByteRange, samples: VideoSampleTable, time: Ints) -> Bools | None:
    """(n,) mask of the samples that the edit list shows; all True without one.

    None if the list repeats, reorders or omits parts or changes the speed, so that times are not those of recording.

    Args:
        data: the file.
        moov: box with the time scale of the edit list.
        trak: box of the track.
        samples: of the track.
        time: (n,) increasing times of the samples [ticks].
    """
    elst = find_box(data, trak, b"edts", b"elst")
    if elst is None:
        return np.ones(len(time), dtype=np.bool_)
    if data[elst.start]:  # 64 bits of length and of time, in two words each
        words = read_table(data, elst, 5, ">i4")
        entries = words[:, [0, 2]] * 2**32 + (words[:, [1, 3]] & 0xFFFFFFFF)
    else:
        words = read_table(data, elst, 3, ">i4")
        entries = words[:, [0, 1]]
        entries[:, 0] &= 0xFFFFFFFF
    is_played = entries[:, 1] >= 0
    if not is_played.any():
        return np.ones(len(time), dtype=np.bool_)
    # A pause before the first part shifts all frames; the part behind it must go on where it ends
    first = int(is_played.argmax())
    ticks = samples.scale / ticks_per_second(data, need_box(data, moov, b"mvhd"))
    lengths, starts = (entries[first:, k].astype(np.float64) for k in (0, 1))
    goes_on = np.abs(starts[:-1] + lengths[:-1] * ticks - starts[1:]) <= max(ticks, 1.0)
    if not goes_on.all() or (words[first:, -1] != USUAL_SPEED).any():
        return None
    length = float(lengths.sum()) * ticks
    stop = starts[0] + length if length > 0 else np.inf
    return np.asarray((time >= starts[0]) & (time < stop), dtype=np.bool_)


def _ticks_to_ns(ticks: Ints, scale: int) -> Ints:
    whole, rest = np.divmod(ticks, scale)
    return np.asarray(whole * 1_000_000_000 + (rest * 1_000_000_000 + scale // 2) // scale, dtype=np.int64)


def _join(a: VideoSampleTable, b: VideoSampleTable) -> VideoSampleTable:
    return VideoSampleTable(a.scale, *(np.concatenate([x, y]) for x, y in zip(a[1:], b[1:], strict=True)))
