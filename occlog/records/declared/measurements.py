"""The table of what stations measure of a target beside directions: ranges, signal strengths, time differences."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from occlog.array_types import Bools, Floats, Ints, Ints32, Strings
from occlog.errors import InputError
from occlog.records.columns import Table, check_order, column, first_row

VALUES = ("range", "rssi", "tdoa", "range_difference")
"""Columns of which each row has at least one."""
WITH_A_RANGE = ("bearing",)
"""Columns of values that a sensor measures together with a range."""
DIFFERENCES = ("tdoa", "range_difference")
"""Columns of values that a reference belongs to."""


@dataclass(frozen=True, slots=True, eq=False)
class Measurements(Table):
    """What stations measure of targets that say who they are (radio tags, beacons, one source of sound).

    A row has a range, a signal strength, a difference of arrival times to another station, or several of them; with a
    range it may have a bearing.
    A time difference in seconds becomes a length by the speed of propagation, which the table does not know.
    """

    NAME: ClassVar[str] = "measurements"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "sensor", "target_id")

    t_ns: Ints = column("i8", "ns", "time since the Unix epoch")
    sensor: Strings = column("U", "1", "name of the station in the scene")
    target_id: Ints32 = column("i4", "1", "target that was measured, >= 0")
    range: Floats = column("f8", "m", "distance from the station to the target, in space", nan="not measured")
    sigma_range: Floats = column("f8", "m", "its standard deviation, > 0", nan="not told")
    rssi: Floats = column("f8", "dBm", "strength of the received signal", nan="not measured")
    sigma_rssi: Floats = column("f8", "dB", "its standard deviation, shadowing included, > 0", nan="not told")
    reference: Strings = column(
        "U", "1", "the other station of a difference; empty where the row has none", optional=True
    )
    tdoa: Floats = column(
        "f8",
        "s",
        "time of arrival at the station minus that at the reference",
        nan="not measured",
        optional=True,
    )
    sigma_tdoa: Floats = column("f8", "s", "its standard deviation, > 0", nan="not told", optional=True)
    range_difference: Floats = column(
        "f8",
        "m",
        "distance of the target from the station minus that from the reference",
        nan="not measured",
        optional=True,
    )
    sigma_range_difference: Floats = column("f8", "m", "its standard deviation, > 0", nan="not told", optional=True)
    bearing: Floats = column(
        "f8",
        "rad",
        "azimuth of the target about the station, of a sensor that measures it with a range",
        nan="not measured",
        optional=True,
    )
    sigma_bearing: Floats = column("f8", "rad", "its standard deviation, > 0", nan="not told", optional=True)

    def check(self) -> None:
        """Times in order, targets known, standard deviations above 0, two stations for each difference."""
        check_order(self)
        bad: Bools = np.asarray(self.target_id < 0)
        if bad.any():
            row = first_row(bad)
            raise InputError(f"Measurements: row {row}: target_id {self.target_id[row]} is below 0")
        for name in (*VALUES, *WITH_A_RANGE):
            sigma: Floats = getattr(self, f"sigma_{name}")
            if (wrong := np.asarray(sigma <= 0)).any():
                row = first_row(wrong)
                raise InputError(f"Measurements: row {row}: sigma_{name} {sigma[row]:g} must be above 0")
        for name in WITH_A_RANGE:
            if (alone := np.isfinite(getattr(self, name)) & ~np.isfinite(self.range)).any():
                row = first_row(alone)
                raise InputError(
                    f"Measurements: row {row}: has a {name} without a range; directions alone are bearings"
                )
        bad = np.asarray(~self.told.any(axis=1))
        if bad.any():
            row = first_row(bad)
            raise InputError(f"Measurements: row {row}: has none of {', '.join(VALUES)}; leave the row out")
        differs = np.isfinite(self.tdoa) | np.isfinite(self.range_difference)
        bad = differs & ((self.reference == "") | (self.reference == self.sensor))
        if bad.any():
            row = first_row(bad)
            raise InputError(
                f"Measurements: row {row}: a difference wants two stations; sensor is {str(self.sensor[row])!r} and "
                f"reference {str(self.reference[row])!r}"
            )

    @property
    def told(self) -> Bools:
        """(N, 4) which of `VALUES` each row has."""
        return np.column_stack([np.isfinite(getattr(self, name)) for name in VALUES])
