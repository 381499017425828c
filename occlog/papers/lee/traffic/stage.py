"""Networks and settings to delays: all cases, each as rows of a table."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from occlog.records.declared.world import END_TO_END
from occlog.records.tables import Delays

from .config import TrafficConfig
from .network import KINDS, Cycle, RouterNetwork, simulate_cycle

KILOBYTE = 1000.0


class TrafficCase(NamedTuple):
    """One simulated tracking cycle and its settings.

    Attributes:
        protocol: `rbvc` or `sbvc`.
        channel: what links between routers share: `shared`, `node` or `link`.
        image_kb: size of an image, in units of 1000 bytes.
        share: share of the objects that are tracked, 0 to 1.
        cycle: delays and messages.
    """

    protocol: str
    channel: str
    image_kb: float
    share: float
    cycle: Cycle

    @property
    def delay_s(self) -> float:
        """Largest end-to-end delay over the routers with objects [s]."""
        return max(self.cycle.delays.values())


def simulate_traffic(network: RouterNetwork, config: TrafficConfig) -> Iterator[TrafficCase]:
    """Generate the cases: each protocol with each size of images and each share of objects, simulated for a cycle."""
    own = network if config.channel is None else replace(network, channel=config.channel)
    for protocol in config.protocols:
        for image_kb in dict.fromkeys(config.image_kb):
            for share in dict.fromkeys(config.objects_share):
                cycle = simulate_cycle(own, protocol, image_kb * KILOBYTE, share)
                yield TrafficCase(protocol, own.channel, image_kb, share, cycle)


def delay_rows(case: TrafficCase) -> Delays:
    """Table of a case: for each router a row from the detection to its final estimate, and a row for each message."""
    messages, ends = case.cycle.messages, sorted(case.cycle.delays.items())
    n, m = len(messages), len(ends)
    none = np.full(m, np.nan)
    hops = np.array([x.hops for x in messages], dtype=np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean_hop = np.where(hops > 0, np.array([x.hop_s for x in messages]) / hops, np.nan)
    return Delays.of(
        t_ns=np.array([0] * m + [round(x.sent_s * 1e9) for x in messages], dtype=np.int64),
        protocol=np.full(n + m, case.protocol),
        channel=np.full(n + m, case.channel),
        image_kb=np.full(n + m, case.image_kb),
        objects_share=np.full(n + m, case.share),
        kind=np.array([END_TO_END] * m + [x.kind for x in messages]),
        source=np.array([name for name, _ in ends] + [x.source for x in messages]),
        destination=np.array([""] * m + [",".join(x.destinations) for x in messages]),
        packets=np.array([0] * m + [x.packets for x in messages], dtype=np.int32),
        hops=np.array([0] * m + [x.hops for x in messages], dtype=np.int32),
        delay_s=np.array([d for _, d in ends] + [x.arrived_s - x.sent_s for x in messages]),
        hop_s=np.concatenate([none, mean_hop]),
        air_s=np.concatenate([none, np.array([x.air_s for x in messages])]),
    ).sorted()


def hop_delays(case: TrafficCase) -> dict[str, float]:
    """Mean delay of a hop [s] by kind of message; kinds without hops are missing."""
    found: dict[str, float] = {}
    for kind in KINDS:
        own = [m for m in case.cycle.messages if m.kind == kind and m.hops]
        if own:
            found[kind] = float(np.sum([m.hop_s for m in own]) / np.sum([m.hops for m in own]))
    return found
