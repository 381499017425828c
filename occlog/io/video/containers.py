"""What kind of container a video file is, and what it says about its frames."""

from __future__ import annotations

import mmap
from pathlib import Path

from occlog.errors import InputError

from .container import Container


def read_container(path: Path) -> Container | None:
    """What the file says about its frames; None for a container that we do not know.

    Raises InputError only where the file cannot be read; faults of its content are
    listed in `problems`.
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
        raise InputError(f"{path}: cannot be read: {error}") from error
