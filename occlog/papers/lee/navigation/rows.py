"""Steps of one robot as rows of a path."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice

import numpy as np

from occlog.array_types import NS, Floats
from occlog.core.navigation.steering import STATES, Steering
from occlog.records.declared.robots import PATH_STATES
from occlog.records.tables import RobotPath

from .stage import Step

ROWS = 4096
"""Rows of a table at a time."""
NOTHING = np.full((1, 2), np.nan)
LAST = Steering(
    attractive=NOTHING,
    repulsive=NOTHING,
    total=NOTHING,
    state=np.array([len(STATES)]),
    recognised=np.zeros(1, dtype=np.bool_),
)
"""Of the last row, after which there is no step."""


class PathRows:
    """Turns steps of a drive with one robot into tables."""

    def __init__(self, names: Sequence[str], start_ns: int, step_s: float) -> None:
        """Nothing is read yet.

        Args:
            names: of the obstacles.
            start_ns: time of the first row.
            step_s: time between two rows.
        """
        self._names, self._start_ns, self._step_s = (*names, ""), start_ns, step_s

    def tables(self, steps: Iterable[Step]) -> Iterator[RobotPath]:
        """Tables of up to `ROWS` rows."""
        left = iter(steps)
        while part := list(islice(left, ROWS)):
            yield self._table(part)

    def _table(self, steps: Sequence[Step]) -> RobotPath:
        told = [LAST if s.steering is None else s.steering for s in steps]
        seconds = np.array([s.number for s in steps]) * self._step_s
        xy = np.concatenate([s.xy for s in steps])
        clearance: Floats = np.concatenate([s.clearance for s in steps])
        attractive, repulsive, total = (
            np.concatenate(part) for part in zip(*((s.attractive, s.repulsive, s.total) for s in told), strict=True)
        )
        return RobotPath.of(
            t_ns=self._start_ns + np.rint(seconds * NS).astype(np.int64),
            x=xy[:, 0],
            y=xy[:, 1],
            attractive_x=attractive[:, 0],
            attractive_y=attractive[:, 1],
            repulsive_x=repulsive[:, 0],
            repulsive_y=repulsive[:, 1],
            total_x=total[:, 0],
            total_y=total[:, 1],
            state=np.array(PATH_STATES)[np.concatenate([s.state for s in told])],
            recognised=np.concatenate([s.recognised for s in told]),
            clearance=np.where(np.isfinite(clearance), clearance, np.nan),
            obstacle=np.array(self._names)[np.concatenate([s.nearest for s in steps])],
        )
