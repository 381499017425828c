"""Changes of what files hold, not of their bytes: values of descriptions, columns and rows of tables.

Descriptions are JSON, YAML, XML and NumPy's archives; tables are Parquet and delimited text.
"""

from __future__ import annotations

import copy
import csv
import io
import json
from collections.abc import Iterator
from random import Random
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import yaml

from .mutations import MCAP, ZIP

OTHERS: tuple[Any, ...] = (
    *(None, True, 0, -1, 2.5, 2**31, 2**63, 1e300, "", "x", "7", [], {}, [[]], [0], [None], [1, 2, 3], ["x"]),
    *({"x": 1}, {"id": 0}, [{}], [[1, 2], [3]], "2001-01-01", float("nan"), float("inf")),
)
NUMBERS = (0.0, -1.0, 1e-300, 1e6, 1e18, 1e300, np.nan, np.inf, -np.inf)
CELLS = ("", "nan", "inf", "-inf", "-1", "0", "1e18", "1e300", "9" * 30, "x", "1.5", '"', "2024-01-01T00:00:00Z")


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Keys and numbers that lead to each value in a value."""
    for key in value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ():
        yield (*path, key)
        yield from places(value[key], (*path, key))


def replaced(value: Any, place: tuple[Any, ...], other: Any) -> Any:
    """A copy of a description with one value another, or for `...` removed."""
    new = copy.deepcopy(value)
    *way, last = place
    holder = new
    for key in way:
        holder = holder[key]
    if other is ...:
        del holder[last]
    else:
        holder[last] = other
    return new


def restructured(data: bytes, random: Random) -> bytes:
    """A file with another structure; ValueError and errors of the libraries where the file has none."""
    if data.startswith(b"PAR1"):
        return _with_table(data, random)
    if data.startswith(b"\x89MCAP"):
        return _with_message(data, random)
    if data.startswith(b"PK"):
        parts = ZIP.parts(data)
        number = random.randrange(len(parts))
        return ZIP.pack(data, number, restructured(parts[number], random))
    text = data.decode()
    try:
        return _with_value(yaml.safe_load(text), random)
    except (yaml.YAMLError, ValueError):
        return _with_cells(text, random)


def _with_value(value: Any, random: Random) -> bytes:
    """A description with one or two values another, removed, or renamed."""
    for _ in range(random.choice((1, 1, 2))):
        known = list(places(value))
        if not known:
            raise ValueError("no values")
        value = replaced(value, random.choice(known), random.choice((..., *OTHERS)))
    return json.dumps(value).encode()


def _with_message(data: bytes, random: Random) -> bytes:
    """A recording with one or several of its messages or attachments in JSON or YAML another."""
    parts = MCAP.parts(data)
    structured = [n for n, part in enumerate(parts) if part[:1] in (b"{", b"o", b"#")]
    for number in random.sample(structured, random.choice((1, 1, 2))):
        part = parts[number]
        data = MCAP.pack(data, number, _with_value(yaml.safe_load(part.decode()), random))
    return data


def _with_table(data: bytes, random: Random) -> bytes:
    """A Parquet table with one or two columns or all rows changed; its metadata stay."""
    table = pq.read_table(io.BytesIO(data))
    for _ in range(random.choice((1, 1, 2))):
        table = _table(table, random)
    out = io.BytesIO()
    pq.write_table(table, out)
    return out.getvalue()


def _table(table: pa.Table, random: Random) -> pa.Table:
    n, rows = random.randrange(table.num_columns), table.num_rows
    column, field = table.column(n), table.schema.field(n)
    match random.randrange(11):
        case 0:
            return table.remove_column(n)
        case 1:
            others = (f"{field.name}_", "t_ns", "x", random.choice(table.column_names))
            names = [random.choice(others) if k == n else name for k, name in enumerate(table.column_names)]
            return table.rename_columns(names)
        case 2:
            return table.slice(0, random.choice((0, 1, rows // 2)))
        case 3:
            return table.take(random.choices(range(rows), k=rows))  # duplicated, missing and unsorted rows
        case 4:
            return pa.concat_tables([table, table])
        case 5:
            return table.take(list(range(rows))[::-1])
        case 6:
            numbers = not (pa.types.is_string(field.type) or pa.types.is_dictionary(field.type))
            other = random.choice((pa.string(), pa.large_string(), *((pa.float32(), pa.int32()) if numbers else ())))
            return table.set_column(n, field.name, column.cast(other))
        case 7:
            return table.set_column(n, field.name, pa.nulls(rows, field.type))
        case _:
            return table.set_column(n, field.name, _column(column, random))


def _column(column: pa.ChunkedArray, random: Random) -> pa.Array:
    """Other values in some or all rows of a column."""
    values = column.to_pylist()
    every = random.choice((1, 2, len(values)))
    start, kind = random.randrange(every), column.type
    if pa.types.is_integer(kind):
        limit = 2 ** (kind.bit_width - 1) - 1
        other: Any = random.choice((0, -1, 1, limit, -limit, limit // 2))
    elif pa.types.is_floating(kind):
        other = random.choice(NUMBERS)
    elif pa.types.is_boolean(kind):
        other = random.random() < 0.5
    else:
        other = random.choice(("", "x", "cam1", "\u202e", "a/b", "..", " "))
    values[start::every] = [other] * len(values[start::every])
    return pa.array(values, kind, from_pandas=False)


def _with_cells(text: str, random: Random) -> bytes:
    """A delimited text with columns, rows or cells changed."""
    mark = max(",;\t ", key=text.count)
    rows = list(csv.reader(io.StringIO(text), delimiter=mark))
    if len(rows) < 2 or mark not in text:
        raise ValueError("no table")
    n, column = random.randrange(len(rows)), random.randrange(max(map(len, rows)) or 1)
    match random.randrange(8):
        case 0:
            rows = [row[:column] + row[column + 1 :] for row in rows]
        case 1:
            rows[0] = [f"{cell}_" if k == column else cell for k, cell in enumerate(rows[0])]
        case 2:
            rows = rows[:1]
        case 3:
            rows += rows[1:]
        case 4:
            rows[1:] = rows[:0:-1]
        case 5:
            cell = random.choice(CELLS)
            rows[1:] = [[cell if k == column else each for k, each in enumerate(row)] for row in rows[1:]]
        case _:
            rows[n] = [random.choice(CELLS) if k == column else each for k, each in enumerate(rows[n])]
    out = io.StringIO()
    csv.writer(out, delimiter=mark, lineterminator="\n").writerows(rows)
    return out.getvalue().encode()
