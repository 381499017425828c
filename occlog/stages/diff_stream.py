"""Two tables side by side in pieces that belong together, so that memory does not grow with their length."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TypeVar

import numpy as np

from ..columns import Ints, Table
from ..errors import InputError

T = TypeVar("T", bound=Table)
LAST = np.iinfo(np.int64).max


class _Side:
    """Chunks of one table and the rows that have not been handed out yet."""

    def __init__(self, chunks: Iterable[Table], kind: type[Table], name: str) -> None:
        self._chunks = iter(chunks)
        self._name = name
        self.rows = kind.empty()
        self.until: int = np.iinfo(np.int64).min  # rows before this time have all arrived

    def pull(self) -> None:
        """Read the next chunk that has rows."""
        for chunk in self._chunks:
            if not len(chunk):
                continue
            t_ns = times(chunk)
            if len(self.rows) and t_ns[0] < times(self.rows)[-1]:
                raise InputError(f"{self._name}: t_ns goes back between two chunks ({t_ns[0]}); sort the table by t_ns")
            self.rows = type(chunk).concat([self.rows, chunk])
            self.until = int(t_ns[-1])
            return
        self.until = LAST

    def take_before(self, cut: int) -> Table:
        """Hand out the rows before a time; all of them at the end."""
        n = len(self.rows) if cut == LAST else int(np.searchsorted(times(self.rows), cut))
        out, self.rows = self.rows.take(slice(0, n)), self.rows.take(slice(n, None))
        return out


def times(table: Table) -> Ints:
    """The t_ns column."""
    out: Ints = getattr(table, "t_ns")  # noqa: B009
    return out


def side_by_side(kind: type[T], a: Iterable[T], b: Iterable[T], slack_ns: int = 0) -> Iterator[tuple[T, T]]:
    """Pieces of both tables that cover the same time, one after the other.

    Args:
        kind: the table.
        a: chunks of the first table in the order of time; a time may be split over two chunks.
        b: chunks of the second table, likewise.
        slack_ns: rows up to this far apart are kept in the same piece, whichever table
            they are in.

    Raises:
        InputError: the chunks of a table are not in the order of time.
    """
    left, right = _Side(a, kind, f"{kind.NAME} A"), _Side(b, kind, f"{kind.NAME} B")
    while True:
        # The side that lags behind is read first.
        for side in (left, right):
            if side.until <= min(left.until, right.until) and side.until != LAST:
                side.pull()
        cut = _cut(times(left.rows), times(right.rows), min(left.until, right.until), slack_ns)
        pieces = left.take_before(cut), right.take_before(cut)
        if len(pieces[0]) or len(pieces[1]):
            yield pieces  # type: ignore[misc]
        if left.until == right.until == LAST:
            return


def _cut(t_a: Ints, t_b: Ints, until: int, slack_ns: int) -> int:
    """The latest time up to `until` before which both tables are complete and after a pause longer than the slack."""
    if until == LAST or slack_ns == 0:
        return until
    union = np.union1d(t_a, t_b)
    starts = union[1:][np.diff(union) > slack_ns]
    starts = starts[starts <= until]
    return int(starts[-1]) if len(starts) else int(union[0]) if len(union) else until
