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
    """The reader plug-in that the user names, and whether it was used for a file (`used`)."""

    def __init__(self, chosen: Chosen) -> None:
        """Wrap a plug-in with its settings; it counts as not used."""
        self.chosen, self.used = chosen, False

    @property
    def endings(self) -> tuple[str, ...]:
        """Suffixes of the file names that the plug-in declares to read."""
        return tuple(self.chosen.plugin.load().endings)

    def check_used(self) -> None:
        """UsageError if no file was read by the plug-in."""
        if not self.used:
            raise UsageError(
                f"{option('reader')} {self.chosen.plugin.name}: no input has a name that ends in "
                f"{' or '.join(self.endings)}, and outputs were made without it; rename the input, or leave the option "
                "out",
                id="unknown-format",
            )


_NAMED: ContextVar[NamedReader | None] = ContextVar("NAMED_READER", default=None)


@contextmanager
def named_reader(chosen: Chosen) -> Iterator[NamedReader]:
    """Context manager in which a reader plug-in reads standard input and the files with its suffixes; others as usual.

    Yields the `NamedReader`, which records whether it was used.
    """
    named = NamedReader(chosen)
    token = _NAMED.set(named)
    try:
        yield named
    finally:
        _NAMED.reset(token)


def reader_of(path: Path) -> Chosen | None:
    """Reader plug-in for a file with its settings: the one that the user names, else one by suffix.

    None if there is none. No plug-in is searched for files that occlog reads itself. A named plug-in is marked as used.

    Raises:
        UsageError: several plug-ins read such files.
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
    """Name of the table that the plug-in for a file states it holds; empty if no plug-in reads the file."""
    chosen = reader_of(path)
    return "" if chosen is None else str(chosen.plugin.load().table)


def text_of(path: Path, what: str) -> str | None:
    """Text table (CSV with a header line) that a reader plug-in makes of a file; None if no plug-in reads it.

    The plug-in is recorded for the provenance of outputs. `what` describes the expected content, for messages.

    Raises:
        InputError: the plug-in states that the file is damaged.
        PluginError: the plug-in fails, or returns an invalid table.
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
    """Text table (CSV with a header line) of a file, by a reader plug-in; the four latest texts are cached.

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
    """Columns (n,) by name that the reader plug-in `chosen` returns for a file.

    Raises:
        InputError: the plug-in states that the file is damaged (ValueError, OSError).
        PluginError: the plug-in fails, or returns invalid columns.
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
    """Text on what is wrong with the columns that a reader plug-in returns; None if they are valid.

    Valid is a mapping of names to one-dimensional sequences of numbers or texts, of equal length.
    """
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
    """Format columns of equal length as CSV with a header line; numbers keep all digits, missing values are empty."""
    file = io.StringIO()
    writer = csv.writer(file, quoting=csv.QUOTE_NONNUMERIC, lineterminator="\n")
    writer.writerow(list(columns))
    cells = [[_cell(value) for value in column.tolist()] for column in columns.values()]
    writer.writerows(zip(*cells, strict=True))
    return file.getvalue()


def _cell(value: object) -> object:
    """Value of a CSV cell: empty for None and NaN, `true` or `false` for Booleans, texts with single blanks."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return " ".join(value.split()) if isinstance(value, str) else value
