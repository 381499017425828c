"""The table of messages in a network of sensors.  Conventions: see `tables`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from occlog.array_types import Floats, Ints, Ints32, Strings
from occlog.errors import InputError
from occlog.records.columns import Table, check_order, column, first_row

END_TO_END = "end-to-end"
"""Kind of the rows that are of a router."""


@dataclass(frozen=True, slots=True, eq=False)
class Delays(Table):
    """Messages between sensors, routers and a server, and their delays.

    A row is a message with all of its packets; rows of the kind `end-to-end` are of a router, from the detection of its
    objects to the last final estimate.
    """

    NAME: ClassVar[str] = "delays"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "protocol", "channel", "image_kb", "objects_share", "kind", "source")

    t_ns: Ints = column("i8", "ns", "when the message was sent, since the detection")
    protocol: Strings = column("U", "1", "`rbvc` or `sbvc`")
    channel: Strings = column("U", "1", "what the links between routers share: `shared`, `node` or `link`")
    image_kb: Floats = column("f8", "kB", "size of an image")
    objects_share: Floats = column("f8", "1", "share of the objects that are tracked")
    kind: Strings = column("U", "1", "what the message is, or `end-to-end`")
    source: Strings = column("U", "1", "node that sends it; of `end-to-end` the router")
    destination: Strings = column("U", "1", "nodes that get it, separated by commas")
    packets: Ints32 = column("i4", "1", "packets of the message; of `end-to-end` 0")
    hops: Ints32 = column("i4", "1", "hops of all packets; of `end-to-end` 0")
    delay_s: Floats = column("f8", "s", "from when it was sent to when the last destination has all of it")
    hop_s: Floats = column("f8", "s", "mean over the hops, from when a packet waits to when it arrives", nan="no hop")
    air_s: Floats = column("f8", "s", "time on the air with acknowledgements, over all hops", nan="end-to-end")

    def check(self) -> None:
        """Times in order, no message arrives before it is sent."""
        check_order(self)
        if (bad := self.delay_s < 0.0).any():
            raise InputError(f"Delays: row {first_row(bad)}: delay_s is {self.delay_s[first_row(bad)]:g}, below 0")
