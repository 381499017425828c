"""The workers of a Dask cluster, which somebody else has started."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from occlog import __version__
from occlog.errors import InputError, UsageError

from .interface import Lost, R, T


class DaskCluster:
    """Workers of a Dask scheduler; they need the same version of occlog."""

    def __init__(self, address: str) -> None:
        """Use the scheduler at this address, e.g. tcp://10.0.0.1:8786."""
        self._address = address

    def outcomes(self, todo: Mapping[str, T], work: Callable[[T], R]) -> Iterator[tuple[str, R | Lost]]:
        """Iterate over the results; `Lost` for a piece that as many workers died of as Dask allows."""
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
        with client:
            _check_versions(client)
            # The scheduler gives one result to all who ask for it by one key: others may have pieces of the same names
            mine = f"occlog-{uuid.uuid4().hex}"
            running = {client.submit(work, piece, key=f"{mine}-{key}"): key for key, piece in todo.items()}
            for future in library.as_completed(running, loop=client.loop):
                if isinstance(future.exception(), library.scheduler.KilledWorker):
                    yield running[future], Lost("its workers died (out of memory, killed, or a crash of a library)")
                else:
                    yield running[future], future.result()


async def _greet(library: Any, address: str) -> None:
    """Connect to a scheduler and leave, within the time that the configuration of Dask gives a connection."""
    arguments = library.Security().get_connection_args("client")
    comm = await library.core.connect(address, **arguments)
    await comm.close()


def _check_versions(client: Any) -> None:
    """Raise InputError for a worker with another version of occlog: its figures would not be comparable."""
    for address, version in client.run(_version).items():
        if version != __version__:
            raise InputError(f"worker {address} has occlog {version}, this is {__version__}; install the same")


def _version() -> str:
    return __version__
