"""The `occlog pack` command."""

from __future__ import annotations

from pathlib import Path

import click

from occlog import console
from occlog.cli import options
from occlog.io.files.atomic import check_outputs


@click.command(name="pack", short_help="Archive a run folder with its inputs and versions in one file.")
@click.argument("folder", type=options.PATH)
@click.option(
    "--config",
    type=options.INPUT,
    required=True,
    help="Configuration (YAML) that `occlog run` made the run folder from.",
)
@options.output_opt("The archive (ZIP).")
@click.option("--reference", is_flag=True, help="Omit the inputs and store only their names, sizes and SHA-256.")
@options.overwrite_opt
@options.json_opt
def command(folder: Path, config: Path, output: Path, reference: bool, overwrite: bool, as_json: bool) -> int:
    """Archive the run folder FOLDER in one file, from which `occlog verify` repeats it.

    The archive contains the outputs of all stages, the configuration and its input files (linked videos too), the
    versions of Python and packages, and all SHA-256 hashes. Every stage must be up to date. The same run gives the
    same bytes.

    \b
      occlog run sample_data/room/run.yaml -o room/
      occlog pack room/ --config sample_data/room/run.yaml -o room.zip
      occlog verify room.zip
    """
    from .run import pack_run

    check_outputs([config], [output], overwrite)
    found = pack_run(folder, config, output, include=not reference, overwrite=overwrite)
    manifest = found.manifest
    summary = {
        "archive": str(output),
        "bytes": found.size,
        "inputs": len(manifest.inputs),
        "inputs_included": sum(file.included for file in manifest.inputs),
        "outputs": len(manifest.outputs),
    }
    console.echo_summary(summary, as_json)
    return 0
