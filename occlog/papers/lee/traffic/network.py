"""The network of a tracking system: routers and a server, sensors and cameras at routers ([Lee] Fig. 5-40)."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class SensorNode:
    """A node with a reader and an array of microphones."""

    name: str
    router: str
    detects: int  # objects that its reader detects
    assigned: float  # share of the router's tracked objects that it is to hear


@dataclass(frozen=True)
class CameraNode:
    """A camera at a router."""

    name: str
    router: str


@dataclass(frozen=True)
class Sizes:
    """Bytes of what is sent."""

    packet: int = 1000  # payload of a packet, at most
    header: int = 0  # of each packet, besides
    ack: int = 40  # acknowledgement of a packet of an image, at each hop
    detection: int = 8  # of an object
    assigned: int = 8
    acoustic: int = 16
    estimate: int = 24


@dataclass(frozen=True)
class Network:
    """Nodes and links.

    Attributes:
        links: pairs of routers, or of a router and the server.
        server: name of the server.
        sensors: nodes with readers and arrays.
        cameras: at least one.
        objects: number of objects in the range of each router that has some.
        rate_bps: of every channel [bit/s].
        channel: what the links share: `shared`, `node` or `link`.
        sizes: bytes of what is sent.
        processing_s: time that an estimate takes.
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
        """Return the channels that a hop from a to b occupies.

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
        """Return the next nodes of each node on the shortest ways from a node to all destinations.

        KeyError names a destination that no way leads to.
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
