"""Pages of Parquet by their heads: what they unpack to is looked at before anything is unpacked.

The footer says how large groups of rows are, but the library believes the head of each page, so that a small file with
a modest footer may unpack to gigabytes.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from typing import NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq

from occlog.errors import InputError
from occlog.io.files.untrusted.promises import most_unpacked

from .check_sums import Checked
from .footer import Group
from .thrift import I32, SHORT, STRUCT, VARINT, MalformedError, Reader, Struct, from_varint

DICTIONARY = 2
"""The kind of a page that has no rows, but what they refer to."""
BYTES_PER_VALUE = 8
Columns = frozenset[str] | None
"""Those that are read of a group; None: all."""
KIND, UNPACKED, PACKED, DATA_HEAD, DATA_HEAD_2, VALUES = 1, 2, 3, 5, 8, 1  # fields, by the numbers of the format
WINDOWS = (128, 1 << 16, 1 << 24)
"""Bytes that a head is looked for in: most are of 40, some have long statistics."""
_USUAL = re.compile(
    rb"\x15(%b)\x15(%b)\x15(%b)(?:(?:\x15%b\x1c|\x2c)\x15(%b)(?:\x15%b){3}(?:\x1c%b)?|(?:\x15%b\x3c|\x4c)(?:\x15%b){2}[\x11\x12]?)\0\0"
    % (*(VARINT,) * 6, SHORT, VARINT, VARINT),
    re.DOTALL,
)
"""Kind, sizes, perhaps a check sum; number of values, encodings, perhaps statistics; or what dictionaries have."""


class Page(NamedTuple):
    """What the head of a page says.

    Attributes:
        kind: of the format's numbers.
        unpacked: size of what follows, unpacked [bytes].
        packed: size of what follows [bytes].
        values: how many numbers or texts it has, null ones included.
        begin: where what follows begins, from the begin of the data.
    """

    kind: int
    unpacked: int
    packed: int
    values: int
    begin: int


def read_head(data: bytes | memoryview, at: int = 0) -> Page:
    """The head of the page that begins at a byte; MalformedError if there is none."""
    usual = _USUAL.match(data, at)
    if usual is not None:  # a tenth of the time
        kind, unpacked, packed, values = (from_varint(each or b"\0") for each in usual.groups())
        end = usual.end()
    else:
        reader = Reader(data, at)
        head = reader.struct()
        kind, unpacked, packed = (_number(head, field) for field in (KIND, UNPACKED, PACKED))
        told = head.get(DATA_HEAD) or head.get(DATA_HEAD_2)
        values = _number(told.value, VALUES) if told is not None and told.kind == STRUCT else 0
        end = reader.at
    if min(unpacked, packed, values) < 0:
        raise MalformedError("the head of a page with a size below 0")
    return Page(kind, unpacked, packed, values, end)


def _number(fields: Struct, number: int) -> int:
    found = fields.get(number)
    if found is None or found.kind != I32:
        raise MalformedError("the head of a page without its sizes")
    return int(found.value)


class PagedFile(pq.ParquetFile):  # type: ignore[misc]  # the library has no types
    """A Parquet file whose pages are unpacked only after a look at the heads of all of them.

    Attributes:
        checked: its bytes.
    """

    def __init__(self, source: Checked, groups: Sequence[Group], **options: object) -> None:
        """Open `source`, whose footer has these groups of rows; `options` are those of the library."""
        super().__init__(source, **options)
        self.checked = source
        self._groups = groups
        self._tried: set[tuple[Columns, int]] = set()
        self._unpacked = Counter[Columns]()  # of the groups that were tried, with the same columns [bytes]

    def iter_batches(  # noqa: D102 - as the library's own
        self, batch_size: int, row_groups: Collection[int] | None = None, columns: Collection[str] | None = None
    ) -> Iterator[pa.RecordBatch]:
        numbers = range(self.num_row_groups) if row_groups is None else row_groups
        for number in numbers:
            self._check(number, columns)
        rows = 0
        for batch in super().iter_batches(batch_size=batch_size, row_groups=row_groups, columns=columns):
            rows += batch.num_rows
            yield batch
        self._check_rows(rows, numbers)

    def read(self, columns: Collection[str] | None = None) -> pa.Table:  # noqa: D102 - as the library's own
        for number in range(self.num_row_groups):
            self._check(number, columns)
        table = super().read(columns=columns)
        self._check_rows(table.num_rows, range(self.num_row_groups))
        return table

    def _check_rows(self, rows: int, numbers: Collection[int]) -> None:
        """Raise ArrowInvalid where groups gave other than their rows: the library ends early on some damage."""
        promised = sum(self._groups[number].rows for number in numbers)
        if rows != promised:
            raise pa.ArrowInvalid(f"{promised} rows are promised, and {rows} can be read")

    def _check(self, number: int, columns: Collection[str] | None) -> None:
        """InputError where pages of a group, with those of others before, unpack to more than such a file can hold."""
        wanted = None if columns is None else frozenset(columns)
        if (wanted, number) in self._tried:
            return
        most, before, unpacked = most_unpacked(self.checked.size), self._unpacked[wanted], 0
        group = self._groups[number]
        for path, begin, end in group.chunks:
            if wanted is not None and path[0] not in wanted:
                continue
            values, at = 0, begin
            while at < end:
                page = self._head(at, end)
                values, at = values + page.values, at + page.begin + page.packed
                unpacked += page.unpacked + BYTES_PER_VALUE * min(max(values - group.rows, 0), page.values)  # of lists
                if before + unpacked > most:
                    self.checked.read_at(begin, at - begin)  # a damaged head is told as that
                    raise InputError(
                        f"{self.checked.path}: column {path[0]} unpacks to more than {most} bytes in a "
                        f"file of {self.checked.size} bytes, which no measurements fit into"
                    )
        self._tried.add((wanted, number))
        self._unpacked[wanted] += unpacked

    def _head(self, at: int, end: int) -> Page:
        """The head at a byte of a column that goes on up to `end`.

        Its check sums are tried when the column is read: here only where it is no head, since damage is told as such.
        """
        for window in WINDOWS:
            try:
                return read_head(self.checked.peek(at, window))
            except MalformedError:
                if window == WINDOWS[-1] or at + window >= end:
                    self.checked.read_at(at, window)
                    raise
        raise AssertionError
