"""Conversion of tables between Arrow and NumPy, without pandas (which pyarrow's own conversions import).

Also the Arrow schema of a table, with units.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import TypeVar

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from occlog.array_types import Strings
from occlog.errors import InputError, abridged, nearest
from occlog.io.files.limits import check_texts
from occlog.io.files.provenance import PROVENANCE_KEY, Provenance
from occlog.records.columns import ANY_WIDTH, Column, ColumnTable, in_length_unit
from occlog.records.tables import TABLES, WIDER


def to_numpy(values: pa.Array) -> NDArray[np.generic]:
    """(n,) read-only NumPy array of a numeric or Boolean Arrow array without nulls."""
    if not pa.types.is_boolean(values.type):
        return np.from_dlpack(values)
    if not len(values):
        return np.empty(0, dtype=np.bool_)
    # Truth values are bits, the first one the lowest of its byte
    bits = np.unpackbits(np.frombuffer(values.buffers()[1], dtype=np.uint8), bitorder="little")
    return bits[values.offset : values.offset + len(values)].astype(np.bool_)


def to_texts(values: pa.Array, where: str, longest: int | None = None) -> Strings:
    """(n,) texts of an Arrow array of texts or numbers; "" for null.

    Each distinct text is created once, since a small file may refer to a large text in a million rows.

    Args:
        values: texts, numbers, or a dictionary of such.
        where: file and column, with which an error begins.
        longest: characters that a text may have; None: as many as fit into an array of these rows.

    Raises:
        InputError: a text is too long, or an index of the dictionary is out of range.
    """
    coded = values if pa.types.is_dictionary(values.type) else values.dictionary_encode()
    texts = ["" if text is None else str(text) for text in coded.dictionary.to_pylist()]
    most = max(map(len, texts), default=0)
    if longest is not None and most > longest:
        raise InputError(f"{where}: a text of {most} characters; shorten it to {longest}", id="input-too-large")
    check_texts(texts, max(len(values), len(texts)), where)
    which = to_numpy(coded.indices.fill_null(0) if coded.null_count else coded.indices)
    if len(which) and coded.null_count < len(which) and not 0 <= int(which.min()) <= int(which.max()) < len(texts):
        raise InputError(f"{where}: the file is damaged: a row refers to a missing text", id="damaged-file")
    out = np.asarray(texts or [""], dtype=np.str_)[which]
    if coded.null_count:
        out[to_numpy(coded.is_null())] = ""
    return np.asarray(out)


SCHEMA_KEY = "occlog.schema"
UNIT_KEY = "occlog.length_unit"
SUM_KEY = "occlog.crc32"
MAX_NUMBERS = 1 << 25
"""Numbers that a column of vectors may have, most of which the file has not: NaN in rows without a vector."""
T = TypeVar("T", bound=ColumnTable)
_ARROW = {
    "i8": pa.int64(),
    "i4": pa.int32(),
    "f8": pa.float64(),
    "f4": pa.float32(),
    "?": pa.bool_(),
    "U": pa.dictionary(pa.int32(), pa.string()),
}


def arrow_field(c: Column, unit: str) -> pa.Field:
    """Arrow field of a table column, with unit, description and meaning of NaN as metadata.

    `unit` is that of the column with the scene's unit of length.
    """
    kind = _ARROW[c.kind]
    if c.width:
        kind = pa.list_(kind) if c.width == ANY_WIDTH else pa.list_(kind, c.width)
    metadata = {"unit": unit, "doc": c.doc}
    if c.nan is not None:
        metadata["nan"] = c.nan
    return pa.field(c.name, kind, nullable=False, metadata=metadata)


def arrow_schema(table: type[ColumnTable], provenance: Provenance, length_unit: str = "m") -> pa.Schema:
    """Arrow schema of a table, with its name, version, key, length unit and provenance as metadata.

    `length_unit` replaces metres in the units of columns.
    """
    fields = [arrow_field(c, in_length_unit(c.unit, length_unit)) for c in table.columns()]
    metadata = {
        SCHEMA_KEY: f"{table.NAME}/{table.VERSION}",
        "occlog.key": ",".join(table.KEY),
        **statements(provenance, length_unit),
    }
    return pa.schema(fields).with_metadata(metadata)


def statements(provenance: Provenance, length_unit: str) -> dict[str, str]:
    """Metadata entries for the length unit (omitted if empty), the provenance, and a check sum (CRC-32) of both."""
    entries = {UNIT_KEY: length_unit} if length_unit else {}
    entries[PROVENANCE_KEY] = provenance.json()
    return entries | {SUM_KEY: _sum(length_unit.encode(), entries[PROVENANCE_KEY].encode())}


def check_statements(path: Path, entries: Mapping[bytes, bytes]) -> None:
    """InputError if length unit and provenance of a file do not match their check sum; older files have no check sum.

    Args:
        path: the file, for the message.
        entries: metadata of the file's schema.
    """
    if (stated := entries.get(SUM_KEY.encode())) is not None:
        unit, provenance = (entries.get(key.encode(), b"") for key in (UNIT_KEY, PROVENANCE_KEY))
        if stated.decode(errors="replace") != _sum(unit, provenance):
            raise InputError(
                f"{path}: damaged: its unit of lengths or its provenance changed since it was written (wrong check "
                "sum); make it again",
                id="damaged-file",
            )


def _sum(unit: bytes, provenance: bytes) -> str:
    return f"{zlib.crc32(unit + bytes(1) + provenance):08x}"


def to_arrow(table: ColumnTable, schema: pa.Schema) -> pa.Table:
    """Convert a table to an Arrow table with the given schema, which must have the columns of the table in order.

    Texts become dictionaries, vectors lists.
    """
    arrays = []
    for c, f in zip(table.columns(), schema, strict=True):
        values = getattr(table, c.name)
        if c.width == ANY_WIDTH:
            starts = numbers(np.arange(len(values) + 1, dtype=np.int32) * values.shape[1])
            arrays.append(pa.ListArray.from_arrays(starts, numbers(values.reshape(-1)), type=f.type))
        elif c.width:
            arrays.append(pa.FixedSizeListArray.from_arrays(numbers(values.reshape(-1)), c.width))
        elif c.kind == "U":
            names, codes = np.unique(values, return_inverse=True)
            arrays.append(pa.DictionaryArray.from_arrays(numbers(codes.astype(np.int32)), texts(names)))
        else:
            arrays.append(numbers(values))
    return pa.Table.from_arrays(arrays, schema=schema)


def numbers(values: NDArray[np.generic]) -> pa.Array:
    """Arrow array of numbers or booleans (n,), without nulls."""
    # Truth values are bits, the first one the lowest of its byte
    logical = values.dtype == np.bool_
    data = np.packbits(values.astype(np.bool_), bitorder="little") if logical else np.ascontiguousarray(values)
    return pa.Array.from_buffers(pa.from_numpy_dtype(values.dtype), len(values), [None, pa.py_buffer(data)])


def texts(values: Strings) -> pa.Array:
    """Arrow array of texts (n,), without nulls."""
    encoded = [text.encode() for text in values.tolist()]
    ends = np.cumsum([0, *map(len, encoded)], dtype=np.int32)
    return pa.StringArray.from_buffers(len(encoded), pa.py_buffer(ends), pa.py_buffer(b"".join(encoded)))


def from_arrow(batch: pa.RecordBatch | pa.Table, table: type[T]) -> T:
    """Convert an Arrow batch, with columns as in `check_schema`, to a table of the class `table`; copies the values.

    Optional columns may be missing. InputError for null values.
    """
    columns = [c for c in table.columns() if c.name in batch.schema.names]
    return table.of(**{c.name: _column_from_arrow(c, batch.column(c.name)) for c in columns})


def _column_from_arrow(c: Column, values: pa.Array | pa.ChunkedArray) -> NDArray[np.generic]:
    if isinstance(values, pa.ChunkedArray):
        values = values.combine_chunks()
    if values.null_count:
        raise InputError(
            f"column {c.name}: {values.null_count} nulls, which are not allowed; write NaN for an unknown number",
            id="missing-value",
        )
    if c.width == ANY_WIDTH:
        return vectors(c, values)
    if c.width:
        return np.array(to_numpy(values.flatten()), c.dtype).reshape(-1, c.width)
    if c.kind == "U":
        return to_texts(values, f"column {c.name}")
    return np.array(to_numpy(values), dtype=c.dtype)


def vectors(c: Column, values: pa.Array) -> NDArray[np.generic]:
    """(n, K) numbers of a list column with n rows, each of K numbers or empty; NaN in empty rows.

    Args:
        c: declaration of the column.
        values: Arrow list array.

    Raises:
        InputError: lists have different lengths or nulls, or most rows of a large column are empty.
    """
    lengths, numbers = to_numpy(values.value_lengths()).astype(np.int64), values.flatten()
    (length, *others) = np.unique(lengths[lengths > 0]).tolist() or [0]
    if others or numbers.null_count:
        fault = (
            f"lists of {length} and of {others[0]} numbers; all must have one length"
            if others
            else "numbers are missing"
        )
        raise InputError(f"column {c.name}: {fault}", id="damaged-file")
    if len(values) * length > max(MAX_NUMBERS, 2 * len(numbers)):
        raise InputError(
            f"column {c.name}: a list of {length} numbers among {len(values)} rows, most of which have none, but take "
            "as much memory; move rows with lists to their own file",
            id="input-too-large",
        )
    out = np.full((len(values), length), np.nan, dtype=c.dtype)
    out[lengths > 0] = to_numpy(numbers).reshape(-1, max(length, 1))
    return out


def check_schema(path: Path, schema: pa.Schema, table: type[ColumnTable]) -> None:
    """InputError unless a file's schema is that of `table`, in its current or an older version.

    Names and types of columns are compared; optional columns may be missing, and columns of other programs are ignored.
    """
    found = (schema.metadata or {}).get(SCHEMA_KEY.encode(), b"").decode()
    name, _, version = found.partition("/")
    if name != table.NAME:
        raise InputError(
            f"{path}: holds {found or 'no occlog table'}, expected {table.NAME}/{table.VERSION}", id="wrong-content"
        )
    if version not in map(str, range(table.VERSION + 1)):
        raise InputError(
            f"{path}: holds {found}, which is newer than {name}/{table.VERSION}; update occlog", id="version-mismatch"
        )
    known = {c.name for kind in (table, *TABLES.values(), *WIDER) if name == kind.NAME for c in kind.columns()}
    for field in schema:  # of another program's column there is no meaning
        if field.name not in known and {b"unit", b"doc"} & (field.metadata or {}).keys():
            hint = f"did you mean {near[0]!r}? " if (near := nearest(field.name, known)) else ""
            raise InputError(
                f"{path}: damaged: {name} has no column {field.name!r}; {hint}make it again", id="damaged-file"
            )
    for c in table.columns():
        if schema.get_field_index(c.name) < 0:
            if c.name in schema.names:
                raise InputError(f"{path}: column {c.name} is there twice; make it again", id="duplicate-name")
            if c.optional:  # a file of an older version
                continue
            raise InputError(
                f"{path}: column {c.name} of {table.NAME} is missing; the file has {abridged(schema.names)}",
                id="missing-column",
            )
        have, kind = schema.field(c.name).type, _ARROW[c.kind]
        if c.width == ANY_WIDTH:
            if not (pa.types.is_list(have) and have.value_type == kind):
                raise InputError(f"{path}: column {c.name} is {have}, expected lists of {kind}; convert it")
            continue
        kind = pa.list_(kind, c.width) if c.width else kind
        texts = have.value_type if pa.types.is_dictionary(have) else have
        if have != kind and not (c.kind == "U" and (pa.types.is_string(texts) or pa.types.is_large_string(texts))):
            raise InputError(f"{path}: column {c.name} is {have}, expected {kind}; convert it")
