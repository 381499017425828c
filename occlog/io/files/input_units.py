"""Units that the user states for columns of tables of others whose names say none.

They hold for all inputs of one command, so that they are kept in a context that the command line enters; every
provenance that is made meanwhile has them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field

from occlog.errors import InputError, UsageError, did_you_mean
from occlog.settings import METRES

ANGLES, TIMES = ("deg", "rad"), ("s", "ms", "us", "ns")
KINDS: Mapping[str, Sequence[str]] = {"angle": ANGLES, "length": tuple(METRES), "time": TIMES, "interval": TIMES}
"""Units by what they measure."""


@dataclass
class StatedUnits:
    """Units of columns by name, and of all columns of one kind.

    Attributes:
        columns: by the file's name of a column, in lower case.
        kinds: by `angle`, `length`, `time`: of columns that are not named.
        used: which of them a table had a use for.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    kinds: Mapping[str, str] = field(default_factory=dict)
    used: set[str] = field(default_factory=set)

    def texts(self) -> tuple[str, ...]:
        """All of them as they were given."""
        return (*(f"{name}={unit}" for name, unit in self.columns.items()), *self.kinds.values())

    def unit_of(self, name: str, kind: str, said: str) -> str:
        """The unit of a column.

        Args:
            name: of the file's column.
            kind: what it measures, of `KINDS`; empty: nothing that has a unit to state.
            said: the unit that its name says; empty: none.

        Raises:
            UsageError: another unit is stated than the name says.
            InputError: a unit is stated that the column cannot have.
        """
        low = name.strip().lower()
        stated = self.columns.get(low)
        if stated is None:
            return said or self.kinds.get(kind, "")
        if stated not in KINDS.get(kind, ()):
            wanted = f"units of {kind}s are {', '.join(KINDS[kind])}" if kind else "it has no unit"
            raise InputError(f"column {name} cannot be in {stated}; {wanted}")
        if said and said != stated:
            raise UsageError(
                f"column {name} is in {said} by its name, and stated to be in {stated}; state no other unit"
            )
        return stated

    def note_use(self, name: str, kind: str, said: str) -> None:
        """Remember that a table has such a column."""
        low = name.strip().lower()
        if low in self.columns:
            self.used.add(f"{low}={self.columns[low]}")
        elif not said and kind in self.kinds:
            self.used.add(self.kinds[kind])

    def unused(self) -> tuple[str, ...]:
        """Those that no table had a use for."""
        return tuple(text for text in self.texts() if text not in self.used)


STATED: ContextVar[StatedUnits] = ContextVar("STATED", default=StatedUnits())  # noqa: B039 - an empty one never changes


@contextmanager
def stated_units(texts: Sequence[str]) -> Iterator[StatedUnits]:
    """Let units hold for the tables that are opened meanwhile.

    Args:
        texts: each `COLUMN=UNIT`, or a unit alone for all columns of its kind whose names say none; several may be
            separated by commas.

    Raises:
        UsageError: a unit is unknown, or two are stated for one thing.
    """
    known = [unit for units in KINDS.values() for unit in units]
    columns: dict[str, str] = {}
    kinds: dict[str, str] = {}
    for part in (part.strip() for text in texts for part in text.split(",")):
        name, _, unit = part.rpartition("=")
        if unit not in known:
            raise UsageError(f"input units: {part!r}: no unit {unit!r}; {did_you_mean(unit, known)}")
        where, key = (columns, name.strip().lower()) if name else (kinds, _kind_of(unit))
        if where.setdefault(key, unit) != unit:
            raise UsageError(f"input units: {name or key} is stated to be in {where[key]} and in {unit}; state one")
    found = StatedUnits(columns, kinds)
    token = STATED.set(found)
    try:
        yield found
    finally:
        STATED.reset(token)


def _kind_of(unit: str) -> str:
    return next(kind for kind, units in KINDS.items() if unit in units)
