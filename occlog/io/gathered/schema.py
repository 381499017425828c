"""What tables over many recordings have in common: the column of recordings, their names, and how they are written.

They carry names of schemas that no command takes for the table of one recording: rows of several recordings in one
track would be a wrong result that looks right.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from occlog.io.files.atomic import open_output
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.arrow_columns import SCHEMA_KEY, statements
from occlog.io.files.tables.table_writer import ROWS_PER_GROUP, WRITTEN

VERSION = 1
GATHERED = "batch."
"""Beginning of the names of their schemas."""
NAMES = pa.dictionary(pa.int32(), pa.string())
"""Type of columns of names."""
RECORDING = pa.field("recording", NAMES, nullable=False, metadata={"unit": "1", "doc": "name of the run folder"})


def field(name: str, kind: pa.DataType, doc: str, *, unit: str = "1", nullable: bool = False) -> pa.Field:
    """A column with its unit and meaning."""
    return pa.field(name, kind, nullable=nullable, metadata={"unit": unit, "doc": doc})


def gathered_schema(name: str, fields: Iterable[pa.Field], provenance: Provenance, length_unit: str = "") -> pa.Schema:
    """Schema of a table over many recordings; `length_unit` where it has lengths."""
    entries = {SCHEMA_KEY: f"{GATHERED}{name}/{VERSION}", **statements(provenance, length_unit)}
    return pa.schema([RECORDING, *fields], metadata=entries)


@contextmanager
def gathered_writer(path: Path, schema: pa.Schema) -> Iterator[pq.ParquetWriter]:
    """Writer of a file that appears whole when the block ends without an error, and replaces an older one."""
    with open_output(path, overwrite=True) as file, pq.ParquetWriter(file, schema, **WRITTEN) as writer:
        yield writer


def write_rows(path: Path, schema: pa.Schema, rows: Iterable[dict[str, object]]) -> int:
    """Write rows, in groups; the number of rows."""
    count, kept = 0, list[dict[str, object]]()
    with gathered_writer(path, schema) as writer:
        for row in rows:
            kept.append(row)
            count += 1
            if len(kept) == ROWS_PER_GROUP:
                writer.write_table(pa.Table.from_pylist(kept, schema=schema))
                kept = []
        writer.write_table(pa.Table.from_pylist(kept, schema=schema))
    return count
