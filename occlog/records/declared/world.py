"""Tables of true positions, priors of occluders, plans, robot paths, and network messages.

Conventions: see `tables`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from occlog.array_types import Bools, Floats, Ints, Ints32, Strings
from occlog.core.navigation.steering import STATES
from occlog.records.columns import ColumnTable, column, first_row, semidefinite


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

    t_ns: Ints = column("time since the Unix epoch", "ns")
    occluder_id: Ints32 = column("number of the occluder; -1 = no occluder at that time")
    x: Floats = column("mean position", "m", nan="no occluder")
    y: Floats = column("mean position", "m", nan="no occluder")
    cov_xx: Floats = column("position covariance", "m^2", nan="no occluder")
    cov_xy: Floats = column("position covariance", "m^2", nan="no occluder")
    cov_yy: Floats = column("position covariance", "m^2", nan="no occluder")

    def check(self) -> None:
        """InputError unless rows with an occluder have a position, and covariances are valid.

        Rows without one (`occluder_id` -1) have none. Covariances must be positive semidefinite.
        """
        numbers = np.stack([self.x, self.y, self.cov_xx, self.cov_xy, self.cov_yy])
        there: Bools = np.asarray(np.isfinite(numbers).all(axis=0))
        _check_there(self, there)
        bad = there & ~semidefinite(self.cov_xx, self.cov_xy, self.cov_yy)
        self.refuse(bad, "the covariance (cov_xx, cov_xy, cov_yy) is not positive semi-definite")


@dataclass(frozen=True, slots=True, eq=False)
class Hulls(ColumnTable):
    """Polygons on the ground that contain the moving occluders: visual hulls from several views.

    An occluder is anywhere in its polygon with equal probability. A time known to have no occluder is one row with
    `occluder_id` = -1.
    """

    NAME: ClassVar[str] = "hulls"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "occluder_id", "corner")

    t_ns: Ints = column("time since the Unix epoch", "ns")
    occluder_id: Ints32 = column("number of the occluder; -1 = no occluder at that time")
    corner: Ints32 = column("number of the corner, from 0, counter-clockwise")
    x: Floats = column("position of the corner", "m", nan="no occluder")
    y: Floats = column("position of the corner", "m", nan="no occluder")

    def check(self) -> None:
        """InputError unless each occluder has a polygon with corners numbered from 0.

        A polygon has at least three corners. Rows without an occluder (`occluder_id` -1) have no position.
        """
        _check_there(self, np.isfinite(self.x) & np.isfinite(self.y))
        if not len(self):
            return
        fresh = np.ones(len(self), dtype=np.bool_)
        fresh[1:] = (np.diff(self.t_ns) != 0) | (np.diff(self.occluder_id) != 0)
        starts = np.flatnonzero(fresh)
        sizes = np.diff(np.append(starts, len(self)))
        bad = self.corner != np.arange(len(self)) - np.repeat(starts, sizes)
        bad |= np.repeat(sizes < 3, sizes) & (self.occluder_id >= 0)
        self.refuse(bad, "corners of a polygon must be numbered 0, 1, 2, ... in its rows, and be at least three")


def _check_there(table: Occluders | Hulls, there: Bools) -> None:
    """InputError if a row with an occluder has no position, or a row without one (`occluder_id` < 0) has a position.

    `there` (n,): mask of the rows with a position.
    """
    if (wrong := (table.occluder_id >= 0) != there).any():
        must = "must be numbers" if table.occluder_id[first_row(wrong)] >= 0 else "must be NaN"
        table.refuse(wrong, f"occluder_id is {{occluder_id}}, so x and y {must}")


@dataclass(frozen=True, slots=True, eq=False)
class Truth(ColumnTable):
    """True positions of the targets, and of the moving objects that occlude them."""

    NAME: ClassVar[str] = "truth"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "target_id")
    ONCE: ClassVar[bool] = True

    t_ns: Ints = column("time since the Unix epoch", "ns")
    target_id: Ints32 = column("identity; targets and occluders share one numbering")
    role: Strings = column("`target` or `occluder`")
    x: Floats = column("position", "m")
    y: Floats = column("position", "m")
    z: Floats = column("height of the point above the ground", "m", nan="not known")

    def check(self) -> None:
        """InputError unless each role is `target` or `occluder`."""
        self.refuse(~np.isin(self.role, ("target", "occluder")), "role {role!r} must be target or occluder")


@dataclass(frozen=True, slots=True, eq=False)
class PlanMap(ColumnTable):
    """Expected performance of a filter at positions on the ground plane."""

    NAME: ClassVar[str] = "plan"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "y", "x")

    t_ns: Ints = column("0: a plan has no time; tables are ordered by it", "ns")
    x: Floats = column("middle of a square of the floor", "m")
    y: Floats = column("middle of a square of the floor", "m")
    weight: Floats = column("share of the floor, or of the time that people of --paths spent there")
    rmse: Floats = column("expected root mean square error of the position of a target that walks through", "m")
    rmse_error: Floats = column("standard error of `rmse` by the draws of walks and crowds", "m")
    seen_by_0: Floats = column("probability that no sensor sees or hears the target")
    seen_by_1: Floats = column("probability that exactly one sensor does")
    seen_by_2: Floats = column("probability that two or more do")
    unlocalised_share: Floats = column(
        "share of the draws in which the position is known, along its worst direction, no better than half as well as"
        " by the room alone"
    )

    def check(self) -> None:
        """InputError unless weights and probabilities are from 0 to 1."""
        for name in ("weight", "seen_by_0", "seen_by_1", "seen_by_2", "unlocalised_share"):
            values = getattr(self, name)
            self.refuse(~((values >= 0.0) & (values <= 1.0 + 1e-9)), f"{name} {{{name}}} must be from 0 to 1")


ENDED = "the path ends here"
PATH_STATES = (*STATES, "end")
"""Values of `state`: what decides on the direction of the next step; of the last row missing."""


@dataclass(frozen=True, slots=True, eq=False)
class RobotPath(ColumnTable):
    """Positions of a robot in a potential field, and the forces that determine its next step."""

    NAME: ClassVar[str] = "robot_path"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns",)

    t_ns: Ints = column("time since the Unix epoch", "ns")
    x: Floats = column("position", "m")
    y: Floats = column("position", "m")
    attractive_x: Floats = column("force of the goal", nan=ENDED)
    attractive_y: Floats = column("force of the goal", nan=ENDED)
    repulsive_x: Floats = column("force of all obstacles", nan=ENDED)
    repulsive_y: Floats = column("force of all obstacles", nan=ENDED)
    total_x: Floats = column(
        "force along which the robot goes, prevented or turned; a guarded step leaves it", nan=ENDED
    )
    total_y: Floats = column(
        "force along which the robot goes, prevented or turned; a guarded step leaves it", nan=ENDED
    )
    state: Strings = column(
        "what decides on the next step: `free`, `oscillating`, `prevent`, `escaping`, `guarded`; `end` in the last row"
    )
    recognised: Bools = column("whether oscillation was recognised")
    clearance: Floats = column(
        "least distance from obstacles since the row before, border to border; negative where they overlapped",
        "m",
        nan="there are no obstacles",
    )
    obstacle: Strings = column("name of that obstacle; empty: no obstacle")

    def check(self) -> None:
        """InputError unless states are among `PATH_STATES`."""
        unknown = ~np.isin(self.state, PATH_STATES)
        self.refuse(unknown, f"state {{state!r}} must be one of {', '.join(PATH_STATES)}")


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

    t_ns: Ints = column("when the message was sent, since the detection", "ns")
    protocol: Strings = column("`rbvc` or `sbvc`")
    channel: Strings = column("what the links between routers share: `shared`, `node` or `link`")
    image_kb: Floats = column("size of an image", "kB")
    objects_share: Floats = column("share of the objects that are tracked")
    kind: Strings = column("what the message is, or `end-to-end`")
    source: Strings = column("node that sends it; of `end-to-end` the router")
    destination: Strings = column("nodes that get it, separated by commas")
    packets: Ints32 = column("packets of the message; of `end-to-end` 0")
    hops: Ints32 = column("hops of all packets; of `end-to-end` 0")
    delay_s: Floats = column("from when it was sent to when the last destination has all of it", "s")
    hop_s: Floats = column("mean over the hops, from when a packet waits to when it arrives", "s", nan="no hop")
    air_s: Floats = column("time on the air with acknowledgements, over all hops", "s", nan="end-to-end")

    def check(self) -> None:
        """InputError unless no delay is negative."""
        self.refuse(self.delay_s < 0.0, "delay_s is {delay_s:g}, below 0: a message cannot arrive before it is sent")
