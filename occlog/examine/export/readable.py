"""Rows that come back as they are when the exported file is read again; others are refused."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TypeVar

import numpy as np

from occlog.errors import InputError
from occlog.io.foreign.names import MAY_BE_EMPTY
from occlog.records.columns import Table

T = TypeVar("T", bound=Table)
BREAKS = ("\n", "\r", "\0")
"""What no cell of a text can hold."""


def readable(chunks: Iterable[T], source: Path, *, text: bool) -> Iterator[T]:
    """The chunks of a table.

    Args:
        chunks: the rows.
        source: the file that they are from.
        text: names are written as cells of a text, which readers take without blanks around them.

    Raises:
        InputError: a name that would not be read again.
    """
    for chunk in chunks:
        if text:
            _check_names(chunk, source)
        yield chunk


def _check_names(chunk: Table, source: Path) -> None:
    for c in chunk.columns():
        if c.kind != "U":
            continue
        empty = c.name not in chunk.KEY or c.name in MAY_BE_EMPTY.get(chunk.NAME, ())
        for name in np.unique(getattr(chunk, c.name)).tolist():
            if name != name.strip() or any(mark in name for mark in BREAKS) or not (name or empty):
                raise InputError(
                    f"{source}: {c.name} {name!r}: a cell of a text has no line break, no blank at its ends and, in "
                    "this column, something in it; rename it, or export Parquet"
                )
