"""Executors on clusters.

Dask (started by others), Ray (or a local Ray), and Slurm jobs by submitit (or local processes).
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import logging
import threading
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from occlog import __version__, console
from occlog.errors import InputError, UsageError

from .interface import Lost, R, T, done_alike
from .processes import ONE_THREAD, SAFE_PATH, Processes

_ONE_AT_A_TIME = threading.Lock()
"""Lock of a worker with several threads: a run changes the working folder and standard error of its whole process."""


class DaskCluster:
    """Workers of a Dask scheduler; they need the same version of occlog."""

    def __init__(self, address: str) -> None:
        """Store the address of a Dask scheduler, for example tcp://10.0.0.1:8786; connect later."""
        self._address = address

    def outcomes(self, todo: Mapping[str, T], work: Callable[[T], R]) -> Iterator[tuple[str, R | Lost]]:
        """Generate key and result of each task as it ends.

        `Lost` if its workers died as often as Dask allows, twice. The second time it runs alone, since Dask blames
        every task that waited at a dead worker.

        Args:
            todo: tasks by key.
            work: function of a task.

        Raises:
            UsageError: Dask is not installed, or the scheduler does not answer.
        """
        try:
            import distributed
        except ImportError as error:
            raise UsageError(
                "a scheduler requires the package distributed; pip install distributed, or use local processes",
                id="missing-package",
            ) from error
        library: Any = distributed  # it has no types
        try:
            # A client that finds no scheduler waits for itself when it is deleted, and complains: ask without one first
            asyncio.run(_greet(library, self._address))
            client = library.Client(self._address, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise UsageError(
                f"scheduler {self._address}: does not answer ({error}); start it, or use processes of this machine",
                id="scheduler-failed",
            ) from error
        with _quiet(), client:
            if not client.nthreads():
                console.note(f"scheduler {self._address} has no workers; work begins when there is one")
            done = partial(_in_turn, __version__, work)
            died = []
            for key, found in self._submitted(library, client, todo, done):
                if isinstance(found, Lost):
                    died.append(key)
                else:
                    yield key, found
            for key in died:
                yield from self._submitted(library, client, {key: todo[key]}, done)

    def _submitted(
        self, library: Any, client: Any, todo: Mapping[str, T], work: Callable[[T], R]
    ) -> Iterator[tuple[str, R | Lost]]:
        """Generate key and result of each of the tasks `todo`, which are submitted together.

        Args:
            library: the module `distributed`.
            client: client of the scheduler.
            todo: tasks by key.
            work: function of a task.

        Raises:
            InputError: the scheduler is gone, or it or a worker cannot read the tasks (without this version of occlog).
        """
        # The scheduler gives one result to all who ask for it by one key: others may have pieces of the same names
        mine = f"occlog-{uuid.uuid4().hex}"
        running = {client.submit(work, piece, key=f"{mine}-{key}"): key for key, piece in todo.items()}
        for future in library.as_completed(running, loop=client.loop):
            try:
                found: R | Lost = future.result()
            except library.scheduler.KilledWorker:
                found = Lost("its workers died (out of memory, killed, or a crash of a library)")
            except (asyncio.CancelledError, concurrent.futures.CancelledError) as error:
                raise InputError(
                    f"scheduler {self._address}: is gone; start it and repeat this command, which goes on where it was",
                    id="scheduler-failed",
                ) from error
            except (RuntimeError, ImportError) as error:
                if isinstance(error, RuntimeError) and "deserializ" not in str(error):
                    raise
                words = " ".join(str(error).split())[:120]
                raise InputError(
                    f"scheduler {self._address}: it or a worker cannot read the work ({words}); install occlog "
                    f"{__version__} there, in the environment that it is started in",
                    id="scheduler-failed",
                ) from error
            yield running[future], found


async def _greet(library: Any, address: str) -> None:
    """Connect to the Dask scheduler at `address` and close; OSError if it does not answer in time.

    `library`: the module `distributed`.
    """
    arguments = library.Security().get_connection_args("client")
    comm = await library.core.connect(address, **arguments)
    await comm.close()


@contextmanager
def _quiet() -> Iterator[None]:
    """Context manager that silences all logging, such as that of Dask about its connections."""
    before = logging.root.manager.disable
    logging.disable()
    try:
        yield
    finally:
        logging.disable(before)


def _in_turn(version: str, work: Callable[[T], R], piece: T) -> R:
    """Return work(piece), one at a time among the threads of this worker; InputError for another version of occlog."""
    with _ONE_AT_A_TIME:
        return done_alike(version, work, piece)


class RayCluster:
    """Workers of Ray, each a process with one thread."""

    def __init__(self, address: str) -> None:
        """Use the cluster at `address`, e.g. ray://10.0.0.1:10001; `ray` starts one locally."""
        self._address = address

    def outcomes(self, todo: Mapping[str, T], work: Callable[[T], R]) -> Iterator[tuple[str, R | Lost]]:
        """Generate key and result of each task as it ends; `Lost` if its worker died as often as Ray allows.

        Args:
            todo: tasks by key.
            work: function of a task.

        Raises:
            UsageError: Ray is not installed, or the scheduler does not answer.
        """
        try:
            import ray
        except ImportError as error:
            raise UsageError(
                "Ray is not installed; pip install 'ray[client]', or use processes of this machine",
                id="missing-package",
            ) from error
        library: Any = ray
        try:
            library.init(
                address=None if self._address == "ray" else self._address,
                runtime_env={"env_vars": dict.fromkeys(ONE_THREAD, "1") | SAFE_PATH},
                log_to_driver=False,
                include_dashboard=False if self._address == "ray" else None,
            )
        except (ConnectionError, RuntimeError, ValueError, OSError) as error:
            raise UsageError(
                f"scheduler {self._address}: does not answer ({error}); start it", id="scheduler-failed"
            ) from error
        try:
            # It takes functions alone, not those with some arguments bound
            remote = library.remote(num_cpus=1)(done_alike)
            running = {remote.remote(__version__, work, piece): key for key, piece in todo.items()}
            while running:
                (done, *_), _ = library.wait(list(running))
                try:
                    result = library.get(done)
                except (library.exceptions.WorkerCrashedError, library.exceptions.OutOfMemoryError) as error:
                    result = Lost(f"its worker died ({type(error).__name__})")
                yield running.pop(done), result
        finally:
            library.shutdown()


JOBS = 10
"""Jobs that the work is dealt out to by default."""
POLL_S = 10.0
"""Polling interval of jobs [s]."""


class Jobs:
    """Executor on a batch system: tasks are divided among jobs.

    Each runs its tasks one after another, in subprocesses.
    """

    def __init__(self, cluster: str, folder: Path, settings: Mapping[str, str]) -> None:
        """Configure jobs on a cluster.

        Args:
            cluster: "slurm", or "local" for processes of this machine.
            folder: for job scripts, logs and results, which all machines see.
            settings: `jobs` (how many), and parameters of submitit, e.g. `slurm_partition`, `timeout_min`, `mem_gb`.

        Raises:
            UsageError: `jobs` is no number above 0.
        """
        options = dict(settings)
        count = options.pop("jobs", str(JOBS))
        if not count.isdecimal() or not int(count):
            raise UsageError(f"--job jobs={count}: expected a number above 0")
        self._cluster, self._folder, self._count, self._settings = cluster, folder, int(count), options

    def outcomes(self, todo: Mapping[str, T], work: Callable[[T], R]) -> Iterator[tuple[str, R | Lost]]:
        """Generate key and result of each task as jobs end; `Lost` for every task of a job that did not finish.

        Args:
            todo: tasks by key.
            work: function of a task.
        """
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
        raise UsageError("jobs require the package submitit; pip install submitit", id="missing-package") from error
    return submitit


def _number(value: str) -> object:
    return int(value) if value.isdecimal() else value


def _each(work: Callable[[T], R], pieces: list[tuple[str, T]]) -> list[tuple[str, R | Lost]]:
    """Return key and result of each task of a job, or `Lost` for a task that crashed.

    Tasks run one after the other in a subprocess, so that a crash does not end the job.

    Args:
        work: function of a task.
        pieces: (key, task) of each task.
    """
    return list(Processes(1).outcomes(dict(pieces), work))
