"""Typed access to the cells of an external table, by column, from text or Arrow."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from occlog.array_types import Bools, Floats, Ints, Strings
from occlog.errors import InputError
from occlog.io.files.tables.arrow import to_numpy, to_texts
from occlog.io.files.texts.csv_rows import MAX_CELL, CsvRows, plain_text
from occlog.io.files.timing.times import COARSEST_NS, UNITS, coarse, column_unit, parse_column, parse_times
from occlog.records.columns import ANY_WIDTH, MAX_NS

YES, NO = ("true", "1", "1.0", "yes"), ("false", "0", "0.0", "no")
EXACT = 2.0**53
"""Largest value up to which whole numbers are exact in float64."""


class TableCells(Protocol):
    """Interface to some rows of a table by column: n rows, and values converted to the requested type.

    Each method that takes a column `name` raises InputError with the position of the first cell that cannot be
    converted.
    """

    def __len__(self) -> int:
        """Number of rows."""

    def floats(self, name: str, *, blank: bool) -> Floats:
        """(n,) finite numbers of a column; empty cells are NaN if `blank` is true, else an error."""

    def ints(self, name: str, *, blank: int | None) -> Ints:
        """(n,) whole numbers of a column; `blank` replaces empty cells (None: empty cells are an error)."""

    def texts(self, name: str, *, blank: bool) -> Strings:
        """(n,) texts of a column; empty cells are an error unless `blank` is true."""

    def lists(self, name: str, width: int) -> Floats:
        """(n, width) numbers of a column of lists; NaN for empty cells.

        `width` `ANY_WIDTH`: as many numbers as in the first list that is not empty.
        """

    def bools(self, name: str) -> Bools:
        """(n,) booleans of a column: true, false, yes, no, 1 or 0."""

    def times(self, name: str, unit: str) -> Ints:
        """(n,) times of a column [ns since the Unix epoch]; an empty `unit` of numbers is inferred from their size."""

    def steps(self, name: str) -> Floats:
        """(n,) resolution of each number of a column in its unit (value of the last digit or bit); 0 unless coarse."""

    def raw(self, name: str) -> list[object]:
        """(n,) values of a column as in the file."""

    def fail(self, row: int, message: str) -> InputError:
        """InputError, to be raised, with the file, the position of row `row` (from 0 in these rows) and a message."""

    def part(self, start: int, stop: int) -> TableCells:
        """The cells of the rows start <= row < stop."""


@dataclass(frozen=True)
class TextCells(CsvRows):
    """Cells of a text table (CSV), with the file's own column names; texts are parsed on access."""

    @classmethod
    def of(cls, rows: CsvRows) -> TextCells:
        """The cells of some rows of a text table."""
        return cls(rows.path, rows.lines, rows.cells, rows.location, rows.files)

    def texts(self, name: str, *, blank: bool) -> Strings:
        """(n,) texts of a column; empty cells are an error unless `blank` is true.

        A quote before a formula character, which spreadsheets add, is removed.
        """
        texts = self.cells[name]
        if not blank and (texts == "").any():
            raise self.fail(int(np.flatnonzero(texts == "")[0]), f"{name} is empty; a text was expected")
        marked = np.char.startswith(texts, "'")
        return np.asarray([plain_text(text) for text in texts.tolist()], np.str_) if marked.any() else texts

    def lists(self, name: str, width: int) -> Floats:
        """Always raise InputError, since a text cell holds a single value.

        `width` values of the column `name` were expected.
        """
        numbers = "numbers" if width == ANY_WIDTH else f"{width} numbers"
        raise InputError(
            f"{self.path}: each cell of column {name} must be a list of {numbers}, which a text table cannot "
            "hold; give Parquet or Arrow",
            id="wrong-content",
        )

    def bools(self, name: str) -> Bools:
        """(n,) booleans of a column: true, false, yes, no, 1 or 0, in any case of letters."""
        return _yes_or_no(self, name, self.cells[name])

    def times(self, name: str, unit: str) -> Ints:
        """(n,) times of the column `name` [ns since the Unix epoch].

        An empty `unit` of numbers is inferred from their size.
        """
        return parse_times(self, name, unit)

    def raw(self, name: str) -> list[object]:
        """(n,) texts of a column as in the file."""
        return list(self.cells[name].tolist())

    def part(self, start: int, stop: int) -> TextCells:
        """The cells of the rows start <= row < stop."""
        return self.pick(np.arange(start, stop))


class ArrowCells:
    """Cells of an Arrow record batch in memory, from Parquet and Arrow files."""

    def __init__(self, path: Path, batch: pa.RecordBatch, first: int) -> None:
        """Wrap a batch of the file `path`; `first` is the number of the batch's first row in the file, for messages."""
        self._path, self._batch, self._first = path, batch, first

    def __len__(self) -> int:
        """Number of rows."""
        return int(self._batch.num_rows)

    def steps(self, name: str) -> Floats:
        """(n,) spacing of floating-point numbers at each value of a float16 or float32 column; 0 for other types."""
        kind = self._column(name).type
        if not (pa.types.is_float16(kind) or pa.types.is_float32(kind)):
            return np.zeros(len(self))
        values = self.floats(name, blank=True).astype(np.float16 if pa.types.is_float16(kind) else np.float32)
        return np.asarray(np.spacing(np.abs(np.nan_to_num(values))), dtype=np.float64)

    def raw(self, name: str) -> list[object]:
        """(n,) Python values of a column as in the file; None for null."""
        column = self._column(name)
        if not pa.types.is_dictionary(column.type):
            return list(column.to_pylist())
        # Rows that have the same text have the same object
        values = column.dictionary.to_pylist()
        return [None if index is None else values[index] for index in column.indices.to_pylist()]

    def fail(self, row: int, message: str) -> InputError:
        """InputError, to be raised, with the file, the number of row `row` in it (from 0) and a message."""
        return InputError(f"{self._path}: row {self._first + row}: {message}")

    def part(self, start: int, stop: int) -> ArrowCells:
        """The cells of the rows start <= row < stop."""
        return ArrowCells(self._path, self._batch.slice(start, stop - start), self._first + start)

    def floats(self, name: str, *, blank: bool) -> Floats:
        """(n,) finite numbers of a column, also parsed from texts; null is NaN if `blank` is true, else an error.

        Integers beyond +-2^53 are an error, since float64 cannot hold them exactly.
        """
        column = self._column(name)
        if _is_text(_plain(column.type)):
            return self._in_text(name, column).floats(name, blank=blank)
        if not _is_number(column.type):
            raise self._unfit(name, column.type, "numbers were expected")
        if (beyond := _beyond(column)).any():
            row = int(np.flatnonzero(beyond)[0])
            raise self.fail(row, f"{name} is {_shown(column[row])}; a number within {EXACT:.0f} was expected")
        values = np.array(to_numpy(pc.fill_null(pc.cast(column, pa.float64()), np.nan)), dtype=np.float64)
        bad = np.isinf(values) if blank else ~np.isfinite(values)
        if bad.any():
            row = int(np.flatnonzero(bad)[0])
            raise self.fail(row, f"{name} is {_shown(column[row])}; a finite number was expected")
        return values

    def ints(self, name: str, *, blank: int | None) -> Ints:
        """(n,) whole numbers of a column, also from texts and floats.

        `blank` replaces null (None: null is an error).
        """
        column = self._column(name)
        if _is_text(_plain(column.type)):
            return self._in_text(name, column).ints(name, blank=blank)
        if not _is_number(column.type):
            raise self._unfit(name, column.type, "whole numbers were expected")
        if blank is None and column.null_count:
            raise self.fail(_first_null(column), f"{name} is null; a whole number was expected")
        if pa.types.is_integer(column.type) or pa.types.is_decimal(column.type):
            filled = pc.fill_null(self._whole(name, column), blank if blank is not None else 0)
            return np.asarray(to_numpy(filled), dtype=np.int64)
        # pandas makes whole numbers with gaps to fractions
        values = self.floats(name, blank=blank is not None)
        values = np.where(np.isnan(values), float(blank or 0), values)
        bad = (values != np.round(values)) | (np.abs(values) >= EXACT)
        if bad.any():
            row = int(np.flatnonzero(bad)[0])
            raise self.fail(row, f"{name} is {values[row]:g}; a whole number was expected")
        return values.astype(np.int64)

    def _in_text(self, name: str, column: pa.Array) -> TextCells:
        """Cells of a text column, which are parsed as those of CSV files; `name` is that of the column."""
        texts = to_texts(column, f"{self._path}: column {name}", MAX_CELL)
        return TextCells(self._path, self._first + np.arange(len(self)), {name: texts}, "row")

    def _whole(self, name: str, column: pa.Array) -> pa.Array:
        """Cast the integers or decimals of a column to int64.

        InputError, with the row, for fractions and larger numbers.
        """
        try:
            return pc.cast(column, pa.int64())
        except pa.ArrowInvalid:
            ends = -(2**63), 2**63 - 1
            for row, value in enumerate(column.to_pylist()):
                if value is not None and not (value == int(value) and ends[0] <= value <= ends[1]):
                    raise self.fail(
                        row, f"{name} is {value}; a whole number was expected, {ends[0]} to {ends[1]}"
                    ) from None
            raise

    def texts(self, name: str, *, blank: bool) -> Strings:
        """(n,) texts of a column of texts or integers; null and empty texts are an error unless `blank` is true."""
        column = self._column(name)
        if column.null_count and not blank:
            raise self.fail(_first_null(column), f"{name} is null; a text was expected")
        kind = _plain(column.type)
        if not (_is_text(kind) or pa.types.is_integer(kind)):
            raise self._unfit(name, kind, "texts were expected")
        texts = to_texts(column, f"{self._path}: column {name}", MAX_CELL)
        if not blank and (texts == "").any():  # also null within a dictionary, which does not count as null
            raise self.fail(int(np.flatnonzero(texts == "")[0]), f"{name} is empty; a text was expected")
        return texts

    def lists(self, name: str, width: int) -> Floats:
        """(n, width) numbers of a column of lists.

        NaN for null. `ANY_WIDTH`: as many as the first list that is not empty. InputError for a list of another length.
        """
        column = self._column(name)
        if not (pa.types.is_list(column.type) or pa.types.is_large_list(column.type) or _is_row(column.type)):
            wanted = "numbers" if width == ANY_WIDTH else f"{width} numbers"
            raise self._unfit(name, column.type, f"lists of {wanted} were expected")
        if not _is_number(column.type.value_type):
            raise self._unfit(name, column.type, "lists of numbers were expected")
        lengths: Ints = to_numpy(pc.fill_null(pc.cast(pc.list_value_length(column), pa.int64()), 0)).astype(np.int64)
        there = to_numpy(column.is_valid())
        if width == ANY_WIDTH:
            there = lengths > 0
            width = int(lengths[there][0]) if there.any() else 0
        bad = there & (lengths != width)
        if bad.any():
            row = int(np.flatnonzero(bad)[0])
            raise self.fail(row, f"{name} has {lengths[row]} numbers; {width} were expected")
        if (beyond := _beyond(flat := column.flatten())).any():
            value = _shown(flat[int(np.flatnonzero(beyond)[0])])
            raise InputError(f"{self._path}: column {name} has {value}; whole numbers must be within +-{EXACT:.0f}")
        out = np.full((len(self), width), np.nan)
        numbers = pc.fill_null(pc.cast(flat, pa.float64()), np.nan)
        out[there] = to_numpy(numbers).reshape(-1, max(width, 1))
        return out

    def bools(self, name: str) -> Bools:
        """(n,) booleans of a column, also from texts and numbers (true, false, yes, no, 1, 0); null is an error."""
        column = self._column(name)
        if column.null_count:
            raise self.fail(_first_null(column), f"{name} is null; true or false was expected")
        if pa.types.is_boolean(column.type):
            return np.asarray(to_numpy(column), dtype=np.bool_)
        kind = _plain(column.type)
        if not (_is_text(kind) or _is_number(kind)):
            raise self._unfit(name, kind, "true or false was expected")
        return _yes_or_no(self, name, to_texts(column, f"{self._path}: column {name}", MAX_CELL))

    def times(self, name: str, unit: str) -> Ints:
        """(n,) times of a column [ns since the Unix epoch], from timestamps, durations, numbers or texts.

        `unit` is that of numbers; empty: inferred from their size. InputError for nulls, dates, times of a day, and
        floats that resolve time too coarsely.
        """
        column = self._column(name)
        if column.null_count:
            raise self.fail(_first_null(column), f"{name} is null; a time was expected")
        if pa.types.is_timestamp(column.type):
            try:
                stamps = pc.cast(column, pa.timestamp("ns", tz=column.type.tz))
            except ValueError as error:  # Arrow's own is one, and that of a time zone with a name that is no text
                raise InputError(f"{self._path}: column {name}: {error}") from None
            return np.asarray(to_numpy(pc.cast(stamps, pa.int64())), dtype=np.int64)
        if pa.types.is_duration(column.type):
            return np.asarray(to_numpy(pc.cast(pc.cast(column, pa.duration("ns")), pa.int64())), dtype=np.int64)
        if pa.types.is_time(column.type) or pa.types.is_date(column.type):
            raise self._unfit(name, column.type, "date and time together were expected; write timestamps")
        if pa.types.is_integer(column.type):
            whole = self.ints(name, blank=None)
            return self._scaled(name, whole, column_unit(whole.astype(np.float64), unit, self.fail))
        if pa.types.is_decimal(column.type):  # exact, as a text is
            return parse_column([str(value) for value in column.to_pylist()], unit, self.fail)
        if _is_number(column.type):
            values = self.floats(name, blank=False)
            unit = column_unit(values, unit, self.fail)
            self._check_range(name, values, unit)
            self._check_steps(name, unit)
            # The whole part and the rest separately, since float64 cannot hold ns since 1970
            floor = np.floor(values)
            rest = np.round((values - floor) * UNITS[unit]).astype(np.int64)
            return np.asarray(self._scaled(name, floor.astype(np.int64), unit) + rest, dtype=np.int64)
        return parse_column(self.texts(name, blank=False).tolist(), unit, self.fail)

    def _scaled(self, name: str, values: Ints, unit: str) -> Ints:
        self._check_range(name, values, unit)
        return values * UNITS[unit]

    def _check_range(self, name: str, values: Floats | Ints, unit: str) -> None:
        limit = MAX_NS // UNITS[unit]
        if not ((values >= -limit) & (values <= limit)).all():
            raise InputError(
                f"{self._path}: column {name}: a time in {unit} is out of range; times from 1824 to 2115 can be held; "
                "check its unit",
                id="time-out-of-range",
            )

    def _check_steps(self, name: str, unit: str) -> None:
        """InputError for times in floats of insufficient precision: since 1970, float32 resolves 128 s only.

        `name` is that of the column, `unit` the unit of its numbers.
        """
        steps = self.steps(name) * UNITS[unit]
        if (steps > COARSEST_NS).any():
            row = int(np.flatnonzero(steps > COARSEST_NS)[0])
            value, kind = self._column(name)[row].as_py(), self._column(name).type
            raise self.fail(
                row, f"{name} is {value:.12g} in {kind}: {coarse(steps[row])}; write it in float64, or t_ns in int64"
            )

    def _unfit(self, name: str, kind: pa.DataType, wanted: str) -> InputError:
        return InputError(f"{self._path}: column {name} holds {_plain(kind)}; {wanted}")

    def _column(self, name: str) -> pa.Array:
        column = self._batch.column(name)
        return column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column


def _beyond(column: pa.Array) -> Bools:
    """(n,) mask of integers beyond +-2^53, which float64 cannot hold exactly; all False for other types."""
    if column.type not in (pa.int64(), pa.uint64()):
        return np.zeros(len(column), dtype=np.bool_)
    whole: Ints = to_numpy(pc.fill_null(column, 0)).astype(np.uint64 if column.type == pa.uint64() else np.int64)
    low, high = (0 if column.type == pa.uint64() else -int(EXACT)), int(EXACT)
    return np.asarray((whole < low) | (whole > high))


def _yes_or_no(cells: TableCells, name: str, texts: Strings) -> Bools:
    low = np.char.lower(np.char.strip(texts))
    yes = np.isin(low, YES)
    bad = ~(yes | np.isin(low, NO))
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise cells.fail(row, f"{name} is {str(texts[row])[:60]!r}; true or false was expected")
    return np.asarray(yes)


def _plain(kind: pa.DataType) -> pa.DataType:
    """Type of the values of a column: of a dictionary-encoded column that of the dictionary, else `kind` itself."""
    return kind.value_type if pa.types.is_dictionary(kind) else kind


def _is_number(kind: pa.DataType) -> bool:
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind))


def _is_text(kind: pa.DataType) -> bool:
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind) or pa.types.is_string_view(kind))


def _is_row(kind: pa.DataType) -> bool:
    return bool(pa.types.is_fixed_size_list(kind))


def _first_null(column: pa.Array) -> int:
    return int(np.flatnonzero(to_numpy(column.is_null()))[0])


def _shown(value: pa.Scalar) -> str:
    return "null" if not value.is_valid else str(value.as_py())
