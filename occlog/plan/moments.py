"""The second moments of a walk, counted.

Whoever walks straight on at speed v, turns r times a second to anywhere and has noise s of the place takes steps that
have, with a = (1 - exp(-r dt)) / r,

    E[d_0 . d_k] = v^2 a^2 exp(-r (k - 1) dt),   k = 1, 2, ...
    E[d_0 . d_0] = 2 v^2 (dt - a) / r + 2 s^2 dt

so that r follows from where that has fallen to half of its value at k = 1, v from that value, and s from the steps
alone.  Walkers who turn at walls, or aside for each other, are counted with all of it.
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats

from .filtering import Motion


def moments_of(people: Floats, dt: float) -> Motion:
    """The motion whose steps agree as well as those of a walk.

    Args:
        people: (K, n, 2) their places, K >= 3.
        dt: between two steps [s].
    """
    steps = np.diff(people, axis=0)
    alone, next_one = _agreement(steps, 0), _agreement(steps, 1)
    if next_one <= 0.0:  # no step says anything of the next
        return Motion(speed=0.0, turns=1.0 / dt, sigma=math.sqrt(alone / (2.0 * dt)))
    turns = math.log(2.0) / (_half(steps, next_one) * dt)
    a = -math.expm1(-turns * dt) / turns
    variance = next_one / a**2
    noise = (alone - 2.0 * variance * (dt - a) / turns) / (2.0 * dt)
    return Motion(math.sqrt(variance), turns, math.sqrt(max(noise, 0.0)))


def _agreement(steps: Floats, lag: int) -> float:
    """Mean inner product of steps that are so many apart."""
    return float(np.mean(np.einsum("tni,tni->tn", steps[: len(steps) - lag], steps[lag:])))


def _half(steps: Floats, whole: float) -> float:
    """How many steps after the next one the agreement is half of `whole`: between two lags, in proportion.

    The lag is found by doubling and halving; a walk too short for it is taken at its longest lag.
    """
    low, at_low, high, longest = 1, whole, 2, len(steps) - 1
    while (at_high := _agreement(steps, min(high, longest))) > 0.5 * whole:
        if high >= longest:
            return (longest - 1) * math.log(2.0) / max(math.log(whole / at_high), 1e-3)
        low, at_low, high = high, at_high, 2 * high
    high = min(high, longest)
    while high - low > 1:
        middle = (low + high) // 2
        if (at := _agreement(steps, middle)) > 0.5 * whole:
            low, at_low = middle, at
        else:
            high, at_high = middle, at
    return low - 1 + (at_low - 0.5 * whole) / (at_low - at_high)
