"""Names of files for libraries that take UTF-8 alone, some of which crash where a name is something else."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def is_utf8(name: str) -> bool:
    """Whether the bytes of a name are UTF-8; on Linux they may be anything."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True


@contextmanager
def utf8_name(path: Path) -> Iterator[str]:
    """A name in UTF-8 of a file that is there, or of one that is to be made in a folder that is; good to the end."""
    if is_utf8(str(path)):
        yield str(path)
        return
    # The name of a descriptor is plain; a file that is not there yet is found through its folder's.
    there = path.exists()
    descriptor = os.open(path if there else path.parent, os.O_RDONLY)
    try:
        yield f"/proc/self/fd/{descriptor}" + ("" if there else f"/{path.name}")
    finally:
        os.close(descriptor)
