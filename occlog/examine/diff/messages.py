"""Messages of a recording as rows, told apart by their hash: frames, and what other programs wrote."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from occlog.array_types import Ints, Strings
from occlog.records.columns import Table, check_order, column


@dataclass(frozen=True, slots=True, eq=False)
class Messages(Table):
    """One row a message; never written to a file."""

    NAME: ClassVar[str] = "messages"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "topic")

    t_ns: Ints = column("i8", "ns", "time of the message since the Unix epoch")
    topic: Strings = column("U", "1", "topic, or camera for decoded frames")
    number: Ints = column("i8", "1", "sequence number, or number of the frame")
    content: Strings = column("U", "1", "SHA-256 of the content")

    def check(self) -> None:
        """Times in order."""
        check_order(self)
