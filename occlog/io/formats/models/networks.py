"""Networks of routers, sensors and cameras in YAML, for `occlog traffic`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from occlog.errors import InputError
from occlog.io.files.texts.yaml import read_yaml
from occlog.records.names import first_double

Name = Annotated[str, Meta(min_length=1, max_length=64, pattern=r"^[^\s,/=:]+$")]
Count = Annotated[int, Meta(ge=0, le=1_000_000)]
Bytes = Annotated[int, Meta(ge=0, le=1_000_000_000)]


class NetworkFileSpec(msgspec.Struct, forbid_unknown_fields=True):
    """Base class of all parts of a network file for `occlog traffic`; unknown keys are errors."""


class SensorNodeSpec(NetworkFileSpec, kw_only=True):
    """Sensor node of a traffic simulation: a tag reader and a microphone array at a router."""

    name: Name
    router: Name
    detects: Annotated[Count, Meta(description="objects that its reader detects")]
    assigned: Annotated[float, Meta(ge=0, le=1, description="share of the router's tracked objects that it hears")]


class CameraNodeSpec(NetworkFileSpec, kw_only=True):
    """A camera of a traffic simulation and the router it is attached to."""

    name: Name
    router: Name


class SizesSpec(NetworkFileSpec, kw_only=True):
    """Sizes of the messages of a traffic simulation [bytes]."""

    packet: Annotated[int, Meta(gt=0, le=1_000_000_000, description="payload of a packet, at most")] = 1000
    header: Annotated[Bytes, Meta(description="added to each packet")] = 0
    ack: Annotated[Bytes, Meta(description="acknowledgement of a packet of an image, at each hop")] = 40
    detection: Annotated[Bytes, Meta(description="RFID detection data of an object")] = 8
    assigned: Annotated[Bytes, Meta(description="assigned object data of an object")] = 8
    acoustic: Annotated[Bytes, Meta(description="acoustic sensing data of an object")] = 16
    estimate: Annotated[Bytes, Meta(description="estimate of an object")] = 24


class NetworkSpec(NetworkFileSpec, kw_only=True):
    """Network of a traffic simulation: that of [Lee] Fig. 5-40, or its chain of routers (Fig. 5-41)."""

    occlog_network: Annotated[Literal[1], Meta(description="version of this format")]
    server: Name
    links: Annotated[
        list[tuple[Name, Name]], Meta(min_length=1, description="pairs of routers, or of a router and the server")
    ]
    channel: Annotated[
        Literal["shared", "node", "link"],
        Meta(description="what links between routers share: one channel, a radio at each node, or nothing"),
    ] = "shared"
    rate_bps: Annotated[float, Meta(gt=0, description="of every channel, bit/s")] = 2e6
    processing_s: Annotated[float, Meta(ge=0, description="time that an estimate takes")] = 0.0
    objects: Annotated[dict[Name, Count], Meta(min_length=1, description="number in the range of each router")]
    sensors: Annotated[list[SensorNodeSpec], Meta(min_length=1)]
    cameras: Annotated[list[CameraNodeSpec], Meta(min_length=1)]
    sizes: SizesSpec = msgspec.field(default_factory=SizesSpec)


def network_schema() -> dict[str, object]:
    """JSON Schema of files with a network for `occlog traffic`."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **msgspec.json.schema(NetworkSpec)}


def read_network(path: Path) -> NetworkSpec:
    """Read a network of routers, sensors and cameras from a YAML file.

    Raises:
        InputError: a value is invalid, names repeat or are unknown, or a node is not connected with the server.
    """
    spec = read_yaml(path, NetworkSpec, "a network (YAML)")
    nodes = {name for pair in spec.links for name in pair}
    routers = nodes - {spec.server}
    if spec.server not in nodes:
        raise InputError(f"{path}: no link leads to the server {spec.server}; add one", id="missing-value")
    if (loop := next((a for a, b in spec.links if a == b), None)) is not None:
        raise InputError(f"{path}: a link leads from {loop} to itself; remove it")
    attached = [(s.name, s.router) for s in spec.sensors] + [(c.name, c.router) for c in spec.cameras]
    if (double := first_double([*nodes, *(name for name, _ in attached)])) is not None:
        raise InputError(f"{path}: two nodes are named {double}; names must differ", id="duplicate-name")
    known = ", ".join(sorted(routers))
    for name, router in attached:
        if router not in routers:
            raise InputError(
                f"{path}: {name}: no router {router!r} among the links; there are: {known}", id="unknown-sensor"
            )
    for router, number in spec.objects.items():
        if router not in routers:
            raise InputError(
                f"{path}: objects: no router {router!r} among the links; there are: {known}", id="unknown-sensor"
            )
        if number and not any(s.router == router for s in spec.sensors):
            raise InputError(
                f"{path}: objects: router {router} has {number} objects, but no sensor; add one", id="missing-value"
            )
    if not any(spec.objects.values()):
        raise InputError(
            f"{path}: objects: no router has any; give at least one router a number of objects", id="missing-value"
        )
    _check_ways(path, spec, nodes)
    return spec


def _check_ways(path: Path, spec: NetworkSpec, nodes: set[str]) -> None:
    """InputError, which names the first one, if a node is not connected with the server by links in any direction.

    Args:
        path: file, for messages.
        spec: has the server and the links.
        nodes: names of the nodes.
    """
    reached, grown = {spec.server}, True
    while grown:
        more = {b for a, b in spec.links if a in reached} | {a for a, b in spec.links if b in reached}
        grown = not more <= reached
        reached |= more
    if lost := sorted(nodes - reached):
        raise InputError(f"{path}: no way leads from the server to {lost[0]}; add a link", id="missing-value")
