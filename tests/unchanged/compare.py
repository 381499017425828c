"""Compares what two sides wrote: bytes, or values with a relative tolerance."""

from __future__ import annotations

import io
import json
import math
import re
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from mcap.reader import make_reader

NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w])")
EXCEPTED = {"version", "versions", "command"}
"""Keys of the provenance that may differ; with a tolerance also `inputs`, the digests of what came before."""


class Tolerance(NamedTuple):
    """Two numbers are equal if |a - b| <= absolute + relative max(|a|, |b|)."""

    relative: float = 0.0
    absolute: float = 0.0

    @property
    def any(self) -> bool:
        """Whether numbers may differ at all."""
        return self.relative > 0 or self.absolute > 0


def first_difference(a: bytes, b: bytes, name: str, tolerance: Tolerance) -> str | None:
    """Where two files of one name first differ in value, or None; equal bytes are equal values."""
    if a == b:
        return None
    kind = Path(name).suffix
    if kind == ".zip":
        return _members(a, b, tolerance)
    if kind == ".mcap":
        return _first(_messages(a), _messages(b), tolerance)
    if kind == ".parquet" and b"PAR1" == a[:4] == b[:4]:
        return _tables(pq.read_table(io.BytesIO(a)), pq.read_table(io.BytesIO(b)), tolerance)
    if kind in (".json", ".jsonl"):
        lines = [[_json(line) for line in data.splitlines()] if kind == ".jsonl" else _json(data) for data in (a, b)]
        return _values(*lines, "", tolerance)
    try:
        return _texts(a.decode(), b.decode(), tolerance)
    except UnicodeDecodeError:
        return "bytes differ"


def _members(a: bytes, b: bytes, tolerance: Tolerance) -> str | None:
    first, second = (zipfile.ZipFile(io.BytesIO(data)) for data in (a, b))
    if first.namelist() != second.namelist():
        return f"members {sorted(set(first.namelist()) ^ set(second.namelist())) or 'in another order'}"
    for name in first.namelist():
        found = first_difference(first.read(name), second.read(name), name, tolerance)
        if found:
            return f"{name}: {found}"
    return None


def _messages(data: bytes) -> Iterator[tuple[str, Any]]:
    """Everything that a recording holds, with a name for each."""
    reader = make_reader(io.BytesIO(data))
    for record in reader.iter_metadata():
        yield f"metadata {record.name}", {key: _json(value.encode()) for key, value in record.metadata.items()}
    for attached in reader.iter_attachments():
        yield f"attachment {attached.name}", attached.data
    for n, (schema, channel, message) in enumerate(reader.iter_messages(log_time_order=False)):
        head = (channel.topic, schema.name if schema else "", message.log_time, message.publish_time)
        yield (
            f"message {n} of {channel.topic}",
            [*head, _json(message.data) if channel.message_encoding == "json" else message.data],
        )


def _first(a: Iterator[tuple[str, Any]], b: Iterator[tuple[str, Any]], tolerance: Tolerance) -> str | None:
    first, second = list(a), list(b)
    if [name for name, _ in first] != [name for name, _ in second]:
        return f"{len(first)} and {len(second)} parts, or in another order"
    return next(
        filter(None, (_values(x, y, name, tolerance) for (name, x), (_, y) in zip(first, second, strict=True))), None
    )


def _tables(a: pa.Table, b: pa.Table, tolerance: Tolerance) -> str | None:
    if a.schema.names != b.schema.names:
        return f"columns {a.schema.names} and {b.schema.names}"
    if len(a) != len(b):
        return f"{len(a)} and {len(b)} rows"
    for name in a.schema.names:
        if a.schema.field(name).type != b.schema.field(name).type:
            return f"column {name}: {a.schema.field(name).type} and {b.schema.field(name).type}"
        x, y = a[name].combine_chunks(), b[name].combine_chunks()
        if not x.equals(y):
            found = _column(x, y, tolerance)
            if found:
                return f"column {name}, {found}"
    metadata = [{k.decode(): _json(v) for k, v in (t.schema.metadata or {}).items()} for t in (a, b)]
    return _values(*metadata, "metadata", tolerance)


def _column(x: pa.Array, y: pa.Array, tolerance: Tolerance) -> str | None:
    if pa.types.is_floating(x.type):
        p, q = (column.to_numpy(zero_copy_only=False) for column in (x, y))
        limit = tolerance.absolute + tolerance.relative * np.maximum(np.abs(p), np.abs(q))
        with np.errstate(invalid="ignore"):
            apart = ~((p == q) | (np.isnan(p) & np.isnan(q)) | (np.abs(p - q) <= limit))
        if not apart.any():
            return None
        row = int(np.argmax(apart))
        return f"row {row}: {p[row]!r} and {q[row]!r} ({int(apart.sum())} rows of {len(p)})"
    found = (
        _values(p, q, f"row {n}", tolerance) for n, (p, q) in enumerate(zip(x.to_pylist(), y.to_pylist(), strict=True))
    )
    return next(filter(None, found), None)


def _json(data: bytes) -> Any:
    try:
        return json.loads(data)
    except (ValueError, UnicodeDecodeError):
        return data.decode(errors="replace")


def _close(a: float, b: float, tolerance: Tolerance) -> bool:
    limit = tolerance.absolute + tolerance.relative * max(abs(a), abs(b))
    return a == b or (math.isnan(a) and math.isnan(b)) or abs(a - b) <= limit


def _values(a: Any, b: Any, where: str, tolerance: Tolerance) -> str | None:
    """Where two values of JSON, or bytes, first differ."""
    if isinstance(a, dict) and isinstance(b, dict):
        skip = EXCEPTED | ({"inputs"} if tolerance.any else set()) if "program" in a else set()
        if a.keys() - skip != b.keys() - skip:
            return f"{where}: keys {sorted((a.keys() ^ b.keys()) - skip)}"
        found = (_values(a[key], b[key], f"{where}.{key}".lstrip("."), tolerance) for key in a if key not in skip)
        return next(filter(None, found), None)
    if isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        found = (_values(x, y, f"{where}[{n}]", tolerance) for n, (x, y) in enumerate(zip(a, b, strict=True)))
        return next(filter(None, found), None)
    numbers = all(isinstance(v, int | float) and not isinstance(v, bool) for v in (a, b))
    if (numbers and _close(a, b, tolerance)) or (type(a) is type(b) and a == b):
        return None
    if isinstance(a, str) and isinstance(b, str) and tolerance.any and _texts(a, b, tolerance) is None:
        return None
    return f"{where}: {_short(a)} and {_short(b)}"


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) < 90 else f"{text[:87]}..."


def _texts(a: str, b: str, tolerance: Tolerance) -> str | None:
    """The first line in which words differ, or numbers by more than the tolerance."""
    first, second = a.splitlines(), b.splitlines()
    for n, (x, y) in enumerate(zip(first, second, strict=False), start=1):
        if x == y or (tolerance.any and NUMBER.sub("#", x) == NUMBER.sub("#", y)):
            pairs = zip(NUMBER.findall(x), NUMBER.findall(y), strict=True)
            if x == y or all(_close(float(p), float(q), tolerance) for p, q in pairs):
                continue
        at = next((k for k, (p, q) in enumerate(zip(x, y, strict=False)) if p != q), min(len(x), len(y)))
        return f"line {n}: {_short(x[max(at - 20, 0) : at + 60])} and {_short(y[max(at - 20, 0) : at + 60])}"
    return None if len(first) == len(second) else f"{len(first)} and {len(second)} lines"
