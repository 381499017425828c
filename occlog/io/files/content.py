"""What a file is, by its first bytes: a recording, a table, or anything else."""

from __future__ import annotations

from enum import Enum
from pathlib import Path

from .inputs import check_input

RECORDING_MAGIC = b"\x89MCAP0\r\n"
SQLITE_MAGIC = b"SQLite format 3\0"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
PARQUET_MAGIC = b"PAR1"
EXPECTED = "a recording or a table"


class Content(Enum):
    """What a file is, by its first bytes."""

    RECORDING = "a recording (MCAP)"
    TABLE = "a table (Parquet)"
    OTHER = "neither a recording (MCAP) nor a table (Parquet)"


def content_of(path: Path, what: str = EXPECTED) -> Content:
    """What a file is; InputError where no readable file with content is there.

    Args:
        path: the file; one whose first bytes are damaged is `OTHER`.
        what: what was expected, for the message.
    """
    check_input(path, what)
    with path.open("rb") as file:
        head = file.read(len(RECORDING_MAGIC))
    if head == RECORDING_MAGIC:
        return Content.RECORDING
    return Content.TABLE if head.startswith(PARQUET_MAGIC) else Content.OTHER
