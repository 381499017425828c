"""Scans of arrays that listened in vain: a recording has rows only for what arrays hear.

An array that has had a row listens at its rate: the scene's `rate_hz`, or else the shortest of
the last intervals between its rows.  Where by its own clock it should have had a row and has
none, it listened in vain.  An array that has had no row yet, or too few to tell its rate, is not
taken to listen; nothing is known of the time after the last row of all.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

import numpy as np

from occlog.array_types import NS
from occlog.records.scene import MicrophoneArray, Scene
from occlog.records.tables import UNLABELLED
from occlog.scans.scan import Scan, concat, in_vain

INTERVALS = 15
"""Intervals of which the shortest counts as an array's period."""
ENOUGH = 3
"""With fewer intervals than this an array's rate is not known."""
LATE = 0.5
"""A row may be late by this share of the period before it counts as missing."""


class Clock:
    """The times at which one array listens."""

    def __init__(self, array: MicrophoneArray) -> None:
        """Before the first row."""
        self._known = None if array.rate_hz is None else round(NS / array.rate_hz)
        self._gaps: deque[int] = deque(maxlen=INTERVALS)
        self._row_ns: int | None = None  # of the last row
        self.last_ns: int | None = None  # when it listened last

    @property
    def period_ns(self) -> int | None:
        """Time between two scans; None: not known."""
        if self._known is not None:
            return self._known
        return min(self._gaps) if len(self._gaps) >= ENOUGH else None

    def heard(self, t_ns: int) -> None:
        """It has a row at this time."""
        if self._row_ns is not None:
            self._gaps.append(t_ns - self._row_ns)
        self._row_ns = self.last_ns = t_ns

    def due(self, t_ns: int, most: int) -> list[int]:
        """Times before t_ns at which it listened in vain, up to `most` of them."""
        period = self.period_ns
        if period is None or self.last_ns is None or period <= 0:
            return []
        count = max(0, int((t_ns - LATE * period - self.last_ns) // period))
        times = [self.last_ns + (n + 1) * period for n in range(min(count, most))]
        if count:
            self.last_ns += count * period
        return times


class Listener:
    """All arrays' scans, silent ones among them."""

    def __init__(self, scene: Scene, forget_s: float) -> None:
        """Before the first row.

        Args:
            scene: the arrays.
            forget_s: of a silence that is longer, only this much is gone through [s].
        """
        self._cameras = len(scene.cameras)
        self._clocks = [Clock(a) for a in scene.arrays]
        self._forget_ns = round(forget_s * NS)

    def scans(self, scan: Scan) -> Iterator[Scan]:
        """What arrays heard, up to the time of a scan: times in vain first, then the arrays' rows themselves.

        An array that listened in vain has a row that is not `seen`.  Rows of an array come by label and
        bearing; labels below 0 are none.
        """
        rows = scan.take(scan.sensor >= self._cameras)
        # Silence before this scan, by the arrays' own clocks
        yield from self._in_vain(scan.t_ns)
        if not len(rows.sensor):
            return
        spoke = {sensor - self._cameras for sensor in rows.sensor.tolist()}
        for a in spoke:
            self._clocks[a].heard(scan.t_ns)
        # Others whose next scan is now: not before its time, for a row of theirs may be about to come.
        silent = []
        for a, clock in enumerate(self._clocks):
            period = clock.period_ns
            if a in spoke or clock.last_ns is None or period is None:
                continue
            if scan.t_ns - clock.last_ns >= period:
                silent.append(self._cameras + a)
                clock.last_ns += period
        yield _ordered(concat([in_vain(scan.t_ns, silent), rows]))

    def _in_vain(self, t_ns: int) -> Iterator[Scan]:
        """Times before t_ns at which arrays listened in vain."""
        silent: dict[int, list[int]] = {}
        for a, clock in enumerate(self._clocks):
            period = clock.period_ns or 1
            for at in clock.due(t_ns, max(1, self._forget_ns // period)):
                silent.setdefault(at, []).append(self._cameras + a)
        for at in sorted(silent):
            yield in_vain(at, silent[at])


def _ordered(scan: Scan) -> Scan:
    """The rows by array, label, bearing and standard deviation, whatever order they came in."""
    label = np.maximum(scan.target_id, UNLABELLED)
    order = np.lexsort((scan.sigma, scan.bearing, label, scan.sensor))
    return scan._replace(target_id=label).take(order)
