"""People who move, as obstacles at the times of a robot's steps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Floats, Ints, Ints32
from occlog.core.numerics.interpolate import interpolate_positions

BLOCK = 256
"""Steps for which places are interpolated at a time."""


class Clock(NamedTuple):
    """When a robot steps."""

    start_ns: int  # time of step 0
    step_s: float


class Moment(NamedTuple):
    """M moving obstacles at the start and the end of a step; NaN where one is not there."""

    xy: Floats  # (M, 2)
    radius: Floats  # (M,)
    after: Floats  # (M, 2) a step later
    radius_after: Floats  # (M,)
    move: Floats  # (M, 2) how each moved in the step before; 0 where that is not known

    def expected(self) -> Moment:
        """The moment as it is known at its start: the obstacles go on as in the step before."""
        return self._replace(after=self.xy + self.move, radius_after=self.radius)


class Moving:
    """Obstacles whose places are known at times of their own, linear in between."""

    def __init__(self, t_ns: Ints, ids: Ints32, places: Floats, clock: Clock, limit_ns: int) -> None:
        """Gather the rows of each obstacle.

        Args:
            t_ns: (R,) times, rising.
            ids: (R,) numbers of the obstacles.
            places: (R, 3) x, y and radius.
            clock: times of the steps.
            limit_ns: longest gap between two rows of an obstacle that is bridged.
        """
        self.clock, self._limit_ns, self._first = clock, limit_ns, -BLOCK
        self.ids = np.unique(ids)
        own = [ids == name for name in self.ids.tolist()]
        self._known = [(t_ns[rows], places[rows]) for rows in own]
        self._block = np.empty((0, len(own), 3))

    def at(self, step: int) -> Moment:
        """The obstacles at a step; quickest where steps are asked for in rising order."""
        if not self._first <= step < self._first + BLOCK:
            self._first = step
            self._block = self._places(np.arange(step - 1, step + BLOCK + 1))
        before, now, after = self._block[step - self._first : step - self._first + 3]
        return Moment(
            xy=now[:, :2],
            radius=now[:, 2],
            after=after[:, :2],
            radius_after=after[:, 2],
            move=np.nan_to_num(now[:, :2] - before[:, :2]),
        )

    def _places(self, steps: Ints) -> Floats:
        """(T, M, 3) x, y and radius of all obstacles at steps."""
        t_ns = self.clock.start_ns + np.rint(steps * (self.clock.step_s * NS)).astype(np.int64)
        places = [interpolate_positions(t_ns, known, columns, self._limit_ns)[0] for known, columns in self._known]
        return np.stack(places, axis=1) if places else np.empty((len(steps), 0, 3))
