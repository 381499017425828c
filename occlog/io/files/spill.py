"""Temporary data on disk: records in blocks of equal length, sequences of numbers, and chunks of a table.

Blocks can be read and replaced in any order. Numbers stay in memory while they are few. A table is kept while it is
read for the first time, for inputs that are slow to read. The files have no name, so that nothing remains when the
program ends.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any, Generic, TypeVar

import numpy as np
import pyarrow as pa

from occlog.array_types import Floats
from occlog.records.columns import ColumnTable

from .atomic import translate_write_errors
from .provenance import Provenance
from .tables.arrow import arrow_schema, from_arrow, to_arrow

RECORDS_PER_BLOCK = 1 << 14
"""Records of a block."""
RECORD_BYTES_IN_MEMORY = 1 << 23
"""Bytes that are kept in memory; more go to a file in the folder for temporary files."""

Records = np.ndarray[Any, np.dtype[Any]]


def _scratch(in_memory: int) -> tempfile.SpooledTemporaryFile[bytes]:
    """Temporary file without a name, in memory as long as it has at most `in_memory` bytes."""
    return tempfile.SpooledTemporaryFile(max(in_memory, 1))


class Blocks:
    """Temporary array of records of one NumPy dtype in blocks of equal length, on disk if it is large.

    Append all records, call `end`, and then read or replace blocks in any order.
    """

    def __init__(
        self, record: np.dtype[Any], block: int = RECORDS_PER_BLOCK, in_memory: int = RECORD_BYTES_IN_MEMORY
    ) -> None:
        """Start without records.

        Args:
            record: dtype of a record.
            block: number of records in a block.
            in_memory: bytes that are kept in memory; if there are more, all are in a temporary file.
        """
        self._record, self._block, self._file = record, block, _scratch(in_memory)
        self._open: list[Records] = []
        self._rows = 0
        self.count = 0
        """Number of blocks, once `end` was called."""

    def __del__(self) -> None:
        """Close the temporary file."""
        self._file.close()

    def append(self, rows: Records) -> None:
        """Append records (n,); OutputError if the folder for temporary files is full."""
        self._open.append(rows)
        self._rows += len(rows)
        if self._rows < self._block:
            return
        together = np.concatenate(self._open)
        whole = self._rows - self._rows % self._block
        for start in range(0, whole, self._block):
            self.put(self.count, together[start : start + self._block])
            self.count += 1
        self._open, self._rows = [together[whole:].copy()], self._rows - whole

    def end(self) -> None:
        """Store the last block, which may be shorter; blocks can be read from now on."""
        if self._rows:
            self.put(self.count, np.concatenate(self._open))
            self.count += 1
        self._open, self._rows = [], 0

    def put(self, number: int, rows: Records) -> None:
        """Store a copy of `rows` as block `number`, replacing the old one; only the last block may be shorter."""
        with translate_write_errors(Path(tempfile.gettempdir())):
            self._file.seek(number * self._block * self._record.itemsize)
            self._file.write(rows.tobytes())
            self._file.flush()

    def get(self, number: int) -> Records:
        """Records of block `number`, a read-only copy."""
        self._file.seek(number * self._block * self._record.itemsize)
        return np.frombuffer(self._file.read(self._block * self._record.itemsize), dtype=self._record)

    def rows(self, first: int, last: int) -> Records:
        """Copy of the records first <= n < last; call after `end`."""
        parts = [np.zeros(0, dtype=self._record)]
        for number in range(first // self._block, -(-last // self._block)):
            start = number * self._block
            parts.append(self.get(number)[max(first - start, 0) : last - start])
        return np.concatenate(parts)


NUMBERS_IN_MEMORY = 1 << 20
"""Numbers that are kept in memory; more go to a file in the folder for temporary files, 8 bytes each."""
NUMBERS_PER_BLOCK = 1 << 17
"""Numbers that are read of the file at once."""


class Spool:
    """Temporary sequence of numbers, added in parts and read repeatedly in the same order; on disk if it is long.

    The file has no name, so that nothing remains when the program ends.
    """

    def __init__(self, in_memory: int = NUMBERS_IN_MEMORY) -> None:
        """Start empty; up to `in_memory` numbers stay in memory."""
        self.count = 0
        self._in_memory, self._file = in_memory, _scratch(8 * in_memory)

    def __del__(self) -> None:
        """Close the temporary file."""
        self._file.close()

    def add(self, values: Floats) -> None:
        """Add a copy of values (n,); OutputError if the folder for temporary files is full."""
        with translate_write_errors(Path(tempfile.gettempdir())):
            self._file.seek(8 * self.count)
            self._file.write(np.asarray(values, dtype=np.float64).tobytes())
            self._file.flush()
        self.count += len(values)

    @property
    def whole(self) -> Floats | None:
        """(N,) all numbers, if they are in memory; None if they are on disk."""
        return None if self.count > self._in_memory else np.concatenate([np.zeros(0), *self.blocks()])

    def blocks(self) -> Iterator[Floats]:
        """Yield all numbers in the order in which they were added, in arrays of limited length."""
        for first in range(0, self.count, NUMBERS_PER_BLOCK):
            self._file.seek(8 * first)
            yield np.frombuffer(self._file.read(8 * NUMBERS_PER_BLOCK), dtype=np.float64)


T = TypeVar("T", bound=ColumnTable)


class SpilledTable(Generic[T]):
    """Table from a source that can be read only once, with chunks that can be read repeatedly.

    They are kept in a temporary file. The file has no name, so that nothing remains when the program ends.
    """

    def __init__(self, table: type[T], source: Callable[[], Iterator[T]]) -> None:
        """Prepare without reading.

        Args:
            table: type of the table.
            source: returns an iterator over all chunks; called once.
        """
        self._table, self._source = table, source
        self._schema = arrow_schema(table, Provenance("aside"))
        self._file: IO[bytes] | None = None
        self.rows = 0
        """Number of rows, once all were read."""

    def __del__(self) -> None:
        """Close the temporary file."""
        if self._file is not None:
            self._file.close()

    def chunks(self) -> Iterator[T]:
        """Iterate over all chunks, from the source for the first time and then from the file.

        The first iteration must be completed before another one begins.

        Raises:
            OutputError: the folder for temporary files is full.
        """
        return self._again(self._file) if self._file is not None else self._first()

    def _first(self) -> Iterator[T]:
        where, rows = Path(tempfile.gettempdir()), 0
        with translate_write_errors(where):
            file = tempfile.TemporaryFile()  # noqa: SIM115 - as long as this is
        try:
            with pa.ipc.new_stream(file, self._schema, options=pa.ipc.IpcWriteOptions(compression="lz4")) as writer:
                for chunk in self._source():
                    with translate_write_errors(where):
                        writer.write_table(to_arrow(chunk, self._schema))
                    rows += len(chunk)
                    yield chunk
        except BaseException:
            file.close()
            raise
        self._file, self.rows = file, rows

    def _again(self, file: IO[bytes]) -> Iterator[T]:
        file.seek(0)
        with pa.ipc.open_stream(file) as reader:
            for batch in reader:
                yield from_arrow(batch, self._table)
