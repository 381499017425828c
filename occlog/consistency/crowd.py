"""Candidates that cannot be one target: several people offered to a filter that follows one."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from occlog.core.metrics.errors import ratio

from .sight import Frames


@dataclass
class Left:
    """What candidates of one sensor were left unexplained."""

    frames: int = 0
    candidates: int = 0
    unexplained: int = 0
    crowded: int = 0  # frames with a candidate that no track explains and that was there in the frame before, too


@dataclass
class Crowd:
    """Gathers what candidates are left unexplained by all tracks, by sensor."""

    sensors: dict[str, Left] = field(default_factory=dict)

    def add(self, parts: Iterable[Frames]) -> None:
        """Count some more frames."""
        for part in parts:
            own = self.sensors.setdefault(part.sensor, Left())
            own.frames += len(part.t_ns)
            own.candidates += int(part.candidates.sum())
            own.unexplained += int(part.unexplained.sum())
            own.crowded += int(np.count_nonzero(part.again))

    @property
    def frames(self) -> int:
        """Frames with candidates."""
        return sum(s.frames for s in self.sensors.values())

    @property
    def candidates(self) -> float:
        """Mean number of candidates in a frame that has any; NaN without frames."""
        return ratio(sum(s.candidates for s in self.sensors.values()), self.frames)

    @property
    def unexplained(self) -> float:
        """Mean number of candidates in a frame that are near no track; NaN without frames."""
        return ratio(sum(s.unexplained for s in self.sensors.values()), self.frames)

    def persistent(self, fewest: int) -> dict[str, float]:
        """Share of frames with a candidate that stays and that no track explains, of sensors with enough frames."""
        return {name: s.crowded / s.frames for name, s in sorted(self.sensors.items()) if s.frames >= fewest}
