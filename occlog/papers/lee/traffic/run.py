"""Run of `occlog traffic`: read the network, simulate all cases, write their delays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

from occlog import console
from occlog.io.files.inputs import hash_inputs
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import TableWriter
from occlog.io.models.networks import NetworkSpec, read_network
from occlog.records.tables import Delays
from occlog.settings import configure

from .config import TrafficConfig
from .network import CameraNode, Network, SensorNode, Sizes
from .stage import Case, delay_rows, simulate_traffic


def run_traffic(
    path: Path, settings: Mapping[str, object], output: Path, overwrite: bool, quiet: bool
) -> dict[str, object]:
    """Simulate and write; return the summary."""
    config = configure(TrafficConfig(), settings)
    network = network_of(read_network(path))
    made = Provenance("traffic", asdict(config), None, hash_inputs([path]))
    cases: list[Case] = []
    parts: list[Delays] = []
    for case in console.progress(simulate_traffic(network, config), "traffic", quiet=quiet):
        cases.append(case)
        parts.append(delay_rows(case))
    with TableWriter(output, Delays, made, overwrite=overwrite) as writer:
        writer.write(Delays.merge(parts))
    return {
        "delays": str(output),
        "channel": cases[0].channel,
        "cases": len(cases),
        "delay_s": {_name(c): c.delay_s for c in cases},
    }


def _name(case: Case) -> str:
    return f"{case.protocol} {case.image_kb:g} kB {case.share:g}"


def network_of(spec: NetworkSpec) -> Network:
    """The network that a file describes."""
    return Network(
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
