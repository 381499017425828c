"""The `occlog verify` command."""

from __future__ import annotations

from pathlib import Path

import click

from occlog import console
from occlog.cli import options


@click.command(name="verify", short_help="Repeat an archived run and compare the results.")
@click.argument("archive", type=options.INPUT)
@click.option(
    "--inputs", type=options.PATH, help="Folder of the inputs that the archive only references, under the same names."
)
@options.quiet_opt
@options.json_opt
def command(archive: Path, inputs: Path | None, quiet: bool, as_json: bool) -> int:
    """Repeat the run in ARCHIVE (of `occlog pack`) from its inputs, and compare every output.

    Exit code 0: the same bytes, or the same values with other package versions or another type of processor; 5: an
    output differs; it is named with its first difference, and whether other versions or the processor may explain it.
    Only temporary files are written.

    \b
      occlog verify room.zip
      occlog verify room.zip --json | jq .different
      occlog verify referenced.zip --inputs sample_data/room
    """
    from .run import verify_pack

    found = verify_pack(archive, inputs, lambda stage: console.note(f"{stage} ...", quiet))
    summary = {
        "same_bytes": len(found.same),
        "same_values": list(found.similar),
        "different": found.different,
        "versions": {n: f"{then or 'none'}, now {now or 'none'}" for n, (then, now) in found.versions.items()},
        "result": found.in_words(),
    }
    console.echo_summary(summary, as_json)
    return found.code
