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

Formats of a family of files (boxes, calibrations, directions, truth), in one table each.

A table `{name: FileFormat(read, doc, sniff)}` states how a format is recognised and what reads it; its order is that of
recognition, from the most particular format to the least.  A new format is a module with both functions, and a line in
the table of its family.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from occlog.array_types import Ints, Strings
from occlog.errors import InputError, UsageError
from occlog.io.files.limits import bounded_text
from occlog.io.files.programs import refuse_unread
from occlog.io.files.timing.times import TIME_COLUMNS, parse_times, time_column

from .csv_rows import CsvRows, first_line, read_rows

RAW, TEXT, NUMBER, LENGTH, WHOLE, IDENTITY = "raw", "text", "number", "length", "whole", "identity"
"""Kinds of cells: unchecked text, a text, a finite number, a length that is written to 1 cm or better, a whole number,
one of 32 bits."""


@dataclass(frozen=True)
class FormatColumn:
    """A column of a text format: accepted names, kind of cells, limits and default.

    Attributes:
        names: what files call it, in lower case; the first one is used in messages.
        kind: kind of its cells, such as `NUMBER`.
        least: smallest value.
        most: largest value.
        above: value that all must exceed.
        unit: of the limits, for messages.
        choices: texts that may be in it; empty: any.
        default: value if the column is missing or, except for texts, a cell is empty; None: every row must have a
            value.
        blank: whether single cells may be empty if there is a default.
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

    def values(self, rows: CsvRows, name: str) -> NDArray[Any]:
        """(n,) values of this column in `rows`, where it is called `name`; the default if the rows lack it.

        Empty cells of numbers are the default too, where `blank` allows them. InputError, with line and limit, for an
        invalid value.
        """
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

    def _texts(self, rows: CsvRows, name: str) -> Strings:
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
class TextFormat:
    """A text table with a first line that names the columns.

    Attributes:
        what: noun for a file of this format, for messages.
        columns: declarations, by occlog's name of the column.
        times: whether it may have a column of times, under one of the names of `TIME_COLUMNS`.
        ignored: names of columns that may be there and are not used.
        others: whether there may be any other columns.
    """

    what: str
    columns: Mapping[str, FormatColumn]
    times: bool = False
    ignored: Sequence[str] = ()
    others: bool = False

    @property
    def names(self) -> dict[str, Sequence[str]]:
        """Accepted names by occlog's name of the column; a column of times by its unit."""
        return {**(TIME_COLUMNS if self.times else {}), **{name: c.names for name, c in self.columns.items()}}


@dataclass(frozen=True)
class TextPart:
    """Some rows of a text table: `part[name]` are the (n,) values of a column, `rows` the cells as text."""

    rows: CsvRows
    values: Mapping[str, NDArray[Any]]

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.values[name]

    def __len__(self) -> int:
        return len(self.rows)

    def times(self) -> Ints:
        """(n,) times [ns since the Unix epoch]; InputError without a time column."""
        unit = time_column(self.rows)
        if unit is None:
            raise InputError(
                f"{self.rows.path}: has no column of times; name one of them time (seconds) or t_ns",
                id="missing-column",
            )
        return parse_times(self.rows, unit, unit)


def read_format(path: Path, table: TextFormat, *, ignore_extra: bool | None = None) -> Iterator[TextPart]:
    """Yield chunks of a text table of a declared format, in file order.

    Args:
        path: the file.
        table: its format.
        ignore_extra: skip unknown columns instead of refusing them; None: refuse them, and suggest no option to skip.

    Raises:
        InputError: a column is missing or unknown, or a value is invalid; with file, line, value and limit.
    """
    extra = True if table.others else ignore_extra
    for rows in read_rows(path, table.names, table.what, ignored=table.ignored, ignore_extra=extra):
        missing = [name for name, c in table.columns.items() if c.default is None and not rows.has(name)]
        if missing:
            absent = " and ".join(table.columns[name].names[0] for name in missing)
            known = ", ".join(names[0] for names in table.names.values())
            raise InputError(f"{path}: has no column {absent}; add it ({table.what} has {known})", id="missing-column")
        yield TextPart(rows, {name: column.values(rows, name) for name, column in table.columns.items()})


R = TypeVar("R")
MAX_TEXT = 16 * 2**20
"""Bytes of a file that is recognised by its whole text."""
START = 4096
"""Bytes at the beginning of a file that formats are recognised by."""


class Probe:
    """A file or folder, the format of which is to be recognised; its content is read on demand and kept.

    Attributes:
        path: of the file or folder.
        what: expected content, for messages.
    """

    def __init__(self, path: Path, what: str) -> None:
        self.path, self.what = path, what

    @cached_property
    def start(self) -> bytes:
        """First `START` bytes of the file, without byte order mark and leading white space."""
        with self.path.open("rb") as file:
            return file.read(START).removeprefix(b"\xef\xbb\xbf").lstrip()

    @cached_property
    def cells(self) -> list[str]:
        """Cells of the first line that is not empty or a comment, in lower case; InputError if it is not text."""
        return [cell.lower() for cell in first_line(self.path, self.what)]

    @cached_property
    def text(self) -> str:
        """The whole text; InputError if it is not UTF-8, or larger than `MAX_TEXT` bytes."""
        return bounded_text(self.path, self.what, limit=MAX_TEXT, encoding="utf-8-sig")


def is_folder(probe: Probe) -> bool:
    """Whether the input to be recognised is a folder."""
    return probe.path.is_dir()


def by_text(shows: Callable[[str], bool]) -> Callable[[Probe], bool]:
    """Make a recogniser of a format from `shows`, a predicate of the file's whole text."""
    return lambda probe: shows(probe.text)


def by_cells(shows: Callable[[list[str]], bool]) -> Callable[[Probe], bool]:
    """Make a recogniser of a format from `shows`, a predicate of the cells of the file's first line, in lower case."""
    return lambda probe: shows(probe.cells)


@dataclass(frozen=True)
class FileFormat(Generic[R]):
    """A format of a family of files (boxes, calibrations, directions, truth).

    Attributes:
        read: function that reads or opens a file.
        doc: what the format is, in words.
        sniff: whether a file has this format; by default never: the user must name the format.
        assumed: unit of lengths, or convention of angles, that holds unless the user states another.
    """

    read: R
    doc: str
    sniff: Callable[[Probe], bool] = lambda _: False
    assumed: str = ""


def recognise(formats: Mapping[str, FileFormat[R]], probe: Probe, stated: str = "auto", family: str = "") -> str | None:
    """Name of a file's format: the stated one, or the first that recognises the file; None if none does.

    Args:
        formats: formats of a family, by name, the most particular first.
        probe: the file.
        stated: name that the user gives, or `auto`.
        family: of the formats, for messages.

    Raises:
        UsageError: there is no format of the stated name.
        InputError: the file cannot be read, or belongs to a program that is known but not read.
    """
    if stated == "auto":
        refuse_unread(probe.path)
        return next((name for name, each in formats.items() if each.sniff(probe)), None)
    if stated not in formats:
        raise UsageError(
            f"{family} format {stated!r} is not known; known: auto, {', '.join(formats)}", id="unknown-name"
        )
    return stated
