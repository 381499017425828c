"""Discrete events: packets that are stored and forwarded over links which share channels.

A hop occupies its channels for the time on the air of the packet and of its acknowledgement.  Hops that wait begin in
the order in which they came to wait, as soon as all of their channels are free: one whose channels are free may
overtake one that still waits for another channel.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, field

from .network import Network

Then = Callable[[float], None]
"""What happens at a time [s]."""
SLOT = 1e-12
"""Times closer than this [s] are one."""


@dataclass
class Message:
    """What was sent, and how it fared.

    Attributes:
        kind: what it is.
        source, destinations: nodes.
        sent_s: when the first packet began to wait.
        packets: number of packets.
        hops: number of hops of all packets.
        air_s: time on the air of all hops, acknowledgements included.
        hop_s: sum over hops from when the packet begins to wait to when it has arrived.
        ack_s: sum over hops from when a packet arrives to when its acknowledgement has arrived.
        arrived_s: when the last destination had all packets.
    """

    kind: str
    source: str
    destinations: tuple[str, ...]
    sent_s: float
    packets: int
    hops: int = 0
    air_s: float = 0.0
    hop_s: float = 0.0
    ack_s: float = 0.0
    arrived_s: float = math.nan


@dataclass
class _Hop:
    """One packet on one link."""

    channels: frozenset[str]
    packet_s: float
    ack_s: float
    since_s: float
    message: Message
    then: Then


@dataclass
class Simulation:
    """Time, events to come, and hops that wait for their channels."""

    network: Network
    now_s: float = 0.0
    messages: list[Message] = field(default_factory=list)
    _events: list[tuple[float, int, Then]] = field(default_factory=list)
    _number: int = 0
    _waiting: list[_Hop] = field(default_factory=list)
    _busy: set[str] = field(default_factory=set)

    def at(self, time_s: float, then: Then) -> None:
        """Let something happen at a time; of equal times in the order of these calls."""
        heapq.heappush(self._events, (time_s, self._number, then))
        self._number += 1

    def run(self) -> None:
        """Let everything happen."""
        while self._events:
            self.now_s, _, then = heapq.heappop(self._events)
            then(self.now_s)
            # Hops begin after all events of this time, so that the order of these does not matter
            if not self._events or self._events[0][0] > self.now_s + SLOT:
                self._begin()

    def send(
        self,
        kind: str,
        source: str,
        destinations: Collection[str],
        size: float,
        *,
        arrived: Callable[[str, float], None],
        reliable: bool = False,
    ) -> None:
        """Send a message now, in packets.

        Args:
            kind: what it is.
            source: node that sends it.
            destinations: nodes that get it, on the shortest ways; the source itself may be one.
            size: bytes.
            arrived: is told each destination when it has all packets.
            reliable: each packet is acknowledged at each hop.
        """
        sizes = self.network.sizes
        full, rest = divmod(math.ceil(size), sizes.packet)
        payloads = [sizes.packet] * full + ([rest] if rest or not full else [])
        message = Message(kind, source, tuple(destinations), self.now_s, len(payloads))
        self.messages.append(message)
        following = self.network.tree(source, destinations)
        missing = dict.fromkeys(destinations, len(payloads))
        done: set[str] = set()

        def reach(node: str, payload: int, now_s: float) -> None:
            if node in missing:
                missing[node] -= 1
                if not missing[node]:
                    done.add(node)
                    if len(done) == len(missing):
                        message.arrived_s = now_s
                    arrived(node, now_s)
            forward(node, payload, now_s)

        def forward(node: str, payload: int, now_s: float) -> None:
            for after in following.get(node, ()):
                self._wait(
                    _Hop(
                        channels=self.network.channels(node, after),
                        packet_s=8.0 * (payload + sizes.header) / self.network.rate_bps,
                        ack_s=8.0 * sizes.ack / self.network.rate_bps if reliable else 0.0,
                        since_s=now_s,
                        message=message,
                        then=lambda t, to=after, p=payload: reach(to, p, t),  # type: ignore[misc]
                    )
                )

        for payload in payloads:
            reach(source, payload, self.now_s)

    def _wait(self, hop: _Hop) -> None:
        self._waiting.append(hop)
        self.at(self.now_s, lambda _: None)  # so that it begins now if it can

    def _begin(self) -> None:
        """Begin all hops whose channels are free, in the order in which they came."""
        left = []
        for hop in self._waiting:
            if hop.channels & self._busy:
                left.append(hop)
            else:
                self._occupy(hop)
        self._waiting = left

    def _occupy(self, hop: _Hop) -> None:
        self._busy |= hop.channels
        arrival = self.now_s + hop.packet_s

        def arrive(now_s: float) -> None:
            m = hop.message
            m.hops += 1
            m.air_s += hop.packet_s + hop.ack_s
            m.hop_s += now_s - hop.since_s
            m.ack_s += hop.ack_s
            hop.then(now_s)

        def free(_: float) -> None:
            self._busy -= hop.channels

        self.at(arrival, arrive)
        self.at(arrival + hop.ack_s, free)
