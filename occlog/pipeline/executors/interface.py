"""Interface of executors: run independent pieces of work, and hand over each outcome as it comes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple, Protocol, TypeVar

from occlog import __version__
from occlog.errors import InputError

T = TypeVar("T")
R = TypeVar("R")


class Lost(NamedTuple):
    """Replacement of the result of a piece of work with a dead worker.

    Attributes:
        reason: description of the end.
    """

    reason: str


class Executor(Protocol):
    """Runs pieces of work, in any order and side by side."""

    def outcomes(self, todo: Mapping[str, T], work: Callable[[T], R]) -> Iterator[tuple[str, R | Lost]]:
        """Iterate over the key and the result of every piece, in the order in which they finish.

        Args:
            todo: pieces of work by their keys; other processes must be able to read them.
            work: does one; a function of a module, so that other processes can import it.  What it raises ends the
                iteration: it returns errors that concern one piece alone.

        Raises:
            UsageError: the executor requires a package that is not installed, or does not answer.
        """
        ...


def done_alike(version: str, work: Callable[[T], R], piece: T) -> R:
    """Do a piece of work on another machine; InputError where its occlog is another one, with other figures."""
    if version != __version__:
        raise InputError(
            f"a worker has occlog {__version__}, this is {version}; install the same", id="version-mismatch"
        )
    return work(piece)


class InThisProcess:
    """Does one piece after another, here."""

    def outcomes(self, todo: Mapping[str, T], work: Callable[[T], R]) -> Iterator[tuple[str, R | Lost]]:
        """Iterate over the results in the order of the pieces."""
        for key, piece in todo.items():
            yield key, work(piece)
