"""Files that may hold a table of others: text with a header (also gzip), Parquet, Arrow, trajectories."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import pyarrow as pa

from occlog.errors import InputError
from occlog.io.files.names.utf8 import utf8_name
from occlog.io.files.tables.arrow_columns import SCHEMA_KEY
from occlog.io.files.tables.parquet import batches, open_parquet
from occlog.io.files.tables.vectors import in_parts
from occlog.io.files.texts.by_reader import table_of
from occlog.io.files.texts.csv_rows import GZIP_MAGIC, first_line, is_header, read_rows
from occlog.io.files.times.timestamps import TIME_COLUMNS
from occlog.io.files.untrusted.content import PARQUET_MAGIC
from occlog.io.files.untrusted.inputs import STANDARD_INPUT, check_input
from occlog.io.files.untrusted.promises import check_promise
from occlog.io.trajectories.reader import Trajectories, find_trajectories

from .arrow_messages import FILE_MAGIC, STREAM_MAGIC, messages
from .cells import ArrowCells, Cells, TextCells

TABULAR = (".csv", ".tsv", ".csv.gz", ".tsv.gz")
"""Endings of names by which a file wants to be a table, whatever it holds."""
ROWS = 65_536
MAX_COLUMNS = 10_000
"""Columns of a table at most: each of their names is compared with those of ours."""
WHAT = "a table"


class Source(NamedTuple):
    """A file with named columns.

    Attributes:
        path: the file.
        kind: `CSV`, `Parquet`, `Arrow`, or a format of trajectories; a file that a plug-in reads is a CSV.
        names: of its columns.
        trajectories: how to read a format of trajectories; None: the file is of another kind.
        table: name of the table that a plug-in says it holds; empty: it is known by its columns.
    """

    path: Path
    kind: str
    names: tuple[str, ...]
    trajectories: Trajectories | None = None
    table: str = ""

    def cells(self, names: Sequence[str]) -> Iterator[Cells]:
        """The cells of some columns, in parts, in the order of the file."""
        if self.trajectories is not None:
            yield from (TextCells(rows) for rows in self.trajectories.read(self.path))
            return
        if self.kind == "CSV":
            columns = {name: (name.lower(),) for name in names}
            yield from (TextCells(rows) for rows in read_rows(self.path, columns, WHAT, ignore_extra=True))
            return
        with _translated(self.path, self.kind):
            first = 0
            for batch in _batches(self.path, self.kind, list(names)):
                yield ArrowCells(self.path, batch, first)
                first += batch.num_rows


def find_source(path: Path) -> Source | None:
    """The columns of a file; None for one that is not a table of others.

    Text is taken for a table if its first line names columns, one of them of times, or if its name ends in `TABULAR`.

    Raises:
        InputError: the file cannot be read, or has more columns than `MAX_COLUMNS`.
    """
    found = _find_source(path)
    if found is not None and len(found.names) > MAX_COLUMNS:
        raise InputError(f"{path}: {len(found.names)} columns; a table of at most {MAX_COLUMNS} was expected")
    return found


def _find_source(path: Path) -> Source | None:
    check_input(path, WHAT)
    table = table_of(path)
    if table:
        return Source(path, "CSV", tuple(first_line(path, WHAT)), table=table)
    with path.open("rb") as file:
        head = file.read(8)
    if head.startswith(PARQUET_MAGIC):
        with _translated(path, "Parquet"), open_parquet(path) as file:
            schema = file.schema_arrow
        return None if SCHEMA_KEY.encode() in (schema.metadata or {}) else Source(path, "Parquet", tuple(schema.names))
    if head.startswith(FILE_MAGIC) or head.startswith(STREAM_MAGIC):
        with _translated(path, "Arrow"):
            return Source(path, "Arrow", tuple(_open_arrow(path).schema.names))
    if _may_be_text(head) and (found := find_trajectories(path)) is not None:
        return Source(path, found.kind, found.names, found)
    named = path.name.lower().endswith(TABULAR) or path.name == STANDARD_INPUT
    if not named and not head.startswith(GZIP_MAGIC) and not _may_be_text(head):
        return None
    try:
        line = first_line(path, WHAT)
    except InputError:
        if named:
            raise
        return None
    times = {name for names in TIME_COLUMNS.values() for name in names}
    if is_header(line) and (named or (len(line) > 1 and times & {cell.lower() for cell in line})):
        return Source(path, "CSV", tuple(line))
    return None


def _may_be_text(head: bytes) -> bool:
    return b"\0" not in head


def _open_arrow(path: Path) -> pa.ipc.RecordBatchFileReader | pa.ipc.RecordBatchStreamReader:
    with path.open("rb") as file:
        of_file = file.read(len(FILE_MAGIC)) == FILE_MAGIC
    with utf8_name(path) as name:
        source = pa.memory_map(name)
    return pa.ipc.open_file(source) if of_file else pa.ipc.open_stream(source)


def _batches(path: Path, kind: str, names: list[str]) -> Iterator[pa.RecordBatch]:
    """Batches of some columns of at most `ROWS` rows."""
    if kind == "Parquet":
        with open_parquet(path) as file:
            found = (_validated(batch) for batch in batches(file, ROWS, names))
            yield from in_parts(path, path.stat().st_size, found)
        return
    yield from in_parts(path, path.stat().st_size, _arrow_batches(path, names))


def _arrow_batches(path: Path, names: list[str]) -> Iterator[pa.RecordBatch]:
    _check_messages(path)
    reader = _open_arrow(path)
    several = (
        (reader.get_batch(n) for n in range(reader.num_record_batches))
        if isinstance(reader, pa.ipc.RecordBatchFileReader)
        else iter(reader)
    )
    for whole in several:
        batch = _validated(whole.select(names))
        for start in range(0, batch.num_rows, ROWS):
            yield batch.slice(start, ROWS)


def _validated(batch: pa.RecordBatch) -> pa.RecordBatch:
    """A batch whose offsets and places in dictionaries lead somewhere: the library follows them wherever that is.

    Its texts are UTF-8, too.
    """
    batch.validate(full=True)
    return batch


def _check_messages(path: Path) -> None:
    """InputError for an Arrow file whose messages promise more than a file of its size can hold."""
    size, rows, unpacked = path.stat().st_size, 0, 0
    for message in messages(path):
        rows, unpacked = rows + message.rows, unpacked + message.unpacked
        check_promise(path, size, rows, unpacked)  # of all together: a footer may list a batch many times


@contextmanager
def _translated(path: Path, kind: str) -> Iterator[None]:
    """Turn every failure of the library into one InputError."""
    try:
        yield
    except InputError:
        raise
    except (pa.ArrowException, OSError, ValueError, KeyError, MemoryError) as error:
        reason = " ".join(str(error).split())[:160]
        raise InputError(
            f"{path}: damaged or not {'an' if kind == 'Arrow' else 'a'} {kind} file ({reason}); make it again"
        ) from error
