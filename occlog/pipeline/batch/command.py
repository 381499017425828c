"""The `occlog batch` command."""

from __future__ import annotations

from pathlib import Path

import click

from occlog.cli import options
from occlog.pipeline.executors.options import executor_options, job_settings, number_of_workers


@click.command(name="batch", short_help="Run the stages of a configuration on many recordings.")
@click.argument("config", type=options.PATH)
@click.argument("recordings", nargs=-1, required=True)
@click.option(
    "-o", "--output", required=True, metavar="PATH", help="Folder of the results, or its URL; created if missing."
)
@executor_options
@click.option(
    "--tables",
    default="tracks",
    show_default=True,
    metavar="A,B,...",
    help="Names of tables in the run folders to concatenate over all recordings, separated by commas.",
)
@click.option(
    "--cache",
    type=options.PATH,
    default=None,
    help="Cache folder for files from URLs. [default: `occlog` in the user's cache folder, or OCCLOG_CACHE]",
)
@click.option(
    "--cache-limit",
    type=click.FloatRange(min=0.001),
    default=20.0,
    show_default=True,
    metavar="GB",
    help="Maximum size of the cache [GB]; the least recently used files are removed first.",
)
@click.option("--force", "--overwrite", "force", is_flag=True, help="Run every stage, also those that are up to date.")
@options.strict_opt
@options.quiet_opt
@options.json_opt
def command(
    config: Path,
    recordings: tuple[str, ...],
    output: str,
    workers: int | None,
    scheduler: str | None,
    jobs: tuple[str, ...],
    tables: str,
    cache: Path | None,
    cache_limit: float,
    force: bool,
    strict: bool,
    quiet: bool,
    as_json: bool,
) -> int:
    """Run the stages of CONFIG (YAML, as of `occlog run`, without a recording) for each of RECORDINGS.

    RECORDINGS are files, quoted patterns, and URLs (s3, gs, https). The folder gets runs/NAME, a run folder for
    each recording, and common tables: runs.parquet (a row per recording: state, exit code, message, losses),
    metrics.parquet (a row per metric), tracks.parquet (with a column `recording`), and timings.csv. A failed
    recording is listed, and the others continue; the exit code is then 3. After an interruption, or with more
    recordings, the same command processes what is not up to date. Results do not depend on the number of workers.

    \b
      occlog batch study.yaml 'recordings/*.mcap' -o results/
      occlog batch study.yaml 'recordings/**/*.mcap' -o results/ --scheduler tcp://127.0.0.1:8786 --json
    """
    from occlog.io.remote import Cache, default_folder, without_end

    from .run import BatchRequest, run_batch

    processes = number_of_workers(workers, scheduler)
    wanted = tuple(dict.fromkeys(name.strip() for name in tables.split(",") if name.strip()))
    kept = Cache((cache or default_folder()).absolute(), int(cache_limit * 1e9))
    request = BatchRequest(
        config=config,
        recordings=recordings,
        output=without_end(output),
        tables=wanted,
        workers=processes,
        scheduler=scheduler,
        jobs=job_settings(jobs, scheduler),
        force=force,
        cache=kept,
    )
    return run_batch(request, strict=strict, quiet=quiet, as_json=as_json)
