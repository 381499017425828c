"""Labelled bearings of each target in scans: rows that are so near in time that their sight lines should meet."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Ints
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.records.pieces import LAST
from occlog.records.tables import Bearings


class Scans(NamedTuple):
    """Whole scans of one target.

    Attributes:
        target: its identity.
        rows: in the order of time.
        starts: (S + 1,) first row of each scan, then their number.
    """

    target: int
    rows: Bearings
    starts: Ints


def labelled(bearings: Bearings, config: EvaluateConfig) -> Bearings:
    """Rows that saw a target that they name; sensors held out are left out."""
    return bearings.take(
        bearings.seen & (bearings.target_id >= 0) & ~np.isin(bearings.sensor, np.array(config.held_out, dtype=np.str_))
    )


class ScanCuts:
    """Cuts rows that stream by into scans, which are the same wherever the stream is cut."""

    def __init__(self, config: EvaluateConfig) -> None:
        """No rows yet."""
        self.window_ns = round(config.lines_window_s * NS)
        """How long a scan lasts at most."""
        self._held: dict[int, Bearings] = {}

    def update(self, rows: Bearings, end_ns: int) -> Iterator[Scans]:
        """Scans that are whole, of each target.

        Args:
            rows: some more, which end between two times; see `labelled`.
            end_ns: no later row is before this time; `LAST`: there is none.
        """
        held, self._held = self._held, {}
        for target in np.union1d(np.unique(rows.target_id), list(held)).astype(np.int64).tolist():
            own = rows.take(rows.target_id == target)
            own = Bearings.concat([held[target], own]) if target in held else own
            starts = scan_starts(own, self.window_ns)
            # The last scan may go on
            begin = int(starts[-2])
            if end_ns != LAST and end_ns <= int(own.t_ns[begin]) + self.window_ns:
                self._held[target] = own.take(slice(begin, None))
                own, starts = own.take(slice(0, begin)), starts[:-1]
            if len(own):
                yield Scans(target, own, starts)


def scan_starts(rows: Bearings, window_ns: int) -> Ints:
    """First row of each scan, then the number of rows.

    A scan lasts at most `window_ns` after its first row and holds each sensor at most once.
    """
    starts, begin, present = [0], 0, set[str]()
    times, sensors = rows.t_ns.tolist(), rows.sensor.tolist()
    for n, (t, sensor) in enumerate(zip(times, sensors, strict=True)):
        if n and (t - times[begin] > window_ns or sensor in present):
            starts.append(n)
            begin, present = n, set()
        present.add(sensor)
    return np.array([*starts, len(rows)] if len(rows) else [0], dtype=np.int64)
