"""The protocols RBVC and SBVC: visual compensation in the routers, or in the server ([Lee] Figs. 5-42 and 5-43)."""

from __future__ import annotations

from typing import NamedTuple

from .events import Message, Simulation, Then
from .network import Network

DETECTION, ASSIGNED, ACOUSTIC = "RFID detection data", "assigned object data", "acoustic sensing data"
VISUAL, FINAL, ESTIMATE = "visual sensing data", "final estimation data", "estimation based on acoustic sensors"
KINDS = (DETECTION, ASSIGNED, ACOUSTIC, VISUAL, ESTIMATE, FINAL)
RBVC, SBVC = "rbvc", "sbvc"


class Cycle(NamedTuple):
    """One cycle of tracking."""

    delays: dict[str, float]  # of each router with objects: from the detection to the last final estimate [s]
    messages: list[Message]


class _Gate:
    """Waits for several things of each router, and then goes on."""

    def __init__(self, wanted: int) -> None:
        self._left = wanted

    def passed(self) -> bool:
        """Count one more; true for the last one."""
        self._left -= 1
        return self._left == 0


def simulate_cycle(network: Network, protocol: str, image_bytes: float, share: float) -> Cycle:
    """Simulate one cycle: everybody detects at time 0, and cameras take their images then.

    RBVC: images go to all routers that track objects; each sends its final estimate to the server.  SBVC: images and
    the acoustic estimates go to the server, which sends each router its final estimate.

    Args:
        network: nodes, links, sizes.
        protocol: `rbvc` or `sbvc`.
        image_bytes: size of each image.
        share: share of the objects that are tracked.
    """
    simulation = Simulation(network)
    tracking = [name for name, number in network.objects.items() if number > 0]
    delays: dict[str, float] = {}
    sizes, server = network.sizes, network.server
    # A router's final estimate wants its acoustic estimate and all images
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
        """The router has all acoustic data, and makes its estimate."""

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


def _sense(simulation: Simulation, router: str, share: float, heard: Then) -> None:
    """Detect, assign and listen: readers tell what they detect, the router who listens to what, arrays what they hear.

    Args:
        simulation: at the time of the detection.
        router: whose sensors they are.
        share: share of the objects that are tracked.
        heard: happens when the router has the data of all arrays.
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
