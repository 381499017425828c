"""Which format of trajectories a text is of, and its rows under names that tables know."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from occlog.errors import InputError
from occlog.io.files.texts.csv_rows import Rows
from occlog.io.files.texts.registry import FileFormat, Probe, recognise

from . import geojson, trc, tum


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


def _is_geojson(probe: Probe) -> bool:
    return probe.start.startswith(b"{") and f'"{geojson.COLLECTION}"'.encode() in probe.start


def _is_tum(probe: Probe) -> bool:
    try:
        return not probe.start.startswith(b"{") and tum.looks_like_tum(probe.cells)
    except InputError:
        return False


FORMATS: dict[str, FileFormat[Callable[[Path], Trajectories]]] = {
    "trc": FileFormat(
        lambda path: Trajectories("TRC", trc.names_of(path), trc.read_trc),
        "TRC of motion capture",
        lambda probe: probe.start.startswith(trc.MAGIC.encode()),
    ),
    "geojson": FileFormat(
        lambda _: Trajectories("GeoJSON", geojson.NAMES, geojson.read_geojson),
        "GeoJSON with times",
        _is_geojson,
    ),
    "tum": FileFormat(lambda _: Trajectories("TUM text", tum.NAMES, tum.read_tum), "text of TUM", _is_tum),
}
"""Every format of trajectories."""


def find_trajectories(path: Path) -> Trajectories | None:
    """The format of a file, known by its content; None for a file of another kind.

    InputError for one of a known format with a header that cannot be read.
    """
    name = recognise(FORMATS, Probe(path, tum.WHAT))
    return None if name is None else FORMATS[name].read(path)
