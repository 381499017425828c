"""End marks of a recording, and determination of where a recording ends.

A flipped bit turns a chunk (code 6) or a message index (7) into an end mark (2 or 15), and concatenated files have
several marks. So a mark is accepted by its length and by the data after it. `SalvagedRecording` is one of the
concatenated recordings; schema and channel numbers, index and metadata apply to it only.
"""

from __future__ import annotations

import re
import struct
import zlib
from bisect import bisect_right
from typing import IO

from mcap import records
from mcap.opcode import Opcode

from occlog.io.files.limits import RECORDING_MAGIC
from occlog.io.recording.chunks import HEAD, MAX_CHUNK_BYTES

from .gaps import ChannelTally, Damage

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
"""First opcode of private MCAP records, which other programs skip."""
BEGIN = RECORDING_MAGIC + bytes([Opcode.HEADER])
"""A recording begins so."""
_FOOTER_HEAD = HEAD.pack(Opcode.FOOTER, END_BYTES[Opcode.FOOTER])
_FOOTER_OR_BEGIN = re.compile(re.escape(_FOOTER_HEAD) + b"|" + re.escape(BEGIN))
_FOOTER = struct.Struct("<QQI")


def is_end_mark(code: int, length: int) -> bool:
    """Whether an opcode and a length [bytes] are those of a DATA_END or FOOTER record."""
    return END_BYTES.get(code) == length


def byte_after_end(file: IO[bytes], at: int, size: int) -> int | None:
    """First byte after an MCAP recording, of which an end mark begins at byte `at`.

    Only records of an index and a footer may follow the mark.

    Args:
        file: open MCAP file.
        at: byte at which an end mark of the right length begins.
        size: length of the file [bytes].

    Returns:
        `size` also if the file is cut off within the index. None if other data follow: it is no end mark, or the index
            is damaged.
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
    """First intact index after byte `begin` that belongs to the recording that begins there.

    Positions in an index are relative to the beginning of its recording; an index of another one is not accepted.

    Args:
        file: open MCAP file, with one or more recordings.
        begin: byte at which a recording begins.
        size: length of the file [bytes].

    Returns:
        Byte at which the index begins, and its records; None without a complete one.
    """
    offsets = [size - FOOTER_BYTES - len(RECORDING_MAGIC)] if begin == 0 else []
    at: int | None = begin + len(RECORDING_MAGIC)
    while at is not None and (at := _find(file, _FOOTER_OR_BEGIN, at, size)) is not None:
        file.seek(at)
        if file.read(len(BEGIN)) == BEGIN:
            break
        offsets.append(at)
        at += 1
    for offset in offsets:
        found = _index_before(file, begin, offset)
        if found is not None:
            return found
    return None


def _index_before(file: IO[bytes], begin: int, at: int) -> tuple[int, bytes] | None:
    """First byte and content of the index of a recording before the footer at byte `at`.

    None if there is no footer, or the index is damaged. `begin` is the first byte of the recording.
    """
    file.seek(max(at, 0))
    footer = file.read(FOOTER_BYTES + len(RECORDING_MAGIC))
    if not (footer.startswith(_FOOTER_HEAD) and footer[FOOTER_BYTES:] == RECORDING_MAGIC):
        return None
    stated, _, crc = _FOOTER.unpack(footer[HEAD.size : FOOTER_BYTES])
    start = begin + stated
    if not begin < start < at <= start + MAX_CHUNK_BYTES:
        return None
    file.seek(start)
    records = file.read(at - start)
    # The check sum is of the footer too, up to itself
    right = zlib.crc32(footer[: FOOTER_BYTES - 4], zlib.crc32(records)) == crc if crc else are_records(records)
    return (start, records) if right else None


def are_records(data: bytes) -> bool:
    """Whether bytes are complete records, in sequence, of kinds that an index has."""
    at = 0
    while at + HEAD.size <= len(data):
        code, length = HEAD.unpack_from(data, at)
        if not (code in INDEX or code >= PRIVATE):
            return False
        at += HEAD.size + length
    return at == len(data)


def _find(file: IO[bytes], marks: re.Pattern[bytes], at: int, size: int) -> int | None:
    """Byte of the first match of the pattern `marks` in a file from byte `at` up to `size`; None if there is none."""
    block = 1 << 20
    while at < size:
        file.seek(at)
        found = marks.search(file.read(block + len(BEGIN) - 1))
        if found is not None:
            return at + found.start()
        at += block
    return None


class SalvagedRecording:
    """One of the recordings in a file, and what is known of it while it is salvaged.

    Definitions, metadata and numbers of channels hold for this recording only.
    """

    def __init__(self, at: int) -> None:
        """Start a recording that begins at byte `at` of the file."""
        self.at = at
        self.schemas: dict[int, records.Schema] = {}
        self.channels: dict[int, records.Channel] = {}
        self.written: dict[int, int] = {}
        """Channel of the new recording by that of this one."""
        self.counts: dict[int, int] | None = None
        """Messages by channel, as the index has it."""
        self.metadata: dict[str, dict[str, str]] = {}
        self.scene: bytes | None = None
        self.damage = Damage()
        self.tallies: dict[int, ChannelTally] = {}
        self.left_out = 0
        """Messages that cannot be brought together with those of the recording before it."""
        self.early = 0
        """Messages that are not later than those of their topic in the recordings before it."""
        self.before: dict[str, int] = {}
        """Time of the last message of each topic in the recordings before it [ns]."""
        self.copies: dict[str, int] = {}
        """Messages by topic that are in the recording twice."""
        self._runs: dict[str, list[list[int]]] = {}
        """Numbers of messages by topic: the first and the last one of each run, in order."""
        self._latest: dict[str, int] = {}
        self._unnumbered: dict[str, set[int]] = {}
        """CRC-32 of the last time's messages by topic, of topics with messages that all have the number 0."""

    def contradicts(self, found: records.Schema | records.Channel) -> bool:
        """Whether a schema or channel number is defined already in another way, so that another recording has begun."""
        known = self.schemas if isinstance(found, records.Schema) else self.channels
        return found.id in known and bool(known[found.id] != found)

    def define(self, found: records.Schema | records.Channel) -> None:
        """Keep a schema or channel by its number."""
        if isinstance(found, records.Schema):
            self.schemas[found.id] = found
        else:
            self.channels[found.id] = found

    def is_copy(self, topic: str, number: int, t_ns: int, data: bytes) -> bool:
        """Whether a message is a duplicate: one of its topic had its sequence number before, at its time or later.

        Numbers increase within a topic, so that duplicates indicate a part of the file that was written twice; they are
        counted in `copies`. If all numbers are 0 (none), messages of one time are duplicates if their bytes are equal.
        Notes the message for later calls.

        Args:
            topic: of the message.
            number: its sequence number.
            t_ns: its time [ns].
            data: its bytes.
        """
        runs = self._runs.setdefault(topic, [])
        latest = self._latest.get(topic, -1)
        self._latest[topic] = max(t_ns, latest)
        if number == 0 and runs in ([], [[0, 0]]):
            there = self._unnumbered.setdefault(topic, set())
            if t_ns > latest:
                there.clear()
            found = zlib.crc32(data)
            if t_ns >= latest and found not in there:
                there.add(found)
                self._runs[topic] = [[0, 0]]
                return False
        index = bisect_right(runs, [number, number])
        near = runs[index - 1] if index else [0, -1]
        if near[0] <= number <= near[1] or (index < len(runs) and runs[index][0] == number):
            if t_ns > latest:
                return False  # numbers of recordings that were brought together begin again
            self.copies[topic] = self.copies.get(topic, 0) + 1
            return True
        if index and near[1] == number - 1:
            near[1] = number
        else:
            runs.insert(index, [number, number])
        return False

    def latest(self) -> dict[str, int]:
        """Time [ns] of the last message of each topic so far, in this recording and those before it."""
        topics = self._latest.keys() | self.before.keys()
        return {topic: max(self._latest.get(topic, -1), self.before.get(topic, -1)) for topic in topics}

    def schema_of(self, channel_id: int) -> str:
        """Name of the schema of the channel with this number; empty if its definition is lost."""
        schema = self.schemas.get(self.channels[channel_id].schema_id)
        return "" if schema is None else str(schema.name)

    def lost(self) -> list[tuple[str, str, int | None]]:
        """(topic, time range as text, number) of lost messages, by channel.

        Number None: unknown whether there were any.
        """
        counts = self.counts if self.counts is not None else dict.fromkeys(self.channels)
        return [
            (self.channels[channel_id].topic, location, messages)
            for channel_id, count in sorted(counts.items())
            if channel_id in self.channels
            for location, messages in self.tallies.get(channel_id, ChannelTally(channel_id, self.damage)).lost(count)
        ]
