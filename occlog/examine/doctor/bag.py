"""Bags of other programs: what is lost of them, header stamps, and clocks."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from occlog.errors import InputError, UsageError
from occlog.io.messages.bag import Bag, open_bag
from occlog.io.messages.kinds import Kind, kind_of
from occlog.io.messages.mcap_file import McapFile
from occlog.io.messages.survey import CLOCKS_APART_S, Messages
from occlog.io.recording.mcap_errors import check_index

from .clock import Clock, judge_clocks
from .findings import Findings

TIMED = (Kind.IMAGE, Kind.BOX, Kind.POSE, Kind.DIRECTION)
"""Messages whose times ingest takes."""


def look_at_bag(path: Path, findings: Findings) -> None:
    """Look at every message of a bag whose time would be taken; what is lost is told by whoever reads the file."""
    try:
        with open_bag([path]) as bag:
            topics = bag.topics()
            stamps = {name: _Stamps(name) for name, topic in topics.items() if kind_of(topic.kind) in TIMED}
            for topic, t_ns, apart_s in _times(bag, set(stamps), findings):
                stamps[topic].add(t_ns, apart_s)
            _check_indexes(bag, findings)
            for loss in bag.losses:
                findings.add("damaged-bag", f"{loss.source}, {loss.place}", loss.what, count=max(loss.count, 1))
            for topic, remark in bag.remarks.items():
                findings.add("miscounted", topic, remark)
        for each in stamps.values():
            each.finish(findings)
        judge_clocks([each.clock for each in stamps.values()], findings)
    except (InputError, UsageError) as error:
        findings.refused("unreadable", error)


def _check_indexes(bag: Bag, findings: Findings) -> None:
    """Note topics that an index leaves out, so that nobody reads them."""
    for file in bag.files:
        if isinstance(file, McapFile) and not file.losses:
            try:
                check_index(file.path)
            except InputError as error:
                what = str(error).removeprefix(f"{file.path}: ").split(";")[0]
                findings.add("damaged-bag", file.name, what)


def _times(bag: Bag, wanted: set[str], findings: Findings) -> Iterator[tuple[str, int, float | None]]:
    """Topic, time, and how much later it was recorded [s] (None: without a header stamp) of each message."""
    messages, unread = Messages(bag.topics()), set[str]()
    for message in bag.messages(wanted):
        if message.topic in unread:
            yield message.topic, message.log_ns, None
            continue
        try:
            stamp = messages.read(message.topic, message.data).header.stamp_ns
        except UsageError as error:
            unread.add(message.topic)
            findings.add("undecoded", message.topic, str(error))
            stamp = 0
        except InputError as error:
            findings.refused("lost-message", error, place=message.topic)
            continue
        yield message.topic, stamp or message.log_ns, (message.log_ns - stamp) / 1e9 if stamp else None


class _Stamps:
    """The times of one topic."""

    def __init__(self, topic: str) -> None:
        self.clock = Clock(topic, unique=True, dropped=True)
        self._times: list[int] = []
        self._low = self._high = 0.0

    def add(self, t_ns: int, apart_s: float | None) -> None:
        self._times.append(t_ns)
        if apart_s is not None:
            self._low, self._high = min(self._low, apart_s), max(self._high, apart_s)
        if len(self._times) >= 4096:
            self._flush()

    def finish(self, findings: Findings) -> None:
        self._flush()
        if max(-self._low, self._high) > CLOCKS_APART_S:
            value = f"{self._low:.3g} to {self._high:.3g} s after them"
            findings.add("two-clocks", self.clock.name, value, limit=f"{CLOCKS_APART_S:g} s")

    def _flush(self) -> None:
        self.clock.add(np.array(self._times, dtype=np.int64))
        self._times = []
