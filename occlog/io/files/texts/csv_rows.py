"""Reading of text tables with a header line, plain or gzip, in chunks.

Errors name the line, the value and the remedy.
"""

from __future__ import annotations

import csv
import gzip
import io
import math
import re
import zlib
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from decimal import Decimal, InvalidOperation
from itertools import islice
from pathlib import Path
from typing import Self, TextIO

import numpy as np

from occlog.array_types import Floats, Ints, Strings
from occlog.errors import InputError, did_you_mean, option
from occlog.io.files.limits import UTF16_MARKS, check_input
from occlog.io.files.texts.by_reader import text_of

ROWS_PER_CHUNK = 16_384
MAX_CELL = 200
MAX_WORDS = 3
"""Words of a column's name at most, where the lines of a text differ in their number of cells."""
GZIP_MAGIC = b"\x1f\x8b"
MISSING = ("", "nan", "none", "na", "<na>", "n/a", "#n/a", "null", r"\n", "nil", "-", "--", "nat")
"""What programs write for a value that is not there, in small letters."""
_SEPARATOR = re.compile(r'"?sep=(.)"?\s*$', re.IGNORECASE)
"""Line of Excel that states the mark between cells."""
_DECIMAL_COMMA = re.compile(r"[+-]?[0-9]+,[0-9]+(?:[eE][+-]?[0-9]+)?$")
_ONE_CELL = re.compile(
    r"\d{2,4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d([.,]\d*)?)?\s*(Z|UTC|[+-]\d\d(:?\d\d)?)?|[^\s,;]+|\w+ *[\[(][^\])\t,;]*[\])]"
)
"""Lines of a table of one column: a date and time, one word, a name with its unit in brackets."""
_UNIT = re.compile(r"(?P<name>.*\w)\s*(?:\[\s*(?P<square>[\w/^]+)\s*\]|\(\s*(?P<round>[\w/^]+)\s*\))")
LONGEST_LINE = 1_000_000
"""Characters of a line at most."""
FREE_LINES = 1_000_000
"""Lines that any gzip file may unpack to, and above that one for each of its bytes: rows of measured numbers take 3
packed bytes or more."""
_FORMULA = re.compile(r"'*[=+\-@\t\r]")
"""Texts that a spreadsheet takes for a formula, and those that begin with the marks that state they are none."""
_NUMBER = re.compile(r"^\s*[-+]?(\d+(\.\d*)?|\.\d+)([eE][-+]?\d+)?\s*$")


IDENTITIES = ("id", "target_id", "source_id", "occluder_id")
"""Columns of identities, which some programs write as texts."""
COARSEST = 0.01
"""Lengths that are held or written to less than this (in m, or in a unit that is not stated) have been rounded."""


def last_place(text: str) -> float:
    """Value of the last digit of a number as it is written, if above 1 (`1.2e9`: 1e8); else 0, also for other texts."""
    try:
        value = Decimal(text.strip())
    except InvalidOperation:
        return 0.0
    last = value.as_tuple().exponent
    return 10.0**last if value and isinstance(last, int) and last > 0 else 0.0


def no_formula(text: str) -> str:
    """Escape a text for CSV: prefix an apostrophe if a spreadsheet would read a formula.

    `-1.5` and other numbers stay as they are.
    """
    return f"'{text}" if _FORMULA.match(text) and not _NUMBER.match(text) else text


def plain_text(text: str) -> str:
    """Remove the apostrophe that `no_formula` put before a text to protect it from spreadsheets.

    Other texts unchanged.
    """
    return text[1:] if text.startswith("'") and _FORMULA.match(text) else text


BAD_LINES: ContextVar[Callable[[InputError], None] | None] = ContextVar("BAD_LINES", default=None)
"""Callback for lines that are no rows; these are then skipped; None: the first one ends the reading."""


@contextmanager
def report_bad_lines_to(listener: Callable[[InputError], None]) -> Iterator[None]:
    """Context manager in which malformed lines of text tables are passed to `listener` as errors and skipped.

    Without it the first one is raised.
    """
    token = BAD_LINES.set(listener)
    try:
        yield
    finally:
        BAD_LINES.reset(token)


def _refuse(error: InputError) -> None:
    """Raise the error, or pass it to the listener of `report_bad_lines_to` and return."""
    listener = BAD_LINES.get()
    if listener is None:
        raise error
    listener(error)


@dataclass(frozen=True)
class CsvRows:
    """Some rows of a text table, with cells as text.

    Attributes:
        path: the file or folder.
        lines: (n,) line number of each row.
        cells: (n,) texts by column.
        location: what the numbers in `lines` count, for messages.
        files: file of each row if `path` is a folder; else empty.
    """

    path: Path
    lines: Ints
    cells: Mapping[str, Strings]
    location: str = "line"
    files: tuple[Path, ...] = ()

    def __len__(self) -> int:
        return len(self.lines)

    def pick(self, kept: Ints) -> Self:
        """The rows with the given indices."""
        return replace(
            self,
            lines=self.lines[kept],
            cells={name: cells[kept] for name, cells in self.cells.items()},
            files=tuple(self.files[n] for n in kept.tolist()) if self.files else (),
        )

    def fail(self, row: int, message: str) -> InputError:
        """InputError, to be raised, with the file, the line of the row with index `row`, and a message."""
        path = self.files[row] if self.files else self.path
        return InputError(f"{path}: {self.location} {int(self.lines[row])}: {message}")

    def floats(self, name: str, *, blank: bool = False, infinite: bool = False) -> Floats:
        """(n,) numbers of a column.

        Empty cells and texts such as `nan` are NaN if `blank` is true, else an InputError; infinite numbers are one
        unless `infinite` is true.
        """
        cells = self._plain(name)
        if blank:
            cells = np.where(np.isin(np.char.lower(np.char.strip(cells)), MISSING), "nan", cells)
        try:
            with np.errstate(over="ignore"):  # too large values are infinite, and refused below
                values = cells.astype(np.float64)
        except ValueError:
            row = next(n for n, cell in enumerate(cells) if not _is_number(cell, blank))
            raise self._no_number(name, row, "a number") from None
        bad = (np.isinf(values) & (not infinite)) | (np.isnan(values) & (not blank))
        if bad.any():
            raise self._no_number(name, int(np.flatnonzero(bad)[0]), "a finite number")
        return values

    def _no_number(self, name: str, row: int, wanted: str) -> InputError:
        """InputError, to be raised, for a cell that is not a number, with the remedy for the usual causes.

        Args:
            name: column.
            row: index of the row.
            wanted: what was expected, as `a number`.
        """
        cell = str(self.cells[name][row]).strip()
        if cell.lower() in MISSING:
            return self.fail(row, f"{name} is missing ({cell!r}); remove this {self.location}, or give the value")
        if _DECIMAL_COMMA.match(cell):
            return self.fail(row, f"{name} is {cell!r}, with a decimal comma; write it with a point")
        if name in IDENTITIES and not _NUMBER.match(cell):
            remedy = "number identities: ids = pandas.factorize(ids)[0]"
            return self.fail(row, f"{name} is {cell[:40]!r}; {wanted} was expected; {remedy}")
        return self.fail(row, f"{name} is {cell!r}; {wanted} was expected; correct this {self.location}")

    def steps(self, name: str) -> Floats:
        """(n,) value of the last digit of each number with an exponent in a column, if above 1; 0 for all others."""
        out, cells = np.zeros(len(self)), self.cells[name]
        for row in np.flatnonzero(np.char.find(np.char.lower(cells), "e") >= 0).tolist():
            out[row] = last_place(str(cells[row]))
        return out

    def lengths(self, name: str, *, blank: bool = False) -> Floats:
        """(n,) lengths of a column; InputError for one that is written to less than the precision `COARSEST`.

        Empty cells are NaN if `blank` is true, else an InputError.
        """
        values, steps = self.floats(name, blank=blank), self.steps(name)
        if (steps > COARSEST).any():
            row = int(np.flatnonzero(steps > COARSEST)[0])
            raise self.fail(
                row, f"{name} is {str(self.cells[name][row])!r}: known to {steps[row]:g} only; write all digits"
            )
        return values

    def ints(self, name: str, blank: int | None = None) -> Ints:
        """(n,) whole numbers of a column; `3.0` is accepted, 3.5 is an InputError.

        `blank` replaces empty cells; None: they are an InputError.
        """
        cells = self._plain(name)
        try:
            return cells.astype(np.int64)
        except (ValueError, OverflowError):
            values = self.floats(name, blank=blank is not None)
        if blank is not None and (empty := np.isnan(values)).any():
            return replace(self, cells={name: np.where(empty, str(blank), cells)}).ints(name)
        bad = (values != np.round(values)) | (np.abs(values) >= 2.0**53)
        if bad.any():
            row = int(np.flatnonzero(bad)[0])
            raise self.fail(
                row, f"{name} is {str(cells[row])!r}; a whole number was expected; correct this {self.location}"
            )
        return values.astype(np.int64)

    def identities(self, name: str, *, least: int = -(2**31), blank: int | None = None) -> Ints:
        """(n,) whole numbers of a column from `least` to 2**31 - 1; InputError for others.

        `blank` replaces empty cells; None: they are an InputError.
        """
        values = self.ints(name, blank)
        bad = (values < least) | (values >= 2**31)
        if bad.any():
            row = int(np.flatnonzero(bad)[0])
            raise self.fail(row, f"{name} is {values[row]}; it must be {least} to {2**31 - 1}; renumber it")
        return values

    def _plain(self, name: str) -> Strings:
        """(n,) cells of a column of numbers.

        InputError for digits with underscores (`2_0`), which only Python reads.
        """
        cells = self.cells[name]
        slips = np.char.find(cells, "_") >= 0
        if slips.any():
            row = int(np.flatnonzero(slips)[0])
            raise self._no_number(name, row, "a number")
        return cells

    def has(self, name: str) -> bool:
        """Whether the file has a column of this name."""
        return name in self.cells


def check_one_sensor(rows: CsvRows, column: str, given: str, label: str) -> None:
    """InputError if the rows of a file that the user gives for one sensor name another sensor than its first row.

    Args:
        rows: of the file.
        column: name of the column with the labels of sensors.
        given: the sensor that the user names.
        label: of the first row of the file.
    """
    others = np.flatnonzero(rows.cells[column] != label)
    if len(others):
        row = int(others[0])
        other = str(rows.cells[column][row])
        raise rows.fail(
            row,
            f"{column} is {other!r}, but {label!r} in rows before, and the file is given as that of {given}; omit "
            f"{given}= to read several",
        )


def read_rows(
    path: Path,
    columns: Mapping[str, Sequence[str]],
    what: str,
    *,
    ignored: Sequence[str] = (),
    ignore_extra: bool | None = None,
    commented: bool = False,
    rows: int = ROWS_PER_CHUNK,
) -> Generator[CsvRows, None, None]:
    """Yield chunks of a text table with a header line, plain or gzip, or of a file that a reader plug-in converts.

    Cells are separated by commas, semicolons, tabs or blanks. Lines that are empty or begin with `#` are skipped, and
    the case of column names does not matter.

    Args:
        path: the file.
        columns: names that files may have, by the name of the column.
        what: what the file should be, for messages.
        ignored: names of columns that may be there and are not used.
        ignore_extra: skip unknown columns instead of refusing them; None: refuse them, and suggest no option to skip.
        commented: the first line, which begins with `#`, names the columns; see `commented_header`.
        rows: number of rows in a chunk.

    Raises:
        InputError: the header is missing, has unknown or repeated columns, or a line is malformed.
    """
    with _open_text(path, what) as file:
        lines = _split(path, file, commented=commented)
        line, header = next(lines, (0, []))
        if not header:
            raise InputError(f"{path}: has no line with data; {what} was expected", id="empty-input")
        if all(_NUMBER.match(cell) for cell in header):
            known = ",".join(names[0] for names in columns.values())
            raise InputError(
                f"{path}: line {line}: a header line was expected, not data; name the columns: {known}",
                id="missing-column",
            )
        names = _resolve(path, line, header, columns, ignored, ignore_extra)
        if isinstance(file, io.StringIO):
            # Of a plug-in's table there are rows, and no lines that a user could open
            lines = ((number - line, cells) for number, cells in lines)
            yield from _chunks(path, lines, names, rows, "row")
            return
        yield from _chunks(path, lines, names, rows)


def read_plain(path: Path, what: str, *, rows: int = ROWS_PER_CHUNK) -> Generator[CsvRows, None, None]:
    """Yield chunks of a text table without a header line; columns are named `0`, `1`, ... by position.

    Args:
        path: the file.
        what: what it should be, for messages.
        rows: number of rows in a chunk.

    Raises:
        InputError: the file is empty, or a line is malformed.
    """
    with _open_text(path, what) as file:
        lines = _split(path, file)
        first = next(lines, None)
        if first is None:
            raise InputError(f"{path}: has no line with data; {what} was expected", id="empty-input")
        names = [str(n) for n in range(len(first[1]))]
        yield from _chunks(path, _rejoin(first, lines), names, rows)


def first_line(path: Path, what: str) -> list[str]:
    """Cells of the first line that is neither empty nor a comment (`#`); empty without one.

    `what` describes the expected content, for messages.
    """
    with _open_text(path, what) as file:
        return next(_split(path, file), (0, []))[1]


def commented_header(path: Path, what: str) -> list[str]:
    """Column names in a first line that begins with `#` and has as many cells as the data.

    Empty if there is no such line. A comment in words is no header, since names and data must be separated by the same
    character (comma, semicolon or tab).
    """
    try:
        with _open_text(path, what) as file:
            lines = _split(path, file, commented=True)
            names, data = next(lines, (0, []))[1], next(lines, (0, []))[1]
    except InputError:
        return []  # whoever reads the rows describes the fault
    return names if 1 < len(names) == len(data) and not is_header(data) else []


def is_prose(path: Path, what: str) -> bool:
    """Whether the first line of a file is a sentence rather than cells.

    It has a cell of more than `MAX_WORDS` words, and another number of cells than the next line.
    """
    with _open_text(path, what) as file:
        lines = _split(path, file)
        first, second = next(lines, (0, []))[1], next(lines, (0, []))[1]
    return len(first) != len(second) and any(len(cell.split()) > MAX_WORDS for cell in first)


def is_header(cells: Sequence[str]) -> bool:
    """Whether the cells of a line name columns, i.e. one of them is not a number."""
    return any(not _NUMBER.match(cell) for cell in cells)


def _is_number(cell: str, blank: bool) -> bool:
    return bool(_NUMBER.match(cell)) or (blank and cell == "nan")


def _open_text(path: Path, what: str) -> TextIO:
    text = text_of(path, what)
    if text is not None:
        return io.StringIO(text)
    with check_input(path, what).open("rb") as file:
        head = file.read(len(GZIP_MAGIC))
    if head == GZIP_MAGIC:
        return gzip.open(path, "rt", encoding="utf-8-sig", newline="")
    return path.open(encoding="utf-16" if head in UTF16_MARKS else "utf-8-sig", newline="")


def _rejoin(first: tuple[int, list[str]], rest: Iterator[tuple[int, list[str]]]) -> Iterator[tuple[int, list[str]]]:
    yield first
    yield from rest


def text_lines(path: Path, file: TextIO) -> Iterator[tuple[int, str]]:
    """Yield (line number from 1, line) of an open text file.

    Lines are limited while reading, so that a file without line ends is not read as a whole.

    Raises:
        InputError: a line is longer than `LONGEST_LINE`, or a gzip file has more lines than its size allows.
    """
    packed = path.stat().st_size if isinstance(getattr(file, "buffer", None), gzip.GzipFile) else None
    most = math.inf if packed is None else max(FREE_LINES, packed)
    for number, line in enumerate(iter(lambda: file.readline(LONGEST_LINE + 1), ""), start=1):
        if len(line) > LONGEST_LINE:
            raise InputError(
                f"{path}: line {number}: longer than {LONGEST_LINE} characters; rows were expected",
                id="input-too-large",
            )
        if number > most:
            raise InputError(
                f"{path}: more than {most:.0f} lines, too many for {packed} compressed bytes; if the file is right, "
                "decompress it first",
                id="input-too-large",
            )
        yield number, line


def _split(path: Path, file: TextIO, *, commented: bool = False) -> Iterator[tuple[int, list[str]]]:
    """Yield (line number, cells) of every line of a text table that is neither empty nor a comment.

    The separator follows from the first line. With `commented`, a first line that begins with `#` is included. A
    repeated header line and lines with NUL or decimal commas are errors, or skipped (`report_bad_lines_to`).
    """
    reader = None
    header: list[str] = []
    number = width = 0
    try:
        for number, line in text_lines(path, file):
            text = line.strip()
            if not text or (text.startswith("#") and not (commented and number == 1)):
                continue
            if "\0" in line:
                _refuse(InputError(f"{path}: line {number}: not text; a text table was expected", id="unknown-format"))
                continue
            if reader is None and (stated := _SEPARATOR.match(line)) is not None:
                reader = stated[1]
                continue
            text = text.removeprefix("#").strip()  # of a commented header line
            if reader is None:
                reader = _delimiter(text)
            cells = _cells(text, reader)
            if not width:
                header = cells if is_header(cells) else []
            elif cells == header:
                _refuse(
                    InputError(
                        f"{path}: line {number}: a second header line, so two tables in one file; split it here",
                        id="ambiguous-input",
                    )
                )
                continue
            width = width or len(cells)
            if reader == "\t" and len(cells) < width:  # tabs at the ends represent cells without a value
                cells = _cells(line.strip("\r\n"), reader)
            decimal = next((cell for cell in cells if _DECIMAL_COMMA.match(cell)), None) if reader != "," else None
            if decimal is not None:
                _refuse(InputError(f"{path}: line {number}: {decimal!r} has a decimal comma; write it with a point"))
                continue
            yield number, cells
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: after line {number}: not UTF-8 text ({error.reason}), as a table should be; save it as UTF-8",
            id="wrong-encoding",
        ) from None
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise InputError(
            f"{path}: after line {number}: damaged gzip file ({error}); compress it again", id="damaged-file"
        ) from None
    except csv.Error as error:
        raise InputError(f"{path}: line {number}: cannot be split into cells ({error})", id="invalid-syntax") from None


def _delimiter(text: str) -> str:
    if _ONE_CELL.fullmatch(text):
        return "\t"
    counts = [(text.count(mark), mark) for mark in (",", ";", "\t")]
    best = max(counts, key=lambda pair: pair[0])
    return best[1] if best[0] else " "


def _cells(text: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return text.split() if '"' not in text else next(csv.reader([text], delimiter=" ", skipinitialspace=True))
    if '"' not in text:
        return [cell.strip() for cell in text.split(delimiter)]
    return [cell.strip() for cell in next(csv.reader([text], delimiter=delimiter))]


def name_with_unit(name: str) -> str:
    """Column name with a unit in brackets converted to a suffix: `time [ms]` becomes `time_ms`.

    Others are unchanged.
    """
    found = _UNIT.fullmatch(name)
    return name if found is None else f"{found['name']}_{found['square'] or found['round']}".replace(" ", "_")


def _resolve(
    path: Path,
    line: int,
    header: list[str],
    columns: Mapping[str, Sequence[str]],
    ignored: Sequence[str],
    ignore_extra: bool | None,
) -> list[str | None]:
    """Name in occlog of each column of a file; None for columns that are not used.

    Args:
        path: the file.
        line: line number of the header.
        header: its cells.
        columns: accepted names, by the name in occlog.
        ignored: names of columns that are not used.
        ignore_extra: unknown columns are not used; else an error, which suggests no option to skip them if None.

    Raises:
        InputError: a column is unknown or repeated.
    """
    meaning = {alias: name for name, aliases in columns.items() for alias in aliases}
    names: list[str | None] = []
    for cell in header:
        name = meaning.get(cell.lower()) or meaning.get(name_with_unit(cell.lower()))
        if name is None and cell.lower() not in ignored and not ignore_extra:
            known = dict.fromkeys([*(aliases[0] for aliases in columns.values()), *meaning])
            hint = did_you_mean(cell.lower(), known, "known:")
            skip = "" if ignore_extra is None else f", or skip unknown columns ({option('ignore_extra_columns')})"
            raise InputError(
                f"{path}: line {line}: unknown column {cell!r}: rename or remove it{skip}; {hint}",
                id="unknown-column",
            )
        if name is not None and name in names:
            raise InputError(
                f"{path}: line {line}: columns {header[names.index(name)]!r} and {cell!r} are both read as {name!r}; "
                "remove or rename one",
                id="duplicate-name",
            )
        names.append(name)
    return names


def _chunks(
    path: Path,
    lines: Iterator[tuple[int, list[str]]],
    names: Sequence[str | None],
    rows: int,
    location: str = "line",
) -> Iterator[CsvRows]:
    whole = ((line, cells) for line, cells in lines if _is_row(path, location, line, cells, len(names)))
    while chunk := list(islice(whole, rows)):
        turned = zip(*(cells for _, cells in chunk), strict=True)
        cells_of = {
            n: np.array(column, dtype=np.str_) for n, column in zip(names, turned, strict=True) if n is not None
        }
        yield CsvRows(path, np.array([line for line, _ in chunk], dtype=np.int64), cells_of, location)


def _is_row(path: Path, location: str, line: int, cells: list[str], columns: int) -> bool:
    """Whether a line has a cell of acceptable length for each column; if not, the error is raised or reported.

    Args:
        path: the file.
        location: what a line is called in messages.
        line: its number.
        cells: its cells.
        columns: number of columns.
    """
    fault = ""
    if len(cells) != columns:
        fault = f"{len(cells)} cells, but the first line has {columns}"
        fault += "; if the first are names of rows (R), leave them out" * (len(cells) == columns + 1)
    elif max(map(len, cells)) > MAX_CELL:
        fault = f"a cell of more than {MAX_CELL} characters"
    if fault:
        _refuse(InputError(f"{path}: {location} {line}: {fault}; correct this {location}", id="invalid-syntax"))
    return not fault
