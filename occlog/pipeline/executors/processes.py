"""Executor with local processes of one thread each; one that dies loses its own task only."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import islice
from typing import Generic

from occlog.console.notes import THREADS

from .interface import Lost, R, T

SAFE_PATH = {"PYTHONSAFEPATH": "1"}
"""Workers search for no modules in the current folder, where a file `pickle.py` would run instead of Python's."""
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", THREADS)
"""Variables that give each worker one thread: as many workers as processors then share them evenly."""
AHEAD = 2
"""Pieces of work that are handed to each process at a time: one that it does, and the next."""
DIED = "its process died (out of memory, killed, or a crash of a library)"


class Processes:
    """Executor with new local processes of one thread each, which inherit no state of this one."""

    def __init__(self, workers: int) -> None:
        """Use the number `workers` of processes, at least 1."""
        self._workers = workers

    def outcomes(self, todo: Mapping[str, T], work: Callable[[T], R]) -> Iterator[tuple[str, R | Lost]]:
        """Generate key and result of each task as it ends.

        `Lost` for a task with a process that died twice, the second time with this task alone.

        Args:
            todo: tasks by key.
            work: function of a task.
        """
        rest = dict(todo)
        while rest:
            pool = _Pool(min(self._workers, len(rest)), work)
            for key, result in pool.outcomes(rest):
                del rest[key]
                yield key, result
            # Of those that were under way when a process died, one has killed it: each is tried by itself
            for key in pool.under_way:
                alone = {key: rest.pop(key)}
                yield next(_Pool(1, work).outcomes(alone), (key, Lost(DIED)))


class _Pool(Generic[T, R]):
    """Pool of processes that lasts until one of them dies.

    Attributes:
        under_way: keys of the tasks that processes had when one of them died.
    """

    def __init__(self, workers: int, work: Callable[[T], R]) -> None:
        self.under_way: list[str] = []
        self._workers, self._work = workers, work

    def outcomes(self, todo: Mapping[str, T]) -> Iterator[tuple[str, R]]:
        """Generate key and result of each of the tasks `todo` as it ends.

        Incomplete if a process dies (see `under_way`).
        """
        waiting = iter(list(todo.items()))
        running: dict[Future[R], str] = {}
        with _one_thread_each():
            spawn = multiprocessing.get_context("spawn")
            pool = ProcessPoolExecutor(self._workers, spawn, initializer=_leave_with_parent)
            try:
                while True:
                    for key, piece in islice(waiting, AHEAD * self._workers - len(running)):
                        running[pool.submit(self._work, piece)] = key
                    if not running:
                        return
                    done, _ = wait(running, return_when=FIRST_COMPLETED)
                    for future in sorted(done, key=list(running).index):
                        result = future.result()
                        yield running.pop(future), result
            except BrokenProcessPool:
                # Finished work keeps its result
                whole = [f for f in running if f.done() and not f.cancelled() and f.exception() is None]
                for future in whole:
                    yield running.pop(future), future.result()
                self.under_way = list(running.values())
            except BaseException:
                # Interrupted: end the processes without waiting for their work
                for process in list((pool._processes or {}).values()):
                    process.terminate()
                raise
            finally:
                pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Context manager in which started processes have one thread."""
    own = dict.fromkeys(ONE_THREAD, "1") | SAFE_PATH
    before = {name: os.environ.get(name) for name in own}
    os.environ.update(own)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _leave_with_parent() -> None:
    """Let this worker ignore Ctrl-C, which the parent handles, and end it when its parent has ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def leave() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=leave, daemon=True).start()
