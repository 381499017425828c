"""Files in formats that reader plug-ins know, read as text tables with a header.

A reader is used for files with the suffixes that it declares, unless occlog reads these itself, or if the user names
the reader.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from occlog.errors import InputError, PluginError, UsageError, option
from occlog.io.files.limits import STANDARD_INPUT, check_input
from occlog.io.files.provenance import READERS_USED
from occlog.plugins.interface import Reader
from occlog.plugins.loading import READER, Chosen, Plugin, installed, plugin_errors

OURS = (
    *(".csv", ".tsv", ".txt", ".dat", ".gz", ".parquet", ".pq", ".arrow", ".feather", ".json", ".jsonl", ".xml"),
    *(".yaml", ".yml", ".ini", ".toml", ".npz", ".npy", ".mat", ".mcap", ".db3", ".bag", ".onnx", ".html", ".wav"),
    *(".tum", ".trc", ".geojson", ".mp4", ".avi", ".mkv", ".webm", ".mov", ".png", ".jpg", ".jpeg", ".bmp", ".tif"),
)
"""Endings of names for which no plug-in is searched for."""
UNIT = "m"
"""Unit of lengths among the settings of readers."""


class NamedReader:
    """The reader that the user names, and whether it was used for a file."""

    def __init__(self, chosen: Chosen) -> None:
        """Wrap the reader that the user names, which was not used so far."""
        self.chosen, self.used = chosen, False

    @property
    def endings(self) -> tuple[str, ...]:
        """Suffixes of the files that the reader reads."""
        return tuple(self.chosen.plugin.load().endings)

    def check_used(self) -> None:
        """UsageError if the reader was used for no file."""
        if not self.used:
            raise UsageError(
                f"{option('reader')} {self.chosen.plugin.name}: no input has a name that ends in "
                f"{' or '.join(self.endings)}; outputs were made without this reader",
                id="unknown-format",
            )


_NAMED: ContextVar[NamedReader | None] = ContextVar("NAMED_READER", default=None)


@contextmanager
def named_reader(chosen: Chosen) -> Iterator[NamedReader]:
    """Context manager that reads files with the suffixes of a reader plug-in, and standard input, by this reader.

    Yields the `NamedReader`, which records whether it was used. Other files are read as usual.
    """
    named = NamedReader(chosen)
    token = _NAMED.set(named)
    try:
        yield named
    finally:
        _NAMED.reset(token)


def reader_of(path: Path) -> Chosen | None:
    """Reader plug-in of a file; None if there is none.

    Raises:
        UsageError: several readers know such files.
    """
    named, low = _NAMED.get(), path.name.lower()
    if named is not None and (low == STANDARD_INPUT or low.endswith(named.endings)):
        named.used = True
        return named.chosen
    if not path.suffix or path.suffix.lower() in OURS:
        return None
    found = []
    for plugin in installed(READER):
        try:
            endings = tuple(plugin.load().endings)
        except PluginError:
            continue
        if low.endswith(endings):
            found.append(plugin)
    if len(found) > 1:
        raise UsageError(
            f"{path}: readers {' and '.join(p.name for p in found)} both read such files; name one of them "
            f"({option('reader')})",
            id="ambiguous-input",
        )
    return Chosen(found[0], {}) if found else None


def table_of(path: Path) -> str:
    """Name of the table that a reader's file holds; empty if no reader reads it."""
    chosen = reader_of(path)
    return "" if chosen is None else str(chosen.plugin.load().table)


def text_of(path: Path, what: str) -> str | None:
    """Convert a file to text with a header line, by a reader plug-in; None if no reader reads it.

    `what` describes what was expected.

    Raises:
        InputError: the reader states that the file is damaged.
        PluginError: the reader fails, or returns an invalid table.
    """
    chosen = reader_of(path)
    if chosen is None:
        return None
    status = check_input(path, what).stat()
    text = _text(chosen.plugin, tuple(sorted(chosen.values.items())), path, (status.st_mtime_ns, status.st_size))
    READERS_USED[path.name] = chosen.provenance(UNIT)
    return text


@lru_cache(maxsize=4)
def _text(plugin: Plugin, values: tuple[tuple[str, object], ...], path: Path, state: tuple[int, int]) -> str:  # noqa: ARG001
    """Text with a header line of the file `path`, by a reader plug-in; the four latest texts are cached.

    Args:
        plugin: the reader.
        values: names and values of its settings.
        path: the file.
        state: time of modification [ns] and size [bytes]; only part of the key of the cache.
    """
    columns = columns_of(Chosen(plugin, dict(values)), path)
    with plugin_errors(plugin):
        return as_text(columns)


def columns_of(chosen: Chosen, path: Path) -> dict[str, NDArray[np.generic]]:
    """Columns of a file, by name, that the reader plug-in `chosen` returns, all of one length.

    Errors are those of `text_of`.
    """
    reader: Reader = chosen.make(UNIT)
    label = f"{path}: "
    with plugin_errors(chosen.plugin):
        try:
            found = reader.read(path)
        except (ValueError, OSError) as error:
            reason = " ".join(str(error).split())[:200].removeprefix(label)
            raise InputError(f"{label}{reason} (reader {chosen.plugin.name}, {chosen.plugin.origin})") from error
        wrong = fault_of(found)
        if wrong is not None:
            raise PluginError(f"{chosen.plugin.label}: {path}: {wrong}")
        return {name: np.asarray(values) for name, values in found.items()}


def fault_of(columns: object) -> str | None:
    """Description of what is wrong with the columns that a reader plug-in returns; None if they are valid."""
    if not isinstance(columns, Mapping):
        return f"read gives a {type(columns).__name__}; a mapping of names to columns was expected"
    if not columns:
        return "read gives no columns"
    rows = -1
    for name, values in columns.items():
        if not isinstance(name, str) or not name.strip() or "\n" in name:
            return f"{name!r} is no name of a column"
        try:
            column = np.asarray(values)
        except ValueError:
            return f"column {name} is no list of single values"
        if column.ndim != 1 or column.dtype.kind not in "biufUOM":
            return (
                f"column {name} is of the shape {column.shape} and kind {column.dtype}; numbers or texts were expected"
            )
        rows = len(column) if rows < 0 else rows
        if len(column) != rows:
            return f"column {name} has {len(column)} rows, those before it {rows}"
    return None


def as_text(columns: Mapping[str, NDArray[np.generic]]) -> str:
    """Format columns as a text table; numbers keep all digits."""
    file = io.StringIO()
    writer = csv.writer(file, quoting=csv.QUOTE_NONNUMERIC, lineterminator="\n")
    writer.writerow(list(columns))
    cells = [[_cell(value) for value in column.tolist()] for column in columns.values()]
    writer.writerows(zip(*cells, strict=True))
    return file.getvalue()


def _cell(value: object) -> object:
    """Format a cell; empty for a missing value."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return " ".join(value.split()) if isinstance(value, str) else value
