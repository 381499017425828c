"""How long people are there before their first place, and after the last one, by the looks that would have shown them.

Moments need not be equally far apart: in a pause of the recording many come and go, and nobody looks.
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.jit import kernel

LEAST_UNSEEN = 1e-4
"""Whoever is missed so long with a lower probability is not there any longer."""
LEAST_RATE = 1e-9
"""Rate of leaving of those who never leave [1/s]."""


@kernel
def waiting(time: Floats, looked: Floats, moment: Ints, miss: Floats, rate: Floats, step: int) -> tuple[Floats, Floats]:
    """Expected time [s] that people are there, and missed by all looks, before or after the moment of a place.

    Args:
        time: (T,) moments [s].
        looked: (T + 1, C) looks of each camera before each moment.
        moment: (n,) of each place.
        miss: (n, C) log of the probability that a camera misses somebody there.
        rate: (n,) at which people leave, or, back in time, have come [1/s].
        step: -1: before the moment; 1: after it.

    Returns:
        The time (n,), and the probability (n,) that they are there, and missed, as long as the recording goes.
    """
    n, T = moment.shape[0], time.shape[0]
    total, rest = np.zeros(n), np.zeros(n)
    for k in range(n):
        leaves = max(rate[k], LEAST_RATE)
        t, there = moment[k], 1.0
        while 0 <= t + step < T:
            gone = -math.expm1(-leaves * abs(time[t + step] - time[t]))
            total[k] += there * gone / leaves
            t += step
            log = 0.0
            for c in range(miss.shape[1]):
                log += miss[k, c] * (looked[t + 1, c] - looked[t, c])
            there *= (1.0 - gone) * math.exp(log)
            if there < LEAST_UNSEEN:
                there = 0.0
                break
        rest[k] = there
    return total, rest
