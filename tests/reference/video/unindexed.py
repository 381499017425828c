"""Recordings as of a writer that makes no index."""

from __future__ import annotations

import struct

from occlog.io.files.limits import RECORDING_MAGIC


def unindexed(data: bytes) -> bytes:
    """The same data, with a footer that tells of no index."""
    (begin,) = struct.unpack_from("<Q", data, len(data) - len(RECORDING_MAGIC) - 20)
    return data[:begin] + struct.pack("<BQQQI", 2, 20, 0, 0, 0) + RECORDING_MAGIC
