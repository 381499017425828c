"""Which format of trajectories a text is of, and its rows under names that tables know."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from occlog.errors import InputError
from occlog.io.files.texts.csv_rows import Rows, first_line

from . import geojson, trc, tum

HEAD = 4096
"""Bytes at the beginning of a file that say its format."""


class Trajectories(NamedTuple):
    """A file of trajectories.

    Attributes:
        kind: the format, in words.
        names: of the columns of its rows.
        read: gives the rows.
    """

    kind: str
    names: tuple[str, ...]
    read: Callable[[Path], Iterator[Rows]]


def find_trajectories(path: Path) -> Trajectories | None:
    """The format of a file, known by its content; None for a file of another kind.

    InputError for one of a known format whose header cannot be read.
    """
    with path.open("rb") as file:
        head = file.read(HEAD).removeprefix(b"\xef\xbb\xbf").lstrip()
    if head.startswith(trc.MAGIC.encode()):
        return Trajectories("TRC", trc.names_of(path), trc.read_trc)
    if head.startswith(b"{"):
        is_collection = f'"{geojson.COLLECTION}"'.encode() in head
        return Trajectories("GeoJSON", geojson.NAMES, geojson.read_geojson) if is_collection else None
    try:
        cells = first_line(path, tum.WHAT)
    except InputError:
        return None
    if tum.looks_like_tum(cells):
        return Trajectories("TUM text", tum.NAMES, tum.read_tum)
    return None
