"""Runs many trials in this process, in several processes, or on a Dask cluster, and stores each as it finishes.

The result of a trial depends on its description alone, so that any number of workers gives the
same results, in the order of the descriptions.  Finished trials are kept in a file, one JSON object
a line: the process may be killed at any time, and the sweep goes on from there.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import math
import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from io import BufferedWriter
from pathlib import Path
from typing import Any, NamedTuple

from occlog import __version__
from occlog.errors import InputError, OcclogError, OutputError, UsageError

from .trial import Spec, run_trial

Result = dict[str, float]
Trial = Callable[[Spec], Result]
"""Runs a trial; a function of a module, so that other processes can import it."""
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Variables that give each worker one thread: as many workers as processors then share them evenly."""


def key_of(spec: Spec, run: Trial = run_trial) -> str:
    """Hash what identifies a trial: the version of the program, the function that runs it, and its description."""
    text = json.dumps([__version__, run.__module__, run.__qualname__, spec], sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:32]


class Store:
    """Results by key; without a path they are kept in memory only.

    A last line that was cut off is left out and overwritten; its trial is run again.
    """

    def __init__(self, path: Path | None) -> None:
        """Read the file if there is one; InputError for a file of another kind."""
        self.results: dict[str, dict[str, float]] = {}
        self._path = path
        self._file: BufferedWriter | None = None
        self._good = 0
        if path is not None and path.exists():
            self._read(path)

    def _read(self, path: Path) -> None:
        try:
            data = path.read_bytes()
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror}") from error
        for number, line in enumerate(data.split(b"\n")[:-1], start=1):
            try:
                row = json.loads(line)
                self.results[row["key"]] = {n: math.nan if v is None else v for n, v in row["result"].items()}
            except (ValueError, KeyError, TypeError, AttributeError) as error:
                raise InputError(
                    f"{path}: line {number}: is no finished trial; remove the file to begin again"
                ) from error
        self._good = data.rfind(b"\n") + 1

    def __enter__(self) -> Store:
        """Open the file for writing."""
        if self._path is not None:
            try:
                self._path.parent.mkdir(parents=True, exist_ok=True)
                self._file = self._path.open("ab")
                self._file.truncate(self._good)
            except OSError as error:
                raise OutputError(f"{self._path}: cannot be written: {error.strerror}") from error
        return self

    def add(self, key: str, result: dict[str, float]) -> None:
        """Keep a result; it is on the disk when this returns."""
        self.results[key] = result
        if self._file is None:
            return
        row = {"key": key, "result": {n: None if math.isnan(v) else v for n, v in result.items()}}
        try:
            self._file.write(json.dumps(row).encode() + b"\n")
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise OutputError(f"{self._path}: cannot be written: {error.strerror}") from error

    def __exit__(self, *reason: object) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()


class Outcome(NamedTuple):
    """Result of a trial, or why there is none."""

    result: Result | None
    error: str | None


class TrialError(OcclogError):
    """Some trials failed; the others are stored."""


def run_all(
    specs: Sequence[Spec],
    workers: int = 1,
    scheduler: str | None = None,
    store: Path | None = None,
    progress: Callable[[int], None] | None = None,
    run: Trial = run_trial,
) -> list[Result]:
    """Run all trials; return their figures in the order of the descriptions.

    Args:
        specs: descriptions, see `run_trial` (or what `run` takes); equal ones are run once.
        workers: processes on this machine.
        scheduler: address of a Dask scheduler; its workers are used instead.
        store: file of finished trials (JSON lines); those in it are not run again.
        progress: called with the number of trials that have finished since the last call.
        run: runs one trial.

    Raises:
        TrialError: names the first trial that failed; all others were run before.
        UsageError: a scheduler without the package `distributed`, or that does not answer.
    """
    kept = Store(store)
    keys = [key_of(spec, run) for spec in specs]
    todo: dict[str, Spec] = {}
    for key, spec in zip(keys, specs, strict=True):
        if key not in kept.results:
            todo.setdefault(key, spec)
    if progress is not None:
        progress(sum(key in kept.results for key in keys))
    failed: dict[str, str] = {}
    with kept:
        for key, outcome in _outcomes(todo, workers, scheduler, run):
            if outcome.result is None:
                failed[key] = outcome.error or "unknown"
            else:
                kept.add(key, outcome.result)
            if progress is not None:
                progress(keys.count(key))
    if failed:
        number = next(i for i, key in enumerate(keys) if key in failed)
        raise TrialError(
            f"{len(failed)} of {len(specs)} trials failed; the first is trial {number} "
            f"({describe(specs[number])}): {failed[keys[number]]}"
        )
    return [dict(kept.results[key]) for key in keys]


def attempt(spec: Spec, run: Trial) -> Outcome:
    """Run a trial; an error in its description is returned, not raised."""
    try:
        return Outcome(run(spec), None)
    except OcclogError as error:
        return Outcome(None, str(error))


def describe(spec: Spec) -> str:
    """Write a trial in one line, without its scene."""
    return ", ".join(f"{name}={value}" for name, value in spec.items() if name != "scene")


def _outcomes(
    todo: Mapping[str, Spec], workers: int, scheduler: str | None, run: Trial
) -> Iterator[tuple[str, Outcome]]:
    if scheduler is not None:
        yield from _on_cluster(todo, scheduler, run)
    elif workers > 1 and len(todo) > 1:
        yield from _in_processes(todo, min(workers, len(todo)), run)
    else:
        for key, spec in todo.items():
            yield key, attempt(spec, run)


def _in_processes(todo: Mapping[str, Spec], workers: int, run: Trial) -> Iterator[tuple[str, Outcome]]:
    """Run trials in new processes, which inherit no state of this one."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), initializer=_leave_with_parent)
    try:
        running = {pool.submit(attempt, spec, run): key for key, spec in todo.items()}
        for future in as_completed(running):
            yield running[future], future.result()
    except BaseException:
        # Interrupted: end the processes without waiting for their trials.
        for process in list((pool._processes or {}).values()):
            process.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _leave_with_parent() -> None:
    """End this worker when the process that started it has ended, in whatever way."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def wait() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


async def _greet(library: Any, scheduler: str) -> None:
    """Connect to a scheduler and leave, within the time that the configuration of Dask gives a connection."""
    arguments = library.Security().get_connection_args("client")
    comm = await library.core.connect(scheduler, **arguments)
    await comm.close()


def _on_cluster(todo: Mapping[str, Spec], scheduler: str, run: Trial) -> Iterator[tuple[str, Outcome]]:
    try:
        import distributed
    except ImportError as error:
        raise UsageError(
            "a scheduler wants the package `distributed`; install occlog[cluster], or use processes of this machine"
        ) from error
    library: Any = distributed  # it has no types
    try:
        # A client that finds no scheduler waits for itself when it is deleted, and complains: ask without one first
        asyncio.run(_greet(library, scheduler))
        client = library.Client(scheduler, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise UsageError(
            f"scheduler {scheduler}: does not answer ({error}); start it, or use processes of this machine"
        ) from error
    with client:
        _check_versions(client)
        running = {client.submit(attempt, dict(spec), run, key=f"occlog-{key}"): key for key, spec in todo.items()}
        for future in library.as_completed(running, loop=client.loop):
            yield running[future], future.result()


def _check_versions(client: Any) -> None:
    """Raise InputError for a worker with another version of occlog: its figures would not be comparable."""
    from occlog import __version__

    for address, version in client.run(_version).items():
        if version != __version__:
            raise InputError(f"worker {address} has occlog {version}, this is {__version__}; install the same")


def _version() -> str:
    from occlog import __version__

    return __version__
