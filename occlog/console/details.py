"""What a command does on its way, for those who ask for it; and whether it is only to say what it would do."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

LISTENER: ContextVar[Callable[[str], None] | None] = ContextVar("LISTENER", default=None)
"""Who is told of details; None: nobody."""
COMPILING: list[Callable[[bool], None]] = []
"""Who is told, in whatever thread, that this process compiles kernels and takes long, and whether they are kept for
later ones; nobody twice."""
_UNCACHED: list[bool] = []
THREADS = "OCCLOG_THREADS"
"""Variable of the environment: how many threads commands take that are not told how many."""


class Plan:
    """What a dry run would do.

    Attributes:
        reads: inputs.
        writes: outputs.
    """

    def __init__(self) -> None:
        """Nothing yet."""
        self.reads: list[Path] = []
        self.writes: list[Path] = []


DRY_RUN: ContextVar[Plan | None] = ContextVar("DRY_RUN", default=None)
"""What would be done; None: it is done."""


class NothingIsWritten(BaseException):
    """A dry run has come to where the work, or the writing, would begin."""


def tell(text: str) -> None:
    """Tell a detail: what an input is taken for, how long a step took, what was written."""
    listener = LISTENER.get()
    if listener is not None:
        listener(text)


def note_uncached() -> None:
    """Remember that a compiled kernel cannot be kept for later processes."""
    _UNCACHED[:] = [True]


def tell_of_compiling() -> None:
    """Tell, once, that compilation takes long."""
    while COMPILING:
        COMPILING.pop()(not _UNCACHED)


@contextmanager
def told_to(listener: Callable[[str], None]) -> Iterator[None]:
    """Tell somebody of details meanwhile."""
    token = LISTENER.set(listener)
    try:
        yield
    finally:
        LISTENER.reset(token)


@contextmanager
def dry_run() -> Iterator[Plan]:
    """Write nothing meanwhile."""
    plan = Plan()
    token = DRY_RUN.set(plan)
    try:
        yield plan
    finally:
        DRY_RUN.reset(token)


def begin_work() -> None:
    """Say that everything has been checked and that work or writing begins; NothingIsWritten in a dry run."""
    if DRY_RUN.get() is not None:
        raise NothingIsWritten


def note_files(reads: Iterable[Path], writes: Iterable[Path]) -> None:
    """Remember, in a dry run, what a command reads and writes; what is named again counts once."""
    plan = DRY_RUN.get()
    if plan is not None:
        plan.reads += [path for path in reads if path not in plan.reads]
        plan.writes += [path for path in writes if path not in plan.writes]


def threads_by_default() -> int:
    """Threads of a command that is not told how many: one a processor, or what `OCCLOG_THREADS` says."""
    told = os.environ.get(THREADS, "")
    return int(told) if told.isdigit() and int(told) > 0 else os.cpu_count() or 1
