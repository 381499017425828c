"""Base of tables: columns declared once with dtype, unit and description; validation on construction.

Also the limit of times and lengths.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from occlog.array_types import Bools, Floats, Ints
from occlog.errors import InputError

MAX_NS = 2**62 - 1
"""Largest time [ns since the Unix epoch, year 2116] and length of time: two of them have a difference in 64 bits."""


def bounded_ns(t_ns: int) -> int:
    """Return a time or length of time `t_ns` [ns] from a file unchanged; ValueError if it is beyond +-`MAX_NS`."""
    if not -MAX_NS <= t_ns <= MAX_NS:
        far = f"{t_ns} ns" if abs(t_ns) < 10**24 else f"ns in {len(str(abs(t_ns)))} digits"
        raise ValueError(f"its time of {far} is out of range (years 1823 to 2116); check its unit")
    return t_ns


ROUNDING, TINY = 5e-10, 1e-150
"""Relative and absolute tolerance by which the covariance of x and y may exceed the product of their deviations."""
ANY_WIDTH = -1
"""Width of a column with vectors of any equal length; 0 if not given."""


MAX_LENGTH = 1e15
"""Largest coordinate, length and speed, in whatever unit: beyond it 64 bits do not resolve one unit."""
MAX_PX = 1e15
"""Largest distance in an image: the tangent of a direction that is across to the last digit of an angle."""
LENGTHS = {"m": 1, "m^2": 2, "m/s": 1, "m^2/s": 2, "m^2/s^2": 2}
"""Units in which m represents the scene's unit of length, and the power of it."""


def largest(unit: str) -> float:
    """Largest absolute value allowed in a column with that unit.

    `MAX_LENGTH` to the power in which the unit has the length (`LENGTHS`), or `MAX_PX` for px, its square for px^2;
    infinite for other units.
    """
    if unit in LENGTHS:
        return MAX_LENGTH ** LENGTHS[unit]
    return {"px": MAX_PX, "px^2": MAX_PX**2}.get(unit, math.inf)


def in_length_unit(unit: str, length_unit: str) -> str:
    """Unit of a column, declared in metres, in the scene's unit of length: `m^2/s` with `cm` becomes `cm^2/s`.

    A unit that is not in `LENGTHS` (`rad`, `px`) is returned unchanged.
    """
    return unit.replace("m", length_unit) if unit in LENGTHS else unit


@dataclass(frozen=True, slots=True)
class Column:
    """Declaration of a column of a `ColumnTable`: name, NumPy kind, width of a row, unit and description.

    The width is the number of values in each row: 0 for a scalar, `ANY_WIDTH` (-1) if the file decides. `nan` is the
    meaning of NaN, None if NaN is not allowed. Files may lack an `optional` column.
    """

    name: str
    kind: str
    width: int
    unit: str
    doc: str
    nan: str | None
    optional: bool

    @property
    def dtype(self) -> np.dtype[np.generic]:
        """NumPy dtype of the column; "U" for strings of any length."""
        return np.dtype(self.kind)

    @property
    def limits(self) -> tuple[int, int]:
        """Smallest and largest integer of the column's kind (`i4`, `i8`, `u1`, ...), which must be one of integers."""
        bits = 8 * self.dtype.itemsize
        return (-(1 << bits - 1), (1 << bits - 1) - 1) if self.dtype.kind == "i" else (0, (1 << bits) - 1)


KINDS = {"Floats": "f8", "Floats32": "f4", "Ints": "i8", "Ints32": "i4", "Bools": "?", "Strings": "U"}
"""NumPy kind of a column by the name of the array type it is declared with."""


def column(doc: str, unit: str = "1", *, nan: str | None = None, width: int = 0, optional: bool = False) -> Any:
    """Dataclass field that declares a table column; its array type (`Floats`, `Strings`, ...) gives the NumPy kind.

    An `optional` column without values is NaN, "" or, for integers, -1.

    Args:
        doc: meaning of the values, without a capital.
        unit: for example `px`, `rad`, `m`; `1`: none.
        nan: meaning of NaN; None: NaN is not allowed.
        width: numbers in each row; 0: one, `ANY_WIDTH`: as many as the file has.
        optional: files may lack it.
    """
    metadata = {"unit": unit, "doc": doc, "nan": nan, "width": width, "optional": optional}
    return field(default=None, metadata=metadata) if optional else field(metadata=metadata)


class ColumnTable:
    """Base class of tables: frozen dataclasses with a NumPy array for each column, all of equal length.

    A subclass declares its columns by `column`, its `NAME` in files, its `VERSION` and its sort key `KEY`. Construction
    fills optional columns that are None with missing values, and raises InputError if dtypes, shapes or values
    contradict the declaration.
    """

    __slots__ = ()
    NAME: ClassVar[str]
    VERSION: ClassVar[int] = 1
    KEY: ClassVar[tuple[str, ...]]
    ONCE: ClassVar[bool] = False
    """Whether keys are unique: two rows of one key contradict each other."""
    MEASURED: ClassVar[str] = ""
    """Column that is finite where a row is a measurement that no other can equal, even if it is of no person's."""

    def __post_init__(self) -> None:
        for c in self.columns():
            if c.optional and getattr(self, c.name) is None:
                object.__setattr__(self, c.name, _absent(c, len(self)))  # frozen for all other code
        check_columns(self)
        check_order(self)
        self.check()

    def check(self) -> None:
        """Raise InputError if values contradict each other; does nothing here, tables override it.

        Called by the constructor after types, shapes, ranges and NaN of all columns and the order of times have been
        checked.
        """

    def refuse(self, wrong: Bools, fault: str) -> None:
        """Raise InputError if a row is wrong: with the table's name, the index of the first such row, and the fault.

        Args:
            wrong: (n,) mask of the rows at fault.
            fault: text in which `{NAME}`, or `{NAME:g}`, is the row's value in the column NAME.
        """
        if wrong.any():
            row = first_row(wrong)
            values = {c.name: getattr(self, c.name)[row].tolist() for c in self.columns()}
            raise InputError(f"{type(self).__name__}: row {row}: {fault.format(**values)}")

    def __len__(self) -> int:
        return len(getattr(self, "t_ns"))  # noqa: B009

    @classmethod
    @functools.cache
    def columns(cls) -> tuple[Column, ...]:
        """The declared columns, in file order."""
        return tuple(Column(f.name, KINDS[str(f.type)], **f.metadata) for f in fields(cls))  # type: ignore[arg-type]

    @classmethod
    def empty(cls) -> Self:
        """A table without rows."""
        return cls(**{c.name: _empty_column(c, 0) for c in cls.columns()})

    @classmethod
    def of(cls, **values: object) -> Self:
        """Build a table from array-likes, cast to the declared dtypes; optional columns may be omitted."""
        columns = [c for c in cls.columns() if not c.optional or c.name in values]
        return cls(**{c.name: as_column(c, values.pop(c.name)) for c in columns}, **values)

    @classmethod
    def concat(cls, parts: Iterable[Self]) -> Self:
        """One table with the rows of several tables in the given order, not sorted; empty parts are ignored."""
        tables = [part for part in parts if len(part)]
        if not tables:
            return cls.empty()
        return cls(**{c.name: _joined(c, [getattr(t, c.name) for t in tables]) for c in cls.columns()})

    @classmethod
    def merge(cls, parts: Iterable[Self]) -> Self:
        """One table with the rows of several tables, which may overlap in time, sorted by `KEY` (stable)."""
        tables = [part for part in parts if len(part)]
        if not tables:
            return cls.empty()
        values = {c.name: _joined(c, [getattr(t, c.name) for t in tables]) for c in cls.columns()}
        order = np.lexsort([values[name] for name in reversed(cls.KEY)])
        return cls(**{name: column[order] for name, column in values.items()})

    def take(self, rows: Ints | Bools | slice) -> Self:
        """New table with the selected rows; `rows` is a mask, a slice or an index array."""
        return type(self)(**{c.name: getattr(self, c.name)[rows] for c in self.columns()})

    def with_columns(self, **values: object) -> Self:
        """Copy with other values in the named columns, cast to the declared dtypes."""
        return type(self).of(**{c.name: getattr(self, c.name) for c in self.columns()} | values)

    def same_rows(self, other: Self) -> bool:
        """Whether two tables have the same rows in the same order; NaN equals NaN."""
        columns = ((getattr(self, c.name), getattr(other, c.name)) for c in self.columns())
        return all(np.array_equal(x, y, equal_nan=x.dtype.kind == "f") for x, y in columns)

    def sorted(self) -> Self:
        """Copy with the rows sorted by `KEY` (stable); an empty table is returned as it is."""
        if not len(self):
            return self
        return self.take(np.lexsort([getattr(self, name) for name in reversed(self.KEY)]))


def _absent(c: Column, rows: int) -> NDArray[np.generic]:
    """Values of an optional column that a table with `rows` rows lacks: "", NaN or, for integers, -1.

    Shape (rows,); of a column of vectors of any length (rows, 0).
    """
    if c.kind == "U":
        return np.full(rows, "")
    if c.width == ANY_WIDTH:
        return _empty_column(c, rows)
    return np.full(rows, np.nan if c.dtype.kind == "f" else -1, dtype=c.dtype)


def _empty_column(c: Column, rows: int) -> NDArray[np.generic]:
    shape = (rows, max(c.width, 0)) if c.width else (rows,)
    return np.empty(shape, dtype="U1" if c.kind == "U" else c.dtype)


def _joined(c: Column, parts: list[NDArray[np.generic]]) -> NDArray[np.generic]:
    """Concatenate arrays of one column from several tables.

    Vectors of any length (`ANY_WIDTH`) must have the same length in all parts, otherwise InputError; parts of width 0
    (without such vectors) are filled with NaN.
    """
    if c.width != ANY_WIDTH:
        return np.concatenate(parts)
    (length, *others) = sorted({part.shape[1] for part in parts} - {0}) or [0]
    if others:
        raise InputError(
            f"column {c.name}: vectors of {length} and of {others[0]} numbers in one table; all must have one length",
            id="incompatible-inputs",
        )
    return np.concatenate([p if p.shape[1] else np.full((len(p), length), np.nan, dtype=c.dtype) for p in parts])


def as_column(c: Column, values: object) -> NDArray[np.generic]:
    """Cast array-like values to the dtype of a column; empty values become an empty array of the declared shape.

    InputError for fractional numbers in an integer column, and for integers outside the column's range.
    """
    array = np.asarray(values)
    if not array.size:
        return _empty_column(c, len(array) if c.width == ANY_WIDTH else 0)
    if c.kind == "U":
        return array.astype(np.str_)
    if array.dtype.kind == "f" and c.dtype.kind in "iu":
        raise InputError(
            f"column {c.name}: has floating-point numbers, but integers ({c.kind}) are declared; convert them"
        )
    if array.dtype.kind in "iu" and c.dtype.kind in "iu" and array.dtype != c.dtype:
        low, high = c.limits
        bad = (array < low) | (array > high)
        if bad.any():  # a cast would make other numbers of them
            row = int(np.argwhere(bad)[0, 0])
            raise InputError(f"column {c.name}: row {row}: {array[row]} must be {low} to {high}")
    return np.asarray(array.astype(c.dtype, casting="same_kind", copy=False))


def semidefinite(xx: Floats, xy: Floats, yy: Floats) -> Bools:
    """(n,) mask of the covariances [[xx, xy], [xy, yy]] that are positive semidefinite up to rounding.

    The elements are given as columns (n,). False where an element is NaN. Tolerances: `ROUNDING` (relative), `TINY`
    (absolute).
    """
    with np.errstate(invalid="ignore"):
        most = np.sqrt(np.maximum(xx, 0.0)) * np.sqrt(np.maximum(yy, 0.0))
        return np.asarray((xx >= 0.0) & (yy >= 0.0) & (np.abs(xy) <= most * (1.0 + ROUNDING) + TINY))


def check_columns(record: ColumnTable) -> None:
    """InputError if a column has another dtype, shape or length than declared, or a value that is not allowed.

    Such values are NaN in a column that does not declare it, infinities, lengths and pixels beyond their limits
    (`largest`), and times beyond +-`MAX_NS`.
    """
    name = type(record).__name__
    length = None
    for c in record.columns():
        values = getattr(record, c.name)
        ok = values.dtype.kind == "U" if c.kind == "U" else values.dtype == c.dtype
        fits = values.ndim == 2 if c.width == ANY_WIDTH else values.shape[1:] == ((c.width,) if c.width else ())
        if not ok or not fits:
            raise InputError(
                f"{name}.{c.name}: expected {c.kind} with {c.width} numbers a row (0: a scalar, -1: any number), "
                f"got {values.dtype} {values.shape}"
            )
        length = len(values) if length is None else length
        if len(values) != length:
            raise InputError(
                f"{name}.{c.name}: has {len(values)} rows, but the first column {length}; columns must have equal "
                "lengths"
            )
        if values.dtype.kind == "f":
            _check_finite(name, c, values)
        elif c.unit == "ns" and values.size:
            _check_times(name, c, values)


def _check_finite(name: str, c: Column, values: NDArray[np.generic]) -> None:
    bad = ~np.isfinite(values) if c.nan is None else np.isinf(values)
    if bad.any():
        row = int(np.argwhere(bad)[0, 0])
        hint = "must be a finite number" if c.nan is None else "must not be infinite"
        raise InputError(f"{name}.{c.name}: row {row}: {values[row]} {hint}")
    most = largest(c.unit)
    if (bad := np.abs(values) > most).any():
        row = int(np.argwhere(bad)[0, 0])
        raise InputError(f"{name}.{c.name}: row {row}: {values[row]:g} {c.unit} must be within {most:g} {c.unit}")


def _check_times(name: str, c: Column, values: NDArray[np.generic]) -> None:
    for extreme in (values.min(), values.max()):
        try:
            bounded_ns(int(extreme))
        except ValueError as error:
            row = int(np.argwhere(values == extreme)[0, 0])
            raise InputError(f"{name}.{c.name}: row {row}: {error} (ns since 1970)", id="time-out-of-range") from None


def check_order(table: ColumnTable) -> None:
    """InputError, with the row, if the column `t_ns` of a table decreases from one row to the next."""
    t_ns: Ints = getattr(table, "t_ns")  # noqa: B009
    back = np.flatnonzero(t_ns[1:] < t_ns[:-1])  # a difference could overflow
    if len(back):
        row = int(back[0]) + 1
        raise InputError(
            f"{type(table).__name__}: t_ns goes back at row {row} ({t_ns[row]} after {t_ns[row - 1]}); sort by time",
            id="unsorted-times",
        )


def repeated_rows(table: ColumnTable, but: str = "") -> tuple[Bools, Bools]:
    """Masks of duplicate rows, and of rows that repeat the key with other values, in a table sorted by its key.

    If the last column of the key is an integer identity, rows with -1 (no identity) are in neither mask, since several
    unidentified objects may have equal values; but two such rows with the same finite measurement (column `MEASURED`)
    are duplicates.

    Args:
        table: sorted by its `KEY`.
        but: column of the key that is not compared, such as the number that a row got when the file was read; empty:
            all are.

    Returns:
        (n,), (n,): rows that equal an earlier one in all columns; other rows with the key of an earlier row.
    """
    rows = len(table)
    like = np.ones(max(rows - 1, 0), dtype=np.bool_)
    key = [name for name in table.KEY if name != but]
    for name in key:
        values = getattr(table, name)
        like &= values[1:] == values[:-1]
        if not like.any():
            return np.zeros(rows, dtype=np.bool_), np.zeros(rows, dtype=np.bool_)
    near = np.flatnonzero(np.append(like, False) | np.append(False, like))
    # A number for each set of values: copies have the same ones in all columns
    codes = [
        np.unique(_comparable(table, c, near), axis=0, return_inverse=True)[1].reshape(-1)
        for c in table.columns()
        if c.name != but
    ]
    order = np.lexsort(codes[::-1])  # stable: the first of several copies stays the first
    sets = np.column_stack(codes)[order]
    copy, twice = np.zeros(rows, dtype=np.bool_), np.append(False, like)
    copy[near[order[1:]]] = (sets[1:] == sets[:-1]).all(axis=1)
    last = getattr(table, key[-1])
    valid = last >= 0 if last.dtype.kind == "i" and key[-1] != "t_ns" else np.ones(rows, dtype=np.bool_)
    alone = valid | np.isfinite(getattr(table, table.MEASURED)) if table.MEASURED else valid
    return copy & alone, twice & ~copy & valid


def is_in_key_order(table: ColumnTable) -> bool:
    """Whether the rows of a table are sorted by all columns of its `KEY`, first by the first of them."""
    near = np.arange(max(len(table) - 1, 0))
    for name in table.KEY:
        values = getattr(table, name)
        before, after = values[near], values[near + 1]
        if (after < before).any():
            return False
        near = near[after == before]
    return True


def check_copies(table: ColumnTable) -> None:
    """InputError if a table, in any order, has two equal rows, or two rows of one key if keys are unique (`ONCE`)."""
    table = table if is_in_key_order(table) else table.sorted()
    copies, twice = repeated_rows(table)
    if copies.any():
        where = key_of(table, first_row(copies))
        raise InputError(f"{type(table).__name__}: a row is repeated ({where}); omit the copies", id="duplicate-row")
    if table.ONCE and twice.any():
        where = key_of(table, first_row(twice))
        raise InputError(
            f"{type(table).__name__}: {where}: is there twice, with other values; keep one of them", id="duplicate-row"
        )


def key_of(table: ColumnTable, row: int) -> str:
    """Text for messages: names and values of the key of the row with index `row`, as `t_ns 5, target_id 1`."""
    return ", ".join(f"{name} {getattr(table, name)[row]}" for name in table.KEY)


def _comparable(table: ColumnTable, c: Column, rows: Ints) -> NDArray[np.generic]:
    """Values of column `c` in the rows with the indices `rows`, in a type in which NaN equals NaN.

    Floats become integers of the same bits; vectors of length 0 become zeros.
    """
    values: NDArray[np.generic] = getattr(table, c.name)[rows]
    if not values.size:  # vectors of no numbers
        return np.zeros(len(rows))
    return np.ascontiguousarray(values).view(f"i{values.itemsize}") if values.dtype.kind == "f" else values


def rows_by_label(labels: NDArray[np.signedinteger]) -> list[tuple[int, Ints]]:
    """(label, sorted indices of its rows) for each distinct integer of `labels` (n,), in ascending order."""
    order = np.argsort(labels, kind="stable")
    names, first = np.unique(labels[order], return_index=True)
    pieces = np.split(order, first)[1:]  # the first piece is what lies before the first name: nothing
    return list(zip(names.tolist(), pieces, strict=True))


def first_row(mask: Bools) -> int:
    """Index of the first True in a mask that has one."""
    return int(np.flatnonzero(mask)[0])
