"""Protection against files in the current folder, or in folders writable by others, that would be executed."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PROGRAM = Path(__file__).resolve().parents[2]
"""The folder of the package."""


@contextmanager
def hidden(name: str) -> Iterator[None]:
    """Context manager in which `os.path.exists` is False for a relative file name.

    For libraries that execute or read a file of the current folder on import.
    """
    exists = os.path.exists
    os.path.exists = lambda path: path != name and exists(path)
    try:
        yield
    finally:
        os.path.exists = exists


def is_own(folder: Path) -> bool:
    """Return whether only this user or the administrator can write to a folder, so that its files are trusted.

    A group of the user's own name counts as the user; True on Windows, where folders of a user are the user's alone;
    False if the folder cannot be read.
    """
    if not hasattr(os, "geteuid"):
        return True
    try:
        found = folder.stat()
    except OSError:
        return False
    if found.st_uid not in (os.geteuid(), 0) or found.st_mode & stat.S_IWOTH:
        return False
    return not found.st_mode & stat.S_IWGRP or _of_one(found.st_gid)


def _of_one(group: int) -> bool:
    """Return whether a group (by id) has the name of this user, so that it has no other members."""
    import grp
    import pwd

    try:
        return grp.getgrgid(group).gr_name == pwd.getpwuid(os.geteuid()).pw_name
    except KeyError:
        return False
