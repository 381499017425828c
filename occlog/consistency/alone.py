"""Bearings that no other sensor can confirm: whether sensors see a target one at a time, and what is not believed then.

Where several sensors see a target at once, a false bearing disagrees with the others.  Where one sees it at a time,
the motion alone speaks against it: some false bearings agree with a motion that is about as probable as the true one,
and no residual shows it.  Bearings that are found to be false there say that others, which are believed, may be false.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints, Strings
from occlog.core.metrics.errors import ratio
from occlog.records.tables import Residuals

TOGETHER_S = 1.0
"""Sensors see a target at about the same time if they do within so many seconds."""
OVERLAP = 0.5
"""Sensors see a target one at a time if fewer of its bearings are near one of another sensor."""


def near_another(sensor: Ints | Strings, seconds: Floats) -> Bools:
    """(N,) whether another sensor has a bearing within `TOGETHER_S` of each.

    Args:
        sensor: (N,) which one each bearing of a target is of.
        seconds: (N,) times, rising.
    """
    near = np.zeros(len(sensor), dtype=np.bool_)
    for s in np.unique(sensor).tolist():
        own, others = seconds[sensor == s], seconds[sensor != s]
        if len(others):
            after = np.minimum(np.searchsorted(others, own), len(others) - 1)
            away = np.minimum(np.abs(others[after] - own), np.abs(others[np.maximum(after - 1, 0)] - own))
            near[sensor == s] = away <= TOGETHER_S
    return near


@dataclass
class Alone:
    """Counts bearings, those near one of another sensor, and those not believed.

    Attributes:
        bearings: how many there were.
        confirmed: near to how many of them another sensor has one.
        doubted: how many are not believed.
    """

    bearings: int = 0
    confirmed: int = 0
    doubted: int = 0

    def add(self, part: Residuals) -> None:
        """Count some more rows, in the order of time."""
        for target in np.unique(part.target_id).tolist():
            own = part.take(part.target_id == target)
            self.bearings += len(own)
            self.confirmed += int(np.count_nonzero(near_another(own.sensor, (own.t_ns - own.t_ns[0]) / NS)))
            self.doubted += int(np.count_nonzero(own.believed < 0.5))

    @property
    def one_at_a_time(self) -> bool:
        """Whether sensors see targets one at a time, most of the time."""
        return self.confirmed < OVERLAP * self.bearings

    @property
    def share(self) -> float:
        """Share of the bearings that are not believed; NaN without any."""
        return ratio(self.doubted, self.bearings)
