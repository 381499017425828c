"""Interface of executors, which run independent tasks and return each outcome as it is available."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple, Protocol, TypeVar

from occlog import __version__
from occlog.errors import InputError

T = TypeVar("T")
R = TypeVar("R")


class Lost(NamedTuple):
    """Placeholder for the result of a task that was lost because its worker died.

    Attributes:
        reason: end of the worker, in words.
    """

    reason: str


class Executor(Protocol):
    """Interface of executors, which run independent tasks in any order, possibly in parallel."""

    def outcomes(self, todo: Mapping[str, T], work: Callable[[T], R]) -> Iterator[tuple[str, R | Lost]]:
        """Generate key and result of every task, in the order in which they finish.

        Args:
            todo: tasks by key; other processes must be able to unpickle them.
            work: runs one task; a function of a module, so that other processes can import it. An error that concerns
                one task alone is to be returned; an exception ends the iteration.

        Raises:
            UsageError: the executor requires a package that is not installed, or does not answer.
        """
        ...


def done_alike(version: str, work: Callable[[T], R], piece: T) -> R:
    """Return work(piece) on a worker; InputError if the worker's occlog has another version than `version`."""
    if version != __version__:
        raise InputError(
            f"a worker has occlog {__version__}, this machine {version}; install {version} there", id="version-mismatch"
        )
    return work(piece)


class InThisProcess:
    """Executor that runs one task after another in this process."""

    def outcomes(self, todo: Mapping[str, T], work: Callable[[T], R]) -> Iterator[tuple[str, R | Lost]]:
        """Generate key and result work(piece) of each task in `todo` (by key), in their order, run in this process."""
        for key, piece in todo.items():
            yield key, work(piece)
