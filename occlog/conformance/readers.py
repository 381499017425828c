"""The kit of readers: each check tries one promise with a sample file, and states in a sentence how it is broken."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from occlog.errors import InputError
from occlog.io.external.source import ColumnSource
from occlog.io.external.table import ExternalTable, best_fit
from occlog.io.files.texts.by_reader import as_text, fault_of
from occlog.io.files.texts.csv_rows import first_line
from occlog.plugins.interface import Columns
from occlog.records.tables import TABLES

from .faults import FIRST, BrokenError, Check, called, defaults, manners, named, refuse

REFUSALS = (ValueError, OSError)
"""Exceptions that a reader may raise for a damaged file."""
GROWTH_BYTES = 2_000
"""Memory that a reading may leave behind."""
SHARES, LAST = (0.9, 0.5, 0.1), range(1, 9)
"""Truncations of the sample: shares that are left, and bytes that are missing."""


def checks_with(sample: Path) -> dict[str, Check]:
    """Return the checks of reader classes by name, with `sample`, a file that the readers can read."""
    checks = ReaderChecks(sample)
    own = {name: getattr(checks, name) for name in vars(ReaderChecks)}
    return {**FIRST, **named(own), **manners(checks.text, "read", growth_bytes=GROWTH_BYTES)}


@dataclass(frozen=True)
class ReaderChecks:
    """Checks of a reader class with one sample file of its format; each raises BrokenError where the reader fails."""

    sample: Path

    def read(self, of: Any, path: Path | None = None) -> Columns:
        """Return the columns that reader class `of` reads from `path` (default: the sample).

        BrokenError if it raises, or returns no valid columns.
        """
        with called("read"):
            found = of(defaults(of)).read(path or self.sample)
        refuse(fault_of(found))
        return found  # type: ignore[no-any-return]

    def text(self, of: Any, path: Path | None = None) -> str:
        """Return the columns of `read` as CSV text."""
        return as_text({name: np.asarray(values) for name, values in self.read(of, path).items()})

    def check_endings(self, of: Any) -> None:
        """Check that file endings begin with a point and are in lower case, and that the sample has one of them."""
        endings = of.endings
        if not isinstance(endings, tuple) or not endings:
            raise BrokenError("the reader's endings must be a tuple of texts, as ('.xyz',)")
        for ending in endings:
            if not isinstance(ending, str) or not ending.startswith(".") or ending != ending.lower():
                raise BrokenError(f"the reader's ending {ending!r} must begin with a point, in lower case")
        if not self.sample.name.lower().endswith(endings):
            raise BrokenError(
                f"the name of the sample, {self.sample.name}, has none of the reader's endings: {', '.join(endings)}"
            )

    def check_table(self, of: Any) -> None:
        """Check that the table which the reader names is one of occlog's (`TABLES`)."""
        if of.table not in TABLES:
            raise BrokenError(f"the reader's table is {of.table!r}; expected one of {', '.join(TABLES)}")

    def check_columns(self, of: Any) -> None:
        """Check that the sample file gives columns of valid names and equal lengths, with at least one row."""
        if not len(next(iter(self.read(of).values()))):  # type: ignore[arg-type]
            raise BrokenError("the reader's read returns no rows of the sample; give a sample that has some (--sample)")

    @contextmanager
    def laid_out(self, of: Any) -> Iterator[ExternalTable]:
        """Context manager that gives the columns read from the sample as an external table of the stated kind.

        Raises:
            BrokenError: the columns or rows do not fit that table.
        """
        found = self.text(of)
        with TemporaryDirectory() as other:
            path = Path(other) / "as_read.csv"
            path.write_text(found, encoding="utf-8")
            try:
                source = ColumnSource(path, "CSV", tuple(first_line(path, "columns")))
                yield ExternalTable(source, best_fit(source, [TABLES[of.table]]))
            except InputError as error:
                reason = str(error).replace(f"{path}: ", "")
                raise BrokenError(
                    f"the reader's read returns columns or rows that do not fit table {of.table}: {reason}"
                ) from error

    def check_fits(self, of: Any) -> None:
        """Check that the columns read from the sample fit the table that the reader states, row by row."""
        if of.table in TABLES:
            with self.laid_out(of) as table:
                list(table.rows(TABLES[of.table]))

    def check_used(self, of: Any) -> None:
        """Check that every column which the reader returns belongs to the table that it states."""
        if of.table in TABLES:
            with self.laid_out(of) as table:
                used = {spelled.name for spelled in table.layout.columns}
                left = [name for name in table.source.names if name not in used]
            if left:
                raise BrokenError(
                    f"the reader's read returns a column {left[0]!r}, which table {of.table} lacks; leave it out, "
                    "or give it the table's name for it"
                )

    def check_place(self, of: Any) -> None:
        """Check that what is read does not depend on the name and folder of the file."""
        with TemporaryDirectory() as other:
            path = Path(other) / f"ein Ort, naïve'{self.sample.suffix}"
            shutil.copy(self.sample, path)
            if self.text(of, path) != self.text(of):
                raise BrokenError("the reader's rows depend on the file's name or folder; use the content alone")

    def check_unchanged(self, of: Any) -> None:
        """Check that `read` leaves the file unchanged, and creates no other file next to it."""
        with TemporaryDirectory() as other:
            path = Path(other) / self.sample.name
            shutil.copy(self.sample, path)
            before = path.read_bytes()
            self.read(of, path)
            if path.read_bytes() != before or len(list(Path(other).iterdir())) != 1:
                raise BrokenError("the reader's read changes the file, or writes another next to it; only read")

    def check_closed(self, of: Any) -> None:
        """Check that `read` leaves no file open (on systems with /proc)."""
        opened = Path("/proc/self/fd")
        if not opened.is_dir():
            return
        kept = of(defaults(of))
        before = len(list(opened.iterdir()))
        with called("read"):
            kept.read(self.sample)
        if len(list(opened.iterdir())) > before:
            raise BrokenError("the reader's read leaves a file open; open it in a with statement")

    def check_reuse(self, of: Any) -> None:
        """Check that one reader object reads the sample file twice with equal results."""
        own = of(defaults(of))
        with called("read"):
            first, second = own.read(self.sample), own.read(self.sample)
        if fault_of(first) is None and fault_of(second) is None:
            both = [as_text({n: np.asarray(v) for n, v in found.items()}) for found in (first, second)]
            if both[0] != both[1]:
                raise BrokenError("the reader's read returns other rows the second time; keep nothing of the first")

    def damaged(self, of: Any, what: str, data: bytes, *, refused: bool = False) -> None:
        """Check that a file with the content `data`, described by `what`, is refused by an error of one line.

        Unless `refused` is True, it may also be read to valid columns. BrokenError otherwise.
        """
        with TemporaryDirectory() as other:
            path = Path(other) / self.sample.name
            path.write_bytes(data)
            try:
                with called(f"{what}: read", *REFUSALS):
                    found = of(defaults(of)).read(path)
            except REFUSALS as error:
                if not str(error).strip() or "\n" in str(error).strip():
                    raise BrokenError(
                        f"{what}: the reader's {type(error).__name__} needs a message of one line that states the fault"
                    ) from error
                return
        if refused:
            raise BrokenError(f"the reader's read accepts {what} as if nothing were wrong; raise a ValueError")
        refuse(fault_of(found), what)

    def check_absent(self, of: Any) -> None:
        """Check that `read` raises OSError for a missing file."""
        with TemporaryDirectory() as other:
            try:
                with called("a file that is not there: read", OSError):
                    of(defaults(of)).read(Path(other) / self.sample.name)
            except OSError:
                return
        raise BrokenError("the reader's read returns rows of a file that does not exist; raise a FileNotFoundError")

    def check_cut(self, of: Any) -> None:
        """Check that a file that is cut off is refused by a ValueError, or read up to its end."""
        data = self.sample.read_bytes()
        for size in (*(int(share * len(data)) for share in SHARES), *(len(data) - n for n in LAST)):
            self.damaged(of, f"a file of {len(data)} bytes cut to {size}", data[: max(size, 1)])

    def check_garbage(self, of: Any) -> None:
        """Check that a file of random bytes is refused."""
        self.damaged(of, "a file of other bytes", np.random.default_rng(3).bytes(2_000), refused=True)

    def check_flipped(self, of: Any) -> None:
        """Check that a file with a wrong byte is refused by a ValueError, or read to valid columns."""
        data, rng = self.sample.read_bytes(), np.random.default_rng(4)
        for _ in range(20):
            broken = bytearray(data)
            broken[int(rng.integers(len(data)))] ^= int(rng.integers(1, 256))
            self.damaged(of, "a file with a wrong byte", bytes(broken))

    def check_size(self, of: Any) -> None:
        """Check that a file which holds the content of the sample twice is refused, or read to valid columns."""
        self.damaged(of, "a file with repeated content", 2 * self.sample.read_bytes())
