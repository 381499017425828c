"""When arrays listened, and heard nothing: rows exist only for what is heard.

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
from occlog.measure.scans.scans import Group
from occlog.records.scene import MicrophoneArray, Scene
from occlog.records.tables import UNLABELLED

from .filter import Look

INTERVALS = 15
"""Intervals of which the shortest counts as an array's period."""
ENOUGH = 3
"""With fewer intervals than this an array's rate is not known."""
NOTHING = Look(0, np.empty(0), np.empty(0), np.empty(0, dtype=np.int64))
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

    def scans(self, group: Group) -> Iterator[tuple[int, tuple[Look, ...]]]:
        """What arrays heard, up to the time of the rows: times in vain first, then the rows themselves."""
        looks = self._looks(group)
        yield from self._in_vain(group.t_ns)
        if not looks:
            return
        for look in looks:
            self._clocks[look.array].heard(group.t_ns)
        spoke = {look.array for look in looks}
        # Others whose next scan is now: not before its time, for a row of theirs may be about to come.
        for a, clock in enumerate(self._clocks):
            period = clock.period_ns
            if a in spoke or clock.last_ns is None or period is None:
                continue
            if group.t_ns - clock.last_ns >= period:
                looks.append(NOTHING._replace(array=a))
                clock.last_ns += period
        yield group.t_ns, tuple(sorted(looks, key=lambda k: k.array))

    def _in_vain(self, t_ns: int) -> Iterator[tuple[int, tuple[Look, ...]]]:
        """Times before t_ns at which arrays listened in vain."""
        silent: dict[int, list[int]] = {}
        for a, clock in enumerate(self._clocks):
            period = clock.period_ns or 1
            for at in clock.due(t_ns, max(1, self._forget_ns // period)):
                silent.setdefault(at, []).append(a)
        for at in sorted(silent):
            yield at, tuple(NOTHING._replace(array=a) for a in silent[at])

    def _looks(self, group: Group) -> list[Look]:
        """Rows of arrays, in an order of their own."""
        looks = []
        for sensor in np.unique(group.sensor[group.sensor >= self._cameras]).tolist():
            rows = np.flatnonzero((group.sensor == sensor) & group.seen)
            label = np.where(group.target[rows] >= 0, group.target[rows].astype(np.int64), UNLABELLED)
            order = np.lexsort((group.sigma[rows], group.bearing[rows], label))
            rows, label = rows[order], label[order]
            looks.append(Look(int(sensor) - self._cameras, group.bearing[rows], group.sigma[rows], label))
        return looks
