"""Units that the user states for columns of external tables without a unit in their names.

They apply to all inputs of one command, so that they are kept in a context variable set by the command line; provenance
records them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path

from occlog.errors import InputError, UsageError, did_you_mean, option
from occlog.settings import METRES

ANGLES, TIMES = ("deg", "rad"), ("s", "ms", "us", "ns")
KINDS: Mapping[str, Sequence[str]] = {"angle": ANGLES, "length": tuple(METRES), "time": TIMES, "interval": TIMES}
"""Units by what they measure."""


Key = tuple[str, str]
"""A file, as its name or its path, or empty for all files; and a column or a kind."""


@dataclass
class StatedUnits:
    """Units that the user states for columns of external tables, by name or for all columns of a quantity.

    Attributes:
        columns: unit by (file or "" for all files, column name in lower case).
        kinds: unit by (file or "", `angle`, `length`, `time` or `interval`), for columns without a unit in their name.
        used: those that a table had a use for, in the syntax of the option.
    """

    columns: Mapping[Key, str] = field(default_factory=dict)
    kinds: Mapping[Key, str] = field(default_factory=dict)
    used: set[str] = field(default_factory=set)

    def texts(self) -> tuple[str, ...]:
        """All stated units in the syntax of the option: `x=cm`, `deg`, `walk.csv:deg`."""
        return (
            *(_text(file, f"{name}={unit}") for (file, name), unit in self.columns.items()),
            *(_text(file, unit) for (file, _), unit in self.kinds.items()),
        )

    def unit_of(self, name: str, kind: str, by_name: str, path: Path | None = None) -> str:
        """Unit of a column: stated for it, else the one in its name, else stated for its quantity.

        Empty if none is known.

        Args:
            name: of the file's column.
            kind: quantity, a key of `KINDS`; empty: one without a unit to state.
            by_name: unit in its name; empty: none.
            path: the file; None: it is not known.

        Raises:
            UsageError: the unit stated for the column contradicts its name.
            InputError: a unit is stated that the column cannot have.
        """
        found = _find(self.columns, path, name.strip().lower())
        if found is None:
            of_kind = _find(self.kinds, path, kind)
            return by_name or ("" if of_kind is None else self.kinds[of_kind])
        stated = self.columns[found]
        if stated not in KINDS.get(kind, ()):
            wanted = f"units of {kind}s are {', '.join(KINDS[kind])}" if kind else "it has no unit"
            raise InputError(
                f"column {name} cannot be in {stated}, as {option('input_units')} states; {wanted}", id="unit-mismatch"
            )
        if by_name and by_name != stated:
            raise UsageError(
                f"{path or 'input'}: column {name} is in {by_name} by its name, but {option('input_units')} states "
                f"{stated}; state {by_name} or nothing",
                id="unit-mismatch",
            )
        return stated

    def note_use(self, name: str, kind: str, by_name: str, path: Path | None = None) -> None:
        """Record that the table at `path` has a column for which the user may have stated a unit.

        Args:
            name: of the column.
            kind: its quantity: `time`, `interval`, `angle` or `length`; else empty.
            by_name: unit in its name; empty: none.
            path: file of the table.
        """
        found, of_kind = _find(self.columns, path, name.strip().lower()), _find(self.kinds, path, kind)
        if found is not None:
            self.used.add(_text(found[0], f"{found[1]}={self.columns[found]}"))
        elif not by_name and of_kind is not None:
            self.used.add(_text(of_kind[0], self.kinds[of_kind]))

    def unused(self) -> tuple[str, ...]:
        """Stated units that no table had a use for, in the syntax of the option."""
        return tuple(text for text in self.texts() if text not in self.used)


def _text(file: str, unit: str) -> str:
    """A stated unit in the syntax of the option.

    `file` is the file for which it is stated, empty: all; `unit` is `COLUMN=UNIT`, or the unit alone.
    """
    return f"{file}:{unit}" if file else unit


def _find(stated: Mapping[Key, str], path: Path | None, name: str) -> Key | None:
    """Key in `stated` for the column or quantity `name`: for the file's path, else its name, else all files.

    None if missing.
    """
    files = ("",) if path is None else (str(path), path.name, "")
    return next((key for file in files if (key := (file, name)) in stated), None)


STATED: ContextVar[StatedUnits] = ContextVar("STATED", default=StatedUnits())  # noqa: B039 - an empty one never changes


@contextmanager
def stated_units(texts: Sequence[str]) -> Iterator[StatedUnits]:
    """Context manager that sets the user's units for tables that are opened within its block.

    Args:
        texts: `COLUMN=UNIT`, or a unit alone for all columns of its quantity without a unit in their names, each also
            as `FILE:...` for one file; several may be separated by commas.

    Raises:
        UsageError: a unit is unknown, or two are stated for one column or quantity.
    """
    known = [unit for units in KINDS.values() for unit in units]
    columns: dict[Key, str] = {}
    kinds: dict[Key, str] = {}
    for part in (part.strip() for text in texts for part in text.split(",")):
        file, _, rest = part.rpartition(":")
        name, _, unit = rest.rpartition("=")
        if unit not in known:
            raise UsageError(f"input units: {part!r}: no unit {unit!r}; {did_you_mean(unit, known)}", id="unknown-name")
        where, key = (columns, name.strip().lower()) if name else (kinds, _kind_of(unit))
        if where.setdefault((file, key), unit) != unit:
            before = where[file, key]
            raise UsageError(
                f"input units: {_text(file, name or key)} is stated to be in {before} and in {unit}; state one",
                id="duplicate-name",
            )
    found = StatedUnits(columns, kinds)
    token = STATED.set(found)
    try:
        yield found
    finally:
        STATED.reset(token)


def _kind_of(unit: str) -> str:
    return next(kind for kind, units in KINDS.items() if unit in units)
