"""Run of `occlog traffic`: read the network, simulate all cases, write their delays."""

from __future__ import annotations

from dataclasses import asdict

from occlog.io.formats.models.networks import NetworkSpec, read_network
from occlog.records.tables import Delays
from occlog.runner import Job
from occlog.settings import configure

from .config import TrafficConfig
from .network import CameraNode, RouterNetwork, SensorNode, Sizes
from .request import TrafficRequest
from .stage import TrafficCase, delay_rows, simulate_traffic


def run_traffic(request: TrafficRequest, job: Job) -> tuple[dict[str, object], tuple[()]]:
    """Simulate all cases of a request and write their delays; a summary for the terminal, and no losses."""
    config = configure(TrafficConfig(), request.settings)
    network = network_of(read_network(request.network))
    cases: list[TrafficCase] = []
    parts: list[Delays] = []
    for case in job.progress(simulate_traffic(network, config), "traffic"):
        cases.append(case)
        parts.append(delay_rows(case))
    with job.tables(job.provenance(asdict(config)), "m") as tables:
        tables.write(output=Delays.merge(parts))
    summary = {
        "delays": str(request.output),
        "channel": cases[0].channel,
        "cases": len(cases),
        "delay_s": {_name(c): c.delay_s for c in cases},
    }
    return summary, ()


def _name(case: TrafficCase) -> str:
    """Name of a case in the summary: protocol, size of images and share of objects."""
    return f"{case.protocol} {case.image_kb:g} kB {case.share:g}"


def network_of(spec: NetworkSpec) -> RouterNetwork:
    """Network of the simulation from the checked content `spec` of a file."""
    return RouterNetwork(
        links=tuple((a, b) for a, b in spec.links),
        server=spec.server,
        sensors=tuple(SensorNode(s.name, s.router, s.detects, s.assigned) for s in spec.sensors),
        cameras=tuple(CameraNode(c.name, c.router) for c in spec.cameras),
        objects=dict(spec.objects),
        rate_bps=spec.rate_bps,
        channel=spec.channel,
        sizes=Sizes(**{name: getattr(spec.sizes, name) for name in spec.sizes.__struct_fields__}),
        processing_s=spec.processing_s,
    )
