"""One of the recordings that stand in a file one behind another, as far as it is whole.

Numbers of schemas and channels, the index and the metadata hold for one recording alone.
"""

from __future__ import annotations

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
