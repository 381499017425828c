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


MADE_BY_INGEST = "make a recording of it by `occlog ingest -o OUT.mcap --video CAMERA={name}`"
OF_A_FOLDER = "make a recording of its folder by `occlog ingest -o OUT.mcap --images CAMERA=FOLDER`"
XML_BY_INGEST = (
    "true boxes and calibrations in XML go into a recording by `occlog ingest -o OUT.mcap --truth CAMERA={name}`, with "
    "the video, boxes or calibration of CAMERA, and `--fps RATE` where nothing else gives times"
)
_OTHERS = (
    (4, b"ftyp", f"a video (MP4); {MADE_BY_INGEST}"),
    (0, b"\x1a\x45\xdf\xa3", f"a video (Matroska or WebM); {MADE_BY_INGEST}"),
    (8, b"AVI ", f"a video (AVI); {MADE_BY_INGEST}"),
    (8, b"WAVE", "sound (WAV); find directions in it by `occlog listen`"),
    (0, b"<?xml", f"XML; {XML_BY_INGEST}"),
    (0, b"<dataset", f"XML; {XML_BY_INGEST}"),
    (0, b"\x89PNG", f"an image (PNG); {OF_A_FOLDER}"),
    (0, b"\xff\xd8\xff", f"an image (JPEG); {OF_A_FOLDER}"),
)
"""Place and bytes by which files are known that commands are given by mistake, what they are, and what to do."""


ODAS = (b'"timeStamp"', b'"src"')
"""What an object of a stream of ODAS holds."""
ODAS_BYTES = 512
ODAS_BY_INGEST = (
    "a stream of directions (ODAS); make a recording of it by `occlog ingest --doa ARRAY={name} --hop SECONDS`"
)


def is_skipped_zstd(head: bytes) -> bool:
    """Whether data of zstd begin with a frame to skip, which holds notes of whoever packed them."""
    return head[1:4] == b"\x2a\x4d\x18" and head[0] & 0xF0 == 0x50


def is_zstd(head: bytes) -> bool:
    """Whether data begin as those that zstd packed."""
    return head.startswith(ZSTD_MAGIC) or is_skipped_zstd(head)


def mistaken_for(path: Path) -> str | None:
    """What a file is that is neither a recording nor a table, and what to do with it; None: not known."""
    with path.open("rb") as file:
        head = file.read(ODAS_BYTES)
    if head.lstrip().startswith(b"{") and all(mark in head for mark in ODAS):
        return ODAS_BY_INGEST.format(name=path.name)
    found = next((words for place, mark, words in _OTHERS if head[place:].startswith(mark)), None)
    return None if found is None else found.replace("{name}", path.name)


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
