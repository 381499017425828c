"""Export of trajectories: MOTChallenge in space, TUM, GeoJSON, TRC.

Also whole tables as CSV, and as Parquet with plain columns. Column names end in the unit: `bearing_rad`, `x_m`,
`cov_xx_m2` (those of times and pixels already do). Reading them back (`occlog.io.external`) gives the same table.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import IO, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.core.metrics.errors import quantiles
from occlog.errors import InputError, UsageError, abridged, option
from occlog.io.external.names import POWERS, ending
from occlog.io.files.geodetic import Origin, degrees_of
from occlog.io.files.spill import Spool
from occlog.io.files.texts.csv_rows import no_formula
from occlog.io.formats.trajectories import COLLECTION, KEYS, ORIGIN
from occlog.records.columns import Column, ColumnTable, rows_by_label
from occlog.records.declared.people import PeopleTracks
from occlog.records.tables import Tracks, Truth
from occlog.settings import METRES

MAX_ROWS = 500_000
"""Rows of targets that are put together at once where a format has one target after another."""
MAX_CELLS = 50_000_000
"""Cells of a table that has columns for each target and a row for each time."""


class ExportedPositions(NamedTuple):
    """N positions of targets, sorted by time, then by identity.

    `t_ns`: (N,) times [ns]; `identity`: (N,); `xyz`: (N, 3), z is 0 if unknown; `velocity`: (N, 2), NaN: unknown;
    `confidence`: (N,) existence probability, NaN: unknown.
    """

    t_ns: Ints
    identity: Ints
    xyz: Floats  # (N, 3) z 0 where it is not known
    velocity: Floats  # (N, 2) NaN: not known
    confidence: Floats  # (N,) NaN: not known


def check_targets(chunks: Iterable[Tracks | Truth], targets: tuple[int, ...]) -> list[int]:
    """Return the sorted identities that are exported, after a pass over the rows.

    Args:
        chunks: chunks of the table.
        targets: identities to export; empty: all.

    Raises:
        InputError: there are none, or one of `targets` is missing.
    """
    known = sorted({identity for part in chunks for identity in np.unique(part.target_id[_used(part)]).tolist()})
    for target in targets:
        if target not in known:
            raise InputError(f"no target {target}; there are: {abridged(known)}", id="unknown-name")
    if not known:
        raise InputError("there are no rows to write", id="empty-input")
    return sorted(set(targets)) or known


def _used(table: Tracks | Truth) -> Bools:
    """Return the mask (N,) of the rows of targets: in a truth, rows with that role; in tracks, all."""
    return table.role == "target" if isinstance(table, Truth) else np.ones(len(table), dtype=np.bool_)


def places_of(table: Tracks | Truth, targets: tuple[int, ...]) -> ExportedPositions:
    """Return the positions of targets in a table, sorted; of a truth only rows with the role `target`.

    Args:
        table: rows in any order.
        targets: identities to export; empty: all.
    """
    used = _used(table)
    used = used & np.isin(table.target_id, targets) if targets else used
    rows = table.take(used).sorted()
    nothing = np.full(len(rows), np.nan)
    velocity = np.column_stack([nothing, nothing] if isinstance(rows, Truth) else [rows.vx, rows.vy])
    z = np.where(np.isnan(rows.z), 0.0, rows.z)
    sure = rows.existence_probability if isinstance(rows, PeopleTracks) else nothing
    return ExportedPositions(
        rows.t_ns, rows.target_id.astype(np.int64), np.column_stack([rows.x, rows.y, z]), velocity, sure
    )


def mot3d_text(pieces: Iterable[ExportedPositions]) -> Iterator[str]:
    """Generate a text of lines `frame,id,-1,-1,-1,-1,confidence,x,y,z` for each part.

    Frames are the distinct times, from 1; a time is in one part only.
    """
    first = 1
    for positions in pieces:
        times, frame = np.unique(positions.t_ns, return_inverse=True)
        numbers = (first + frame).tolist()
        rows = zip(
            numbers, positions.identity.tolist(), positions.confidence.tolist(), positions.xyz.tolist(), strict=True
        )
        yield "".join(
            f"{f},{identity},-1,-1,-1,-1,{-1 if p != p else repr(p)},{x!r},{y!r},{z!r}\n"
            for f, identity, p, (x, y, z) in rows
        )
        first += len(times)


def check_one_target(names: list[int]) -> None:
    """Raise UsageError if there are several target identities in `names`, since TUM text holds one."""
    if len(names) > 1:
        few = ", ".join(map(str, names[:10])) + (f" and {len(names) - 10} more" if len(names) > 10 else "")
        raise UsageError(
            f"TUM text holds one target, and there are {few}; choose one ({option('target')})", id="ambiguous-input"
        )


def tum_text(positions: ExportedPositions) -> str:
    """Return lines `t x y z qx qy qz qw` (TUM) of one target, with t in seconds.

    The orientation is the direction of motion, +x if unknown.
    """
    heading = np.arctan2(positions.velocity[:, 1], positions.velocity[:, 0])
    half = np.where(np.isnan(heading), 0.0, 0.5 * heading)
    rows = zip(
        positions.t_ns.tolist(), positions.xyz.tolist(), np.sin(half).tolist(), np.cos(half).tolist(), strict=True
    )
    return "".join(f"{_seconds(t_ns)} {x!r} {y!r} {z!r} 0 0 {qz!r} {qw!r}\n" for t_ns, (x, y, z), qz, qw in rows)


def _seconds(t_ns: int) -> str:
    """Return a time [ns] as text in seconds, with all nine decimals."""
    whole, rest = divmod(abs(t_ns), NS)
    return f"{'-' if t_ns < 0 else ''}{whole}.{rest:09d}"


def geojson_texts(
    pieces: Callable[[], Iterable[ExportedPositions]], origin: Origin, length_unit: str, most: int = MAX_ROWS
) -> Iterator[str]:
    """Generate GeoJSON text, part by part: a WGS 84 line for each target (a point for a single row), with times.

    Args:
        pieces: returns an iterator over the positions in the order of time, at each call.
        origin: position of the scene's origin on earth.
        length_unit: unit of the positions.
        most: rows of targets that are in memory in one pass; of a target with more there are two passes.

    Raises:
        InputError: the length unit is not known in metres.
    """
    if length_unit not in METRES:
        raise InputError(
            f"lengths are in {length_unit}, of which the length in metres is not known; export CSV", id="missing-unit"
        )
    counts: Counter[int] = Counter()
    for positions in pieces():
        names, rows = np.unique(positions.identity, return_counts=True)
        counts.update(dict(zip(names.tolist(), rows.tolist(), strict=True)))
    where = {
        ORIGIN: dict(zip(KEYS, origin[: len(KEYS)], strict=True))
    }  # so that positions in the scene can be read again
    yield json.dumps({"type": COLLECTION, **where, "features": []})[:-2]
    mark = ""
    for group in _groups(counts, most):
        if counts[group[0]] > most:
            yield mark
            yield from _long_feature(pieces, group[0], origin, length_unit)
        else:
            together = _of_targets(pieces, group)
            for name, rows in rows_by_label(together.identity):
                yield mark + _feature(name, together, rows, origin, length_unit)
                mark = ", "
        mark = ", "
    yield "]}\n"


def _groups(counts: Mapping[int, int], most: int) -> Iterator[list[int]]:
    """Generate the sorted identities in groups of at most `most` rows, or of one identity with more.

    `counts`: number of rows of each identity.
    """
    group: list[int] = []
    rows = 0
    for name in sorted(counts):
        if group and rows + counts[name] > most:
            yield group
            group, rows = [], 0
        group.append(name)
        rows += counts[name]
    if group:
        yield group


def _of_targets(pieces: Callable[[], Iterable[ExportedPositions]], names: Sequence[int]) -> ExportedPositions:
    """Return the positions of the targets `names`, concatenated over all parts.

    `pieces`: returns an iterator over these.
    """
    found = [
        ExportedPositions._make(column[np.isin(positions.identity, names)] for column in positions)
        for positions in pieces()
    ]
    return ExportedPositions._make(np.concatenate(columns) for columns in zip(*found, strict=True))


def _corners(positions: ExportedPositions, rows: Ints, origin: Origin, length_unit: str) -> list[list[float]]:
    degrees = degrees_of(positions.xyz[rows, :2] * METRES[length_unit], origin)
    return [[round(lon, 9), round(lat, 9)] for lon, lat in degrees.tolist()]


def _feature(name: int, positions: ExportedPositions, rows: Ints, origin: Origin, length_unit: str) -> str:
    corners = _corners(positions, rows, origin, length_unit)
    shape = (
        {"type": "LineString", "coordinates": corners}
        if len(corners) > 1
        else {"type": "Point", "coordinates": corners[0]}
    )
    properties = {"target_id": name, "t_ns": positions.t_ns[rows].tolist()}
    return json.dumps({"type": "Feature", "geometry": shape, "properties": properties})


def _long_feature(
    pieces: Callable[[], Iterable[ExportedPositions]], name: int, origin: Origin, length_unit: str
) -> Iterator[str]:
    """Generate the GeoJSON text of a line with more vertices than fit in memory: vertices, then their times.

    Args:
        pieces: returns an iterator over the positions of all targets; called twice.
        name: identity of the target.
        origin: position of the scene's origin on earth.
        length_unit: unit of the positions.
    """
    head = {"type": "Feature", "geometry": {"type": "LineString", "coordinates": []}}
    yield json.dumps(head)[:-3]
    for part in (0, 1):
        mark = ""
        for positions in pieces():
            rows = np.flatnonzero(positions.identity == name)
            if len(rows):
                values = positions.t_ns[rows].tolist() if part else _corners(positions, rows, origin, length_unit)
                yield mark + json.dumps(values)[1:-1]
                mark = ", "
        yield "]}}" if part else ']}, "properties": ' + json.dumps({"target_id": name, "t_ns": []})[:-2]


def trc_texts(pieces: Callable[[], Iterable[ExportedPositions]], length_unit: str, name: str) -> Iterator[str]:
    """Generate TRC text (OpenSim), part by part: a marker for each target, a line for each time.

    Cells of absent targets are empty. The unit is mm, or m for lengths in m. The head comes after a first pass, lines
    in a second one.

    Args:
        pieces: returns an iterator over the positions in the order of time, at each call; a time is in one part only.
        length_unit: unit of the positions.
        name: name of the file.

    Raises:
        InputError: the length unit is not known in metres, or there are more than `MAX_CELLS` cells.
    """
    if length_unit not in METRES:
        raise InputError(
            f"lengths are in {length_unit}, of which the length in metres is not known; export CSV", id="missing-unit"
        )
    unit = length_unit if length_unit in ("m", "mm") else "mm"
    known: set[int] = set()
    steps, last, start, n_steps = Spool(), None, 0, 0
    for positions in pieces():
        times = np.unique(positions.t_ns)
        if not len(times):
            continue
        known.update(np.unique(positions.identity).tolist())
        steps.add(np.diff(times if last is None else np.insert(times, 0, last)).astype(np.float64))
        start, last, n_steps = int(times[0]) if last is None else start, int(times[-1]), n_steps + len(times)
    names = np.array(sorted(known), dtype=np.int64)
    if (cells := 3 * len(names) * n_steps) > MAX_CELLS:
        raise InputError(
            f"{len(names)} targets at {n_steps} times are {cells} cells in TRC, at most {MAX_CELLS}; export fewer with "
            f"{option('target')}, or CSV",
            id="problem-too-large",
        )
    rate = NS / quantiles(steps.blocks, steps.count, [0.5])[0] if steps.count else 1.0
    yield "\n".join([
        f"PathFileType\t4\t(X/Y/Z)\t{name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate:g}\t{rate:g}\t{n_steps}\t{len(names)}\t{unit}\t{rate:g}\t1\t{n_steps}",
        "Frame#\tTime\t" + "\t\t\t".join(f"target_{n}" for n in names.tolist()) + "\t\t",
        "\t\t" + "\t".join(f"{axis}{n + 1}" for n in range(len(names)) for axis in "XYZ"),
        "\n",
    ])  # fmt: skip
    first = 1
    for positions in pieces():
        xyz = positions.xyz * (METRES[length_unit] / METRES[unit])
        times, frame = np.unique(positions.t_ns, return_inverse=True)
        marker = np.searchsorted(names, positions.identity)
        order = np.argsort(frame, kind="stable")
        ends = np.searchsorted(frame[order], np.arange(len(times) + 1))
        for n, t in enumerate(times.tolist()):
            line = [""] * (3 * len(names))
            for row in order[ends[n] : ends[n + 1]].tolist():
                line[3 * marker[row] : 3 * marker[row] + 3] = [repr(value) for value in xyz[row].tolist()]
            yield f"{first + n}\t{(t - start) / NS!r}\t" + "\t".join(line) + "\n"
        first += len(times)


CELL = '"'


def shown_name(column: Column, length_unit: str) -> str:
    """Return the name of a column with its unit, as in the header of an exported file: `bearing_rad`, `x_m`."""
    if column.unit == "rad":
        return f"{column.name}_rad"
    return column.name + ending(column, length_unit) if column.unit in POWERS else column.name


def write_csv(
    rows: Iterable[ColumnTable], table: type[ColumnTable], file: IO[bytes], length_unit: str
) -> tuple[int, tuple[str, ...]]:
    """Write rows as CSV; return their number, and the names of the list columns, which are omitted.

    Args:
        rows: chunks of the table.
        table: its type.
        file: open binary file.
        length_unit: unit of lengths, part of the names of columns.
    """
    kept = [c for c in table.columns() if not c.width]
    file.write((",".join(shown_name(c, length_unit) for c in kept) + "\n").encode())
    count = 0
    for part in rows:
        cells = [_cells(part, c) for c in kept]
        file.write("".join(",".join(line) + "\n" for line in zip(*cells, strict=True)).encode())
        count += len(part)
    return count, tuple(c.name for c in table.columns() if c.width)


def _cells(part: ColumnTable, column: Column) -> Sequence[str]:
    """Return the values of a column as texts for CSV; NaN becomes an empty text."""
    values = getattr(part, column.name)
    if column.kind == "U":
        return [_quoted(no_formula(text)) for text in values.tolist()]
    if column.kind == "?":
        return ["true" if value else "false" for value in values.tolist()]
    if values.dtype.kind == "f":
        return ["" if value != value else repr(value) for value in values.tolist()]
    return [str(value) for value in values.tolist()]


def _quoted(text: str) -> str:
    if not any(mark in text for mark in ',"\n\r'):
        return text
    return CELL + text.replace(CELL, CELL + CELL) + CELL


def write_parquet(rows: Iterable[ColumnTable], table: type[ColumnTable], file: IO[bytes], length_unit: str) -> int:
    """Write Parquet without occlog's metadata, with null for NaN; return the number of rows.

    Args:
        rows: chunks of the table.
        table: its type.
        file: open binary file.
        length_unit: unit of lengths, part of the names of columns.
    """
    schema = pa.schema([pa.field(shown_name(c, length_unit), _kind(c)) for c in table.columns()])
    count = 0
    with pq.ParquetWriter(file, schema, compression="zstd") as writer:
        for part in rows:
            arrays = [_array(part, c) for c in table.columns()]
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema))
            count += len(part)
    return count


def _kind(column: Column) -> pa.DataType:
    kinds = {"i8": pa.int64(), "i4": pa.int32(), "f8": pa.float64(), "f4": pa.float32(), "?": pa.bool_()}
    kind = kinds.get(column.kind, pa.string())
    return pa.list_(kind) if column.width else kind


def _array(part: ColumnTable, column: Column) -> pa.Array:
    values = getattr(part, column.name)
    if column.width:
        flat = pa.array(np.ascontiguousarray(values).reshape(-1), from_pandas=True)
        starts = pa.array(np.arange(len(part) + 1, dtype=np.int32) * values.shape[1])
        return pa.ListArray.from_arrays(starts, flat)
    if column.kind == "U":
        return pa.array(values.tolist(), pa.string())
    return pa.array(values, _kind(column), from_pandas=values.dtype.kind == "f")
