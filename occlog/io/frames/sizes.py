"""The size of each frame as its compressed data states it.

OpenCV scales every frame to the size of the first one and says nothing.  So where the
codec's data tell the size (motion JPEG, PNG, VP8, H.264), it is read from them.
"""

from __future__ import annotations

from bisect import bisect_right
from pathlib import Path

import cv2

from ..files.names.utf8 import utf8_name
from .codec import image_size

Size = tuple[int, int]
Changes = list[tuple[float, Size]]
"""(time after the start of the file [ns], size from then on)."""

START_CODE = b"\x00\x00\x01"
MAX_SEARCH = 4096
"""Bytes of a packet that are searched for the sequence parameters of H.264, which come first."""


def size_changes(path: Path) -> Changes:
    """Where the size of the frames changes, the first size included; empty where the codec is another."""
    with utf8_name(path.resolve()) as name:
        capture = cv2.VideoCapture(name, cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1, cv2.CAP_PROP_N_THREADS, 1])
    changes: Changes = []
    try:
        while capture.grab():
            ok, packet = capture.retrieve()
            size = packet_size(packet.tobytes()) if ok and packet is not None and packet.size else None
            if size is not None and (not changes or changes[-1][1] != size):
                changes.append((capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6, size))
    finally:
        capture.release()
    return sorted(changes)


def size_at(changes: Changes, pos_ns: float) -> Size | None:
    """Size of the frame at a time; None if it is not known."""
    k = bisect_right([at for at, _ in changes], pos_ns + 1e3) - 1
    return changes[k][1] if k >= 0 else None


def packet_size(data: bytes) -> Size | None:
    """Width and height that a packet of compressed video states, None if it does not."""
    if data[:2] == b"\xff\xd8" or data[:4] == b"\x89PNG":
        return image_size(data)
    # A key frame of VP8: RFC 6386 sec. 9.1.
    if len(data) >= 10 and data[3:6] == b"\x9d\x01\x2a" and not data[0] & 1:
        width, height = (int.from_bytes(data[k : k + 2], "little") & 0x3FFF for k in (6, 8))
        return width, height
    if data[:3] == START_CODE or data[:4] == b"\0" + START_CODE:
        return _h264_size(data)
    return None


def _h264_size(data: bytes) -> Size | None:
    """Size in the first sequence parameter set of an Annex B packet."""
    at = data.find(START_CODE, 0, MAX_SEARCH)
    # Packets of MPEG-1, 2 and 4 begin with other codes, and later ones of theirs (slice 7) look like parameters
    if not b"\0" < data[at + 3 : at + 4] < b"\x80":
        return None
    while at >= 0 and at + 4 < len(data):
        if data[at + 3] & 0x9F == 7:
            stop = data.find(START_CODE, at + 3)
            content = data[at + 4 : stop if stop >= 0 else len(data)]
            try:
                return _parameters(_Bits(content.replace(b"\0\0\3", b"\0\0")))
            except IndexError:
                return None
        at = data.find(START_CODE, at + 3, MAX_SEARCH)
    return None


class _Bits:
    """Reads bits and Exp-Golomb codes from the left; IndexError at the end."""

    def __init__(self, data: bytes) -> None:
        self._value, self._left = int.from_bytes(data, "big"), 8 * len(data)

    def u(self, n: int) -> int:
        """The next n bits as a whole number."""
        self._left -= n
        if self._left < 0:
            raise IndexError
        return self._value >> self._left & ((1 << n) - 1)

    def ue(self) -> int:
        """An unsigned Exp-Golomb code (ITU-T H.264 sec. 9.1)."""
        zeros = 0
        while not self.u(1):
            zeros += 1
        return (1 << zeros) - 1 + self.u(zeros)

    def se(self) -> int:
        """A signed Exp-Golomb code."""
        k = self.ue()
        return (k + 1) // 2 if k & 1 else -k // 2


_HIGH_PROFILES = (100, 110, 122, 244, 44, 83, 86, 118, 128, 138, 139, 134, 135)


def _parameters(bits: _Bits) -> Size:
    """Size of a sequence parameter set, ITU-T H.264 sec. 7.3.2.1.1."""
    profile = bits.u(8)
    bits.u(16)
    bits.ue()
    chroma = _high_profile(bits) if profile in _HIGH_PROFILES else 1
    bits.ue()
    order = bits.ue()
    if order == 0:
        bits.ue()
    elif order == 1:
        bits.u(1), bits.se(), bits.se()
        for _ in range(min(bits.ue(), 255)):
            bits.se()
    bits.ue(), bits.u(1)
    width, height = 16 * (bits.ue() + 1), 16 * (bits.ue() + 1)
    frames_only = bits.u(1)
    height *= 2 - frames_only
    if not frames_only:
        bits.u(1)
    bits.u(1)
    if not bits.u(1):
        return width, height
    across = 2 if chroma in (1, 2) else 1
    down = (2 if chroma == 1 else 1) * (2 - frames_only)
    left, right, top, bottom = (bits.ue() for _ in range(4))
    return width - across * (left + right), height - down * (top + bottom)


def _high_profile(bits: _Bits) -> int:
    """Chroma format, and past the parts that only high profiles have."""
    chroma = bits.ue()
    if chroma == 3:
        bits.u(1)
    bits.ue(), bits.ue(), bits.u(1)
    if bits.u(1):
        for n in range(8 if chroma != 3 else 12):
            if bits.u(1):
                _scaling_list(bits, 16 if n < 6 else 64)
    return chroma


def _scaling_list(bits: _Bits, n: int) -> None:
    last = following = 8
    for _ in range(n):
        if following:
            following = (last + bits.se()) % 256
        last = following or last
