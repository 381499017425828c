"""Measurement model of a sensor that measures bearing and range at once: radar, sonar, lidar.

Its row of the table `measurements` has a range and a bearing, the azimuth of the target about the station,

    z = atan2(y - p_y, x - p_x) + noise,

from +x towards +y in the world, with residuals wrapped to [-pi, pi). The errors of range and bearing are independent
(Bar-Shalom, Li and Kirubarajan 2001, Sec. 10.4); each of the two can be false by itself. A detour of the signal
lengthens the range and does not affect the bearing.
"""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats

from .measurement_model import MeasurementModel, StationPositions

NEAREST = 1e-9
"""Squares of distances are not below this, so that a position at a station gives finite numbers."""


def azimuth(xy: Floats, at: StationPositions) -> tuple[Floats, Floats]:
    """Return azimuths (..., m) [rad] of positions about m stations, and their gradients by position (..., m, 2).

    Args:
        xy: (..., m, 2) one position for each station, or (..., 1, 2) one for all.
        at: the m stations.
    """
    away = xy - at.position
    square = np.maximum((away**2).sum(axis=-1), NEAREST)
    across = np.stack([-away[..., 1], away[..., 0]], axis=-1)
    return np.arctan2(away[..., 1], away[..., 0]), across / square[..., None]


MODEL = MeasurementModel(azimuth, compiled=0, angular=True, column="bearing")
