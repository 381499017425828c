"""The executor that the options of a command ask for."""

from __future__ import annotations

from .dask_cluster import DaskCluster
from .interface import Executor, InThisProcess
from .processes import Processes


def executor_of(workers: int, scheduler: str | None, *, isolated: bool = False) -> Executor:
    """Return what runs the work.

    Args:
        workers: processes of this machine.
        scheduler: address of a Dask scheduler; its workers are used instead.
        isolated: true: one worker is a process of its own too, which may die without harm.
    """
    if scheduler is not None:
        return DaskCluster(scheduler)
    return Processes(workers) if isolated or workers > 1 else InThisProcess()
