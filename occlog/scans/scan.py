"""One scan: the rows of `Bearings` of one moment, as filters and their kernels read them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from occlog.array_types import Bools, Floats, Ints, Ints32
from occlog.core.occlusion.priors import Priors
from occlog.filtering.likelihood.distances import Distances
from occlog.records.scene import Scene
from occlog.records.tables import UNLABELLED


class Measured(NamedTuple):
    """What stations measured beside directions at one time; see `occlog.scans.measured`."""

    target_id: Ints32  # (m,) >= 0
    distances: Distances  # m measurements

    def of_target(self, target: int) -> Measured | None:
        """Those of a target; None for nothing."""
        own = self.target_id == target
        return Measured(self.target_id[own], self.distances.take(own)) if own.any() else None


class Scan(NamedTuple):
    """What all sensors say at one time: R rows of the columns of `occlog.records.tables.Bearings`, by sensor.

    A sensor has one row for each label, and a row for each candidate or one that is not `seen`.
    A sensor without a row had no frame.  A scan is a tuple of arrays and no table: tables check
    their values when they are made, which a filter cannot afford at every step.
    """

    t_ns: int
    sensor: Ints  # (R,) place in `sensor_names`, rising
    target_id: Ints32  # (R,) UNLABELLED: a candidate that may be of any object
    seen: Bools  # (R,)
    bearing: Floats  # (R,) [rad]
    sigma: Floats  # (R,) [rad]
    u_px: Floats  # (R,) NaN where the sensor gives no pixels
    sigma_px: Floats  # (R,) NaN: the camera's read noise
    score: Floats  # (R,) NaN: unknown
    elevation: Floats  # (R,) [rad]; NaN: the sensor tells none
    sigma_elevation: Floats  # (R,) [rad]
    occluders: Priors | None = None  # at this time; None: nothing is known about moving occluders
    measured: Measured | None = None  # ranges and their like, of the same time; None: there are none

    @classmethod
    def of(cls, t_ns: int, sensor: Sequence[int] | Ints, **columns: ArrayLike) -> Scan:
        """A scan of array-likes; columns left out say nothing: no label, seen, and NaN."""
        n = len(sensor)
        known = {"sensor": np.asarray(sensor, dtype=np.int64)}
        known |= {name: np.asarray(values, dtype=DTYPES.get(name, np.float64)) for name, values in columns.items()}
        blank = {"target_id": np.full(n, UNLABELLED, dtype=np.int32), "seen": np.ones(n, dtype=np.bool_)}
        return cls(t_ns, **dict.fromkeys(COLUMNS, np.full(n, np.nan)) | blank | known)

    @property
    def labelled(self) -> Bools:
        """(R,) rows whose target is known."""
        return np.asarray(self.target_id != UNLABELLED)

    def take(self, rows: Bools | Ints | slice) -> Scan:
        """The rows selected by a mask, a slice or an index array."""
        return Scan._make((self.t_ns, *(column[rows] for column in self[1:-2]), self.occluders, self.measured))

    def of_target(self, target: int) -> Scan | None:
        """A target's own rows, and candidates of sensors that have none for it; None for nothing."""
        own = self.target_id == target
        rows, free = own, self.target_id == UNLABELLED
        if free.any():
            rows = own | (free & ~np.isin(self.sensor, self.sensor[own]))
        if self.measured is not None:
            measured = self.measured.of_target(target)
            some = self.take(rows)._replace(measured=measured)
            return some if rows.any() or measured is not None else None
        if rows.all():
            return self if len(rows) else None
        return self.take(rows) if rows.any() else None

    @property
    def targets(self) -> set[int]:
        """Targets that rows or measurements name."""
        named = set(self.target_id[self.labelled].tolist())
        return named if self.measured is None else named.union(self.measured.target_id.tolist())

    def by_sensor(self) -> Iterator[tuple[int, Scan]]:
        """Every sensor that has rows, rising, and its rows that are `seen`: none where it looked in vain."""
        for sensor in np.unique(self.sensor).tolist():
            yield sensor, self.take((self.sensor == sensor) & self.seen)


DTYPES: dict[str, type[np.generic]] = {"target_id": np.int32, "seen": np.bool_}
"""Of the columns that are not numbers with fractions."""
COLUMNS = tuple(name for name in Scan._fields if name not in ("t_ns", "occluders", "measured"))
"""Names of the columns of a scan: those of `Bearings`, but for the time and what the fusion did."""


def concat(scans: Sequence[Scan]) -> Scan:
    """The rows of scans, at least one, one after the other; the time and the occluders are those of the last.

    Measurements beside directions are left out.
    """
    columns = (np.concatenate(parts) for parts in zip(*(scan[1:-2] for scan in scans), strict=True))
    return Scan._make((scans[-1].t_ns, *columns, scans[-1].occluders, None))


def in_vain(t_ns: int, sensors: Sequence[int]) -> Scan:
    """A scan of sensors, rising, that looked and saw nothing: a row of no target for each."""
    return Scan.of(t_ns, sensors, seen=np.zeros(len(sensors), dtype=np.bool_))


def sensor_names(scene: Scene) -> tuple[str, ...]:
    """Names of all sensors of a scene, cameras first; `Scan.sensor` counts in this order."""
    return (*(c.name for c in scene.cameras), *(a.name for a in scene.arrays))
