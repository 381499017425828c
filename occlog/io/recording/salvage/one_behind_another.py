"""One of the recordings that stand in a file one behind another, as far as it is whole.

Numbers of schemas and channels, the index and the metadata hold for one recording alone.
"""

from __future__ import annotations

import zlib
from bisect import bisect_right

from mcap import records

from occlog.io.recording.salvage.gaps import Damage, Tally


class Part:
    """What is known of one recording."""

    def __init__(self, at: int) -> None:
        """`at`: byte of the file at which it begins."""
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
        self.tallies: dict[int, Tally] = {}
        self.left_out = 0
        """Messages that cannot be brought together with those of the recording before it."""
        self.early = 0
        """Messages that are not later than those of their topic in the recordings before it."""
        self.before: dict[str, int] = {}
        """Time of the last message of each topic in the recordings before it [ns]."""
        self.copies: dict[str, int] = {}
        """Messages by topic that stand in the recording twice."""
        self._runs: dict[str, list[list[int]]] = {}
        """Numbers of messages by topic: the first and the last one of each run, in order."""
        self._latest: dict[str, int] = {}
        self._unnumbered: dict[str, set[int]] = {}
        """CRC-32 of the last time's messages by topic, of topics whose messages all have the number 0."""

    def contradicts(self, found: records.Schema | records.Channel) -> bool:
        """Whether a number is defined a second time, and otherwise: it is of another recording."""
        known = self.schemas if isinstance(found, records.Schema) else self.channels
        return found.id in known and bool(known[found.id] != found)

    def define(self, found: records.Schema | records.Channel) -> None:
        """Take a definition."""
        if isinstance(found, records.Schema):
            self.schemas[found.id] = found
        else:
            self.channels[found.id] = found

    def is_copy(self, topic: str, number: int, t_ns: int, data: bytes) -> bool:
        """Whether a message stood there before: another one of its topic had its number, and one its time or a later.

        Numbers rise in a topic, so that this is so where a part of the file was written twice; it is counted.  Where
        all are 0, which is what MCAP has for none, messages of one time are copies if their bytes are the same.
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
        place = bisect_right(runs, [number, number])
        near = runs[place - 1] if place else [0, -1]
        if near[0] <= number <= near[1] or (place < len(runs) and runs[place][0] == number):
            if t_ns > latest:
                return False  # numbers of recordings that were brought together begin again
            self.copies[topic] = self.copies.get(topic, 0) + 1
            return True
        if place and near[1] == number - 1:
            near[1] = number
        else:
            runs.insert(place, [number, number])
        return False

    def latest(self) -> dict[str, int]:
        """Time of the last message of each topic so far, of the recordings before it as well [ns]."""
        topics = self._latest.keys() | self.before.keys()
        return {topic: max(self._latest.get(topic, -1), self.before.get(topic, -1)) for topic in topics}

    def schema_of(self, channel_id: int) -> str:
        """Name of the schema of a channel; empty: it is lost, or there is none."""
        schema = self.schemas.get(self.channels[channel_id].schema_id)
        return "" if schema is None else str(schema.name)

    def lost(self) -> list[tuple[str, str, int | None]]:
        """Topic, time and number of messages that are lost; None: nobody knows whether there were any."""
        counts = self.counts if self.counts is not None else dict.fromkeys(self.channels)
        return [
            (self.channels[channel_id].topic, place, messages)
            for channel_id, count in sorted(counts.items())
            if channel_id in self.channels
            for place, messages in self.tallies.get(channel_id, Tally(channel_id, self.damage)).lost(count)
        ]
