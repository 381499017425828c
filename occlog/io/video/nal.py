"""Headers of H.264 and H.265 streams (Annex B): NAL units, their bits, and the sequence parameters of H.264.

Sources: ITU-T H.264 sec. 7.3.2.1.1 and 9.1, ITU-T H.265 sec. 9.2.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

HEAD_BYTES = 256
"""Bytes of a unit that hold its headers."""
SEQUENCE_PARAMETERS = 7
"""Type of the NAL units of H.264 with sequence parameters."""
_START = re.compile(rb"\x00\x00\x01")
_WITH_CHROMA = (44, 83, 86, 100, 110, 118, 122, 128, 134, 135, 138, 139, 244)
"""Profiles of H.264 that state their chroma format."""


class HeaderBits:
    """Reader of the first bits of a NAL unit, without emulation prevention bytes; IndexError at their end."""

    def __init__(self, unit: bytes) -> None:
        """Start at the first bit of `unit`, a NAL unit without its header."""
        data = unit[:HEAD_BYTES].replace(b"\0\0\3", b"\0\0")
        self._value, self._left = int.from_bytes(data, "big"), 8 * len(data)

    def number(self, bits: int) -> int:
        """Read an unsigned number of `bits` bits; IndexError at the end of the data."""
        if bits > self._left:
            raise IndexError
        self._left -= bits
        return self._value >> self._left & ((1 << bits) - 1)

    def golomb(self) -> int:
        """Read an unsigned Exp-Golomb code; IndexError at the end of the data."""
        zeros = 0
        while not self.number(1):
            zeros += 1
            if zeros > 32:
                raise IndexError
        return (1 << zeros) - 1 + self.number(zeros)


class SequenceParameters(NamedTuple):
    """Sequence parameters of H.264.

    Attributes:
        size: width and height of the pictures [px], cropped.
        number_bits: bits of `frame_num`.
        planes: the three colours are coded apart.
        fields: pictures may be interlaced.
    """

    size: tuple[int, int]
    number_bits: int
    planes: bool
    fields: bool


def units(data: bytes) -> Iterator[bytes]:
    """Yield the NAL units of an Annex B stream (bytes), without their start codes."""
    begins = [match.end() for match in _START.finditer(data)]
    for begin, end in zip(begins, [*(at - 3 for at in begins[1:]), len(data)], strict=False):
        if begin < end:
            yield data[begin:end]


def sequence_parameters(unit: bytes) -> SequenceParameters:
    """Parse a NAL unit of H.264 of type `SEQUENCE_PARAMETERS`; IndexError if it ends early."""
    bits = HeaderBits(unit[1:])
    profile = bits.number(8)
    bits.number(16)
    bits.golomb()
    chroma, planes = 1, False
    if profile in _WITH_CHROMA:
        chroma = bits.golomb()
        planes = chroma == 3 and bool(bits.number(1))
        bits.golomb()
        bits.golomb()
        bits.number(1)
        if bits.number(1):
            for n in range(12 if chroma == 3 else 8):
                if bits.number(1):
                    _skip_scaling(bits, 16 if n < 6 else 64)
    number_bits = bits.golomb() + 4
    order = bits.golomb()
    if order == 0:
        bits.golomb()
    elif order == 1:
        bits.number(1)
        for _ in range(2):
            bits.golomb()
        for _ in range(min(bits.golomb(), 255)):
            bits.golomb()
    bits.golomb()
    bits.number(1)
    width, height = 16 * (bits.golomb() + 1), 16 * (bits.golomb() + 1)
    frames_only = bits.number(1)
    if not frames_only:
        bits.number(1)
    bits.number(1)
    size = cropped(bits, width, height * (2 - frames_only), chroma, 2 - frames_only)
    return SequenceParameters(size, number_bits, planes, not frames_only)


def cropped(bits: HeaderBits, width: int, height: int, chroma: int, fields: int = 1) -> tuple[int, int]:
    """Read the cropping window of a picture, and return width and height within it [px].

    Args:
        bits: at the flag of the window.
        width: width before cropping [px].
        height: height before cropping [px].
        chroma: `chroma_format_idc`.
        fields: fields of a picture: 2 if it may be interlaced, else 1.
    """
    crop = [bits.golomb() for _ in range(4)] if bits.number(1) else [0] * 4
    across, down = (2 if chroma in (1, 2) else 1), (2 if chroma == 1 else 1) * fields
    return width - across * (crop[0] + crop[1]), height - down * (crop[2] + crop[3])


def _skip_scaling(bits: HeaderBits, size: int) -> None:
    last = following = 8
    for _ in range(size):
        if following:
            code = bits.golomb()
            following = (last + (code + 1 >> 1 if code & 1 else -(code >> 1)) + 256) % 256
        last = following or last
