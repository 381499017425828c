"""Selection of the executor by the options of a command."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from occlog.errors import UsageError

from .clusters import DaskCluster, Jobs, RayCluster
from .interface import Executor, InThisProcess
from .options import JOB_CLUSTERS, JOB_FOLDER
from .processes import Processes


def executor_of(
    workers: int, scheduler: str | None, jobs: Mapping[str, str], folder: Path | None, *, isolated: bool = False
) -> Executor:
    """Return the executor that the options of a command select.

    Args:
        workers: number of local processes.
        scheduler: address or name of a cluster to use instead; None: local processes.
        jobs: settings of jobs, for schedulers that run jobs.
        folder: for scripts and logs of jobs, unless their settings name one; None: none.
        isolated: whether a single worker is a separate process too, so that it may die without harm.

    Raises:
        UsageError: jobs have no folder.
    """
    if scheduler in JOB_CLUSTERS:
        settings = dict(jobs)
        location = settings.pop(JOB_FOLDER, None) or folder
        if location is None:
            raise UsageError(
                f"--scheduler {scheduler}: give a folder that all machines see: --job {JOB_FOLDER}=PATH",
                id="missing-option",
            )
        return Jobs(JOB_CLUSTERS[scheduler], Path(location), settings)
    if scheduler is not None:
        return RayCluster(scheduler) if scheduler.partition(":")[0] == "ray" else DaskCluster(scheduler)
    return Processes(workers) if isolated or workers > 1 else InThisProcess()
