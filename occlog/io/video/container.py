"""Frame list of a video container, read without a decoder.

OpenCV never reports that a video was cut or damaged, and its frame count is an estimate for some containers. The
parsers `mp4`, `avi` and `mkv` read the container's tables, so that lost frames are counted and the others keep their
numbers. This module has what they share: the result, checked reading, and common faults.
"""

from __future__ import annotations

import mmap
import struct
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from occlog.array_types import Bools, Ints

MAX_FRAMES = 10_000_000
"""A container that announces more frames than it holds is accepted up to this number."""

MAX_FAULTS = 20
"""Faults reported one by one; the others are counted."""

RELEASE_BYTES = 4 * 2**20


MIRRORS: dict[tuple[int, ...], str] = {
    (-1, 0, 0, 1): "left to right",
    (1, 0, 0, -1): "top to bottom",
    (0, 1, 1, 0): "along the diagonal from top left",
    (0, -1, -1, 0): "along the diagonal from top right",
}
"""Mirrors by the signs of a, b, c, d of a display matrix: x' = a x + c y, y' = b x + d y."""
OTHER_MIRROR, SHEARED, STEREO, SPHERE = "at another angle", "sheared", "split into two views", "unrolled from a sphere"
SLACK = 0.02
"""Relative difference from a display that scales, shears or stretches: coded sizes are multiples of 16, cut to 1080."""


def mirror_of(a: float, b: float, c: float, d: float) -> str:
    """How a display matrix x' = a x + c y, y' = b x + d y mirrors pictures: one of `MIRRORS` or `OTHER_MIRROR`.

    Empty if it does not.
    """
    signs = tuple((each > 0) - (each < 0) for each in (a, b, c, d))
    return MIRRORS.get(signs, OTHER_MIRROR) if a * d < b * c else ""


@dataclass(frozen=True, eq=False)
class Container:
    """Frame list of a video container, read without a decoder.

    Attributes:
        kind: `mp4`, `avi` or `matroska`.
        pts_ns: (n,) presentation times of all frames [ns], from 0 and increasing; None: they are not known.
        broken: (n,) mask of frames with bytes that are not, or not all, in the file.
        stamped: the times are time stamps, not frame numbers divided by a frame rate.
        rate: frames per second as stated, None if not.
        problems: (position, description) of every fault found.
        packets: AVI only: frame number of each readable packet in order, -1 for an empty one.
        first_packet: AVI only: number from which the decoder counts packets.
        steps: AVI only: (n,) number of frame intervals from the first packet to each frame; None: k for frame k.
        first_ns: time in `pts_ns` of the first frame that is still in the file.
        origin_ns: Matroska only: time stamp of frame 0 in the file.
        first_key: Matroska only: number of the first key frame, at which decoding begins.
        largest: AVI only: size of the largest frame [bytes] by the header, and in the file.
        mirror: how the metadata ask players to mirror the pictures: a value of `MIRRORS`, or `OTHER_MIRROR`; empty:
            not.
        pixel: MP4 only: width of a coded pixel as displayed, relative to its height, by the header of the track.
        undone: what else the metadata ask of the display, which no decoder does: `SHEARED`, scaled, or `STEREO`; empty:
            nothing.
        tracks: number of video tracks, of which the first is read.
    """

    kind: str
    pts_ns: Ints | None
    broken: Bools
    stamped: bool
    rate: Fraction | None
    problems: tuple[tuple[str, str], ...] = ()
    packets: Ints | None = None
    first_packet: int = 0
    steps: Ints | None = None
    first_ns: int = 0
    origin_ns: int = 0
    first_key: int = 0
    largest: tuple[int, int] | None = None
    mirror: str = ""
    pixel: float = 1.0
    undone: str = ""
    tracks: int = 1

    @property
    def frames(self) -> int | None:
        """Number of frames listed; None if unknown."""
        return None if self.pts_ns is None else len(self.pts_ns)


class Faults:
    """List of faults (position, description) of bounded length; after the first `MAX_FAULTS` they are only counted."""

    def __init__(self) -> None:
        self._reported: list[tuple[str, str]] = []
        self._more: list[str] = []  # positions of the first and the last of the others
        self._count = 0

    def append(self, fault: tuple[str, str]) -> None:
        """Add a fault (position, description), or count it if there are `MAX_FAULTS` already."""
        if len(self._reported) < MAX_FAULTS:
            self._reported.append(fault)
            return
        self._more[1:] = [fault[0]]
        self._count += 1

    def __bool__(self) -> bool:
        """Whether any fault was added."""
        return bool(self._reported)

    def __iter__(self) -> Iterator[tuple[str, str]]:
        """Yield the first faults, and one entry that counts the others."""
        yield from self._reported
        if self._more:
            yield f"{self._more[0]} to {self._more[-1]}", f"damaged in {self._count} more positions"


class BrokenContainerError(ValueError):
    """A container cannot be parsed beyond a byte (`byte`), for the reason `what`."""

    def __init__(self, byte: int, what: str) -> None:
        super().__init__(f"byte {byte}: {what}")
        self.byte, self.what = byte, what


@dataclass(frozen=True, slots=True)
class ByteRange:
    """Part of a file: its name `kind`, and bytes start <= n < stop; `stop` may be beyond the end of the file."""

    kind: bytes
    start: int
    stop: int


def let_go(data: mmap.mmap, upto: int, done: int) -> int:
    """Release the mapped memory of the part of a file that was read; return the byte up to which it is released.

    Pages of a mapped file count as the process's memory while they are mapped. Nothing is done before another
    `RELEASE_BYTES` were read.

    Args:
        data: the mapped file.
        upto: byte up to which it was read.
        done: result of the last call, 0 at first.
    """
    if upto - done < RELEASE_BYTES:
        return done
    with suppress(AttributeError, ValueError, OSError):
        data.madvise(mmap.MADV_DONTNEED, 0, upto // mmap.PAGESIZE * mmap.PAGESIZE)
    return upto


def unknown_frames(kind: str, *problems: tuple[str, str]) -> Container:
    """A `Container` without a frame list, which could not be read.

    `problems` are its faults (position, description).
    """
    return Container(kind, None, np.zeros(0, dtype=np.bool_), False, None, problems)


def unpack(data: mmap.mmap, layout: str, byte: int) -> tuple[int, ...]:
    """Numbers at a byte of a file, in a `struct` layout; BrokenContainerError if the file ends before."""
    try:
        return struct.unpack_from(layout, data, byte)
    except struct.error:
        raise BrokenContainerError(byte, "the file ends here") from None


def cut_short(size: int, wanted: int, part: str) -> tuple[str, str]:
    """Fault (position, description) of a file of `size` bytes that ends before byte `wanted`, the end of its `part`."""
    return (
        f"byte {size}",
        f"the file ends {wanted - size} bytes before the end of its {part} (it was cut, or its recorder was stopped)",
    )
