"""Options that select the executor; they import no executor."""

from __future__ import annotations

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


def scheduler_options(command: F) -> F:
    """Add the options `--scheduler` and `--job`, which select where tasks are run."""
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
    ):
        command = option(command)
    return command


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
