"""Checks that every reader makes before it opens an input."""

from __future__ import annotations

import stat
from pathlib import Path

from occlog.errors import InputError

STANDARD_INPUT = "-"
"""Name of the file that holds what came from standard input."""

FOREIGN_BAG = "of a bag of another program `occlog ingest` makes a recording"
"""What to do with a bag where a recording was expected."""


_KINDS = {
    stat.S_IFIFO: "a pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}


def check_regular(path: Path, mode: int, what: str) -> None:
    """InputError unless the mode is of a regular file: a pipe waits for ever, and is read once."""
    if not stat.S_ISREG(mode):
        kind = _KINDS.get(stat.S_IFMT(mode), "no file")
        raise InputError(f"{path}: is {kind}; {what} was expected; give a file, or - for standard input")


def check_input(path: Path, what: str) -> Path:
    """The path, if a non-empty readable file is there; else InputError that says what was expected."""
    path = Path(path)
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            bag = any(path.glob("*.mcap")) or any(path.glob("*.db3"))
            hint = f"; {FOREIGN_BAG}" if bag else ""
            raise InputError(f"{path}: is a folder; {what} was expected{hint}")
        check_regular(path, status.st_mode, what)
        with path.open("rb"):
            pass
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; {what} was expected") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError:  # a zero byte
        raise InputError(f"{str(path)!r}: no name of a file; {what} was expected") from None
    if status.st_size == 0:
        raise InputError(f"{path}: is empty (0 bytes); {what} was expected; make it again")
    return path
