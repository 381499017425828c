"""Formats of a family of files (boxes, calibrations, directions, truth), in one table each.

A table `{name: FileFormat(read, doc, sniff)}` says how a format is recognised and what reads it; its order is that of
recognition, from the most particular format to the least.  A new format is a module with both functions, and a line in
the table of its family.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Generic, TypeVar

from occlog.errors import InputError, UsageError
from occlog.io.files.untrusted.inputs import check_input

from .csv_rows import first_line

R = TypeVar("R")
MOST_TEXT = 16 * 2**20
"""Bytes of a file that is recognised by its whole text."""
START = 4096
"""Bytes at the beginning of a file that formats are recognised by."""


class Probe:
    """What a format can be recognised by: the path, and the beginning of the file, read when it is asked for.

    Attributes:
        path: of the file or folder.
        what: what is expected, for messages.
    """

    def __init__(self, path: Path, what: str) -> None:
        self.path, self.what = path, what

    @cached_property
    def start(self) -> bytes:
        """The first bytes, without a byte order mark and white space."""
        with self.path.open("rb") as file:
            return file.read(START).removeprefix(b"\xef\xbb\xbf").lstrip()

    @cached_property
    def cells(self) -> list[str]:
        """Cells of the first line that is neither empty nor a comment, in lower case; InputError if it is no text."""
        return [cell.lower() for cell in first_line(self.path, self.what)]

    @cached_property
    def text(self) -> str:
        """The whole text; InputError if it is no UTF-8, or of more than `MOST_TEXT` bytes."""
        path = check_input(self.path, self.what)
        if path.stat().st_size > MOST_TEXT:
            raise InputError(f"{path}: {path.stat().st_size} bytes; {self.what} was expected, of at most {MOST_TEXT}")
        try:
            return path.read_text(encoding="utf-8-sig")
        except UnicodeDecodeError as error:
            raise InputError(f"{path}: byte {error.start}: not UTF-8 text; {self.what} was expected") from None


def is_folder(probe: Probe) -> bool:
    """Recognise a folder."""
    return probe.path.is_dir()


def by_text(shows: Callable[[str], bool]) -> Callable[[Probe], bool]:
    """Recognise a format by the whole text of a file."""
    return lambda probe: shows(probe.text)


def by_cells(shows: Callable[[list[str]], bool]) -> Callable[[Probe], bool]:
    """Recognise a format by the cells of the first line."""
    return lambda probe: shows(probe.cells)


@dataclass(frozen=True)
class FileFormat(Generic[R]):
    """A format of a family of files.

    Attributes:
        read: reads a file.
        doc: what it is, in words.
        sniff: whether a file is of it; by default never: the format is chosen by its name.
        assumed: unit of lengths, or convention of angles, that holds unless the user states another.
    """

    read: R
    doc: str
    sniff: Callable[[Probe], bool] = lambda _: False
    assumed: str = ""


def recognise(formats: Mapping[str, FileFormat[R]], probe: Probe, stated: str = "auto", family: str = "") -> str | None:
    """Name of the format of a file: the stated one, or the first that the file shows; None if it shows none.

    Args:
        formats: of the family, by name.
        probe: of the file.
        stated: a name, or `auto`.
        family: of the formats, for messages.

    Raises:
        UsageError: there is no format of the stated name.
        InputError: the file cannot be read as far as formats are recognised.
    """
    if stated == "auto":
        return next((name for name, each in formats.items() if each.sniff(probe)), None)
    if stated not in formats:
        raise UsageError(f"{family} format {stated!r} is not known; known: auto, {', '.join(formats)}")
    return stated
