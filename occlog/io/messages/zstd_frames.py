"""Data that zstd packed in several frames, or behind frames to skip: the library unpacks the first one alone."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import zstandard

from occlog.io.files.untrusted.content import is_skipped_zstd

_SKIPPED = struct.Struct("<II")
_HEAD = 18
"""Bytes of the head of a frame at most."""
_SUM = 4
_REPEATED = 1
"""Kind of a block that is one byte, repeated."""


def unpack_frames(data: bytes, most: int) -> bytes:
    """What all frames unpack to; zstandard.ZstdError where they are damaged, or come to more than so many bytes."""
    parts, left = list[bytes](), most
    for frame in _frames(data):
        told = zstandard.frame_content_size(frame)  # -1: whoever packed it did not know
        if told > left or left == 0:
            raise zstandard.ZstdError(f"it would unpack to {most - left + max(told, 1)} bytes (limit {most})")
        parts.append(
            zstandard.ZstdDecompressor().decompress(frame, max_output_size=left, allow_extra_data=False)
            if told
            else b""
        )
        left -= len(parts[-1])
    return b"".join(parts)


def _frames(data: bytes) -> Iterator[bytes]:
    """The frames that hold something, one after the other."""
    at = 0
    while at < len(data):
        begin = at
        try:
            if is_skipped_zstd(data[at : at + 4]):
                at += _SKIPPED.size + _SKIPPED.unpack_from(data, at)[1]
                continue
            head = data[at : at + _HEAD]
            at += zstandard.frame_header_size(head)
            last = 0
            while not last:
                block = int.from_bytes(struct.unpack_from("3s", data, at)[0], "little")
                last, kind, size = block & 1, block >> 1 & 3, block >> 3
                at += 3 + (1 if kind == _REPEATED else size)
            at += _SUM * zstandard.get_frame_parameters(head).has_checksum
        except struct.error:
            at = len(data) + 1
        if at > len(data):
            raise zstandard.ZstdError(f"the frame at byte {begin} is cut off")
        yield data[begin:at]
