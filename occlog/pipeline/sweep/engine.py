"""Execution of many trials on an executor, with storage of each result.

The result of a trial depends on its description only, so that any number of workers gives the same results, in the
order of the descriptions. Finished trials are stored in a file, one JSON object per line, so that an interrupted sweep
can be resumed.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from io import BufferedWriter
from pathlib import Path
from typing import NamedTuple

from occlog import __version__
from occlog.errors import InputError, OcclogError, OutputError
from occlog.io.files.atomic import alone_with
from occlog.pipeline.executors.chosen import executor_of
from occlog.pipeline.executors.interface import Lost
from occlog.pipeline.executors.options import JOBS_FOLDER

from .trial import Spec, run_trial

Result = dict[str, float]
Trial = Callable[[Spec], Result]
"""Runs a trial; a function of a module, so that other processes can import it."""


def key_of(spec: Spec, run: Trial = run_trial) -> str:
    """Return the hash that identifies a trial, made of program version, function and specification."""
    text = json.dumps([__version__, run.__module__, run.__qualname__, spec], sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:32]


class Store:
    """Store of the results of trials by key, in memory and (with a path) in a file of JSON lines.

    A truncated last line is overwritten; its trial is repeated.
    """

    def __init__(self, path: Path | None) -> None:
        """Read the file `path` if it exists (None: keep results in memory only).

        InputError for another kind of file.
        """
        self.results: dict[str, dict[str, float]] = {}
        self._path = path
        self._file: BufferedWriter | None = None
        self._good = 0
        self._opened = ExitStack()
        if path is not None and path.exists():
            self._read(path)

    def _read(self, path: Path) -> None:
        try:
            data = path.read_bytes()
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror}", id="unreadable-file") from error
        for number, line in enumerate(data.split(b"\n")[:-1], start=1):
            try:
                row = json.loads(line)
                self.results[row["key"]] = {n: math.nan if v is None else float(v) for n, v in row["result"].items()}
            except (ValueError, KeyError, TypeError, AttributeError) as error:
                raise InputError(
                    f"{path}: line {number}: is no finished trial; remove the file to begin again", id="damaged-file"
                ) from error
        self._good = data.rfind(b"\n") + 1

    def __enter__(self) -> Store:
        """Open the file of the results for writing, drop an incomplete last line, and return the store.

        OutputError if it cannot be written; another sweep may not use it at the same time.
        """
        if self._path is not None:
            try:
                self._path.parent.mkdir(parents=True, exist_ok=True)
                with ExitStack() as stack:
                    self._file = stack.enter_context(self._path.open("ab"))
                    stack.enter_context(alone_with(self._path, "sweep"))
                    self._read(self._path)  # another may have added to it
                    self._file.truncate(self._good)
                    self._opened = stack.pop_all()
            except OSError as error:
                raise OutputError(f"{self._path}: cannot be written: {error.strerror}") from error
        return self

    def add(self, key: str, result: dict[str, float]) -> None:
        """Store a result; it is on the disk when this returns."""
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

    def __exit__(self, kind: object, *_: object) -> None:
        """Close the file, removing it if empty; OutputError if writing fails, unless another error is being handled."""
        if self._file is not None and self._path is not None:
            try:
                self._file.close()
                if not self.results:
                    self._path.unlink(missing_ok=True)
            except OSError as error:
                if kind is None:
                    raise OutputError(f"{self._path}: cannot be written: {error.strerror}") from error
            finally:
                self._opened.close()


class TrialOutcome(NamedTuple):
    """Outcome of a trial; exactly one of the two is not None.

    Attributes:
        result: figures of the trial.
        error: message why it failed.
    """

    result: Result | None
    error: str | None


class TrialError(OcclogError):
    """Error that states which trials failed; the results of the others are stored."""


def run_all(
    specs: Sequence[Spec],
    workers: int = 1,
    scheduler: str | None = None,
    store: Path | None = None,
    progress: Callable[[int], None] | None = None,
    run: Trial = run_trial,
    jobs: Mapping[str, str] | None = None,
) -> list[Result]:
    """Run all trials; return their figures in the order of the specifications.

    Args:
        specs: specifications, see `run_trial` (or what `run` takes); equal ones are run once.
        workers: number of local processes.
        scheduler: address or name of a cluster to use instead, as for `--scheduler`; None: local processes.
        store: file of finished trials (JSON lines), which are not run again; None: none.
        progress: called with the number of trials that have finished since the last call.
        run: runs one trial.
        jobs: settings of jobs, for schedulers that run jobs.

    Raises:
        TrialError: names the first trial that failed; all others were run before.
        UsageError: a scheduler with a package that is not installed, or that does not answer.
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
        folder = None if store is None else store.parent / JOBS_FOLDER
        for key, outcome in _outcomes(todo, workers, scheduler, run, jobs or {}, folder):
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
            f"({describe(specs[number], specs)}): {failed[keys[number]]}"
        )
    return [dict(kept.results[key]) for key in keys]


def attempt(spec: Spec, run: Trial) -> TrialOutcome:
    """Return the outcome of run(spec): its figures, or the message of an OcclogError, which is not raised."""
    try:
        return TrialOutcome(run(spec), None)
    except OcclogError as error:
        return TrialOutcome(None, str(error))


def describe(spec: Spec, specs: Sequence[Spec]) -> str:
    """Return the values that distinguish a trial from the others (`specs`), in one line of text."""
    own = (name for name in spec if any(other.get(name) != spec[name] for other in specs))
    return ", ".join(f"{name}={spec[name]}" for name in own) or "the only one"


def _outcomes(
    todo: Mapping[str, Spec],
    workers: int,
    scheduler: str | None,
    run: Trial,
    jobs: Mapping[str, str],
    folder: Path | None,
) -> Iterator[tuple[str, TrialOutcome]]:
    executor = executor_of(min(workers, len(todo)), scheduler, jobs, folder)
    for key, found in executor.outcomes({key: dict(spec) for key, spec in todo.items()}, partial(attempt, run=run)):
        yield key, TrialOutcome(None, found.reason) if isinstance(found, Lost) else found
