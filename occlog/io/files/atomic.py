"""Atomic outputs, which appear complete or not at all.

A file is written without a name if the file system supports it (O_TMPFILE), so that a killed process leaves nothing
behind, else under a hidden name next to its target. A complete file, flushed to the disk, is renamed to the target.
Files of a group are renamed when all are complete. A lock prevents two commands from adding to the same folder or file
at once.
"""

from __future__ import annotations

import errno
import os
import shutil
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from types import TracebackType
from typing import IO, NamedTuple, Self

from occlog.console.notes import begin_work, log_detail, note_files
from occlog.errors import OcclogError, OutputError, OutputExistsError, UsageError

PARTIAL = ".partial"
_ONLY: ContextVar[Path | None] = ContextVar("_ONLY", default=None)
_NO_LINKS: ContextVar[Path | None] = ContextVar("_NO_LINKS", default=None)


@contextmanager
def outputs_below(folder: Path) -> Iterator[None]:
    """Context manager in which outputs outside of `folder` are refused, for configurations from untrusted sources."""
    token = _ONLY.set(folder.resolve())
    try:
        yield
    finally:
        _ONLY.reset(token)


@contextmanager
def no_links_out_of(folder: Path) -> Iterator[None]:
    """Context manager in which outputs in `folder` are refused if they are links that lead out of it."""
    token = _NO_LINKS.set(folder.resolve())
    try:
        yield
    finally:
        _NO_LINKS.reset(token)


def check_writable(path: Path, overwrite: bool) -> None:
    """Raise OutputError unless a file can be written at `path`; called before any work is done.

    Args:
        path: the output.
        overwrite: it may replace an existing file; else OutputExistsError.

    Raises:
        OutputError: it is a folder, a device, in a missing folder, or outside of the permitted folders.
        UsageError: it is `-`, standard output.
    """
    if str(path) == "-":
        raise UsageError("-: nothing is written to standard output; name a file", id="not-applicable")
    only = _ONLY.get()
    if only is not None and only not in Path(os.path.realpath(path)).parents:
        raise OutputError(f"{path}: is outside of {only}; all outputs must be in it")
    own = _NO_LINKS.get()
    if own is not None and own in (Path.cwd() / path).parents:
        real = Path(os.path.realpath(path))
        if own not in real.parents:
            raise OutputError(
                f"{path}: is a link to {real}, outside of {own}, which would be replaced; remove the link"
            )
    if path.is_dir():
        raise OutputError(f"{path}: is a folder; name a file")
    if path.exists() and not path.is_file():
        raise OutputError(f"{path}: is no file but a pipe or a device, which would be replaced; name a file")
    if path.exists() and not overwrite:
        raise OutputExistsError(f"{path}: exists")
    if not path.parent.is_dir():
        raise OutputError(f"{path}: the folder {path.parent} does not exist; make it first")


def check_outputs(inputs: Iterable[Path | None], outputs: Iterable[Path | None], overwrite: bool) -> None:
    """Raise an error for outputs that exist, are also inputs, or are named twice; called before any work is done.

    Args:
        inputs: files that are read; None is ignored.
        outputs: files that are written; None is ignored.
        overwrite: outputs may exist.

    Raises:
        UsageError: an output is an input, or named twice.
        OutputError: an output exists, or cannot be written there.
    """
    wanted = [Path(p) for p in outputs if p is not None]
    read = [Path(p) for p in inputs if p is not None]
    used = {os.path.realpath(p) for p in read}  # Path.resolve fails on a link to itself
    for n, path in enumerate(wanted):
        if os.path.realpath(path) in used:
            raise UsageError(f"{path}: is an input too; give the output another name", id="conflicting-options")
        if os.path.realpath(path) in {os.path.realpath(p) for p in wanted[:n]}:
            raise UsageError(f"{path}: is named for two outputs; give each its own name", id="duplicate-name")
        check_writable(path, overwrite)
    note_files(read, wanted)


class _Complete(NamedTuple):
    """A complete output file that has not been renamed to its target `path` yet."""

    fd: int
    name: Path | None  # hidden name; None: nameless
    path: Path
    overwrite: bool


class OutputGroup:
    """Context manager for outputs that are renamed to their targets together when its block ends without an error.

    They are renamed in the order of completion. If the block or a renaming fails, no output appears, and files that
    were already replaced are restored.
    """

    def __init__(self) -> None:
        """Start a group of outputs that appear all or not at all; it has none yet."""
        self._waiting: list[_Complete] = []

    def add(self, fd: int, name: Path | None, path: Path, overwrite: bool) -> None:
        """Register a complete file, which is renamed when the block of the group ends.

        Args:
            fd: descriptor of the open file, which is duplicated.
            name: its temporary path; None: it has no name.
            path: target.
            overwrite: replace an existing target.
        """
        self._waiting.append(_Complete(os.dup(fd), name, path, overwrite))

    def __enter__(self) -> Self:
        """Return self."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Rename all files to their targets, or delete them after an error."""
        try:
            if kind is None:
                self._name_all()
        finally:
            for file in self._waiting:
                os.close(file.fd)
                if file.name is not None:
                    with suppress(OSError):
                        file.name.unlink(missing_ok=True)
            self._waiting = []

    def _name_all(self) -> None:
        for file in self._waiting:
            _check_absent(file.path, file.overwrite)
        with ExitStack() as undo:
            for file in self._waiting:
                with translate_write_errors(file.path):
                    undo.callback(_put_back, file.path, existed=_kept_aside(file.path))
                    _name(file.fd, file.name, file.path)
            undo.pop_all()
        for file in self._waiting:
            _aside(file.path).unlink(missing_ok=True)


@contextmanager
def open_output(path: Path, overwrite: bool = False, together: OutputGroup | None = None) -> Iterator[IO[bytes]]:
    """Context manager: binary file that is renamed to `path` when the block ends without an error, else deleted.

    Args:
        path: target; of a link the file that it leads to.
        overwrite: replace an existing file.
        together: group at the end of which the file is renamed; None: at the end of the block.

    Raises:
        OutputExistsError: `path` exists and `overwrite` is false.
        OutputError: the folder is missing or not writable, or the disk is full.
    """
    path = Path(path)
    check_writable(path, overwrite)
    if path.is_symlink():  # the file it leads to is replaced, and the link stays
        path = Path(os.path.realpath(path))  # Path.resolve fails on links in a ring
        check_writable(path, overwrite)
    begin_work()
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
            if together is None:
                _name(file.fileno(), name, path)
            else:
                together.add(file.fileno(), name, path, overwrite)
            size = file.tell()
            done = True
        log_detail(f"wrote {path} ({size} bytes)")
    finally:
        if name is not None and not done:
            with suppress(FileNotFoundError):
                name.unlink()


@contextmanager
def folder_beside(path: Path) -> Iterator[Path]:
    """Context manager: temporary hidden folder next to an output, for libraries that name the files they write.

    It is deleted at the end of the block. Folders left by killed processes are deleted when the output is written
    again.

    Raises:
        OutputError: the folder of `path` is not writable, or the disk is full.
    """
    _remove_stale(path)
    name = path.with_name(f".{path.name}.{os.getpid()}.folder{PARTIAL}")
    with translate_write_errors(path):
        name.mkdir()
    try:
        yield name
    finally:
        shutil.rmtree(name, ignore_errors=True)


def _aside(path: Path) -> Path:
    return path.with_name(f".{path.name}.{os.getpid()}.before{PARTIAL}")


def _kept_aside(path: Path) -> bool:
    """Keep the file at `path`, which an output is to replace, by a hard link, to restore it after an error.

    Returns whether there is a file at `path`.
    """
    with suppress(OSError):  # of file systems that know no second names
        _aside(path).unlink(missing_ok=True)
        os.link(path, _aside(path))
    return path.exists()


def _put_back(path: Path, *, existed: bool) -> None:
    """Restore the previous file at `path` after an error.

    If none `existed`, remove the new one. OS errors are ignored.
    """
    with suppress(OSError):
        if existed:
            _aside(path).replace(path)
            _aside(path).unlink(missing_ok=True)  # two names of one file both stay
        else:
            path.unlink(missing_ok=True)


def write_bytes(path: Path, data: bytes, overwrite: bool = False) -> None:
    """Write a small file atomically; OutputExistsError if it exists and `overwrite` is False."""
    with open_output(path, overwrite) as file:
        file.write(data)


@contextmanager
def translate_write_errors(path: Path) -> Iterator[None]:
    """Context manager that converts an OSError while writing `path` to OutputError, with the remedy in its message."""
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
    """Open a new file in the folder of `path`; return its descriptor and its temporary path.

    The path is None if the file system supports files without names (O_TMPFILE).
    """
    flag = getattr(os, "O_TMPFILE", None)
    if flag is not None:
        with suppress(OSError):
            return os.open(path.parent, flag | os.O_RDWR, 0o666), None
    name = _partial_name(path, os.getpid())
    return os.open(name, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o666), name


def _check_absent(path: Path, overwrite: bool) -> None:
    if not overwrite and path.exists():
        raise OutputExistsError(f"{path}: another program wrote it during this run; it was not replaced")


def _name(fd: int, name: Path | None, path: Path) -> None:
    """Rename a complete file to the target `path` in one step, replacing an existing one.

    `fd` is the open file, `name` its temporary path; None: it has none.
    """
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
    try:
        name.replace(path)
    except OSError:
        with suppress(OSError):
            name.unlink()
        raise


def _remove_stale(path: Path) -> None:
    """Delete temporary files and folders of the output `path` that processes which no longer run have left behind."""
    for old in path.parent.glob(f".{path.name}.*{PARTIAL}"):
        pid = old.name[len(path.name) + 2 : -len(PARTIAL)].removesuffix(".folder").removesuffix(".before")
        if pid.isdigit() and not Path(f"/proc/{pid}").exists() and Path("/proc/self").exists():
            with suppress(OSError):
                if old.is_dir() and not old.is_symlink():
                    shutil.rmtree(old, ignore_errors=True)
                else:
                    old.unlink()


with suppress(ImportError):  # Windows has no such locks
    import fcntl


@contextmanager
def alone_with(path: Path, command: str, patience: float = 0.0) -> Iterator[None]:
    """Context manager that locks an existing folder or file against other commands of occlog.

    The lock ends with the block or the process. On file systems and systems without locks nothing is locked.

    Args:
        path: the folder or file.
        command: name of the command, for the message.
        patience: time to wait for another command to end [s].

    Raises:
        UsageError: another command holds the lock after that time.
    """
    if "fcntl" not in globals():
        yield
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        end = time.monotonic() + patience
        while not _locked(descriptor):
            if time.monotonic() >= end:
                raise UsageError(
                    f"{path}: is in use by another `occlog {command}`; wait until it ends, or name another one",
                    id="output-busy",
                )
            time.sleep(0.05)
        yield
    finally:
        os.close(descriptor)


def _locked(descriptor: int) -> bool:
    """Try to lock an open file by its descriptor, without waiting; False if another process has locked it.

    True also on file systems without locks.
    """
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        pass
    return True
