"""Jobs of Slurm, by submitit; or the same jobs as processes of this machine, to try them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from occlog.errors import UsageError

from .interface import Lost, R, T
from .processes import Processes

JOBS = 10
"""Jobs that the work is dealt out to by default."""
POLL_S = 10.0
"""Time between two looks at jobs [s]."""


class Jobs:
    """Jobs that share the pieces of work; each does one piece after another, in a process beside it."""

    def __init__(self, cluster: str, folder: Path, settings: Mapping[str, str]) -> None:
        """Use jobs on a cluster.

        Args:
            cluster: "slurm", or "local" for processes of this machine.
            folder: for job scripts, logs and results, which all machines see.
            settings: `jobs` (how many), and parameters of submitit, e.g. `slurm_partition`, `timeout_min`, `mem_gb`.

        Raises:
            UsageError: `jobs` is no number above 0.
        """
        told = dict(settings)
        count = told.pop("jobs", str(JOBS))
        if not count.isdecimal() or not int(count):
            raise UsageError(f"--job jobs={count}: want a number above 0")
        self._cluster, self._folder, self._count, self._settings = cluster, folder, int(count), told

    def outcomes(self, todo: Mapping[str, T], work: Callable[[T], R]) -> Iterator[tuple[str, R | Lost]]:
        """Iterate over the results as jobs end; `Lost` for every piece of a job that did not come to its end."""
        library = _library()
        if not self._folder.exists():
            # Others of this machine are not to read what jobs are given
            self._folder.mkdir(parents=True, mode=0o700)
        keys = list(todo)
        shares = [keys[start :: self._count] for start in range(min(self._count, len(keys)))]
        executor = self._executor(library)
        with executor.batch():
            jobs = [executor.submit(_each, work, [(key, todo[key]) for key in share]) for share in shares]
        dealt = dict(zip((job.job_id for job in jobs), shares, strict=True))
        try:
            for job in library.helpers.as_completed(jobs, poll_frequency=POLL_S):
                try:
                    results = job.result()
                except library.core.utils.UncompletedJobError as error:
                    reason = f"job {job.job_id} ended early ({' '.join(str(error).split())[:120]}); see {self._folder}"
                    yield from ((key, Lost(reason)) for key in dealt[job.job_id])
                else:
                    yield from results
        except BaseException:
            for job in jobs:
                job.cancel(check=False)
            raise
        finally:
            # What the jobs were given may name URLs that are signed
            for job in jobs:
                job.paths.submitted_pickle.unlink(missing_ok=True)

    def _executor(self, library: Any) -> Any:
        try:
            executor = library.AutoExecutor(folder=self._folder, cluster=self._cluster)
            executor.update_parameters(
                name="occlog", **{name: _number(value) for name, value in self._settings.items()}
            )
        except (NameError, TypeError, ValueError, RuntimeError) as error:
            raise UsageError(f"--job: {' '.join(str(error).split())[:160]}") from error
        return executor


def _library() -> Any:
    try:
        import submitit
    except ImportError as error:
        raise UsageError("jobs want the package `submitit`; install occlog[slurm]") from error
    return submitit


def _number(value: str) -> object:
    return int(value) if value.isdecimal() else value


def _each(work: Callable[[T], R], pieces: list[tuple[str, T]]) -> list[tuple[str, R | Lost]]:
    """Do the pieces of a job, in a process of its own: one that dies would end the job before the others, each time."""
    return list(Processes(1).outcomes(dict(pieces), work))
