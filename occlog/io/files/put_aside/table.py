"""A table that is put aside while it is gone through for the first time, for inputs that are slow to read."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Generic, TypeVar

import pyarrow as pa

from occlog.io.files.atomic import translate_write_errors
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.arrow_columns import arrow_schema, from_arrow, to_arrow
from occlog.records.columns import Table

T = TypeVar("T", bound=Table)


class Aside(Generic[T]):
    """Chunks of a table, as often as wanted, of which the source is asked once.

    The file, in the folder for temporary files, has no name, so that nothing is left of it, however the program ends.
    """

    def __init__(self, table: type[T], source: Callable[[], Iterator[T]]) -> None:
        """Nothing was asked yet.

        Args:
            table: what it is.
            source: gives all chunks, and need not give them again.
        """
        self._table, self._source = table, source
        self._schema = arrow_schema(table, Provenance("aside"))
        self._file: IO[bytes] | None = None
        self.rows = 0
        """How many rows there are, once all were gone through."""

    def __del__(self) -> None:
        """Let go of the file."""
        if self._file is not None:
            self._file.close()

    def chunks(self) -> Iterator[T]:
        """All of them, to be gone through to their end before they are asked for again.

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
