"""Exporters: a table in, a file in a format of others out."""

from __future__ import annotations

from typing import IO, ClassVar, NamedTuple, Protocol

from occlog.records.columns import Table
from occlog.records.scene import Scene
from occlog.settings import Settings


class World(NamedTuple):
    """What must be known beside the rows.

    Attributes:
        length_unit: of all lengths.
        scene: cameras, arrays and the room; None: nobody gave one.
    """

    length_unit: str
    scene: Scene | None


class Exporter(Protocol):
    """A format that tables are written in (group `occlog.exporters`).  It changes nothing that it is given."""

    summary: ClassVar[str]  # one line for --help
    settings: ClassVar[type[Settings]]
    tables: ClassVar[tuple[str, ...]]  # names of the tables that it takes; the first that an input holds is taken

    def __init__(self, settings: Settings) -> None:
        """Nothing has been written yet."""

    def write(self, rows: Table, world: World, file: IO[bytes]) -> None:
        """Write all rows; the file can only be written on, may be standard output, and is closed by who opened it."""
