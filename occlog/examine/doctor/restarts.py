"""Times of a table of others that go back in the order of the file: a clock that was set, or started anew."""

from __future__ import annotations

from collections.abc import Hashable

from occlog.errors import InputError
from occlog.io.foreign.cells import Cells
from occlog.io.foreign.table import ForeignTable

from .findings import Findings

MOST = 1 / 3
"""Where more of the rows than this go back, the file is in no order, which is allowed and says nothing of a clock."""


class Restarts:
    """The times of each sensor and identity, fed in the order of the file."""

    def __init__(self, table: ForeignTable) -> None:
        """No row yet."""
        self._table = table
        self._last: dict[Hashable, int] = {}
        self._rows = self._back = 0
        self._first = InputError("")

    def add(self, cells: Cells) -> None:
        """Take the next rows; InputError for a time that cannot be."""
        t_ns = self._table.times_of(cells).tolist()
        for row, (t, whose) in enumerate(zip(t_ns, self._table.whose(cells), strict=True)):
            before = self._last.get(whose)
            if before is not None and t < before:
                self._first = self._first if self._back else cells.fail(row, f"{t} ns after {before} ns")
                self._back += 1
            self._last[whose] = t
        self._rows += len(t_ns)

    def judge(self, findings: Findings) -> None:
        """Note how often times go back, if the file is in any order at all."""
        if 0 < self._back <= MOST * self._rows:
            findings.refused("restart", self._first, count=self._back)
