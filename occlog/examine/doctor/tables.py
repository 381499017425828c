"""Checks of tables: occlog Parquet, and external tables.

All invalid rows are reported (the table's own check stops at the first), and duplicate rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
import pyarrow as pa

from occlog.array_types import NS, Ints
from occlog.consistency.frozen import FrozenCameras
from occlog.errors import InputError
from occlog.io.dataset import COLLECTED
from occlog.io.external.cells import TableCells
from occlog.io.external.source import ColumnSource
from occlog.io.external.table import ExternalTable, best_fit
from occlog.io.files.tables.arrow import from_arrow
from occlog.io.files.tables.parquet import arrow_batches, groups_of, read_header
from occlog.io.files.texts.csv_rows import report_bad_lines_to
from occlog.io.files.timing.utc import time_words, utc
from occlog.records.columns import ColumnTable, repeated_rows
from occlog.records.losses import Loss
from occlog.records.tables import TABLES, Bearings, Boxes, Truth, TruthBoxes

from .clock import Restarts, SensorTimes, check_clocks
from .findings import Findings

MAX_CHECKS = 1000
"""Checks of parts of some thousand rows: about 80 bad rows are found by this many."""
COMPLETE = tuple(table.NAME for table in (Bearings, Boxes, TruthBoxes, Truth))
"""Tables with a row for each frame or time step, with or without a detection; other tables omit empty frames."""
M = TypeVar("M")
MAX_HELD = 65_536
"""Rows of one time that are held back for those of the same time in the next part."""


class TableWatch:
    """Checks of a table that need several rows: duplicates, order, and times of each sensor."""

    def __init__(self, table: type[ColumnTable], findings: Findings) -> None:
        """Start without rows; `table`: type of the table, `findings`: to be extended."""
        self.table, self.findings = table, findings
        self._clocks: dict[str, SensorTimes] = {}
        self._frozen = FrozenCameras()
        self._held: ColumnTable | None = None
        self._last: int | None = None

    @property
    def clocks(self) -> list[SensorTimes]:
        """Statistics of the times of each sensor, or of all rows for a table without sensors."""
        return list(self._clocks.values())

    def note_order(self, t_ns: Ints, first: int) -> None:
        """Add a finding if times [ns] of successive rows go back.

        `first`: number of the first of these rows in the file.
        """
        whole = t_ns if self._last is None else np.concatenate([[self._last], t_ns])
        back = np.flatnonzero(whole[1:] < whole[:-1])
        if len(back):
            k = int(back[0])
            row = first + k + 1 - (len(whole) - len(t_ns))
            value = f"{time_words(whole[k + 1])} after {time_words(whole[k])}"
            self.findings.add("order", f"row {row}", value, count=len(back), similar="order")
        self._last = int(whole[-1]) if len(whole) else None

    def take(self, table: ColumnTable) -> None:
        """Add further rows, in the order of time, to the checks."""
        if not len(table):
            return
        whole = table.sorted() if self._held is None else self.table.merge([self._held, table])
        t_ns = _times(whole)
        last = int(np.searchsorted(t_ns, t_ns[-1]))
        self._held = whole.take(slice(last, None)) if len(t_ns) - last <= MAX_HELD else None
        self._settle(whole.take(slice(0, last)) if self._held is not None else whole)

    def finish(self) -> None:
        """Check the rows that are still buffered, and add the findings about clocks and frozen cameras."""
        if self._held is not None:
            self._settle(self._held)
        check_clocks(self.clocks, self.findings)
        note_frozen(self._frozen, self.findings)

    def _settle(self, table: ColumnTable) -> None:
        if not len(table):
            return
        copies, double = repeated_rows(table)
        if isinstance(table, Boxes):  # with numbers that may be those that they got on reading
            copies |= repeated_rows(table, "box")[0]
            if table.NAME == Boxes.NAME:
                self._frozen.add_boxes(table)
        for kind, rows in (
            ("duplicate-row", copies),
            ("two-positions" if table.ONCE else "duplicate-key", double & ~copies),
        ):
            for row in np.flatnonzero(rows)[:1].tolist():
                key = ", ".join(f"{name} {getattr(table, name)[row]}" for name in table.KEY if name != "t_ns")
                location = utc(int(_times(table)[row]))
                self.findings.add(kind, location, key, count=int(rows.sum()), similar=kind)
        t_ns, sensor, frame = _times(table), getattr(table, "sensor", None), getattr(table, "frame", None)
        if sensor is None:
            self._clock("times").add(t_ns)
            return
        for name in np.unique(sensor).tolist():
            own = sensor == name
            self._clock(f"sensor {name}").add(t_ns[own], None if frame is None else frame[own])

    def _clock(self, name: str) -> SensorTimes:
        return self._clocks.setdefault(name, SensorTimes(name, sorted=True, sporadic=self.table.NAME not in COMPLETE))


def note_frozen(cameras: FrozenCameras, findings: Findings) -> None:
    """Add a finding for each camera that repeats one frame while others continue."""
    for run in cameras.found():
        value = f"{run.frames} identical frames, {(run.last_ns - run.first_ns) / NS:.3g} s"
        findings.add("frozen-camera", f"sensor {run.camera}, from {utc(run.first_ns)}", value)


def bisect_bad_rows(
    rows: int, make: Callable[[int, int], M], good: list[M], checks: int = MAX_CHECKS
) -> Iterator[tuple[int, InputError]]:
    """Generate the number of each invalid row with its error; rows are found by bisection.

    Args:
        rows: number of rows.
        make: makes the rows start <= row < stop; InputError if one of them is invalid.
        good: its results for parts without invalid rows are appended to this list.
        checks: largest number of calls of `make`; a part that is not resolved by then counts as one invalid row, its
            first.
    """
    if rows:
        yield from _bad(0, rows, make, good, [checks])


def _bad(
    start: int, stop: int, make: Callable[[int, int], M], good: list[M], left: list[int]
) -> Iterator[tuple[int, InputError]]:
    """Generate the invalid rows from `start` up to `stop` with their errors, by bisection.

    Args:
        start: first row.
        stop: row after the last.
        make: makes rows from start to stop; InputError if one is invalid.
        good: its results for parts without invalid rows are appended.
        left: number of calls left, as a list of one, counted down in place.
    """
    left[0] -= 1
    try:
        good.append(make(start, stop))
        return
    except InputError as error:
        # Without the frames of the stack, which would hold the rows in memory
        fault = InputError(str(error))
    found = False
    if stop - start > 1 and left[0] > 0:
        middle = (start + stop) // 2
        for part in ((start, middle), (middle, stop)):
            for one in _bad(*part, make, good, left):
                found = True
                yield one
    if not found:  # one row, or some that are good alone, and not together
        yield start, fault


def drop_bad_rows(
    rows: int, make: Callable[[int, int], ColumnTable], watch: TableWatch, location: Callable[[int], str] = lambda _: ""
) -> None:
    """Convert rows to a table; add a finding for each invalid one, and pass the others to further checks.

    Args:
        rows: number of rows.
        make: returns the table of the rows start <= row < stop; InputError if one is invalid.
        watch: receives the table of the valid rows.
        location: returns the location of a row, for errors that do not state one.
    """
    good: list[ColumnTable] = []
    for row, error in bisect_bad_rows(rows, make, good):
        # What a table states about its only row, which it calls row 0
        watch.findings.refused("row", InputError(str(error).replace(": row 0: ", ": ", 1)), location=location(row))
    try:
        watch.take(watch.table.merge(good))
    except InputError as error:
        watch.findings.refused("row", error)


def _times(table: ColumnTable) -> Ints:
    times: Ints = table.t_ns  # type: ignore[attr-defined]
    return times


def check_table(path: Path, findings: Findings) -> None:
    """Add findings about an occlog Parquet table: header, row groups, rows, and times of its sensors."""
    try:
        header = read_header(path)
        note_losses(header.provenance.losses, findings)
        if header.table.startswith(COLLECTED):
            # Rows of several recordings, which are in no order
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
                findings.refused("damaged-table", what, location=f"rows {first} to {group.first + group.rows - 1}")
    except InputError as error:
        if not findings.has("unreadable"):
            findings.refused("unreadable", error)
    if watch is not None:
        watch.finish()


def _look_at_batch(batch: pa.RecordBatch, first: int, watch: TableWatch) -> None:
    times = np.asarray(batch.column("t_ns"))
    watch.note_order(times, first)
    # Rows in a wrong order are stated once; here each is checked for itself
    order = np.argsort(times, kind="stable")
    ordered = batch if (np.diff(order) == 1).all() else batch.take(pa.array(order))
    drop_bad_rows(
        len(times),
        lambda start, stop: from_arrow(ordered.slice(start, stop - start), watch.table),
        watch,
        lambda row: f"row {first + int(order[row])}",
    )


def check_others(source: ColumnSource, findings: Findings) -> bool:
    """Add findings about an external table; return whether its kind is known."""
    try:
        external_table = ExternalTable(source, best_fit(source))
    except InputError as error:
        findings.refused("no-table", error)
        return False
    check_external(external_table, findings)
    return True


def check_external(external_table: ExternalTable, findings: Findings) -> None:
    """Add findings about an external table, row by row, in any order."""
    watch = TableWatch(external_table.layout.table, findings)
    restarts = Restarts(external_table)
    with report_bad_lines_to(partial(findings.refused, "row")):
        try:
            for cells in external_table.cells():
                drop_bad_rows(len(cells), _maker(external_table, cells), watch)
                with suppress(InputError):  # of a time that cannot be, and was reported
                    restarts.add(cells)
        except InputError as error:
            findings.refused("unreadable", error)
    watch.finish()
    restarts.judge(findings)


def _maker(external_table: ExternalTable, cells: TableCells) -> Callable[[int, int], ColumnTable]:
    return lambda start, stop: external_table.table_of(cells.part(start, stop))


def note_losses(losses: Iterable[Loss], findings: Findings) -> None:
    """Add a finding for each loss recorded when the file was made."""
    for loss in losses:
        lost = f" ({loss.count} lost)" if loss.count else ""
        findings.add("losses", f"{loss.source}, {loss.place}", loss.what + lost)
