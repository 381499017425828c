"""Request of `occlog traffic`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from occlog.request import Request, group, output_file, source

from .config import TrafficConfig


@dataclass(frozen=True, kw_only=True)
class TrafficRequest(Request):
    """Simulate one cycle of tracking in NETWORK (YAML): routers in a mesh, a server, sensors, cameras.

    With protocol rbvc images go to all routers, which correct their estimates; with sbvc estimates and images go to
    the server, which corrects them and sends them back ([Lee] Sec. 5.2.3). A delay is the time from the detection to
    the last final estimate. `occlog track --method imm` takes it as the latency of camera answers (--answer-delay).

    \b
      occlog traffic examples/traffic.yaml --image-kb 10,40,100 --objects-share .1,.5,1 -o delays.parquet
    """

    OWNER: ClassVar[str] = "traffic"
    RUN: ClassVar[str] = "occlog.papers.lee.traffic.run:run_traffic"

    network: Path = source("The network (YAML).", argument=True)
    output: Path = output_file(
        "Delay of each simulated message, and of each router from a detection to the last final estimate (Parquet).",
        "delays",
    )
    settings: Mapping[str, object] = group(lambda: TrafficConfig)
