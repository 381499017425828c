"""Checks before an input is parsed: kind of the file, size limits, and conversion of parser errors.

The kind of a file follows from its first bytes: a recording, a table, or other. Parsers raise more exceptions than
documented: a date with month 99 is a ValueError, a list as a key a TypeError, nested brackets a RecursionError; each is
called inside `guarded`, on a number of bytes checked before. Declared sizes of columns or compressed chunks are limited
before anything is read.
"""

from __future__ import annotations

import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import Literal

from occlog.errors import InputError

from .programs import START, describe_program

STANDARD_INPUT = "-"
"""Name of the file that holds the content of standard input."""

ROS_BAG = "convert a bag of another program by `occlog ingest`"
"""Remedy for a bag where a recording was expected."""


HIVE_CSV = "*=*/*.csv"
"""CSV tables in parts in folders with the value of a column in their names."""
_IN_FOLDERS = (
    ("*.mcap", f"; {ROS_BAG}"),
    ("*.db3", f"; {ROS_BAG}"),
    ("_delta_log", "; of a table of Delta Lake write the current version as one file"),
    ("metadata/*.avro", "; of a table of Iceberg write the current version as one file"),
    (HIVE_CSV, "; join its parts: duckdb -c \"COPY (FROM '{path}/*/*.csv') TO 'one.csv'\""),
    ("*.csv", "; name one file, and join tables in several files"),
)
"""What a folder holds that is given for a file, and what to do."""


def folder_hint(path: Path) -> str:
    """Return what to do about a folder that is given for a file, after a semicolon; empty: its content is unknown."""
    return next((words.format(path=path) for pattern, words in _IN_FOLDERS if any(path.glob(pattern))), "")


_KINDS = {
    stat.S_IFIFO: "a pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}


def check_regular(path: Path, mode: int, what: str) -> None:
    """InputError unless `mode` (`st_mode` of `stat`) is that of a regular file.

    A pipe blocks and can be read only once. `what` describes the expected content.
    """
    if not stat.S_ISREG(mode):
        kind = _KINDS.get(stat.S_IFMT(mode), "no file")
        raise InputError(
            f"{path}: is {kind}; {what} was expected; give a file, or - for standard input", id="not-a-file"
        )


_STREAMS = ("rtsp:", "rtsps:", "rtmp:", "udp:", "rtp:", "srt:")


def check_input(path: Path, what: str) -> Path:
    """Return `path` if it is a readable regular file that is not empty; InputError otherwise.

    `what` describes the expected content, for the message.
    """
    path = Path(path)
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise InputError(f"{path}: is a folder; {what} was expected{folder_hint(path)}", id="not-a-file")
        check_regular(path, status.st_mode, what)
        with path.open("rb"):
            pass
    except FileNotFoundError:
        streamed = f"; record the stream first: ffmpeg -i {path.parts[0]}//... -c copy FILE.mkv"
        hint = streamed if path.parts[0] in _STREAMS else ""
        raise InputError(f"{path}: no such file; {what} was expected{hint}", id="file-not-found") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}", id="unreadable-file") from error
    except ValueError:  # a zero byte
        raise InputError(
            f"{str(path)!r}: has the character 0 (NUL), which no name of a file has; {what} was expected",
            id="not-a-file",
        ) from None
    if status.st_size == 0:
        raise InputError(f"{path}: is empty (0 bytes); {what} was expected; make it again", id="empty-input")
    return path


RECORDING_MAGIC = b"\x89MCAP0\r\n"
SQLITE_MAGIC = b"SQLite format 3\0"
UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")
"""First bytes of a text in UTF-16, as Excel and PowerShell write it."""
ROS1_MAGIC = b"#ROSBAG V"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
BAG_MAGICS = (SQLITE_MAGIC, ROS1_MAGIC, ZSTD_MAGIC)
"""First bytes of bags of ROS other than MCAP."""
PARQUET_MAGIC = b"PAR1"
EXPECTED = "a recording or a table"


class Content(Enum):
    """Kind of a file by its first bytes."""

    RECORDING = "a recording (MCAP)"
    TABLE = "a table (Parquet)"
    OTHER = "neither a recording (MCAP) nor a table (Parquet)"


MADE_BY_INGEST = "make a recording of it by `occlog ingest -o OUT.mcap --video CAMERA={name}`"
OF_A_FOLDER = "make a recording of its folder by `occlog ingest -o OUT.mcap --images CAMERA=FOLDER`"
XML_BY_INGEST = (
    "true boxes and calibrations in XML go into a recording by `occlog ingest -o OUT.mcap --truth CAMERA={name}`, with "
    "the video, boxes or calibration of CAMERA, and `ingest --fps RATE` where nothing else gives times"
)
BAG_BY_INGEST = "make a recording of it by `occlog ingest {name} -o OUT.mcap`"
JSON_BY_INGEST = "boxes in it go into a recording by `occlog ingest --boxes CAMERA={name}`; write other rows as CSV"
_OTHERS = (
    (0, ROS1_MAGIC, f"a bag of ROS 1; {BAG_BY_INGEST}"),
    (0, SQLITE_MAGIC, f"a database (SQLite), perhaps a bag of ROS 2; {BAG_BY_INGEST}"),
    (4, b"ftyp", f"a video (MP4); {MADE_BY_INGEST}"),
    (0, b"\x1a\x45\xdf\xa3", f"a video (Matroska or WebM); {MADE_BY_INGEST}"),
    (8, b"AVI ", f"a video (AVI); {MADE_BY_INGEST}"),
    (8, b"WAVE", "sound (WAV); find directions in it by `occlog listen`"),
    (0, b"<?xml", f"XML; {XML_BY_INGEST}"),
    (0, b"<dataset", f"XML; {XML_BY_INGEST}"),
    (0, b"\x89PNG", f"an image (PNG); {OF_A_FOLDER}"),
    (0, b"\xff\xd8\xff", f"an image (JPEG); {OF_A_FOLDER}"),
    (0, b"PK\x03\x04", "a ZIP archive, as of Excel or NumPy; save a sheet as CSV, and arrays as Parquet"),
    (0, b"\xd0\xcf\x11\xe0", "a file of Excel; save its sheet as CSV"),
    (0, b"\x89HDF", "HDF5, as of pandas or MATLAB; write its rows as Parquet or CSV"),
    (0, b"MATLAB 5.0", "a file of MATLAB; write its rows as CSV (writetable)"),
)
"""Position and bytes by which files are known that commands are given by mistake, what they are, and what to do."""


ODAS = (b'"timeStamp"', b'"src"')
"""Content of an object of an ODAS stream."""
ODAS_BYTES = 512
ODAS_BY_INGEST = (
    "a stream of directions (ODAS); make a recording of it by `occlog ingest --doa ARRAY={name} --odas-hop SECONDS`"
)


def is_skipped_zstd(head: bytes) -> bool:
    """Whether data that begin with `head` begin with a skippable zstd frame, which holds metadata."""
    return head[1:4] == b"\x2a\x4d\x18" and head[0] & 0xF0 == 0x50


def is_zstd(head: bytes) -> bool:
    """Whether data that begin with `head` begin with a zstd frame."""
    return head.startswith(ZSTD_MAGIC) or is_skipped_zstd(head)


def is_odas(head: bytes) -> bool:
    """Whether the first bytes of a file are those of the JSON stream of directions that ODAS writes."""
    return head.lstrip().startswith(b"{") and all(mark in head for mark in ODAS)


def describe_unsupported(path: Path, *, yaml: bool = False) -> str | None:
    """Text on what a file is that is neither a recording nor a table, and what to do with it; None: unknown.

    Args:
        path: the file.
        yaml: YAML was expected, which includes JSON, so that JSON is not described.
    """
    with path.open("rb") as file:
        head = file.read(START)
    if (program := describe_program(head)) is not None:
        return program.removeprefix("is ")
    if is_odas(head[:ODAS_BYTES]):
        return ODAS_BY_INGEST.format(name=path.name)
    found = next((words for offset, mark, words in _OTHERS if head[offset:].startswith(mark)), None)
    if not yaml and head[:1] in (b"{", b"["):
        found = f"JSON; {JSON_BY_INGEST}"
    return None if found is None else found.replace("{name}", path.name)


def holds_text(path: Path) -> bool:
    """Whether the first `START` bytes of a file are UTF-8 text without NUL."""
    with path.open("rb") as file:
        head = file.read(START)
    try:
        head.decode()
    except UnicodeDecodeError as error:
        return len(head) == START and error.start > START - 4
    return b"\0" not in head


def content_of(path: Path, what: str = EXPECTED) -> Content:
    """Kind of a file by its first bytes: recording, table or other; InputError if it is not readable, or empty.

    Args:
        path: the file; one with damaged first bytes is `OTHER`.
        what: expected content, for the message.
    """
    check_input(path, what)
    with path.open("rb") as file:
        head = file.read(len(RECORDING_MAGIC))
    if head == RECORDING_MAGIC:
        return Content.RECORDING
    return Content.TABLE if head.startswith(PARQUET_MAGIC) else Content.OTHER


MAX_CONFIGURATION_BYTES = 4_000_000
"""Size of a text that describes something and holds no rows: scenes, calibrations, settings."""
LONG_TEXT = 1_000
"""Characters of a text that a column of many rows may hold, whatever their number."""
MAX_TEXTS_BYTES = 2**28
"""Memory of a column with longer texts at most: each of its rows takes as much as the longest."""
FAILURES = (ValueError, TypeError, AttributeError, LookupError, ArithmeticError)
"""Exceptions of parsers for unexpected bytes, each also its own exception."""


@contextmanager
def guarded(where: Path | str, what: str) -> Iterator[None]:
    """Context manager that converts the usual exceptions of parsers (`FAILURES`, deep nesting) to InputError.

    An InputError of the parser is passed on unchanged.

    Args:
        where: the file, and the position in it.
        what: expected content.

    Raises:
        InputError: the parser failed.
    """
    try:
        yield
    except RecursionError:
        raise InputError(f"{where}: nested too deeply; {what} was expected", id="input-too-large") from None
    except FAILURES as error:
        reason = " ".join(str(error).split())[:140] or type(error).__name__
        raise InputError(f"{where}: cannot be read ({reason}); {what} was expected", id="unreadable-file") from error


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Context manager that prefixes the message of an InputError in its block with the file name `path`."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{path}: {error}", id=error.id) from None


def bounded_text(
    path: Path, what: str, *, limit: int = MAX_CONFIGURATION_BYTES, encoding: Literal["utf-8", "utf-8-sig"] = "utf-8"
) -> str:
    """Text of a UTF-8 file; InputError if it is unreadable, not UTF-8, or larger than `limit` bytes.

    Args:
        path: the file.
        what: expected content, for messages.
        limit: largest size [bytes].
        encoding: `utf-8-sig` leaves out a byte order mark at the beginning.
    """
    path = check_input(path, what)
    size = path.stat().st_size
    if size > limit:
        raise InputError(f"{path}: {size} bytes; {what} was expected, of at most {limit} bytes", id="input-too-large")
    try:
        return path.read_text(encoding=encoding)
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: byte {error.start}: not UTF-8 text; {what} was expected", id="wrong-encoding"
        ) from error


def check_texts(texts: Iterable[str], rows: int, where: Path | str) -> None:
    """InputError if texts contain NUL, or are too long for a column of this many rows.

    A text column takes the memory of its longest text in every row.

    Args:
        texts: distinct texts of the column.
        rows: number of rows.
        where: file and column, for the message.
    """
    different = set(texts)
    cut = next((text for text in different if "\0" in text), None)
    if cut is not None:
        raise InputError(f"{where}: {cut[:40]!r}: a text must not contain the character 0 (NUL); rename it")
    longest = max(map(len, different), default=0)
    if longest > LONG_TEXT and 4 * longest * rows > MAX_TEXTS_BYTES:
        raise InputError(
            f"{where}: a text of {longest} characters, the memory of which each of {rows} rows takes; shorten it to "
            f"{LONG_TEXT}"
        )


def check_text(value: str, where: Path | str) -> None:
    """InputError for a text with a lone surrogate (half of a UTF-16 pair), which cannot be encoded in UTF-8.

    `where` is its position, for the message.
    """
    try:
        value.encode()
    except UnicodeEncodeError as error:
        half = f"\\u{ord(value[error.start]):04x}"
        raise InputError(
            f"{where}: {half} is half of a surrogate pair; write the whole character", id="wrong-encoding"
        ) from None


FREE_ROWS, MAX_ROWS_PER_BYTE = 1_000_000, 20
"""Rows that any file may promise, and above that for each of its bytes: a row of measured numbers takes 2 bytes or
more, however well it is packed."""
FREE_BYTES, MAX_GROWTH = 128 * 1024 * 1024, 1000
"""Unpacked bytes of a group of rows, or of all chunks, that any file may promise, and more for each of its bytes."""


def max_decompressed_bytes(size: int) -> int:
    """Maximum decompressed size [bytes] of a row group, or of all chunks, accepted in a file of `size` bytes."""
    return max(FREE_BYTES, MAX_GROWTH * size)


def exceeded_limit(size: int, rows: int, unpacked: int) -> str:
    """Text with the declared number that is too large for a file of `size` bytes, as `7 rows`; empty if none is.

    `rows` is the declared number of rows, `unpacked` the declared decompressed size of its largest group [bytes].
    """
    if rows > max(FREE_ROWS, MAX_ROWS_PER_BYTE * size):
        return f"{rows} rows"
    return f"{unpacked} bytes at once" if unpacked > max_decompressed_bytes(size) else ""


def check_declared_size(path: Path, size: int, rows: int, unpacked: int) -> None:
    """InputError if a file declares more rows or decompressed bytes than a file of its size can hold.

    Args:
        path: the file, for the message.
        size: of the file [bytes].
        rows: declared number of rows.
        unpacked: declared decompressed size of its largest group, or of all chunks [bytes].
    """
    if fault := exceeded_limit(size, rows, unpacked):
        raise InputError(
            f"{path}: declares {fault} in a file of {size} bytes, more than it can hold; it is damaged, copy it again",
            id="input-too-large",
        )
