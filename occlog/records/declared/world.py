"""Tables of true positions, priors of occluders, plans, robot paths, and network messages.

Conventions: see `tables`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from occlog.array_types import Bools, Floats, Ints, Ints32, Strings
from occlog.core.navigation.steering import STATES
from occlog.errors import InputError
from occlog.records.columns import ColumnTable, check_order, column, first_row, semidefinite


@dataclass(frozen=True, slots=True, eq=False)
class Occluders(ColumnTable):
    """Gaussian priors of the moving occluders' positions on the ground.

    The rows of a time list all occluders that are present then. A time known to have no occluder is one row with
    `occluder_id` = -1 and NaN elsewhere, to distinguish it from a time without information. A covariance of 0 means
    that the position is known.
    """

    NAME: ClassVar[str] = "occluders"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "occluder_id")
    ONCE: ClassVar[bool] = True

    t_ns: Ints = column("i8", "ns", "time since the Unix epoch")
    occluder_id: Ints32 = column("i4", "1", "number of the occluder; -1 = no occluder at that time")
    x: Floats = column("f8", "m", "mean position", nan="no occluder")
    y: Floats = column("f8", "m", "mean position", nan="no occluder")
    cov_xx: Floats = column("f8", "m^2", "position covariance", nan="no occluder")
    cov_xy: Floats = column("f8", "m^2", "position covariance", nan="no occluder")
    cov_yy: Floats = column("f8", "m^2", "position covariance", nan="no occluder")

    def check(self) -> None:
        """InputError unless times are in order, rows with an occluder have a position, and covariances are valid.

        Rows without one (`occluder_id` -1) have none. Covariances must be positive semidefinite.
        """
        check_order(self)
        numbers = np.stack([self.x, self.y, self.cov_xx, self.cov_xy, self.cov_yy])
        there: Bools = np.asarray(np.isfinite(numbers).all(axis=0))
        _check_there(self, self.occluder_id, there)
        bad = there & ~semidefinite(self.cov_xx, self.cov_xy, self.cov_yy)
        if bad.any():
            raise InputError(
                f"Occluders: row {first_row(bad)}: the covariance (cov_xx, cov_xy, cov_yy) is not positive "
                "semi-definite"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Hulls(ColumnTable):
    """Polygons on the ground that contain the moving occluders: visual hulls from several views.

    An occluder is anywhere in its polygon with equal probability. A time known to have no occluder is one row with
    `occluder_id` = -1.
    """

    NAME: ClassVar[str] = "hulls"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "occluder_id", "corner")

    t_ns: Ints = column("i8", "ns", "time since the Unix epoch")
    occluder_id: Ints32 = column("i4", "1", "number of the occluder; -1 = no occluder at that time")
    corner: Ints32 = column("i4", "1", "number of the corner, from 0, counter-clockwise")
    x: Floats = column("f8", "m", "position of the corner", nan="no occluder")
    y: Floats = column("f8", "m", "position of the corner", nan="no occluder")

    def check(self) -> None:
        """InputError unless times are in order, and each occluder has a polygon with corners numbered from 0.

        A polygon has at least three corners. Rows without an occluder (`occluder_id` -1) have no position.
        """
        check_order(self)
        _check_there(self, self.occluder_id, np.isfinite(self.x) & np.isfinite(self.y))
        if not len(self):
            return
        fresh = np.ones(len(self), dtype=np.bool_)
        fresh[1:] = (np.diff(self.t_ns) != 0) | (np.diff(self.occluder_id) != 0)
        starts = np.flatnonzero(fresh)
        sizes = np.diff(np.append(starts, len(self)))
        bad = self.corner != np.arange(len(self)) - np.repeat(starts, sizes)
        bad |= np.repeat(sizes < 3, sizes) & (self.occluder_id >= 0)
        if bad.any():
            raise InputError(
                f"Hulls: row {first_row(bad)}: corners of a polygon must be numbered 0, 1, 2, ... in its rows, and "
                "be at least three"
            )


def _check_there(table: ColumnTable, identity: Ints32, there: Bools) -> None:
    """InputError if a row with an occluder has no position, or a row without one has a position.

    Args:
        table: for the name of the table in the message.
        identity: (n,) number of the occluder; -1: none.
        there: (n,) mask of rows with a position.
    """
    if (wrong := (identity >= 0) != there).any():
        row = first_row(wrong)
        raise InputError(
            f"{type(table).__name__}: row {row}: occluder_id is {identity[row]}, "
            f"so x and y {'must be numbers' if identity[row] >= 0 else 'must be NaN'}"
        )


@dataclass(frozen=True, slots=True, eq=False)
class Truth(ColumnTable):
    """True positions of the targets, and of the moving objects that occlude them."""

    NAME: ClassVar[str] = "truth"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "target_id")
    ONCE: ClassVar[bool] = True

    t_ns: Ints = column("i8", "ns", "time since the Unix epoch")
    target_id: Ints32 = column("i4", "1", "identity; targets and occluders share one numbering")
    role: Strings = column("U", "1", "`target` or `occluder`")
    x: Floats = column("f8", "m", "position")
    y: Floats = column("f8", "m", "position")
    z: Floats = column("f8", "m", "height of the point above the ground", nan="not known")

    def check(self) -> None:
        """InputError unless times are in order, and each role is `target` or `occluder`."""
        check_order(self)
        bad = ~np.isin(self.role, ("target", "occluder"))
        if bad.any():
            role = str(self.role[first_row(bad)])
            raise InputError(f"Truth: row {first_row(bad)}: role {role!r} must be target or occluder")


@dataclass(frozen=True, slots=True, eq=False)
class PlanMap(ColumnTable):
    """Expected performance of a filter at positions on the ground plane."""

    NAME: ClassVar[str] = "plan"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "y", "x")

    t_ns: Ints = column("i8", "ns", "0: a plan has no time; tables are ordered by it")
    x: Floats = column("f8", "m", "middle of a square of the floor")
    y: Floats = column("f8", "m", "middle of a square of the floor")
    weight: Floats = column("f8", "1", "share of the floor, or of the time that people of --paths spent there")
    rmse: Floats = column("f8", "m", "expected root mean square error of the position of a target that walks through")
    rmse_error: Floats = column("f8", "m", "standard error of `rmse` by the draws of walks and crowds")
    seen_by_0: Floats = column("f8", "1", "probability that no sensor sees or hears the target")
    seen_by_1: Floats = column("f8", "1", "probability that exactly one sensor does")
    seen_by_2: Floats = column("f8", "1", "probability that two or more do")
    unlocalised_share: Floats = column(
        "f8",
        "1",
        "share of the draws in which the position is known, along its worst direction, no better than half as well as "
        "by the room alone",
    )

    def check(self) -> None:
        """InputError unless times are in order, and weights and probabilities from 0 to 1."""
        check_order(self)
        for name in ("weight", "seen_by_0", "seen_by_1", "seen_by_2", "unlocalised_share"):
            values = getattr(self, name)
            bad = ~((values >= 0.0) & (values <= 1.0 + 1e-9))
            if np.any(bad):
                row = first_row(bad)
                raise InputError(f"PlanMap: row {row}: {name} {values[row]} must be from 0 to 1")


ENDED = "the path ends here"
PATH_STATES = (*STATES, "end")
"""Values of `state`: what decides on the direction of the next step; of the last row missing."""


@dataclass(frozen=True, slots=True, eq=False)
class RobotPath(ColumnTable):
    """Positions of a robot in a potential field, and the forces that determine its next step."""

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
    obstacle: Strings = column("U", "1", "name of that obstacle; empty: no obstacle")

    def check(self) -> None:
        """InputError unless times are in order, and states are among `PATH_STATES`."""
        check_order(self)
        bad = ~np.isin(self.state, PATH_STATES)
        if bad.any():
            row = first_row(bad)
            raise InputError(
                f"RobotPath: row {row}: state {str(self.state[row])!r} must be one of {', '.join(PATH_STATES)}"
            )


END_TO_END = "end-to-end"
"""Kind of the rows that are of a router."""


@dataclass(frozen=True, slots=True, eq=False)
class Delays(ColumnTable):
    """Simulated messages between sensors, routers and a server, with their delays.

    A row is a message with all of its packets. Rows of the kind `end-to-end` are for a router: from the detection of
    its objects to the last final estimate.
    """

    NAME: ClassVar[str] = "delays"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "protocol", "channel", "image_kb", "objects_share", "kind", "source")

    t_ns: Ints = column("i8", "ns", "when the message was sent, since the detection")
    protocol: Strings = column("U", "1", "`rbvc` or `sbvc`")
    channel: Strings = column("U", "1", "what the links between routers share: `shared`, `node` or `link`")
    image_kb: Floats = column("f8", "kB", "size of an image")
    objects_share: Floats = column("f8", "1", "share of the objects that are tracked")
    kind: Strings = column("U", "1", "what the message is, or `end-to-end`")
    source: Strings = column("U", "1", "node that sends it; of `end-to-end` the router")
    destination: Strings = column("U", "1", "nodes that get it, separated by commas")
    packets: Ints32 = column("i4", "1", "packets of the message; of `end-to-end` 0")
    hops: Ints32 = column("i4", "1", "hops of all packets; of `end-to-end` 0")
    delay_s: Floats = column("f8", "s", "from when it was sent to when the last destination has all of it")
    hop_s: Floats = column("f8", "s", "mean over the hops, from when a packet waits to when it arrives", nan="no hop")
    air_s: Floats = column("f8", "s", "time on the air with acknowledgements, over all hops", nan="end-to-end")

    def check(self) -> None:
        """InputError unless times are in order, and no delay is negative."""
        check_order(self)
        if (bad := self.delay_s < 0.0).any():
            row = first_row(bad)
            raise InputError(
                f"Delays: row {row} (counted from 0): delay_s is {self.delay_s[row]:g}, below 0: a message cannot "
                "arrive before it is sent"
            )
