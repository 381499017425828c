"""Formats of text tables as data: columns with their names, kinds, limits and defaults; one reader checks them all.

FORMAT = Format(
"a table of readers",
{
"reader": Column(("reader", "name"), TEXT),
"x": Column(("x", "x_m"), LENGTH),
"range": Column(("range", "range_m"), above=0.0, default=math.inf),
},
)
for part in read_format(path, FORMAT):
part["x"]  # (n,) float64
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from occlog.array_types import Ints, Strings
from occlog.errors import InputError
from occlog.io.files.texts.csv_rows import Rows, read_rows
from occlog.io.files.times.timestamps import TIME_COLUMNS, parse_times, time_column

RAW, TEXT, NUMBER, LENGTH, WHOLE, IDENTITY = "raw", "text", "number", "length", "whole", "identity"
"""Kinds of cells: unchecked text, a text, a finite number, a length that is written to 1 cm or better, a whole number,
one of 32 bits."""


@dataclass(frozen=True)
class Column:
    """A column of a format.

    Attributes:
        names: what files call it, in lower case; the first one is used in messages.
        kind: of its cells.
        least: smallest value.
        most: largest value.
        above: value that all must exceed.
        unit: of the limits, for messages.
        choices: texts that may stand in it; empty: any.
        default: value of rows without one, where the column is missing or, but for texts, a cell is empty; None: every
            row must have one.
        blank: whether single cells may be empty where there is a default.
    """

    names: Sequence[str]
    kind: str = NUMBER
    least: float = -math.inf
    most: float = math.inf
    above: float = -math.inf
    unit: str = ""
    choices: Sequence[str] = ()
    default: Any = None
    blank: bool = True

    def values(self, rows: Rows, name: str) -> NDArray[Any]:
        """(n,) values of its cells under a name in `rows`; InputError with line and limit for a wrong one."""
        if not rows.has(name):
            return np.full(len(rows), self.default)
        if self.kind == RAW:
            return rows.cells[name]
        if self.kind == TEXT:
            return self._texts(rows, name)
        blank = self.blank and self.default is not None
        if self.kind == IDENTITY:
            least = -(2**31) if self.least == -math.inf else int(self.least)
            return rows.identities(name, least=least)
        if self.kind == WHOLE:
            values: NDArray[Any] = rows.ints(name, int(self.default) if blank else None)
        elif self.kind == LENGTH:
            values = rows.lengths(name, blank=blank)
        else:
            values = rows.floats(name, blank=blank)
        there = ~np.isnan(values) if blank else np.ones(len(values), dtype=np.bool_)
        bad = there & ~((self.least <= values) & (values <= self.most) & (values > self.above))
        if bad.any():
            row = int(np.flatnonzero(bad)[0])
            or_empty = ", or empty" if blank else ""
            raise rows.fail(
                row, f"{name} is {rows.cells[name][row]}; it must be {self._limits()}{or_empty}; correct this line"
            )
        return np.where(there, values, self.default) if blank else values

    def _texts(self, rows: Rows, name: str) -> Strings:
        cells = rows.cells[name]
        bad = ~np.isin(cells, self.choices) if self.choices else np.char.strip(cells) == ""
        if self.default is None or self.choices:
            for row in np.flatnonzero(bad)[:1].tolist():
                if not self.choices:
                    raise rows.fail(row, f"{name} is empty; a name was expected; correct this line")
                raise rows.fail(row, f"{name} {str(cells[row])!r} must be {' or '.join(self.choices)}")
        return cells

    def _limits(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        if self.above > -math.inf:
            return f"above {self.above:g}{unit}"
        if self.most == math.inf:
            return f"at least {self.least:g}{unit}"
        return f"{self.least:g} to {self.most:g}{unit}"


@dataclass(frozen=True)
class Format:
    """A text table whose first line names the columns.

    Attributes:
        what: what a file of it is, for messages.
        columns: by the name that the program uses.
        times: whether it has a column of times, under one of the names of `TIME_COLUMNS`.
        ignored: names of columns that may be there and are not used.
        others: whether there may be any other columns.
    """

    what: str
    columns: Mapping[str, Column]
    times: bool = False
    ignored: Sequence[str] = ()
    others: bool = False

    @property
    def names(self) -> dict[str, Sequence[str]]:
        """What each column may be called."""
        return {**(TIME_COLUMNS if self.times else {}), **{name: c.names for name, c in self.columns.items()}}


@dataclass(frozen=True)
class Part:
    """Some rows of a table: `part[name]` are the (n,) values of a column."""

    rows: Rows
    values: Mapping[str, NDArray[Any]]

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.values[name]

    def __len__(self) -> int:
        return len(self.rows)

    def times(self) -> Ints:
        """(n,) times [ns]; InputError without a column of times."""
        unit = time_column(self.rows)
        if unit is None:
            raise InputError(f"{self.rows.path}: has no column of times; name one of them time (seconds) or t_ns")
        return parse_times(self.rows, unit, unit)


def read_format(path: Path, table: Format, *, ignore_extra: bool = False) -> Iterator[Part]:
    """Chunks of a text table in the order of the file.

    Args:
        path: the file.
        table: its format.
        ignore_extra: skip unknown columns instead of refusing them.

    Raises:
        InputError: a column is missing or unknown, or a value is none of its column; with file, line, value and limit.
    """
    extra = ignore_extra or table.others
    for rows in read_rows(path, table.names, table.what, ignored=table.ignored, ignore_extra=extra):
        missing = [name for name, c in table.columns.items() if c.default is None and not rows.has(name)]
        if missing:
            absent = " and ".join(table.columns[name].names[0] for name in missing)
            known = ", ".join(names[0] for names in table.names.values())
            raise InputError(f"{path}: has no column {absent}; add it ({table.what} has {known})")
        yield Part(rows, {name: column.values(rows, name) for name, column in table.columns.items()})
