"""Ornstein-Uhlenbeck velocity: motion with the first two moments of a random waypoint walk.

A target of [Ercan] Sec. 4.1 keeps its velocity until it chooses another destination.  Where choices come at random,
1 / tau in a unit of time, and destinations lie in all directions, its velocity v has mean 0, variance
V = speed^2 / 2 per axis, and the correlation exp(-t / tau).  The Gaussian process of these moments is

    dx = v dt + sigma_v dw,    dv = -v / tau dt + sqrt(2 V / tau) dw'

(velocity of Ornstein and Uhlenbeck), which a Kalman filter takes exactly.  Walls and destinations have no place in it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats

SMALL = 1e-2
"""Below this time over tau the variance of the position is summed as a series: its closed form loses its digits."""


class OrnsteinUhlenbeck(NamedTuple):
    """Motion model in the plane with an exponentially correlated velocity; the state is x, y, vx, vy."""

    speed: float  # usual speed [length/s], > 0
    turn_s: float  # tau, mean time between changes of direction [s], > 0
    sigma_v: float  # white noise of the position per axis, accumulated over 1 s [length]

    @property
    def velocity_variance(self) -> float:
        """Return the stationary variance of the velocity per axis, speed^2 / 2."""
        return 0.5 * self.speed**2

    def transition(self, dt: float) -> tuple[Floats, Floats]:
        """Return the (4, 4) transition matrix F and process-noise covariance Q over a time dt >= 0 [s]."""
        tau, V = self.turn_s, self.velocity_variance
        u = dt / tau
        e, lost = math.exp(-u), -math.expm1(-u)
        series = u**3 * (2.0 / 3.0 - u / 2.0 + 7.0 * u**2 / 30.0)
        variance = series if u < SMALL else 2.0 * u - 3.0 + 4.0 * e - e * e
        move = tau * lost
        F = np.array([[1.0, 0.0, move, 0.0], [0.0, 1.0, 0.0, move], [0.0, 0.0, e, 0.0], [0.0, 0.0, 0.0, e]])
        x, v = V * tau**2 * variance + self.sigma_v**2 * dt, -V * math.expm1(-2.0 * u)
        c = V * tau * lost**2
        return F, np.array([[x, 0.0, c, 0.0], [0.0, x, 0.0, c], [c, 0.0, v, 0.0], [0.0, c, 0.0, v]])
