"""Temporary folders of tables, removed with the last reference to them.

All folders of a process are in one folder, which is locked while the process lives, and removed when Python ends, also
in `multiprocessing`. The unlocked folder of a killed process is removed by the next process that creates folders.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from itertools import count
from multiprocessing.util import Finalize
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

PREFIX = "occlog-tables-"
FRESH_S = 60.0
"""A folder this young may be that of a process which has not locked it yet."""


class Folder:
    """A temporary folder, removed with the last reference to it, or when Python ends."""

    def __init__(self) -> None:
        """Create the folder under `TMPDIR`; it is removed with this object, or by calling `remove`."""
        self.path = _Home.of_this_process().new()
        # Unlike those of `weakref`, these run in the end of a process of `multiprocessing`, too, and not in a copy
        # that was forked
        self.remove = Finalize(self, shutil.rmtree, (self.path, True), exitpriority=1)

    def file(self, name: str) -> Path:
        """Return the path of a file in the folder."""
        return self.path / name

    def written(self, names: Iterable[str]) -> dict[str, Path]:
        """Return the paths of those tables among `names` that exist in the folder as Parquet files, by name."""
        paths = {name: self.file(f"{name}.parquet") for name in names}
        return {name: path for name, path in paths.items() if path.is_file()}

    def without_paths(self, summary: Mapping[str, Any]) -> dict[str, Any]:
        """Return a copy of a summary without the entries that are paths in this folder."""
        return {name: value for name, value in summary.items() if not str(value).startswith(str(self.path))}


class _Home:
    """Folder that contains all temporary folders of a process; it is locked while the process lives.

    Attributes:
        known: the folder of this process, or of the process from which it was forked; None: not created yet.
        process: id of the process that created it.
        path: path of the folder.
    """

    known: _Home | None = None

    def __init__(self) -> None:
        """Create and lock a new folder under `TMPDIR`, and remove the folders of processes that have ended."""
        self.process, self.path = os.getpid(), Path(mkdtemp(prefix=PREFIX))
        self._lock = _locked(self.path)
        self._numbers = count(1)
        Finalize(None, shutil.rmtree, (self.path, True), exitpriority=0)
        _remove_abandoned(self.path.parent)

    @classmethod
    def of_this_process(cls) -> _Home:
        """Return the folder of this process; a new one after a fork, or if it was removed."""
        home = cls.known
        if home is None or home.process != os.getpid() or not home.path.is_dir():
            home = cls.known = cls()
        return home

    def new(self) -> Path:
        """Create an empty subfolder, named by the next number, and return its path."""
        path = self.path / str(next(self._numbers))
        path.mkdir(mode=0o700)
        return path


def _locked(folder: Path) -> int | None:
    """Lock a folder until this process ends, and return the file descriptor of the lock.

    None if another process has locked it, or the system has no such locks.
    """
    try:
        import fcntl
    except ImportError:  # no such locks on this system: nothing is found abandoned, either
        return None
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        return None
    return handle


def _remove_abandoned(parent: Path) -> None:
    """Remove the temporary folders of this user's processes that have ended; only on systems with file locks.

    `parent`: folder that contains them. Folders younger than `FRESH_S` remain, since they may not be locked yet.
    """
    if not hasattr(os, "getuid"):  # Windows
        return
    for path in parent.glob(f"{PREFIX}*"):
        with suppress(OSError):
            if time.time() - path.stat().st_mtime < FRESH_S or path.stat().st_uid != os.getuid():
                continue
            handle = _locked(path)
            if handle is not None:
                shutil.rmtree(path, ignore_errors=True)
                os.close(handle)
