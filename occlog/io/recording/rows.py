"""Conversion of table rows to MCAP messages and back: one message holds the rows of one time (and sensor)."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from functools import cache
from typing import Any, Generic, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from occlog.array_types import Ints, Strings
from occlog.errors import InputError
from occlog.io.files.limits import check_texts
from occlog.io.files.timing.utc import time_words
from occlog.records.columns import Column, ColumnTable, check_copies
from occlog.records.tables import Bearings, Boxes, Doa, Occluders, Positions, Reads, Truth, TruthBoxes, has_all_columns

T = TypeVar("T", bound=ColumnTable)

RECORDED: tuple[type[ColumnTable], ...] = (Truth, TruthBoxes, Boxes, Bearings, Doa, Positions, Reads, Occluders)
"""Tables that a recording can hold."""

MAX_MESSAGE_BYTES, MAX_ROWS_AT_ONCE = 32_000_000, 1_000_000
"""Size of a message of rows at most, and rows of one time, which are held in memory together."""

_PYTHON_TYPES = {"i8": int, "i4": int, "f8": float, "f4": float, "?": bool, "U": str}
_JSON_TYPES = {"i8": "integer", "i4": "integer", "f8": "number", "f4": "number", "?": "boolean", "U": "string"}


def schema_of(table: type[ColumnTable]) -> str:
    """Name of the schema of messages with rows of a table, e.g. `occlog.Bearings`."""
    return f"occlog.{table.__name__}"


def topic_of(table: type[ColumnTable], sensor: str) -> str:
    """Topic of the messages with rows of a table: `/TABLE/SENSOR`, or `/TABLE` if no column names a sensor."""
    return f"/{table.NAME}/{sensor}" if _has_sensor(table) else f"/{table.NAME}"


def _has_sensor(table: type[ColumnTable]) -> bool:
    # Asked for every message, so not through `columns()`.
    return "sensor" in getattr(table, "__dataclass_fields__", {})


def _listed(table: type[ColumnTable]) -> list[Column]:
    """Columns of a table that are lists in a message: all but time and sensor, which a message has once."""
    return [c for c in table.columns() if c.name not in ("t_ns", "sensor")]


def message_schema(table: type[ColumnTable]) -> dict[str, object]:
    """JSON Schema of the messages with rows of a table at one time."""
    properties: dict[str, object] = {"t_ns": {"type": "integer", "description": "ns since the Unix epoch, of all rows"}}
    if _has_sensor(table):
        properties["sensor"] = {"type": "string", "description": "sensor of all rows"}
    for c in _listed(table):
        kind = _JSON_TYPES[c.kind]
        item = {"type": [kind, "null"] if c.nan is not None else kind}
        text = f"{c.doc} [{c.unit}]" + (f"; null: {c.nan}" if c.nan is not None else "")
        properties[c.name] = {"type": "array", "items": item, "description": text}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": schema_of(table),
        "description": f"Rows of the table `{table.NAME}` at one time; the lists have equal lengths.",
        "type": "object",
        "properties": properties,
        "required": [name for name in properties if name not in {c.name for c in table.columns() if c.optional}],
        "additionalProperties": False,
    }


def table_to_messages(table: ColumnTable) -> Iterator[tuple[str, int, bytes]]:
    """Yield (topic, time [ns], message as JSON bytes) for each time and sensor of a table, which is sorted by time."""
    if not len(table):
        return
    kind = type(table)
    t_ns: Ints = table.t_ns  # type: ignore[attr-defined]
    sensor: Strings | None = getattr(table, "sensor", None)
    change = np.flatnonzero(np.diff(t_ns) != 0) + 1
    if sensor is not None:
        change = np.union1d(change, np.flatnonzero(sensor[1:] != sensor[:-1]) + 1)
    lists = {c.name: getattr(table, c.name).tolist() for c in _listed(kind)}
    bounds = [0, *change.tolist(), len(table)]
    for start, stop in itertools.pairwise(bounds):
        time, name = int(t_ns[start]), "" if sensor is None else str(sensor[start])
        named = {} if sensor is None else {"sensor": name}
        message = {"t_ns": time, **named, **{column: values[start:stop] for column, values in lists.items()}}
        yield topic_of(kind, name), time, msgspec.json.encode(message)


@cache
def _decoder(table: type[ColumnTable]) -> msgspec.json.Decoder[Any]:
    """Strict JSON decoder of the messages of a table: texts are not numbers, and 1.5 is not a time."""
    fields: list[Any] = [("t_ns", int), *([("sensor", str)] if _has_sensor(table) else [])]
    for c in sorted(_listed(table), key=lambda c: c.optional):
        item: Any = _PYTHON_TYPES[c.kind]
        item = item | None if item is float else item
        values: Any = list[list[item]] if c.width else list[item]
        fields.append((c.name, values | None, None) if c.optional else (c.name, values))
    return msgspec.json.Decoder(msgspec.defstruct(schema_of(table), fields))


class RowCollector(Generic[T]):
    """Collects the rows of messages of one table, and returns them as a table."""

    def __init__(self, table: type[T], source: str) -> None:
        """Start without rows of `table`; `source` is the file in messages."""
        self.rows = 0
        self._table, self._source = table, source
        self._lists: dict[str, list[object]] = {c.name: [] for c in table.columns()}
        self._has_sensor = _has_sensor(table)
        self._decoder = _decoder(table)  # type: ignore[arg-type]  # a type is hashable
        # What a column holds in messages of older recordings, which do not have it
        self._columns = {c.name: "" if c.kind == "U" else None for c in _listed(table)}

    def add(self, topic: str, data: bytes) -> None:
        """Append the rows of a message; InputError if it does not fit the table, or if too many rows are collected.

        Args:
            topic: of the message, for messages of errors.
            data: the message, JSON.
        """
        if len(data) > MAX_MESSAGE_BYTES:
            raise InputError(
                f"{self._source}: topic {topic}: a message with rows of a table has {len(data)} bytes, limit "
                f"{MAX_MESSAGE_BYTES}; write fewer rows in each",
                id="input-too-large",
            )
        try:
            message = self._decoder.decode(data)
            given = {name: values for name in self._columns if (values := getattr(message, name)) is not None}
            (n,) = set(map(len, given.values()))
        except (msgspec.DecodeError, ValueError, RecursionError) as error:
            reason = " ".join(str(error).split())[:100]
            raise InputError(
                f"{self._source}: topic {topic}: not a message of {schema_of(self._table)} ({reason})",
                id="damaged-file",
            ) from error
        self.rows += n
        if self.rows > MAX_ROWS_AT_ONCE:
            raise InputError(
                f"{self._source}: topic {topic}: more than {MAX_ROWS_AT_ONCE} rows of one time "
                f"({time_words(message.t_ns)}), too many to hold at once; check the times of its rows",
                id="input-too-large",
            )
        for name, values in given.items():
            self._lists[name].extend(values)
        for name in self._columns.keys() - given.keys():  # an older recording
            self._lists[name].extend([self._columns[name]] * n)
        self._lists["t_ns"].extend([message.t_ns] * n)
        if self._has_sensor:
            self._lists["sensor"].extend([message.sensor] * n)

    def take(self) -> T:
        """Collected rows as a table sorted by its key; the collector is empty then.

        InputError for invalid values or duplicate rows.
        """
        values = self.columns()
        try:
            table = self._table(**values).sorted()
            if has_all_columns(self._table):
                check_copies(table)
            return table
        except (InputError, ValueError) as error:
            raise InputError(f"{self._source}: {error}") from error

    def columns(self) -> dict[str, NDArray[np.generic]]:
        """Columns (n,) of the collected rows by name, unchecked and unsorted; the collector is empty then."""
        lists, self._lists = self._lists, {c.name: [] for c in self._table.columns()}
        self.rows = 0
        return {c.name: _array(c, lists[c.name], self._source) for c in self._table.columns()}


def _array(c: Column, values: list[object], source: str) -> NDArray[np.generic]:
    if not values:
        return np.empty((0, c.width) if c.width else 0, "U1" if c.kind == "U" else c.dtype)
    if c.kind == "U":
        check_texts((text for text in values if isinstance(text, str)), len(values), f"{source}: column {c.name}")
    try:
        # null becomes NaN; only columns that declare a meaning for NaN will accept it.
        return np.array(values, dtype=np.str_ if c.kind == "U" else c.dtype)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{source}: column {c.name}: values are not of type {'text' if c.kind == 'U' else c.dtype} ({error})"
        ) from error
