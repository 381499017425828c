"""Outputs that appear whole or not at all.

A file is written without a name where the file system can do that (O_TMPFILE), so that
even a killed process leaves nothing behind, and beside its target under a hidden name
elsewhere.  Only a complete file, flushed to the disk, takes the target's name.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from ..errors import OcclogError, OutputError, OutputExistsError

PARTIAL = ".partial"


def check_writable(path: Path, overwrite: bool) -> None:
    """Raise unless `path` may become an output: before any work is done for it."""
    if path.is_dir():
        raise OutputError(f"{path}: is a folder; name a file")
    if path.exists() and not overwrite:
        raise OutputExistsError(f"{path}: exists; give --overwrite to replace it")
    if not path.parent.is_dir():
        raise OutputError(f"{path}: the folder {path.parent} does not exist; make it first")


@contextmanager
def open_output(path: Path, overwrite: bool = False) -> Iterator[IO[bytes]]:
    """Binary file that takes the name `path` when the block ends without an error.

    Raises:
        OutputExistsError: `path` exists and `overwrite` is false.
        OutputError: the folder is missing or not writable, or the disk is full.
    """
    path = Path(path)
    check_writable(path, overwrite)
    _remove_stale(path)
    with translate_write_errors(path):
        fd, name = _create(path)
    done = False
    try:
        with translate_write_errors(path), os.fdopen(fd, "w+b") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
            _check_absent(path, overwrite)
            _name(file.fileno(), name, path)
            done = True
    finally:
        if name is not None and not done:
            with suppress(FileNotFoundError):
                name.unlink()


def write_bytes(path: Path, data: bytes, overwrite: bool = False) -> None:
    """Write a whole small file atomically."""
    with open_output(path, overwrite) as file:
        file.write(data)


@contextmanager
def translate_write_errors(path: Path) -> Iterator[None]:
    """Turn an OSError of writing `path` into one OutputError with a remedy."""
    try:
        yield
    except OcclogError:
        raise
    except OSError as error:
        raise OutputError(f"{path}: {_reason(error)}") from error


def _reason(error: OSError) -> str:
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return "the disk is full; free some space or write to another disk; nothing was written"
    if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        return "not allowed to write here; choose another folder or change its permissions"
    if error.errno == errno.EFBIG:
        return "the file would be larger than this system allows; nothing was written"
    return f"cannot be written: {error.strerror or error}; nothing was written"


def _partial_name(path: Path, pid: int) -> Path:
    return path.with_name(f".{path.name}.{pid}{PARTIAL}")


def _create(path: Path) -> tuple[int, Path | None]:
    """Open a new file in the folder of `path`: nameless if possible, else under a hidden name."""
    flag = getattr(os, "O_TMPFILE", None)
    if flag is not None:
        with suppress(OSError):
            return os.open(path.parent, flag | os.O_RDWR, 0o666), None
    name = _partial_name(path, os.getpid())
    return os.open(name, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o666), name


def _check_absent(path: Path, overwrite: bool) -> None:
    if not overwrite and path.exists():
        raise OutputExistsError(f"{path}: another program has written it meanwhile; give --overwrite to replace it")


def _name(fd: int, name: Path | None, path: Path) -> None:
    """Give the complete file the target's name in one step."""
    if name is None:
        # A nameless file can only be linked to a new name, so it passes through a hidden one.
        name = _partial_name(path, os.getpid())
        with suppress(FileNotFoundError):
            name.unlink()
        # A folder descriptor makes Python call linkat with AT_SYMLINK_FOLLOW; plain link would not follow /proc.
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.link(f"/proc/self/fd/{fd}", name.name, dst_dir_fd=folder, follow_symlinks=True)
        finally:
            os.close(folder)
    name.replace(path)


def _remove_stale(path: Path) -> None:
    """Remove what killed writers of the same target left behind."""
    for old in path.parent.glob(f".{path.name}.*{PARTIAL}"):
        pid = old.name[len(path.name) + 2 : -len(PARTIAL)]
        if pid.isdigit() and not Path(f"/proc/{pid}").exists() and Path("/proc/self").exists():
            with suppress(OSError):
                old.unlink()
