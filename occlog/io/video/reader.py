"""Reading of a video file's own frame list: MP4, AVI or Matroska, recognised by content."""

from __future__ import annotations

import mmap
from pathlib import Path

from occlog.errors import InputError

from .container import Container


def is_container(path: Path) -> bool:
    """Whether a file begins like MP4, AVI or Matroska; False if it cannot be read."""
    from . import avi, mkv, mp4

    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            return any(each.recognised(data) for each in (mp4, avi, mkv))
    except (OSError, ValueError):
        return False


def read_container(path: Path) -> Container | None:
    """Frame list of a video file, recognised by its content; None for other containers than MP4, AVI and Matroska.

    Faults of the content are listed in `Container.problems`.

    Raises:
        InputError: the file cannot be read, or it is empty.
    """
    from . import avi, mkv, mp4

    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            if mp4.recognised(data):
                return mp4.parse(data)
            if avi.recognised(data):
                return avi.parse(data)
            return mkv.parse(data) if mkv.recognised(data) else None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {error}", id="unreadable-file") from error
