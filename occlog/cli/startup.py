"""Notice on standard error while a first run compiles kernels; and the limit of open files.

A decoding process uses four files, and there is one for each video.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress

import click

from occlog.console.notes import COMPILING, QUIET

KEPT = "once for this command and its method; later runs start at once"
NOT_KEPT = (
    "in every run, since neither the folder of the program nor the user's cache folder can be written; set "
    "NUMBA_CACHE_DIR to a folder that can"
)


class UnknownNameError(click.UsageError):
    """Usage error for a command or a method that occlog does not have."""


@contextmanager
def with_compile_notice() -> Iterator[None]:
    """Context manager that reports once if compiling kernels takes long, unless the command is quiet."""

    def say(kept: bool) -> None:
        if not QUIET.get():
            click.echo(f"occlog: compiling, {KEPT if kept else NOT_KEPT}", err=True)

    COMPILING.append(say)
    try:
        yield
    finally:
        if say in COMPILING:
            COMPILING.remove(say)


def remember_quiet(ctx: click.Context, param: click.Parameter, given: bool) -> bool:  # noqa: ARG001
    """Callback of `--quiet`: return its value `given`, and hold it in `QUIET` until the command ends."""
    token = QUIET.set(given)
    ctx.call_on_close(lambda: QUIET.reset(token))
    return given


with suppress(ImportError):  # no such limits on Windows
    import resource

WANTED_OPEN_FILES = 65_536
"""Open files that are enough for some thousands of cameras."""


def allow_open_files() -> None:
    """Raise the soft limit of open files (often 1024) to the required value, as far as the hard limit allows."""
    if "resource" in globals():
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        most = WANTED_OPEN_FILES if hard == resource.RLIM_INFINITY else min(hard, WANTED_OPEN_FILES)
        if soft != resource.RLIM_INFINITY and soft < most:
            with suppress(ValueError, OSError):
                resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))


def open_files_limit() -> int | None:
    """Return the current soft limit of open files; None if there is none (unlimited, or Windows)."""
    if "resource" not in globals():
        return None
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return None if soft == resource.RLIM_INFINITY else soft
