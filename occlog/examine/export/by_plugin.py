"""Formats of plug-ins: which tables they take, and writing by them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import IO

import numpy as np

from occlog.errors import PluginError, UsageError
from occlog.plugins.chosen import Chosen
from occlog.plugins.interface import Exporter, World
from occlog.plugins.loading import said_by
from occlog.records.columns import Table
from occlog.records.tables import TABLES

from .formats import Format


class Sink:
    """A file that can only be written on."""

    def __init__(self, file: IO[bytes]) -> None:
        """Nothing is written yet."""
        self._file = file

    def write(self, data: bytes) -> int:
        """Write some bytes; TypeError for anything else."""
        if not isinstance(data, bytes | bytearray | memoryview):
            raise TypeError(f"bytes are written, not {type(data).__name__}; encode the text")
        return self._file.write(data)

    def writable(self) -> bool:
        """Whether it can be written on, which wrappers ask."""
        return True

    def readable(self) -> bool:
        """Whether it can be read."""
        return False

    def seekable(self) -> bool:
        """Whether one can go back in it."""
        return False

    @property
    def closed(self) -> bool:
        """Whether it is closed, which wrappers ask."""
        return False

    def flush(self) -> None:
        """Leave it to who opened the file."""

    def close(self) -> None:
        """Leave it to who opened the file."""


def format_of_plugin(exporter: Chosen) -> Format:
    """The format as one of ours; PluginError for a table that there is not."""
    of = exporter.plugin.load()
    unknown = [name for name in of.tables if name not in TABLES]
    if unknown or not of.tables:
        raise PluginError(
            f"{exporter.plugin.label}: tables: {unknown[0] if unknown else 'none'}; want names of {', '.join(TABLES)}"
        )
    return Format((), tuple(of.tables), str(of.summary))


def chosen_rows(rows: Table, name: str, targets: Sequence[int], camera: str | None) -> Table:
    """Rows of some targets and of one camera; UsageError for a table that has no such column."""
    for option, column, given in (("target", "target_id", tuple(targets)), ("camera", "sensor", camera)):
        if not given:
            continue
        if not hasattr(rows, column):
            raise UsageError(f"{option}: format {name} writes {rows.NAME}, which have none; leave it out")
        rows = rows.take(np.isin(getattr(rows, column), given))
    return rows


def write_by_plugin(exporter: Chosen, rows: Table, world: World, file: IO[bytes]) -> None:
    """Write rows; PluginError, in one line, where the plug-in fails."""
    own: Exporter = exporter.make(world.length_unit)
    with said_by(exporter.plugin):
        own.write(rows, world, Sink(file))  # type: ignore[arg-type]
