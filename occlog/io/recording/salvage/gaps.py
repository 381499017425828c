"""Lost messages of a topic in damaged parts: when, and how many if known.

The number follows from statistics in the index, from the message index after a damaged chunk, or from message numbers
if these increase by one in the topic (skipped frames leave the same jump otherwise). `Written` records which messages
were written, to recognise duplicates.
"""

from __future__ import annotations

import zlib
from array import array
from typing import NamedTuple

from occlog.io.files.timing.utc import utc
from occlog.io.recording.chunks import MESSAGE_HEAD


class Gap(NamedTuple):
    """Damaged section between two messages of a channel.

    Attributes:
        before: time of the last message before it [ns]; None: there is none.
        after: time of the first message behind it [ns]; None: there is none.
        jump: number of missing messages by sequence numbers, if these increase by one; None: one end is open.
        indexed: number of messages in it by the message indexes after damaged chunks.
        whole: whether such indexes cover all of the damage.
    """

    before: int | None
    after: int | None
    jump: int | None
    indexed: int
    whole: bool

    @property
    def location(self) -> str:
        """Time range of the section as text, for losses."""
        if self.before is None:
            return "all of it" if self.after is None else f"before {utc(self.after)}"
        return f"after {utc(self.before)}" if self.after is None else f"{utc(self.before)} to {utc(self.after)}"


class Damage:
    """Damage of a recording so far, which its channels compare with their own messages."""

    def __init__(self) -> None:
        self.n_locations = 0
        """Number of damaged positions."""
        self.unknown = 0
        """Number of damaged positions without an index of a chunk."""
        self.counted: dict[int, int] = {}
        """Messages of each channel that indexes of damaged chunks count."""
        self._behind = self._reported = False

    def begin(self) -> None:
        """Count a damaged position."""
        self.n_locations += 1
        self.unknown += 1
        self._behind, self._reported = True, False

    def end(self) -> None:
        """Note that a message is intact, so that message indexes from here on belong to intact chunks."""
        self._behind = False

    def index(self, channel: int, messages: int) -> None:
        """Count the messages of a channel that the message index after a chunk states, if that chunk is damaged."""
        if not self._behind:
            return
        if not self._reported:
            self.unknown -= 1
            self._reported = True
        self.counted[channel] = self.counted.get(channel, 0) + messages


class ChannelTally:
    """Counts the messages of one channel of a recording, and finds gaps at damaged positions."""

    def __init__(self, channel: int, damage: Damage) -> None:
        """Start without messages of the channel with this number.

        `damage` is that of the whole recording; it grows while the recording is read.
        """
        self.messages = 0
        self._channel, self._damage = channel, damage
        self._last: tuple[int, int] | None = None  # number and time of the last message
        self._seen = (0, 0, 0)  # damage when it came
        self._rising: bool | None = None  # whether numbers rise by one where nothing is damaged; None: not known
        self._gaps: list[Gap] = []

    def add(self, number: int, t_ns: int) -> None:
        """Count a message with a sequence number and a time [ns]; if damage came before it, a gap is noted."""
        if self._damage.n_locations > self._seen[0]:
            self._gaps.append(self._gap(t_ns, number))
        elif self._last is not None and self._rising is not False:
            self._rising = number == self._last[0] + 1
        self._last, self._seen = (number, t_ns), self._now()
        self.messages += 1

    def lost(self, count: int | None) -> list[tuple[str, int | None]]:
        """(time range as text, number) of lost messages; number None: unknown whether there were any.

        Args:
            count: number of messages of the channel by the statistics of the index; None: unknown.
        """
        gaps = list(self._gaps)
        if self._damage.n_locations > self._seen[0]:
            gaps.append(self._gap(None, 0))
        found = [self._missing(gap) for gap in gaps]
        if count is None:
            return [(gap.location, n) for gap, n in zip(gaps, found, strict=True) if n != 0]
        missing = count - self.messages
        open_gaps, rest = [n for n in found if n is None], missing - sum(n or 0 for n in found)
        if missing <= 0 or not gaps:
            return [] if missing <= 0 else [(self._gap(None, 0).location, missing)]
        if rest < 0 or (rest and len(open_gaps) != 1):  # how many are in which gap is not known
            first, last = gaps[0], gaps[-1]
            return [(first._replace(after=last.after).location, missing)]
        counts = [rest if n is None else n for n in found]
        return [(gap.location, n) for gap, n in zip(gaps, counts, strict=True) if n]

    def _missing(self, gap: Gap) -> int | None:
        """Number of messages lost in a gap, by message indexes or sequence numbers; None if unknown."""
        if gap.whole:
            return gap.indexed
        return gap.jump if self._rising else None

    def _gap(self, after: int | None, number: int) -> Gap:
        before = None if self._last is None else self._last[1]
        jump = None if self._last is None or after is None else max(number - self._last[0] - 1, 0)
        _, unknown, counted = (now - seen for now, seen in zip(self._now(), self._seen, strict=True))
        return Gap(before, after, jump, counted, not unknown)

    def _now(self) -> tuple[int, int, int]:
        return self._damage.n_locations, self._damage.unknown, self._damage.counted.get(self._channel, 0)


class Written:
    """Hashes (8 bytes) of the messages that were written, by topic, to recognise duplicates."""

    def __init__(self) -> None:
        """Start without messages."""
        self._all: dict[str, array[int]] = {}
        self._asked: dict[str, set[int]] = {}

    def add(self, topic: str, t_ns: int, record: bytes) -> None:
        """Note a written message of a topic and time [ns]; `record` is its content with the message header."""
        key = _key(t_ns, record)
        if topic in self._asked:
            self._asked[topic].add(key)
        else:
            self._all.setdefault(topic, array("Q")).append(key)

    def holds(self, topic: str, t_ns: int, record: bytes) -> bool:
        """Whether a message of this topic, time [ns] and content was written.

        `record` is the content with its header, which is not compared.
        """
        if topic not in self._asked:
            self._asked[topic] = set(self._all.pop(topic, ()))
        return _key(t_ns, record) in self._asked[topic]


def _key(t_ns: int, record: bytes) -> int:
    return zlib.crc32(memoryview(record)[MESSAGE_HEAD.size :]) << 32 | (t_ns ^ t_ns >> 32) & 0xFFFFFFFF
