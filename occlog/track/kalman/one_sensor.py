"""Update by the rows of one sensor, in polar coordinates about it.

Sight lines of one sensor say nothing of the distance.  In Cartesian coordinates they seem to: what was learned of one
line is kept as a strip of constant width, two such strips of different directions cross at the sensor, and
linearised each at a place of its own they draw the estimate to it, with a covariance that is too small (Aidala
1979).  Where the state is azimuth and log distance instead, rows measure the azimuth alone, the strip is a wedge,
and the maximum a posteriori needs no search.
"""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats
from occlog.core.sight.camera import wrap_angle
from occlog.filtering.gaussian import Gaussian, symmetric
from occlog.filtering.likelihood.directions import NEAREST
from occlog.filtering.likelihood.linearised import Rows, World, azimuths, linearised


def along_the_ray(state: Gaussian, rows: Rows, world: World) -> Gaussian | None:
    """Return the state after rows of one sensor; None where the prediction is around the sensor.

    The place is Gaussian in azimuth and log distance with the moments of `state` to first order; the velocity stays
    Cartesian.  The noise of a row is that on its own ray, at the distance of the prediction.
    """
    sensor = world.sensors.xy[rows.sensor[0]]
    away = state.mean[:2] - sensor
    distance, azimuth = float(np.hypot(*away)), float(np.arctan2(away[1], away[0]))
    if distance < NEAREST or distance**2 < float(np.linalg.eigvalsh(state.covariance[:2, :2])[0]):
        return None
    # Prediction in azimuth, log distance and velocity
    J = np.eye(4)
    J[:2, :2] = np.linalg.inv(_outwards(azimuth, distance))
    P = J @ state.covariance @ J.T
    mean = np.array([azimuth, np.log(distance), *state.mean[2:]])
    # Rows one by one, as their noise is independent
    for k, measured in enumerate(azimuths(rows, world)):
        row = rows.take(np.array([k]))
        frame = _outwards(float(measured), distance)
        H, R = linearised(sensor + frame[:, 1], row, world)
        variance = float(R[0] / (H[0] @ frame[:, 0]) ** 2)
        gain = P[:, 0] / (P[0, 0] + variance)
        mean = mean + gain * float(wrap_angle(np.array([measured - mean[0]]))[0])
        left = np.eye(4)
        left[:, 0] -= gain
        P = left @ P @ left.T + variance * np.outer(gain, gain)
    back = np.eye(4)
    back[:2, :2] = _outwards(mean[0], float(np.exp(mean[1])))
    return Gaussian(np.array([*(sensor + back[:2, 1]), *mean[2:]]), symmetric(back @ P @ back.T))


def _outwards(azimuth: float, distance: float) -> Floats:
    """(2, 2) derivatives of the place by azimuth and by log distance; the second column is the place itself."""
    c, s = np.cos(azimuth), np.sin(azimuth)
    return distance * np.array([[-s, c], [c, s]])
