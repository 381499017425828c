"""Particles in a scene without a room: where a scan says that the target is, within what sensors can see.

In a room particles begin all over the floor.  Without one they may be as far as sensors see, and so few of them would
be near the target that the filter's first estimate would be a draw of chance.
"""

from __future__ import annotations

import numpy as np

from occlog.core.sight.view_prior import SightLines, ViewPrior
from occlog.core.sight.visibility import Sensors
from occlog.filtering.likelihood.directions import Noise, PackedScan
from occlog.records.scene import Scene

WANDER_S = 10.0
"""Without a room a new destination is at most as far as a target of usual speed comes in this time [s]."""


def wander(scene: Scene, speed: float) -> float:
    """How far a new destination is from a target, in a scene without a room.

    Half the extent of the sensors, or `WANDER_S` at the speed of new particles if that is more.  Destinations all over
    a region that reaches much farther on one side would nearly all lie in that direction.
    """
    return max(0.5 * float(np.hypot(*np.ptp(scene.surroundings, axis=0))), WANDER_S * speed)


def sight_lines(looks: PackedScan, sensors: Sensors, noise: Noise, prior: ViewPrior) -> SightLines:
    """The directions of a scan's measurements, with the errors of reading, yaw and place ([Ercan] Eq. 2)."""
    i = np.repeat(looks.sensor, np.diff(looks.first))
    f, yaw = np.where(looks.pixel, noise.focal_px[i], 1.0), np.arctan2(sensors.axis[i, 1], sensors.axis[i, 0])
    reading = np.sqrt(looks.variance)
    sigma = np.where(looks.pixel, np.hypot(reading * f / (f**2 + looks.value**2), noise.sigma_yaw[i]), reading)
    return SightLines(
        origin=sensors.xy[i],
        azimuth=np.where(looks.pixel, yaw + np.arctan2(looks.value, f), looks.value),
        sigma=sigma,
        sigma_origin=np.where(looks.pixel, noise.sigma_position[i], 0.0),
        far=prior.far[i],
        sensor=i,
    )
