"""What a measurement model is: the predicted value of a station's measurement as a function of a target's position."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from occlog.array_types import Floats


class Geometry(NamedTuple):
    """Positions of the stations of m measurements."""

    place: Floats  # (m, 2) of the station, p
    rise2: Floats  # (m,) square of its height over the target
    other: Floats  # (m, 2) of the reference of a difference, q; else that of the station
    other_rise2: Floats  # (m,)


class MeasurementModel(NamedTuple):
    """One kind of measurement: z = h(x) + noise.

    `predict(xy, geometry)` gives h (..., m) at positions (..., m or 1, 2) and its gradient (..., m, 2).
    """

    predict: Callable[[Floats, Geometry], tuple[Floats, Floats]]
    compiled: int  # the kind by which `occlog.track.apf.kernels.importance.linearise` knows it
    angular: bool = False  # residuals are wrapped to [-pi, pi)
    delayed: bool = False  # a signal without a free path comes late, so that values are too long
    column: str | None = None  # of the table `measurements`, for values that are taken as they stand there
