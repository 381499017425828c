"""What a cut LZ4 frame holds of the block in which it was cut, which the library gives whole or not at all.

A block is a list of sequences: literal bytes, and then a match, which repeats what came before.  They are unpacked in
their order, so all before the cut can be (LZ4 block format, sections "Compressed block format" and "End of block").
"""

from __future__ import annotations

import struct

_MAGIC = 0x184D2204
_PLAIN = 1 << 31
"""Bit of a block's size that says that its bytes are not packed."""
_LENGTH = struct.Struct("<I")
_OFFSET = struct.Struct("<H")
_HEAD = 7
"""Bytes of the shortest head of a frame: mark, flags, size of blocks, check sum."""
_SHORTEST_MATCH = 4
_LONG = 15
"""A length of this or more goes on in the bytes that follow."""


def rest_of_block(frame: bytes, whole: bytes, most: int) -> bytes:
    """The unpacked bytes that follow those of a cut frame's whole blocks.

    Args:
        frame: an LZ4 frame, as far as it is there.
        whole: what its whole blocks unpack to, and plain bytes of the block with the cut.
        most: how many bytes `whole` and the rest may be together.
    """
    block = _cut_block(frame)
    return _sequences(block, whole, most - len(whole)) if block is not None else b""


def _cut_block(frame: bytes) -> bytes | None:
    """Packed bytes of the last block, if the frame ends within it; None where they are plain, or the frame is whole."""
    if len(frame) < _HEAD or _LENGTH.unpack_from(frame)[0] != _MAGIC:
        return None
    flags = frame[4]
    at = _HEAD + (8 if flags & 0x08 else 0) + (4 if flags & 0x01 else 0)
    sum_bytes = 4 if flags & 0x10 else 0
    while at + _LENGTH.size <= len(frame):
        (told,) = _LENGTH.unpack_from(frame, at)
        begin, size = at + _LENGTH.size, told & ~_PLAIN
        if not size:
            return None
        if begin + size + sum_bytes > len(frame):
            return None if told & _PLAIN else frame[begin : begin + size]
        at = begin + size + sum_bytes
    return None


def _sequences(block: bytes, before: bytes, most: int) -> bytes:
    """Unpack sequences up to the end of the bytes that are there, or to the first that cannot be."""
    out, skipped, at = bytearray(before[-65_535:]), len(before[-65_535:]), 0
    while at < len(block) and len(out) - skipped < most:
        token = block[at]
        literals, at = _length(block, at + 1, token >> 4)
        out += block[at : at + literals]
        at += literals
        if at + _OFFSET.size > len(block):
            break
        (offset,) = _OFFSET.unpack_from(block, at)
        if not 0 < offset <= len(out):
            break
        match, at = _length(block, at + _OFFSET.size, token & _LONG)
        match = min(match + _SHORTEST_MATCH, most - (len(out) - skipped))
        part = bytes(out[-offset:])
        out += (part * (match // offset + 1))[: max(match, 0)]
    return bytes(out[skipped : skipped + max(most, 0)])


def _length(block: bytes, at: int, length: int) -> tuple[int, int]:
    """A length that begins with this number, and the place after it; what is there of it where it is cut."""
    if length < _LONG:
        return length, at
    while at < len(block):
        more = block[at]
        length, at = length + more, at + 1
        if more < 255:
            break
    return length, at
