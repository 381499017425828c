"""Options that select the executor; they import no executor."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import TypeVar

import click

from occlog.errors import UsageError

F = TypeVar("F", bound=Callable[..., object])
JOB_CLUSTERS = {"slurm": "slurm", "slurm-here": "local"}
"""Names of schedulers that run jobs, and their names in submitit."""
JOBS_FOLDER = "jobs"
"""Folder of the scripts and logs of jobs, in that of the results."""
JOB_FOLDER = "folder"
"""Setting of jobs that names the folder of their scripts and logs."""


def executor_options(command: F) -> F:
    """Add the options `--workers`, `--scheduler` and `--job`, which select where tasks are run."""
    for option in (
        click.option(
            "--job",
            "jobs",
            multiple=True,
            metavar="NAME=VALUE",
            help="Setting NAME=VALUE of the jobs of --scheduler slurm: jobs (their number), timeout_min, mem_gb, "
            "slurm_partition, ...; may be repeated.",
        ),
        click.option(
            "--scheduler",
            default=None,
            metavar="WHERE",
            help="Cluster to use instead of this machine: tcp://HOST:PORT (Dask), slurm, slurm-here (its jobs on this "
            "machine), ray or ray://HOST:PORT.",
        ),
        click.option(
            "--workers",
            type=click.IntRange(min=1),
            default=None,
            help="Number of processes; results do not depend on it. [default: one per processor]",
        ),
    ):
        command = option(command)
    return command


def number_of_workers(workers: int | None, scheduler: str | None) -> int:
    """Return the number of processes on this machine; by default one per processor.

    Raises:
        click.UsageError: a number, and a cluster, which has its own workers.
    """
    if workers is not None and scheduler is not None:
        raise click.UsageError("--workers and --scheduler exclude each other; the cluster has its own workers")
    return workers or os.cpu_count() or 1


def job_settings(texts: Sequence[str], scheduler: str | None) -> dict[str, str]:
    """Return the settings of jobs given as texts NAME=VALUE (`--job`).

    UsageError if one is invalid, or the scheduler does not run jobs.
    """
    if texts and scheduler not in JOB_CLUSTERS:
        raise UsageError(
            f"--job {texts[0]}: only goes with --scheduler {' or '.join(JOB_CLUSTERS)}", id="not-applicable"
        )
    settings = {}
    for text in texts:
        name, given, value = text.partition("=")
        if not (name and given and value):
            raise UsageError(f"--job {text}: expected NAME=VALUE")
        settings[name] = value
    return settings
