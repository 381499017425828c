"""The workers of a Dask cluster, which somebody else has started."""

from __future__ import annotations

import asyncio
import concurrent.futures
import logging
import threading
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import Any

from occlog import __version__, console
from occlog.errors import InputError, UsageError

from .interface import Lost, R, T, done_alike

_ONE_AT_A_TIME = threading.Lock()
"""Of a worker with several threads: a run changes the working folder and standard error of its whole process."""


class DaskCluster:
    """Workers of a Dask scheduler; they need the same version of occlog."""

    def __init__(self, address: str) -> None:
        """Use the scheduler at this address, e.g. tcp://10.0.0.1:8786."""
        self._address = address

    def outcomes(self, todo: Mapping[str, T], work: Callable[[T], R]) -> Iterator[tuple[str, R | Lost]]:
        """Iterate over the results; `Lost` for a piece of which as many workers died as Dask allows, twice.

        The second time it is alone in the cluster: Dask blames every piece that waited at a worker for its death.
        """
        try:
            import distributed
        except ImportError as error:
            raise UsageError(
                "a scheduler wants the package `distributed`; install occlog[cluster], or use processes of this machine"
            ) from error
        library: Any = distributed  # it has no types
        try:
            # A client that finds no scheduler waits for itself when it is deleted, and complains: ask without one first
            asyncio.run(_greet(library, self._address))
            client = library.Client(self._address, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise UsageError(
                f"scheduler {self._address}: does not answer ({error}); start it, or use processes of this machine"
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
        """Iterate over the results of what is submitted together.

        Raises:
            InputError: the scheduler has gone, or has no occlog that it could read the work with.
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
                    f"scheduler {self._address}: is gone; start it again: the same command goes on where it was"
                ) from error
            except (RuntimeError, ImportError) as error:
                if isinstance(error, RuntimeError) and "deserializ" not in str(error):
                    raise
                words = " ".join(str(error).split())[:120]
                raise InputError(
                    f"scheduler {self._address}: it or a worker cannot read the work ({words}); install occlog "
                    f"{__version__} there, in the environment that it is started in"
                ) from error
            yield running[future], found


async def _greet(library: Any, address: str) -> None:
    """Connect to a scheduler and leave, within the time that the configuration of Dask gives a connection."""
    arguments = library.Security().get_connection_args("client")
    comm = await library.core.connect(address, **arguments)
    await comm.close()


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep what Dask logs of connections, with tracebacks, out of standard error: their end is an error of its own."""
    before = logging.root.manager.disable
    logging.disable()
    try:
        yield
    finally:
        logging.disable(before)


def _in_turn(version: str, work: Callable[[T], R], piece: T) -> R:
    """Do a piece of work while no other thread of this worker does one."""
    with _ONE_AT_A_TIME:
        return done_alike(version, work, piece)
