"""One scan: what all sensors say about a target at one time."""

from __future__ import annotations

from typing import NamedTuple

from occlog.array_types import Bools, Floats, Ints
from occlog.core.occlusion.priors import Priors
from occlog.records.scene import Scene


class Scan(NamedTuple):
    """What all sensors say about a target at one time; R rows as in `occlog.records.tables.Bearings`, by sensor.

    A labelled sensor has one row.  An unlabelled one has a row for each candidate, or one
    that is not `seen`.
    """

    t_ns: int
    sensor: Ints  # (R,) place in `sensor_names`, rising
    labelled: Bools  # (R,) false: candidates that may be of any object
    seen: Bools  # (R,)
    bearing: Floats  # (R,) [rad]
    sigma: Floats  # (R,) [rad]
    u_px: Floats  # (R,) NaN where the sensor gives no pixels
    sigma_px: Floats  # (R,) NaN: the camera's read noise
    score: Floats  # (R,) NaN: unknown
    occluders: Priors | None = None  # None: nothing is known about moving occluders
    elevation: Floats | None = None  # (R,) [rad], NaN: the sensor tells none; None: no sensor does
    sigma_elevation: Floats | None = None  # (R,) [rad]


def sensor_names(scene: Scene) -> tuple[str, ...]:
    """Names of all sensors of a scene, cameras first; `Scan.sensor` counts in this order."""
    return (*(c.name for c in scene.cameras), *(a.name for a in scene.arrays))
