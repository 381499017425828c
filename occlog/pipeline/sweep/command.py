"""The `occlog sweep` command."""

from __future__ import annotations

from pathlib import Path

import click

from occlog.cli import options
from occlog.pipeline.executors.options import executor_options, job_settings, number_of_workers


@click.command(name="sweep", short_help="Run a Monte Carlo study over seeds and parameters, in parallel.")
@click.argument("sweep", type=options.PATH)
@click.option("-o", "--output", type=options.PATH, required=True, help="Folder of the results; created if missing.")
@executor_options
@click.option(
    "--figures",
    default="rmse,rmse_occ,restart,bytes",
    show_default=True,
    metavar="A,B,...",
    help="Names of the metrics in the printed table; the files have all.",
)
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(
    sweep: Path,
    output: Path,
    workers: int | None,
    scheduler: str | None,
    jobs: tuple[str, ...],
    figures: str,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
) -> int:
    """Run all trials of SWEEP (YAML): each simulates a scene, tracks, and evaluates against the truth.

    Trials of equal seed and run have the same world and the same noise. Finished trials are kept in the folder;
    after an interruption the same command resumes. Results do not depend on the number of workers. The folder gets
    trials.csv (a row per trial), summary.csv (mean, standard deviation, standard error and 95 % confidence interval
    of every metric and setting), timings.csv and sweep.json (provenance).

    \b
      occlog sweep examples/sweep.yaml -o sweep/
      occlog sweep examples/sweep.yaml -o sweep/ --scheduler tcp://127.0.0.1:8786 --json
    """
    from .run import run_sweep

    processes = number_of_workers(workers, scheduler)
    wanted = tuple(name.strip() for name in figures.split(",") if name.strip())
    return run_sweep(
        sweep,
        output,
        workers=processes,
        scheduler=scheduler,
        jobs=job_settings(jobs, scheduler),
        figures=wanted,
        overwrite=overwrite,
        quiet=quiet,
        as_json=as_json,
    )
