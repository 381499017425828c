"""One command at a time in a folder or a file that it adds to: two would mix what they make."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

with suppress(ImportError):  # Windows has no such locks
    import fcntl

from occlog.errors import UsageError


@contextmanager
def alone_with(path: Path, command: str, patience: float = 0.0) -> Iterator[None]:
    """Keep other commands out of a folder or file that is there, to the end of the block or of the process.

    File systems that know no locks let everybody in.

    Args:
        path: the folder or file.
        command: what works with it.
        patience: time to wait for another command to end [s].

    Raises:
        UsageError: another command works with it.
    """
    if "fcntl" not in globals():
        yield
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        end = time.monotonic() + patience
        while not _locked(descriptor):
            if time.monotonic() >= end:
                raise UsageError(f"{path}: another `occlog {command}` works with it; wait, or name another one")
            time.sleep(0.05)
        yield
    finally:
        os.close(descriptor)


def _locked(descriptor: int) -> bool:
    """Lock a file unless another process has; true also where there are no locks."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        pass
    return True
