"""Which messages were written, so that those of a copy that follows are not taken for others."""

from __future__ import annotations

import zlib
from array import array

from occlog.io.recording.layout import MESSAGE_HEAD


class Written:
    """Times and check sums of messages by topic: 8 bytes a message, and more once somebody asks for a topic."""

    def __init__(self) -> None:
        """Nothing was written yet."""
        self._all: dict[str, array[int]] = {}
        self._asked: dict[str, set[int]] = {}

    def add(self, topic: str, t_ns: int, record: bytes) -> None:
        """Note a message; `record` has its head, too."""
        key = _key(t_ns, record)
        if topic in self._asked:
            self._asked[topic].add(key)
        else:
            self._all.setdefault(topic, array("Q")).append(key)

    def holds(self, topic: str, t_ns: int, record: bytes) -> bool:
        """Whether a message of this topic, time and content was written."""
        if topic not in self._asked:
            self._asked[topic] = set(self._all.pop(topic, ()))
        return _key(t_ns, record) in self._asked[topic]


def _key(t_ns: int, record: bytes) -> int:
    return zlib.crc32(memoryview(record)[MESSAGE_HEAD.size :]) << 32 | (t_ns ^ t_ns >> 32) & 0xFFFFFFFF
