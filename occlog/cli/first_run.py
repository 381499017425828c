"""A line on standard error where a first run compiles for long, so that nobody takes it for stuck."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import click

from occlog.console.details import COMPILING

QUIET = "occlog.quiet"
"""Key of `--quiet` in the metadata of click's context."""
KEPT = "once for this command and its method; later runs start at once"
NOT_KEPT = (
    "in every run, since neither the folder of the program nor the user's cache folder can be written; set "
    "NUMBA_CACHE_DIR to a folder that can"
)


@contextmanager
def announced(root: click.Context) -> Iterator[None]:
    """Say once that kernels are compiled, if that takes long meanwhile and the command of this context is not quiet."""

    def say(kept: bool) -> None:
        if not root.meta.get(QUIET):
            click.echo(f"occlog: compiling, {KEPT if kept else NOT_KEPT}", err=True)

    COMPILING.append(say)
    try:
        yield
    finally:
        if say in COMPILING:
            COMPILING.remove(say)


def note_quiet(ctx: click.Context, param: click.Parameter, given: bool) -> bool:  # noqa: ARG001
    """Remember `--quiet`; the quiet stages of a run have contexts of their own."""
    ctx.find_root().meta[QUIET] = given
    return given
