"""Directions and reads that stand in logs twice, alike in everything: a log was copied, or exported twice."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TypeVar

import numpy as np

from occlog.array_types import Bools, Ints, Strings, Uints
from occlog.console.text import counted
from occlog.io.boxes.rows import fingerprints
from occlog.records.columns import Table

T = TypeVar("T", bound=Table)


class Copies:
    """Leaves copies out of the logs (of tables with a column `sensor`) of a recording, and tells how many there were.

    Of several logs 8 bytes for each row are kept; of one log only those of the last time.
    """

    def __init__(self, *, several: bool) -> None:
        """No log yet; `several`: there is more than one, so that a row may stand in one before."""
        self._several = several
        self._before: dict[str, list[Uints]] = {}

    def once(self, tables: Iterable[T], path: Path, note: Callable[[str], None], what: str) -> Iterator[T]:
        """The tables of a log without rows that were there before; a warning at the end calls one of them `what`."""
        here: dict[str, list[Uints]] = {}
        copies = 0
        for table in tables:
            fresh = np.ones(len(table), dtype=np.bool_)
            sensor: Strings = table.sensor  # type: ignore[attr-defined]
            for name in np.unique(sensor).tolist():
                own = np.flatnonzero(sensor == name)
                mine = table.take(own)
                t_ns: Ints = mine.t_ns  # type: ignore[attr-defined]
                marks = fingerprints([getattr(mine, c.name) for c in mine.columns() if c.kind != "U"])
                fresh[own] = _first(marks, [*self._before.get(name, ()), *here.get(name, ())])
                kept = marks if self._several else marks[t_ns == t_ns[-1]]
                # Equal times may lie in two parts of a log
                here[name] = [*here.get(name, ()), kept] if self._several else [*here.get(name, ())[-1:], kept]
            copies += int((~fresh).sum())
            yield table if fresh.all() else table.take(fresh)
        for name, parts in here.items():
            self._before.setdefault(name, []).append(np.unique(np.concatenate(parts)))
        if copies:
            others = " or in a log before" if self._several else ""
            note(
                f"warning: {path.name}: {counted(copies, what)} stood there{others} already, alike in everything; each "
                "counts once"
            )


def _first(marks: Uints, before: list[Uints]) -> Bools:
    """(n,) whether a mark is there for the first time."""
    out = np.zeros(len(marks), dtype=np.bool_)
    out[np.unique(marks, return_index=True)[1]] = True
    for known in before:
        out &= ~np.isin(marks, known)
    return out
