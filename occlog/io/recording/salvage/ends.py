"""End marks of a recording: where they may stand, and where the recording ends behind them.

A flipped bit makes an end mark of a chunk (6 becomes 2), or of an index of messages (7 becomes 15), and files that were
put one behind another have several.  So a mark counts by its length and by what follows it.
"""

from __future__ import annotations

import re
import struct
import zlib
from typing import IO

from mcap.opcode import Opcode

from occlog.io.files.untrusted.content import RECORDING_MAGIC
from occlog.io.recording.chunks import MAX_CHUNK_BYTES
from occlog.io.recording.layout import HEAD

END_BYTES: dict[int, int] = {Opcode.DATA_END: 4, Opcode.FOOTER: 20}
"""Length of each end mark, without code and length."""
FOOTER_BYTES = HEAD.size + END_BYTES[Opcode.FOOTER]
INDEX = frozenset(
    (
        Opcode.SCHEMA,
        Opcode.CHANNEL,
        Opcode.STATISTICS,
        Opcode.CHUNK_INDEX,
        Opcode.ATTACHMENT_INDEX,
        Opcode.METADATA_INDEX,
        Opcode.SUMMARY_OFFSET,
    )
)
"""Kinds of records between the end of the data and the footer."""
PRIVATE = 0x80
"""From this kind on records belong to programs, and others pass over them."""
BEGIN = RECORDING_MAGIC + bytes([Opcode.HEADER])
"""A recording begins so."""
_FOOTER_HEAD = HEAD.pack(Opcode.FOOTER, END_BYTES[Opcode.FOOTER])
_FOOTER_OR_BEGIN = re.compile(re.escape(_FOOTER_HEAD) + b"|" + re.escape(BEGIN))
_FOOTER = struct.Struct("<QQI")


def is_end_mark(code: int, length: int) -> bool:
    """Whether a record of this kind and length is an end mark."""
    return END_BYTES.get(code) == length


def behind_end(file: IO[bytes], at: int, size: int) -> int | None:
    """The byte behind a recording whose data end with the end mark at byte `at`.

    Args:
        file: an MCAP file.
        at: where an end mark of the right length begins.
        size: length of the file.

    Returns:
        `size` too where the file is cut in the index; None: what follows is no index, so that the mark is none, or the
        index is damaged.
    """
    while at < size:
        file.seek(at)
        head = file.read(HEAD.size)
        if len(head) < HEAD.size:
            return size
        code, length = HEAD.unpack(head)
        if not (code in INDEX or code >= PRIVATE or is_end_mark(code, length)):
            return None
        at += HEAD.size + length
        if code == Opcode.FOOTER:
            file.seek(at)
            closing = file.read(len(RECORDING_MAGIC))
            cut = at + len(closing) >= size and RECORDING_MAGIC.startswith(closing)
            return at + len(closing) if closing == RECORDING_MAGIC or cut else None
    return size


def index_of(file: IO[bytes], begin: int, size: int) -> tuple[int, bytes] | None:
    """The first index from byte `begin` on whose footer says that it belongs to a recording that begins there.

    Places in an index count from the beginning of its recording, so that of a recording behind another one the index
    has a right check sum only if it is looked for there.

    Args:
        file: an MCAP file.
        begin: where a recording begins.
        size: length of the file.

    Returns:
        Where the index begins in the file, and its records; None: there is none that is whole.
    """
    places = [size - FOOTER_BYTES - len(RECORDING_MAGIC)] if begin == 0 else []
    at: int | None = begin + len(RECORDING_MAGIC)
    while at is not None and (at := _find(file, _FOOTER_OR_BEGIN, at, size)) is not None:
        file.seek(at)
        if file.read(len(BEGIN)) == BEGIN:
            break
        places.append(at)
        at += 1
    for place in places:
        found = _index_before(file, begin, place)
        if found is not None:
            return found
    return None


def _index_before(file: IO[bytes], begin: int, at: int) -> tuple[int, bytes] | None:
    """The index of a recording before the footer at byte `at`; None: it is damaged, or there is no footer."""
    file.seek(max(at, 0))
    footer = file.read(FOOTER_BYTES + len(RECORDING_MAGIC))
    if not (footer.startswith(_FOOTER_HEAD) and footer[FOOTER_BYTES:] == RECORDING_MAGIC):
        return None
    told, _, crc = _FOOTER.unpack(footer[HEAD.size : FOOTER_BYTES])
    start = begin + told
    if not begin < start < at <= start + MAX_CHUNK_BYTES:
        return None
    file.seek(start)
    records = file.read(at - start)
    # The check sum is of the footer too, up to itself
    right = zlib.crc32(footer[: FOOTER_BYTES - 4], zlib.crc32(records)) == crc if crc else are_records(records)
    return (start, records) if right else None


def are_records(data: bytes) -> bool:
    """Whether these are whole records of an index, one behind another."""
    at = 0
    while at + HEAD.size <= len(data):
        code, length = HEAD.unpack_from(data, at)
        if not (code in INDEX or code >= PRIVATE):
            return False
        at += HEAD.size + length
    return at == len(data)


def _find(file: IO[bytes], marks: re.Pattern[bytes], at: int, size: int) -> int | None:
    """Where a mark stands for the first time from a byte on."""
    block = 1 << 20
    while at < size:
        file.seek(at)
        found = marks.search(file.read(block + len(BEGIN) - 1))
        if found is not None:
            return at + found.start()
        at += block
    return None
