"""Tables in pieces that a command works through one after another, so that memory does not grow with their length."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TypeVar

import numpy as np

from occlog.array_types import Ints
from occlog.errors import InputError

from .columns import Table

T = TypeVar("T", bound=Table)


def times(table: Table) -> Ints:
    """The column t_ns, which every table has."""
    out: Ints = getattr(table, "t_ns")  # noqa: B009
    return out


def whole_times(chunks: Iterable[T]) -> Iterator[T]:
    """The rows of chunks in pieces that end between two times.

    Args:
        chunks: in the order of time; a time may be split over several of them.

    Raises:
        InputError: a chunk begins before the one ahead of it ends.
    """
    held: T | None = None
    for chunk in chunks:
        if not len(chunk):
            continue
        if held is not None and times(chunk)[0] < times(held)[-1]:
            raise InputError(f"{chunk.NAME}: t_ns goes back between two chunks; sort the table by t_ns")
        rows = chunk if held is None else type(chunk).concat([held, chunk])
        cut = int(np.searchsorted(times(rows), times(rows)[-1]))
        if cut:
            yield rows.take(slice(0, cut))
        held = rows.take(slice(cut, None))
    if held is not None:
        yield held
