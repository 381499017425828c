"""Notes on standard error, details of `-v`, dry runs, and progress bars.

Interrupts are raised between the steps of progress bars.
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
    """Write a line to a standard stream and flush it; do nothing if the stream is closed (None)."""
    if stream is not None:
        stream.write(f"{spelled(text)}\n")
        stream.flush()


def named(text: str) -> str:
    """Return a text in which paths of temporary files are replaced by their aliases."""
    for path, name in ALIASES.items():
        text = text.replace(path, name)
    return text


@contextmanager
def notes_kept() -> Iterator[list[str]]:
    """Context manager that collects notes in a list (including those that `quiet` drops) instead of writing them."""
    kept: list[str] = []
    token = _KEPT.set(kept)
    try:
        yield kept
    finally:
        _KEPT.reset(token)


def note(message: str, quiet: bool = False) -> None:
    """Write the line `message` to standard error, or append it to the list of `notes_kept` within that context.

    `quiet`: do not write it; within `notes_kept` it is appended nevertheless.
    """
    kept = _KEPT.get()
    if kept is not None:
        kept.append(spelled(message))
    elif not quiet:
        write_line(f"occlog: {shortened(named(spelled(message)))}", sys.stderr)


def note_once(message: str) -> None:
    """Write the note `message` unless this command has written it before (a file may be read several times).

    A quiet command writes warnings only.
    """
    kept = _KEPT.get()
    if message not in (NOTED_ONCE if kept is None else kept):
        NOTED_ONCE.add(message)
        note(message, QUIET.get() and message.startswith("note:"))


def note_findings(texts: Iterable[str], quiet: bool = False) -> None:
    """Write the texts of findings (`records.verdicts.texts_of`) to standard error, a line each, as `note` does."""
    for text in texts:
        note(text, quiet)


def note_losses(losses: Iterable[object]) -> None:
    """Write losses to standard error, a line each, even if notes are collected or dropped."""
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
    """Files that a dry run would read and write.

    Attributes:
        reads: inputs.
        writes: outputs.
    """

    def __init__(self) -> None:
        """Create a plan without files that would be read or written."""
        self.reads: list[Path] = []
        self.writes: list[Path] = []


DRY_RUN: ContextVar[DryRunPlan | None] = ContextVar("DRY_RUN", default=None)
"""Plan of a dry run; None: no dry run."""


class DryRunStop(BaseException):
    """Raised in a dry run when work or writing would begin."""


def log_detail(text: str) -> None:
    """Report a detail (`-v`), such as the detected format of an input, to the listener, if any."""
    listener = LISTENER.get()
    if listener is not None:
        listener(text)


def note_uncached() -> None:
    """Record that a compiled kernel cannot be cached for later processes."""
    _UNCACHED[:] = [True]


def log_compiling() -> None:
    """Report, at the first call of a command, that compiling kernels takes long; later calls do nothing."""
    while COMPILING:
        COMPILING.pop()(not _UNCACHED)


@contextmanager
def logging_to(listener: Callable[[str], None]) -> Iterator[None]:
    """Context manager: call `listener` with each line of details of the code inside."""
    token = LISTENER.set(listener)
    try:
        yield
    finally:
        LISTENER.reset(token)


@contextmanager
def dry_run() -> Iterator[DryRunPlan]:
    """Context manager of a dry run, in which nothing is written; yields the plan of files read and written."""
    plan = DryRunPlan()
    token = DRY_RUN.set(plan)
    try:
        yield plan
    finally:
        DRY_RUN.reset(token)


def begin_work() -> None:
    """Mark the end of all checks, before work or writing begins; raises DryRunStop in a dry run."""
    if DRY_RUN.get() is not None:
        raise DryRunStop


def note_files(reads: Iterable[Path], writes: Iterable[Path]) -> None:
    """In a dry run, record the files that a command reads and writes, each once; otherwise do nothing."""
    plan = DRY_RUN.get()
    if plan is not None:
        plan.reads += [path for path in reads if path not in plan.reads]
        plan.writes += [path for path in writes if path not in plan.writes]


def threads_by_default() -> int:
    """Return the default number of threads: `OCCLOG_THREADS` of the environment, or one per processor."""
    value = os.environ.get(THREADS, "")
    return int(value) if value.isdigit() and int(value) > 0 else os.cpu_count() or 1


T = TypeVar("T")


def progress(items: Iterable[T], label: str, total: int | None = None, *, quiet: bool = False) -> Iterator[T]:
    """Generate the items, with a progress bar on standard error if it is a terminal.

    Args:
        items: what to generate.
        label: text before the bar.
        total: number of items; None: their length, or unknown.
        quiet: show no bar.

    Raises:
        KeyboardInterrupt: an interrupt was dropped earlier.
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
