"""The table of a robot's path.  Conventions: see `tables`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from occlog.array_types import Bools, Floats, Ints, Strings
from occlog.core.navigation.steering import STATES
from occlog.errors import InputError
from occlog.records.columns import Table, check_order, column, first_row

ENDED = "the path ends here"
PATH_STATES = (*STATES, "end")
"""Values of `state`: what decides on the direction of the next step; of the last row there is none."""


@dataclass(frozen=True, slots=True, eq=False)
class RobotPath(Table):
    """Places of a robot in a potential field, and the forces that decide on its next step."""

    NAME: ClassVar[str] = "robot_path"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns",)

    t_ns: Ints = column("i8", "ns", "time since the Unix epoch")
    x: Floats = column("f8", "m", "position")
    y: Floats = column("f8", "m", "position")
    attractive_x: Floats = column("f8", "1", "force of the goal", nan=ENDED)
    attractive_y: Floats = column("f8", "1", "force of the goal", nan=ENDED)
    repulsive_x: Floats = column("f8", "1", "force of all obstacles", nan=ENDED)
    repulsive_y: Floats = column("f8", "1", "force of all obstacles", nan=ENDED)
    total_x: Floats = column(
        "f8", "1", "force along which the robot goes, prevented or turned; a guarded step leaves it", nan=ENDED
    )
    total_y: Floats = column(
        "f8", "1", "force along which the robot goes, prevented or turned; a guarded step leaves it", nan=ENDED
    )
    state: Strings = column(
        "U",
        "1",
        "what decides on the next step: `free`, `oscillating`, `prevent`, `escaping`, `guarded`; `end` in the last row",
    )
    recognised: Bools = column("?", "1", "whether oscillation was recognised")
    clearance: Floats = column(
        "f8",
        "m",
        "least distance from obstacles since the row before, border to border; negative where they overlapped",
        nan="there are no obstacles",
    )
    obstacle: Strings = column("U", "1", "which obstacle that was; empty if there are none")

    def check(self) -> None:
        """Times in order, known states."""
        check_order(self)
        bad = ~np.isin(self.state, PATH_STATES)
        if bad.any():
            row = first_row(bad)
            raise InputError(f"RobotPath: row {row}: state {self.state[row]!r} must be one of {', '.join(PATH_STATES)}")
