"""The `occlog pack` command."""

from __future__ import annotations

from pathlib import Path

import click

from occlog import console
from occlog.cli import options
from occlog.io.files.atomic import check_outputs


@click.command(name="pack", short_help="Archive a run folder with its inputs and versions in one file.")
@click.argument("folder", type=options.PATH)
@click.option("--config", type=options.INPUT, required=True, help="Configuration that the run folder was made by.")
@options.output_opt("The archive (ZIP).")
@click.option(
    "--reference", is_flag=True, help="Leave the inputs out, and say only which they are: name, size and SHA-256."
)
@options.overwrite_opt
@options.json_opt
def command(folder: Path, config: Path, output: Path, reference: bool, overwrite: bool, as_json: bool) -> int:
    """Put the run folder FOLDER into one file, from which `occlog verify` makes it again.

    The archive holds the outputs of all stages, the configuration and all that it names (videos that recordings link
    to as well), the versions of Python and of packages, and the SHA-256 of everything.  Every stage has to be up to
    date.  The same run gives the same bytes.

    \b
      occlog run sample_data/room/run.yaml -o room/
      occlog pack room/ --config sample_data/room/run.yaml -o room.zip
      occlog verify room.zip
    """
    from .run import pack_run

    check_outputs([config], [output], overwrite)
    found = pack_run(folder, config, output, include=not reference, overwrite=overwrite)
    told = found.manifest
    summary = {
        "archive": str(output),
        "bytes": found.size,
        "inputs": len(told.inputs),
        "inputs_included": sum(file.included for file in told.inputs),
        "outputs": len(told.outputs),
    }
    console.echo_summary(summary, as_json)
    return 0
