"""Writing of tables as Parquet, chunk by chunk, with page check sums."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Any, Self

import pyarrow as pa
import pyarrow.parquet as pq

from occlog.io.files.atomic import OutputGroup, open_output
from occlog.io.files.names import TABLE, check_output_name
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.arrow import arrow_schema, statements, to_arrow
from occlog.records.columns import ColumnTable

ROWS_PER_GROUP = 65_536
BYTES_PER_GROUP = 4 * 1024 * 1024
WRITTEN: dict[str, Any] = {
    "version": "2.6",
    "compression": "zstd",
    "compression_level": 3,
    "write_page_checksum": True,
}
"""Settings of Parquet pages."""


class TableWriter:
    """Context manager that writes a table as Parquet chunk by chunk.

    The file appears if the block ends without an error.
    """

    def __init__(
        self,
        path: Path,
        table: type[ColumnTable],
        provenance: Provenance,
        *,
        overwrite: bool = False,
        length_unit: str = "m",
        together: OutputGroup | None = None,
    ) -> None:
        """Prepare to write; nothing is opened before the block begins.

        Args:
            path: the file.
            table: type of the table.
            provenance: stored with it.
            overwrite: replace an existing file.
            length_unit: of its lengths.
            together: group at the end of which the file appears; None: at the end of the block.

        Raises:
            UsageError: the name promises another format.
        """
        check_output_name(path, TABLE)
        self.rows = 0
        self._table = table
        self._schema, self._length_unit = arrow_schema(table, provenance, length_unit), length_unit
        self._pending: list[ColumnTable] = []
        self._pending_rows = self._pending_bytes = 0
        self._output = open_output(Path(path), overwrite, together)
        self._writer: pq.ParquetWriter | None = None

    def __enter__(self) -> Self:
        """Open the output; OutputExistsError if it exists and may not be replaced."""
        file = self._output.__enter__()
        try:
            self._writer = pq.ParquetWriter(
                file, self._schema, write_page_index=True, sorting_columns=[pq.SortingColumn(0)], **WRITTEN
            )
        except BaseException as failure:
            self._output.__exit__(type(failure), failure, failure.__traceback__)
            raise
        return self

    def write(self, table: ColumnTable) -> None:
        """Append rows, in the order of time.

        They are collected into row groups, so that many small chunks cost no space.
        """
        self.rows += len(table)
        self._pending.append(table)
        self._pending_rows += len(table)
        self._pending_bytes += sum(getattr(table, c.name).nbytes for c in table.columns())
        if self._pending_rows >= ROWS_PER_GROUP or self._pending_bytes >= BYTES_PER_GROUP:
            self._flush()

    def _flush(self) -> None:
        if self._pending_rows and self._writer is not None:
            whole = to_arrow(self._table.concat(self._pending), self._schema)
            self._writer.write_table(whole, row_group_size=ROWS_PER_GROUP)
        self._pending, self._pending_rows, self._pending_bytes = [], 0, 0

    def annotate(self, provenance: Provenance) -> None:
        """Replace the stored provenance, when it is complete only after the last row (for example with losses)."""
        if self._writer is not None:
            self._writer.add_key_value_metadata(statements(provenance, self._length_unit))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool | None:
        """Complete the file, or delete it after an error."""
        try:
            if kind is None:
                self._flush()
            self._close(kind is not None)
        except BaseException as failure:
            self._close(True)
            if not self._output.__exit__(type(failure), failure, failure.__traceback__):
                raise
        return self._output.__exit__(kind, error, trace)

    def _close(self, abandon: bool) -> None:
        """Close the library's writer, so that garbage collection does not finalise an abandoned one.

        `abandon`: the file is to be deleted, and errors are ignored.
        """
        if self._writer is None:
            return
        try:
            self._writer.close()
        except (pa.ArrowException, OSError, ValueError):
            self._writer.is_open = False
            if not abandon:
                raise


def write_table(
    path: Path, table: ColumnTable, provenance: Provenance, *, overwrite: bool = False, length_unit: str = "m"
) -> None:
    """Write a whole table, sorted by its key, to a Parquet file.

    Args:
        path: the file.
        table: its rows, in any order.
        provenance: stored with it.
        overwrite: replace an existing file; else OutputExistsError.
        length_unit: of its lengths.
    """
    with TableWriter(path, type(table), provenance, overwrite=overwrite, length_unit=length_unit) as writer:
        writer.write(table.sorted())
