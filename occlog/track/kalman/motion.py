"""Motion with a velocity that is forgotten: the first two moments of a walk by waypoints, and its smoother.

A target of [Ercan] Sec. 4.1 keeps its velocity until it chooses another destination.  Where choices come at random,
1 / tau in a unit of time, and destinations lie in all directions, its velocity v has mean 0, variance
V = speed^2 / 2 per axis, and the correlation exp(-t / tau).  The Gaussian process of these moments is

    dx = v dt + sigma_v dw,    dv = -v / tau dt + sqrt(2 V / tau) dw'

(velocity of Ornstein and Uhlenbeck), which a Kalman filter takes exactly.  Walls and destinations have no place in it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.track.interface import Past

from .config import WalkConfig

SMALL = 1e-2
"""Below this time over tau the variance of the place is summed as a series: its closed form loses its digits."""


class Gaussian(NamedTuple):
    """What is known of a target: x, y, vx, vy."""

    mean: Floats  # (4,)
    covariance: Floats  # (4, 4)


class Link(NamedTuple):
    """A filter after a scan, for the way back."""

    after: Gaussian
    dt: float  # since the link before [s]
    begun: bool  # anew: nothing before it counts


def transition(dt: float, config: WalkConfig) -> tuple[Floats, Floats]:
    """(4, 4) matrices F and Q of the motion over a time dt >= 0 [s]."""
    tau, V = config.turn_s, velocity_variance(config)
    u = dt / tau
    e, lost = math.exp(-u), -math.expm1(-u)
    series = u**3 * (2.0 / 3.0 - u / 2.0 + 7.0 * u**2 / 30.0)
    place = series if u < SMALL else 2.0 * u - 3.0 + 4.0 * e - e * e
    F1 = np.array([[1.0, tau * lost], [0.0, e]])
    across = V * tau * lost**2
    Q1 = np.array([[V * tau**2 * place + config.sigma_v**2 * dt, across], [across, -V * math.expm1(-2.0 * u)]])
    both = np.eye(2)
    return np.kron(F1, both), np.kron(Q1, both)


def velocity_variance(config: WalkConfig) -> float:
    """Variance of the velocity per axis, of a target that was not seen yet."""
    return 0.5 * config.speed**2


def predicted(state: Gaussian, dt: float, config: WalkConfig) -> Gaussian:
    """The state a time dt >= 0 later."""
    F, Q = transition(dt, config)
    return Gaussian(F @ state.mean, F @ state.covariance @ F.T + Q)


def smooth(traces: Sequence[Link], config: WalkConfig) -> list[Past]:
    """Return past states by the recursion of Rauch, Tung and Striebel (1965), from the last link to the first."""
    out: list[Past] = []
    later, ahead = traces[-1].after, None
    for k in range(len(traces) - 1, -1, -1):
        own = traces[k].after
        if ahead is None or ahead.begun:
            later = own
        else:
            F, Q = transition(ahead.dt, config)
            P = F @ own.covariance @ F.T + Q
            # Gain: P_k F' (F P_k F' + Q)^-1
            G = np.linalg.solve(P, F @ own.covariance).T
            covariance = own.covariance + G @ (later.covariance - P) @ G.T
            later = Gaussian(own.mean + G @ (later.mean - F @ own.mean), 0.5 * (covariance + covariance.T))
        out.append(Past(later.mean[:2], later.mean[2:], later.covariance[:2, :2]))
        ahead = traces[k]
    return out[::-1]
