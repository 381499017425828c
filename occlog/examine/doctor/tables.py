"""Tables: Parquet of occlog, and tables of other programs that fit one of ours."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa

from occlog.errors import InputError
from occlog.io.files.tables.arrow_columns import from_arrow
from occlog.io.files.tables.header import read_header
from occlog.io.files.tables.parquet import arrow_batches, groups_of
from occlog.io.files.texts.csv_rows import bad_lines_told_to
from occlog.io.foreign.cells import Cells
from occlog.io.foreign.source import Source
from occlog.io.foreign.table import ForeignTable, best_fit
from occlog.io.gathered.schema import GATHERED
from occlog.records.columns import Table
from occlog.records.losses import Loss
from occlog.records.tables import TABLES

from .findings import Findings
from .restarts import Restarts
from .rows import TableWatch, sift


def look_at_table(path: Path, findings: Findings) -> None:
    """Look at a Parquet table of occlog: its header, each group of rows, each row, and the times of its sensors."""
    try:
        header = read_header(path)
        note_losses(header.provenance.losses, findings)
        if header.table.startswith(GATHERED):
            # Rows of several recordings, which follow no order
            for _ in arrow_batches(path):
                pass
            return
    except InputError as error:
        findings.refused("unreadable", error)
    watch: TableWatch | None = None
    try:
        for group in groups_of(path, TABLES):
            watch = watch or TableWatch(group.table, findings)
            first = group.first
            try:
                for batch in group.batches():
                    _look_at_batch(batch, first, watch)
                    first += batch.num_rows
            except InputError as error:
                what = InputError(str(error).replace(": damaged: ", ": ", 1))
                findings.refused("damaged-table", what, place=f"rows {first} to {group.first + group.rows - 1}")
    except InputError as error:
        if not findings.has("unreadable"):
            findings.refused("unreadable", error)
    if watch is not None:
        watch.finish()


def _look_at_batch(batch: pa.RecordBatch, first: int, watch: TableWatch) -> None:
    times = np.asarray(batch.column("t_ns"))
    watch.note_order(times, first)
    # Rows in a wrong order are said once; here each is looked at for itself
    order = np.argsort(times, kind="stable")
    ordered = batch if (np.diff(order) == 1).all() else batch.take(pa.array(order))
    sift(
        len(times),
        lambda start, stop: from_arrow(ordered.slice(start, stop - start), watch.table),
        watch,
        lambda row: f"row {first + int(order[row])}",
    )


def look_at_others(source: Source, findings: Findings) -> bool:
    """Look at a table of another program; whether it is one that occlog knows."""
    try:
        foreign = ForeignTable(source, best_fit(source))
    except InputError as error:
        findings.refused("no-table", error)
        return False
    look_at_foreign(foreign, findings)
    return True


def look_at_foreign(foreign: ForeignTable, findings: Findings) -> None:
    """Look at a table of another program, row by row, which may be in any order."""
    watch = TableWatch(foreign.layout.table, findings)
    restarts = Restarts(foreign)
    with bad_lines_told_to(partial(findings.refused, "row")):
        try:
            for cells in foreign.cells():
                sift(len(cells), _maker(foreign, cells), watch)
                with suppress(InputError):  # of a time that cannot be, and was told
                    restarts.add(cells)
        except InputError as error:
            findings.refused("unreadable", error)
    watch.finish()
    restarts.judge(findings)


def _maker(foreign: ForeignTable, cells: Cells) -> Callable[[int, int], Table]:
    return lambda start, stop: foreign.table_of(cells.part(start, stop))


def note_losses(losses: Iterable[Loss], findings: Findings) -> None:
    """Note what had been lost when the file was made."""
    for loss in losses:
        lost = f" ({loss.count} lost)" if loss.count else ""
        findings.add("losses", f"{loss.source}, {loss.place}", loss.what + lost)
