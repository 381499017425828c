"""The tables of what is where: the truth, and priors of what hides the targets.  Conventions: see `tables`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from occlog.array_types import Bools, Floats, Ints, Ints32, Strings
from occlog.errors import InputError
from occlog.records.columns import Table, check_order, column, first_row, semidefinite


@dataclass(frozen=True, slots=True, eq=False)
class Occluders(Table):
    """Gaussian priors of the moving occluders' positions.

    A row holds everything that is known at its time: an occluder that has no row then is
    not there.  A time at which there is known to be none is one row with `occluder_id` = -1
    and NaN elsewhere, so that it is kept apart from a time at which nothing is known.
    A covariance of 0 says that the position is known.
    """

    NAME: ClassVar[str] = "occluders"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "occluder_id")
    ONCE: ClassVar[bool] = True

    t_ns: Ints = column("i8", "ns", "time since the Unix epoch")
    occluder_id: Ints32 = column("i4", "1", "number of the occluder; -1 = there is none at that time")
    x: Floats = column("f8", "m", "mean position", nan="there is none")
    y: Floats = column("f8", "m", "mean position", nan="there is none")
    cov_xx: Floats = column("f8", "m^2", "position covariance", nan="there is none")
    cov_xy: Floats = column("f8", "m^2", "position covariance", nan="there is none")
    cov_yy: Floats = column("f8", "m^2", "position covariance", nan="there is none")

    def check(self) -> None:
        """Times in order, numbers where there is an occluder, covariances positive semi-definite up to rounding."""
        check_order(self)
        numbers = np.stack([self.x, self.y, self.cov_xx, self.cov_xy, self.cov_yy])
        there: Bools = np.asarray(np.isfinite(numbers).all(axis=0))
        _check_there(self, self.occluder_id, there)
        bad = there & ~semidefinite(self.cov_xx, self.cov_xy, self.cov_yy)
        if bad.any():
            raise InputError(f"Occluders: row {first_row(bad)}: the covariance is not positive semi-definite")


@dataclass(frozen=True, slots=True, eq=False)
class Hulls(Table):
    """Polygons on the ground in which the moving occluders are: the visual hull of several views.

    An occluder is anywhere in its polygon with equal probability.  As in `Occluders` a time
    without any is one row with `occluder_id` = -1.
    """

    NAME: ClassVar[str] = "hulls"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "occluder_id", "corner")

    t_ns: Ints = column("i8", "ns", "time since the Unix epoch")
    occluder_id: Ints32 = column("i4", "1", "number of the occluder; -1 = there is none at that time")
    corner: Ints32 = column("i4", "1", "number of the corner, from 0, counter-clockwise")
    x: Floats = column("f8", "m", "position of the corner", nan="there is none")
    y: Floats = column("f8", "m", "position of the corner", nan="there is none")

    def check(self) -> None:
        """Times in order, corners from 0 on and at least three of them."""
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
                f"Hulls: row {first_row(bad)}: corners must be numbered 0, 1, 2, ... and be at least three a polygon"
            )


def _check_there(table: Table, identity: Ints32, there: Bools) -> None:
    """InputError where an occluder has no place or a row that says "none" has one."""
    if (wrong := (identity >= 0) != there).any():
        row = first_row(wrong)
        raise InputError(
            f"{type(table).__name__}: row {row}: occluder_id is {identity[row]}, "
            f"so x and y {'must be numbers' if identity[row] >= 0 else 'must be NaN'}"
        )


@dataclass(frozen=True, slots=True, eq=False)
class Truth(Table):
    """True positions on the ground of the targets and of the objects that hide them."""

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
        """Times in order, known roles."""
        check_order(self)
        bad = ~np.isin(self.role, ("target", "occluder"))
        if bad.any():
            role = str(self.role[first_row(bad)])
            raise InputError(f"Truth: row {first_row(bad)}: role {role!r} must be target or occluder")
