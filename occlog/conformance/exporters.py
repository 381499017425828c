"""The kit of exporters: each check tries one promise with small tables, and states in a sentence how it is broken."""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import Any

import numpy as np

from occlog.examine.export.run import Sink
from occlog.plugins.interface import ExportContext
from occlog.records.columns import ColumnTable
from occlog.records.tables import TABLES

from .faults import FIRST, BrokenError, Check, called, defaults, manners, named
from .samples import SAMPLES, SCENE, in_unit, moved, with_gaps, with_names

GROWTH_BYTES = 2_000
"""Memory that a writing may leave behind."""


def taken(of: Any) -> Iterator[ColumnTable]:
    """Generate a sample table of each kind that the exporter class `of` can write.

    Kinds without a sample are omitted.
    """
    yield from (SAMPLES[name]() for name in of.tables if name in SAMPLES)


def write(of: Any, rows: ColumnTable, what: str, *, unit: str = "m", own: Any = None) -> bytes:
    """Run an exporter of class `of` on a table, and return the bytes that it writes.

    Args:
        of: class of the plug-in.
        rows: table to export.
        what: words for the call in messages.
        unit: unit of the lengths of the table.
        own: exporter to continue with; None: a new one.

    Raises:
        BrokenError: the exporter raises, or closes the file.
    """
    file = io.BytesIO()
    with called(what):
        (of(defaults(of, unit)) if own is None else own).write(rows, ExportContext(unit, SCENE), Sink(file))
    if file.closed:
        raise BrokenError(f"the exporter closes the file ({what}); leave this to occlog, which opened it")
    return file.getvalue()


def use(of: Any) -> list[bytes]:
    """Return the bytes that new exporters of class `of` write for each sample table of a kind they can write."""
    return [write(of, rows, f"writing {rows.NAME}") for rows in taken(of)]


def check_tables(of: Any) -> None:
    """Check that an exporter declares tables of occlog only, at least one of which the kit has a sample of."""
    if not isinstance(of.tables, tuple) or not of.tables:
        raise BrokenError("the exporter's tables must be a tuple of names, as ('tracks',)")
    for name in of.tables:
        if name not in TABLES:
            raise BrokenError(f"the exporter's tables: {name!r} is unknown; expected {', '.join(TABLES)}")
    if not any(name in SAMPLES for name in of.tables):
        raise BrokenError(
            f"the exporter cannot be tried: it takes {', '.join(of.tables)}, and there are samples of "
            f"{', '.join(SAMPLES)} alone"
        )


def check_writes(of: Any) -> None:
    """Check that an exporter writes some output for each sample table."""
    for rows in taken(of):
        if not write(of, rows, f"writing {rows.NAME}"):
            raise BrokenError(f"the exporter writes nothing of {len(rows)} rows of {rows.NAME}; write every row")


def check_rows(of: Any) -> None:
    """Check that the output depends on the first and on the last row."""
    for rows in taken(of):
        whole = write(of, rows, f"writing {rows.NAME}")
        for name, row in (("first", 0), ("last", -1)):
            if write(of, moved(rows, row), f"writing {rows.NAME}") == whole:
                raise BrokenError(
                    f"the exporter leaves out the {name} row of table {rows.NAME}: its output stays the same if values "
                    "of that row change; write every row"
                )


def check_inputs(of: Any) -> None:
    """Check that an exporter leaves the rows of each sample table unchanged."""
    for rows in taken(of):
        before = {c.name: getattr(rows, c.name).tobytes() for c in rows.columns()}
        write(of, rows, f"writing {rows.NAME}")
        changed = [name for name, data in before.items() if getattr(rows, name).tobytes() != data]
        if changed:
            raise BrokenError(f"the exporter's write changes {changed[0]} of the rows that it is given; copy it")


def check_empty(of: Any) -> None:
    """Check that a table without rows can be written."""
    for rows in taken(of):
        write(of, type(rows).empty(), f"writing {rows.NAME} without rows")


def check_one_row(of: Any) -> None:
    """Check that a table of one row can be written."""
    for rows in taken(of):
        write(of, rows.take(slice(0, 1)), f"writing one row of {rows.NAME}")


def check_absent_values(of: Any) -> None:
    """Check that tables can be written with NaN in all columns that may be NaN."""
    for rows in taken(of):
        write(of, with_gaps(rows), f"writing {rows.NAME} with NaN wherever it may be")


def check_names(of: Any) -> None:
    """Check that an exporter accepts names of sensors with blanks, marks and any letters."""
    for rows in taken(of):
        if hasattr(rows, "sensor"):
            write(of, with_names(rows, 'Tür 2, "süd"; ☂'), f"writing {rows.NAME} of a sensor with marks in its name")


def check_old_times(of: Any) -> None:
    """Check that tables with times before 1970 (negative) can be written."""
    for rows in taken(of):
        early = rows.with_columns(t_ns=rows.t_ns - int(rows.t_ns[0]) - 10**9)  # type: ignore[attr-defined]
        write(of, early, f"writing {rows.NAME} with times before 1970")


def check_exact_times(of: Any) -> None:
    """Check that the output differs if all times are 1 ms later."""
    for rows in taken(of):
        later = rows.with_columns(t_ns=rows.t_ns + np.int64(10**6))  # type: ignore[attr-defined]
        if write(of, later, f"writing {rows.NAME}") == write(of, rows, f"writing {rows.NAME}"):
            raise BrokenError(
                f"the exporter writes the same file for {rows.NAME} with times 1 ms later; write milliseconds"
            )


def check_unit(of: Any) -> None:
    """Check that tables with lengths in centimetres and in a scene-specific unit can be written."""
    for rows in taken(of):
        for unit, factor in (("cm", 100.0), ("cell", 1.0)):
            write(of, in_unit(rows, factor), f"writing {rows.NAME} in {unit}", unit=unit)


def check_reuse(of: Any) -> None:
    """Check that one exporter writes the same table twice with equal output."""
    own = of(defaults(of))
    for rows in taken(of):
        first = write(of, rows, "writing", own=own)
        if write(of, rows, "writing again", own=own) != first:
            raise BrokenError(
                "the exporter writes the same rows differently the second time; keep nothing of the first file"
            )


CHECKS: dict[str, Check] = {
    **FIRST,
    **named(globals()),
    **manners(use, "write", growth_bytes=GROWTH_BYTES),
}
"""Every check by its name."""
