"""The network of a tracking system: routers and a server, sensors and cameras at routers ([Lee] Fig. 5-40).

Discrete events: packets that are stored and forwarded over links which share channels.

A hop occupies its channels for the time on the air of the packet and of its acknowledgement.  Hops that wait begin in
the order in which they came to wait, as soon as all of their channels are free: one with channels that are free may
overtake one that still waits for another channel.

The protocols RBVC and SBVC: visual compensation in the routers, or in the server ([Lee] Figs. 5-42 and 5-43).
"""

from __future__ import annotations

import heapq
import math
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple


@dataclass(frozen=True)
class SensorNode:
    """A node with an RFID reader and an array of microphones.

    Attributes:
        name: name of the node.
        router: name of the router that it is connected to.
        detects: number of objects that its reader detects.
        assigned: share of the router's tracked objects that its array is to hear.
    """

    name: str
    router: str
    detects: int
    assigned: float


@dataclass(frozen=True)
class CameraNode:
    """A camera by `name`, and the name of the `router` that it is connected to."""

    name: str
    router: str


@dataclass(frozen=True)
class Sizes:
    """Sizes of packets, acknowledgements and messages, in bytes.

    Attributes:
        packet: payload of a packet, at most.
        header: added to each packet.
        ack: acknowledgement of a packet of an image, at each hop.
        detection, assigned, acoustic, estimate: data of one object in messages of detections, of assigned objects, of
            measured sounds, and of estimates.
    """

    packet: int = 1000
    header: int = 0
    ack: int = 40
    detection: int = 8
    assigned: int = 8
    acoustic: int = 16
    estimate: int = 24


@dataclass(frozen=True)
class RouterNetwork:
    """Routers, server, sensors and cameras, and the links between them.

    Attributes:
        links: pairs of names of two routers, or of a router and the server.
        server: name of the server.
        sensors: nodes with readers and arrays.
        cameras: at least one.
        objects: number of objects in the range of a router, by its name; a router that is missing has none.
        rate_bps: rate of every channel [bit/s].
        channel: what links between routers share: one channel (`shared`), a radio at each node (`node`) or nothing
            (`link`).
        sizes: sizes of packets and messages.
        processing_s: time that the computation of an estimate takes [s].
    """

    links: tuple[tuple[str, str], ...]
    server: str
    sensors: tuple[SensorNode, ...]
    cameras: tuple[CameraNode, ...]
    objects: Mapping[str, int]
    rate_bps: float = 2e6
    channel: str = "shared"
    sizes: Sizes = field(default_factory=Sizes)
    processing_s: float = 0.0

    @property
    def nodes(self) -> tuple[str, ...]:
        """Routers and server, in the order in which links name them."""
        return tuple(dict.fromkeys(name for pair in self.links for name in pair))

    def channels(self, a: str, b: str) -> frozenset[str]:
        """Names of the channels that a hop from node a to node b occupies.

        The sensors of a router share a channel, and each camera has one ([Lee] Fig. 5-41: groups have different
        channels).
        """
        for sensor in self.sensors:
            if sensor.name in (a, b):
                return frozenset({f"sensors of {sensor.router}"})
        for camera in self.cameras:
            if camera.name in (a, b):
                return frozenset({f"camera {camera.name}"})
        if self.channel == "shared":
            return frozenset({"routers"})
        if self.channel == "node":
            return frozenset({f"node {a}", f"node {b}"})
        return frozenset({"link " + " ".join(sorted((a, b)))})

    def tree(self, source: str, destinations: Iterable[str]) -> dict[str, tuple[str, ...]]:
        """Children of each node in the tree of shortest paths from the node `source` to all destinations.

        Raises:
            KeyError: no way leads to a destination; it names this one, or a node on the way.
        """
        attached = [(s.name, s.router) for s in self.sensors] + [(c.name, c.router) for c in self.cameras]
        ways = (*self.links, *attached)
        # Breadth-first search: the first way found has the fewest hops
        before: dict[str, str] = {}
        waiting = deque([source])
        while waiting:
            here = waiting.popleft()
            for a, b in ways:
                for near, far in ((a, b), (b, a)):
                    if near == here and far != source and far not in before:
                        before[far] = here
                        waiting.append(far)
        after: dict[str, list[str]] = {}
        for destination in destinations:
            here = destination
            while here != source:
                back = before[here]
                if here in after.setdefault(back, []):
                    break
                after[back].append(here)
                here = back
        return {node: tuple(following) for node, following in after.items()}


Then = Callable[[float], None]
"""Action at a time [s]."""
SLOT = 1e-12
"""Times closer than this [s] are one."""


@dataclass
class NetworkMessage:
    """A message, with its delays so far; all times [s].

    Attributes:
        kind: what it contains, one of `KINDS`.
        source, destinations: names of nodes.
        sent_s: when the first packet began to wait.
        packets: number of packets.
        hops: number of hops of all packets so far.
        air_s: time on the air of all hops, acknowledgements included.
        hop_s: sum over hops from when the packet begins to wait to when it has arrived.
        ack_s: sum over hops from when a packet arrives to when its acknowledgement has arrived.
        arrived_s: when the last destination had all packets; NaN before.
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
class _PacketHop:
    """One packet that waits for, or is sent over, one link.

    Attributes:
        channels: channels that the hop occupies.
        packet_s: time on the air of the packet [s].
        ack_s: time on the air of its acknowledgement [s]; 0 without one.
        since_s: when it began to wait [s].
        message: message that the packet belongs to, updated on arrival.
        then: is called with the time of the packet's arrival [s].
    """

    channels: frozenset[str]
    packet_s: float
    ack_s: float
    since_s: float
    message: NetworkMessage
    then: Then


@dataclass
class NetworkSimulation:
    """Discrete events in a network: the time, events to come, and hops that wait for their channels.

    Attributes:
        network: nodes, links and sizes.
        now_s: current time [s].
        messages: all messages sent so far.
    """

    network: RouterNetwork
    now_s: float = 0.0
    messages: list[NetworkMessage] = field(default_factory=list)
    _events: list[tuple[float, int, Then]] = field(default_factory=list)
    _number: int = 0
    _waiting: list[_PacketHop] = field(default_factory=list)
    _busy: set[str] = field(default_factory=set)

    def at(self, time_s: float, then: Then) -> None:
        """Schedule the call of `then` at the time `time_s` [s]; calls at equal times run in the order of scheduling."""
        heapq.heappush(self._events, (time_s, self._number, then))
        self._number += 1

    def run(self) -> None:
        """Run all scheduled calls in the order of time, with those that they schedule, until none is left."""
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
        """Send a message at the current time, in packets.

        Args:
            kind: what it contains, one of `KINDS`.
            source: node that sends it.
            destinations: nodes that get it, on the shortest ways; the source itself may be one.
            size: size of the message in bytes, rounded up.
            arrived: is called with each destination and the time [s] at which it has all packets.
            reliable: whether each packet is acknowledged at each hop.

        Raises:
            KeyError: no way leads to a destination.
        """
        sizes = self.network.sizes
        full, rest = divmod(math.ceil(size), sizes.packet)
        payloads = [sizes.packet] * full + ([rest] if rest or not full else [])
        message = NetworkMessage(kind, source, tuple(destinations), self.now_s, len(payloads))
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
                    _PacketHop(
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

    def _wait(self, hop: _PacketHop) -> None:
        """Add a hop to those that wait; it begins at once if its channels are free."""
        self._waiting.append(hop)
        self.at(self.now_s, lambda _: None)  # so that it begins now if it can

    def _begin(self) -> None:
        """Start all waiting hops with free channels, in the order in which they came to wait."""
        left = []
        for hop in self._waiting:
            if hop.channels & self._busy:
                left.append(hop)
            else:
                self._occupy(hop)
        self._waiting = left

    def _occupy(self, hop: _PacketHop) -> None:
        """Start a hop: occupy its channels until the acknowledgement has arrived, and schedule the packet's arrival."""
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


DETECTION, ASSIGNED, ACOUSTIC = "RFID detection data", "assigned object data", "acoustic sensing data"
VISUAL, FINAL, ESTIMATE = "visual sensing data", "final estimation data", "estimation based on acoustic sensors"
KINDS = (DETECTION, ASSIGNED, ACOUSTIC, VISUAL, ESTIMATE, FINAL)
RBVC = "rbvc"


class Cycle(NamedTuple):
    """Result of one tracking cycle.

    Attributes:
        delays: delay from the detection to the last final estimate [s], by router with objects.
        messages: all messages of the cycle.
    """

    delays: dict[str, float]
    messages: list[NetworkMessage]


class _Gate:
    """Counter of events that states when the last of them has occurred; `wanted`: their number."""

    def __init__(self, wanted: int) -> None:
        self._left = wanted

    def passed(self) -> bool:
        """Count one event; true if it was the last."""
        self._left -= 1
        return self._left == 0


def simulate_cycle(network: RouterNetwork, protocol: str, image_bytes: float, share: float) -> Cycle:
    """Simulate one cycle: all nodes detect at time 0, and cameras take their images then.

    RBVC: images go to all routers that track objects; each sends its final estimate to the server. SBVC: images and the
    acoustic estimates go to the server, which sends each router its final estimate.

    Args:
        network: nodes, links and sizes.
        protocol: `rbvc` or `sbvc`.
        image_bytes: size of each image in bytes.
        share: share of each router's objects that are tracked, 0 to 1.
    """
    simulation = NetworkSimulation(network)
    tracking = [name for name, number in network.objects.items() if number > 0]
    delays: dict[str, float] = {}
    sizes, server = network.sizes, network.server
    # A router's final estimate requires its acoustic estimate and all images
    ready = {name: _Gate(1 + len(network.cameras)) for name in tracking}

    def finish(router: str, now_s: float) -> None:
        if not ready[router].passed():
            return
        size = sizes.estimate * share * network.objects[router]
        source, destination = (router, server) if protocol == RBVC else (server, router)

        def final(_: float) -> None:
            simulation.send(FINAL, source, (destination,), size, arrived=lambda _, t: delays.__setitem__(router, t))

        simulation.at(now_s + network.processing_s, final)

    def image(node: str, now_s: float) -> None:
        for router in (node,) if protocol == RBVC else tracking:
            finish(router, now_s)

    def heard(router: str, now_s: float) -> None:
        """Schedule the estimate of a router, which has all acoustic data at the time `now_s` [s]."""

        def estimate(t: float) -> None:
            if protocol == RBVC:
                finish(router, t)
                return
            size = sizes.estimate * share * network.objects[router]
            simulation.send(ESTIMATE, router, (server,), size, arrived=lambda _, at: finish(router, at))

        simulation.at(now_s + network.processing_s, estimate)

    def start(_: float) -> None:
        for router in tracking:
            _sense(simulation, router, share, lambda now_s, router=router: heard(router, now_s))  # type: ignore[misc]
        for camera in network.cameras:
            destinations = tracking if protocol == RBVC else [server]
            simulation.send(VISUAL, camera.name, destinations, image_bytes, arrived=image, reliable=True)

    simulation.at(0.0, start)
    simulation.run()
    return Cycle(delays, simulation.messages)


def _sense(simulation: NetworkSimulation, router: str, share: float, heard: Then) -> None:
    """Start detection, assignment and listening of one router's sensors; each step follows when messages arrive.

    Args:
        simulation: simulation at the time of the detection; messages are sent in it.
        router: name of the router.
        share: share of its objects that are tracked, 0 to 1.
        heard: is called with the time [s] at which the router has the data of all arrays.
    """
    network = simulation.network
    sizes, objects = network.sizes, share * network.objects[router]
    sensors = [s for s in network.sensors if s.router == router]
    detections, sounds = _Gate(len(sensors)), _Gate(len(sensors))

    def listen(name: str, assigned: float) -> None:
        def sounded(_: str, now_s: float) -> None:
            if sounds.passed():
                heard(now_s)

        simulation.send(ACOUSTIC, name, (router,), sizes.acoustic * assigned, arrived=sounded)

    def detected(_: str, now_s: float) -> None:  # noqa: ARG001
        if detections.passed():
            for s in sensors:
                assigned = s.assigned * objects
                simulation.send(
                    ASSIGNED,
                    router,
                    (s.name,),
                    sizes.assigned * assigned,
                    arrived=lambda name, _, assigned=assigned: listen(name, assigned),  # type: ignore[misc]
                )

    for s in sensors:
        simulation.send(DETECTION, s.name, (router,), sizes.detection * s.detects, arrived=detected)
