"""Vectors in rows, each of which takes as much as the longest: a file may have one of a million numbers among many."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from occlog.errors import InputError
from occlog.io.files.untrusted.promises import most_unpacked

NUMBERS_AT_ONCE = 1 << 23
"""Numbers of a column that are made at one time."""
BYTES_PER_NUMBER = 8


def in_parts(path: Path, size: int, batches: Iterable[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
    """The batches in parts of so many rows that none takes much memory.

    Args:
        path: the file that they are of.
        size: of the file [bytes].
        batches: rows.

    Raises:
        InputError: their vectors take more memory than those of a file of its size can.
    """
    total, most = 0, most_unpacked(size)
    for batch in batches:
        widths = {name: _width(batch.column(name)) for name in batch.schema.names}
        name, width = max(widths.items(), key=lambda item: item[1], default=("", 0))
        total += BYTES_PER_NUMBER * width * batch.num_rows
        if total > most:
            raise InputError(
                f"{path}: column {name}: a list of {width} numbers among {batch.num_rows} rows, each of which takes "
                "as much memory; write lists of one length"
            )
        step = max(NUMBERS_AT_ONCE // max(width, 1), 1)
        for start in range(0, batch.num_rows, step):
            yield batch.slice(start, step)


def _width(column: pa.Array) -> int:
    """Numbers of the longest list of a column; 0 where it has none."""
    kind = column.type
    if pa.types.is_fixed_size_list(kind):
        return int(kind.list_size)
    if not (pa.types.is_list(kind) or pa.types.is_large_list(kind)):
        return 0
    return int(pc.max(pc.list_value_length(column)).as_py() or 0)
