"""Lines on standard error, and the standard streams that they are written to.

What a command does on its way, for those who ask for it; and whether it is only to state what it would do.

Progress bars, between the steps of which interrupts are raised.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TextIO, TypeVar

from occlog.errors import spelled

from .interrupts import INTERRUPTS
from .text import shortened

ALIASES: dict[str, str] = {}
"""Paths of temporary files and the names to report instead, such as that which holds standard input."""
NOTED_ONCE: set[str] = set()
"""Lines of `note_once` of the command that runs."""
QUIET: ContextVar[bool] = ContextVar("QUIET", default=False)
"""True in a command that writes no notes on standard error."""
_KEPT: ContextVar[list[str] | None] = ContextVar("_KEPT", default=None)


def write_line(text: str, stream: TextIO | None) -> None:
    """Write a line to a standard stream at once; nothing where the stream is closed (None)."""
    if stream is not None:
        stream.write(f"{spelled(text)}\n")
        stream.flush()


def named(text: str) -> str:
    """A text for the user, with the aliases of temporary files in place of their paths."""
    for path, name in ALIASES.items():
        text = text.replace(path, name)
    return text


@contextmanager
def notes_kept() -> Iterator[list[str]]:
    """Keep notes in a list inside the block, also those that `quiet` would drop, and write none on standard error."""
    kept: list[str] = []
    token = _KEPT.set(kept)
    try:
        yield kept
    finally:
        _KEPT.reset(token)


def note(message: str, quiet: bool = False) -> None:
    """Write a line to standard error, or append it to the list of `notes_kept`."""
    kept = _KEPT.get()
    if kept is not None:
        kept.append(spelled(message))
    elif not quiet:
        write_line(f"occlog: {shortened(named(spelled(message)))}", sys.stderr)


def note_once(message: str) -> None:
    """Write a line that readers of a file come to at each pass through it, once in a command.

    A quiet command writes its warnings alone.
    """
    kept = _KEPT.get()
    if message not in (NOTED_ONCE if kept is None else kept):
        NOTED_ONCE.add(message)
        note(message, QUIET.get() and message.startswith("note:"))


def note_findings(texts: Iterable[str], quiet: bool = False) -> None:
    """Write the findings on results to standard error, a line each; see `records.verdicts.texts_of`."""
    for text in texts:
        note(text, quiet)


def note_losses(losses: Iterable[object]) -> None:
    """Write the losses to standard error, a line each, also where notes are kept or dropped."""
    for loss in losses:
        write_line(shortened(named(" ".join(f"occlog: lost: {loss}".split()))), sys.stderr)


LISTENER: ContextVar[Callable[[str], None] | None] = ContextVar("LISTENER", default=None)
"""Receiver of details; None: none."""
COMPILING: list[Callable[[bool], None]] = []
"""Receiver of the note, in any thread, that this process compiles kernels, and whether they are kept for
later ones; each receiver once."""
_UNCACHED: list[bool] = []
THREADS = "OCCLOG_THREADS"
"""Variable of the environment: how many threads commands take that are not given how many."""


class DryRunPlan:
    """Plan of a dry run.

    Attributes:
        reads: inputs.
        writes: outputs.
    """

    def __init__(self) -> None:
        """Create an empty plan."""
        self.reads: list[Path] = []
        self.writes: list[Path] = []


DRY_RUN: ContextVar[DryRunPlan | None] = ContextVar("DRY_RUN", default=None)
"""Plan of a dry run; None: no dry run."""


class DryRunStop(BaseException):
    """A dry run has come to where the work, or the writing, would begin."""


def log_detail(text: str) -> None:
    """Report a detail: the detected format of an input, how long a step took, the files written."""
    listener = LISTENER.get()
    if listener is not None:
        listener(text)


def note_uncached() -> None:
    """Remember that a compiled kernel cannot be kept for later processes."""
    _UNCACHED[:] = [True]


def log_compiling() -> None:
    """Report once that compilation takes long."""
    while COMPILING:
        COMPILING.pop()(not _UNCACHED)


@contextmanager
def logging_to(listener: Callable[[str], None]) -> Iterator[None]:
    """Send details to a receiver meanwhile."""
    token = LISTENER.set(listener)
    try:
        yield
    finally:
        LISTENER.reset(token)


@contextmanager
def dry_run() -> Iterator[DryRunPlan]:
    """Write nothing meanwhile."""
    plan = DryRunPlan()
    token = DRY_RUN.set(plan)
    try:
        yield plan
    finally:
        DRY_RUN.reset(token)


def begin_work() -> None:
    """Report that everything has been checked and that work or writing begins; NothingIsWritten in a dry run."""
    if DRY_RUN.get() is not None:
        raise DryRunStop


def note_files(reads: Iterable[Path], writes: Iterable[Path]) -> None:
    """Remember, in a dry run, what a command reads and writes; repeated names count once."""
    plan = DRY_RUN.get()
    if plan is not None:
        plan.reads += [path for path in reads if path not in plan.reads]
        plan.writes += [path for path in writes if path not in plan.writes]


def threads_by_default() -> int:
    """Threads of a command that is not given how many: one a processor, or what `OCCLOG_THREADS` states."""
    value = os.environ.get(THREADS, "")
    return int(value) if value.isdigit() and int(value) > 0 else os.cpu_count() or 1


T = TypeVar("T")


def progress(items: Iterable[T], label: str, total: int | None = None, *, quiet: bool = False) -> Iterator[T]:
    """The items, with a progress bar on standard error when that is a terminal.

    Raises:
        KeyboardInterrupt: there was an interrupt that got lost.
    """
    begin_work()
    start, count = time.perf_counter(), 0
    if not quiet and sys.stderr.isatty():
        from tqdm import tqdm

        items = tqdm(items, desc=label, total=total, file=sys.stderr, leave=False)
    for item in items:
        INTERRUPTS.check()
        count += 1
        yield item
    log_detail(f"{label}: {count} parts in {time.perf_counter() - start:.2f} s")
