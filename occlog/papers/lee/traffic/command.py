"""The `occlog traffic` command."""

from __future__ import annotations

from pathlib import Path

import click

from occlog import console
from occlog.cli import options
from occlog.cli.setting_options import SettingsCommand, given, with_options
from occlog.io.files.atomic import check_outputs

from .config import TrafficConfig


@click.command(
    name="traffic",
    cls=SettingsCommand,
    short_help="Simulate the data traffic of sensors that help each other, and its delays.",
)
@click.argument("network", type=options.INPUT)
@options.output_opt("Delays (Parquet).")
@with_options(TrafficConfig)
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(network: Path, output: Path, overwrite: bool, quiet: bool, as_json: bool, **values: object) -> int:
    """Simulate one cycle of tracking in NETWORK (YAML): routers in a mesh, a server, sensors, cameras.

    With protocol rbvc images go to all routers, which correct their estimates; with sbvc estimates and images go to
    the server, which corrects them and sends them back ([Lee] Sec. 5.2.3). A delay is from the detection to the
    last final estimate. `occlog track --method imm` takes it as the age of what cameras answer (--answer-delay).

    \b
      occlog traffic examples/traffic.yaml --image-kb 10,40,100 --objects-share .1,.5,1 -o delays.parquet
    """
    from .run import run_traffic

    check_outputs([network], [output], overwrite)
    return console.finish(run_traffic(network, given(TrafficConfig, values), output, overwrite, quiet), (), as_json)
