"""Lines on standard error, and the standard streams that they are written to."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TextIO

from occlog.console.text import told
from occlog.errors import spelled

ALIASES: dict[str, str] = {}
"""Paths of temporary files and the names to report in their place, such as that which holds standard input."""
_KEPT: ContextVar[list[str] | None] = ContextVar("_KEPT", default=None)


def write_line(text: str, stream: TextIO | None) -> None:
    """Write a line to a standard stream at once; nothing where the stream is closed (None)."""
    if stream is not None:
        stream.write(f"{spelled(text)}\n")
        stream.flush()


def named(text: str) -> str:
    """A text for the user, with the aliases of temporary files in the place of their paths."""
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
        write_line(f"occlog: {told(named(spelled(message)))}", sys.stderr)


def note_findings(texts: Iterable[str], quiet: bool = False) -> None:
    """Write what was found in checking results to standard error, a line each; see `records.verdicts.texts_of`."""
    for text in texts:
        note(text, quiet)


def note_losses(losses: Iterable[object]) -> None:
    """Write what was lost to standard error, a line each, also where notes are kept or dropped."""
    for loss in losses:
        write_line(told(named(" ".join(f"occlog: lost: {loss}".split()))), sys.stderr)
