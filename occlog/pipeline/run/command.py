"""The `occlog run` command."""

from __future__ import annotations

from pathlib import Path

import click

from occlog.cli import options


@click.command(name="run", short_help="Run all stages of a configuration into a run folder.")
@click.argument("config", type=options.PATH)
@click.option("-o", "--output", type=options.PATH, required=True, help="Run folder; created if missing.")
@click.option("--force", "--overwrite", "force", is_flag=True, help="Run every stage, also those that are up to date.")
@click.option("--dry-run", is_flag=True, help="List the stages that would run, and stop.")
@options.strict_opt
@options.quiet_opt
@options.json_opt
def command(config: Path, output: Path, force: bool, dry_run: bool, strict: bool, quiet: bool, as_json: bool) -> int:
    """Run all stages of CONFIG (YAML) into a run folder.

    A stage is skipped if its options, the program and the content of its inputs are unchanged, and its outputs
    untouched. The outputs of a stage that runs again are replaced; other files in the folder stay.

    \b
      occlog run sample_data/room/run.yaml -o run/ && open run/report.html
      occlog run study.yaml -o run/ --json | jq .metrics.rmse_m
    """
    from .run import run_stages

    return run_stages(config, output, force=force, dry_run=dry_run, strict=strict, quiet=quiet, as_json=as_json)
