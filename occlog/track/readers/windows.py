"""Reads of some time as one observation: which readers read a tag in a window, how often, how strongly."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.errors import InputError
from occlog.records.tables import Reads


@dataclass(frozen=True, eq=False)
class Windows:
    """W observations of tags by R readers, in the order of time; a tag that nobody read in a window has none."""

    t_ns: Ints  # (W,) mean time of the reads
    target_id: Ints  # (W,)
    count: Ints  # (W, R) reads
    rssi: Floats  # (W, R) mean strength [dBm]; NaN: no read tells it

    def __len__(self) -> int:
        return len(self.t_ns)

    def take(self, rows: Ints | Bools | slice) -> Windows:
        """Select rows by a mask, a slice or an index array."""
        return Windows(self.t_ns[rows], self.target_id[rows], self.count[rows], self.rssi[rows])


def windows_of(
    chunks: Iterable[Reads], readers: Sequence[str], window_ns: int, targets: Sequence[int] = ()
) -> Iterator[Windows]:
    """Gather the reads of each window and tag; where chunks are cut does not matter.

    Args:
        chunks: reads in the order of time.
        readers: names of the readers that count.
        window_ns: length of a window, > 0; the first one begins at the first read.
        targets: targets to keep; none: all.

    Raises:
        InputError: times go back from one chunk to the next.
    """
    first: int | None = None
    last = 0
    rest = Reads.empty()
    for chunk in chunks:
        if not len(chunk):
            continue
        if first is None:
            first = int(chunk.t_ns[0])
        elif chunk.t_ns[0] < last:
            raise InputError(f"reads: time {chunk.t_ns[0]} ns comes after {last} ns; sort by t_ns")
        last = int(chunk.t_ns[-1])
        kept = np.isin(chunk.sensor, list(readers))
        if targets:
            kept &= np.isin(chunk.target_id, targets)
        rows = Reads.concat([rest, chunk.take(kept)])
        # The last window may go on in the next chunk
        begun = first + (last - first) // window_ns * window_ns
        cut = int(np.searchsorted(rows.t_ns, begun))
        yield _gathered(rows.take(slice(0, cut)), readers, first, window_ns)
        rest = rows.take(slice(cut, None))
    if first is not None:
        yield _gathered(rest, readers, first, window_ns)


def _gathered(rows: Reads, readers: Sequence[str], first: int, window_ns: int) -> Windows:
    """Reads of whole windows by window and tag."""
    n = len(readers)
    if not len(rows):
        none = np.zeros(0, dtype=np.int64)
        return Windows(none, none, np.zeros((0, n), dtype=np.int64), np.zeros((0, n)))
    place = {name: k for k, name in enumerate(readers)}
    reader = np.array([place[name] for name in rows.sensor.tolist()], dtype=np.int64)
    number = (rows.t_ns - first) // window_ns
    pairs = np.column_stack([number, rows.target_id.astype(np.int64)])
    unique, group = np.unique(pairs, axis=0, return_inverse=True)
    group = group.ravel()
    size = len(unique)
    cell = group * n + reader
    count = np.bincount(cell, minlength=size * n)
    told = np.isfinite(rows.rssi)
    heard = np.bincount(cell[told], minlength=size * n)
    total = np.bincount(cell[told], weights=rows.rssi[told], minlength=size * n)
    mean = np.where(heard > 0, total / np.maximum(heard, 1), np.nan)
    # Mean times, relative to the first read: float64 cannot hold ns since 1970 exactly
    away = np.bincount(group, weights=(rows.t_ns - first).astype(np.float64), minlength=size)
    t_ns = first + np.round(away / np.bincount(group, minlength=size)).astype(np.int64)
    order = np.lexsort((unique[:, 1], t_ns))
    found = Windows(t_ns, unique[:, 1], count.reshape(size, n), mean.reshape(size, n))
    return found.take(order)
