"""Which places a walking crowd hides from a sensor: the discs of [Ercan] Fig. 3, with a height where it is known."""

from __future__ import annotations

import math

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel


@kernel
def hide_behind_crowd(
    seen: Bools,
    ways: Floats,
    origin: Floats,
    people: Floats,
    first: Ints,
    own: Ints,
    diameter: float,
    least_share: float,
) -> None:
    """Set `seen` to false, in place, where a disc stands between sensor and target.

    A disc hides the target if its centre is in the rectangle from the sensor to the target, as wide as the disc.

    Args:
        seen: (N, T) what the sensor would see without a crowd.
        ways: (N, T, 2) of targets.
        origin: (2,) the sensor.
        people: (K, n, 2) walk of all people.
        first: (N,) step of that walk at which each target's way begins.
        own: (N,) which of the people the target is, who does not hide itself; -1: none of them.
        diameter: of discs.
        least_share: of the sight line, from the sensor, beyond which it is low enough for heads; 0: everywhere.
    """
    half = 0.5 * diameter
    for i in range(ways.shape[0]):
        for t in range(ways.shape[1]):
            if not seen[i, t]:
                continue
            x, y = ways[i, t, 0], ways[i, t, 1]
            dx, dy = x - origin[0], y - origin[1]
            r = math.hypot(dx, dy)
            if r == 0.0:
                continue
            dx, dy = dx / r, dy / r
            k = first[i] + t
            for j in range(people.shape[1]):
                if j == own[i]:
                    continue
                px, py = people[k, j, 0] - origin[0], people[k, j, 1] - origin[1]
                if abs(dx * py - dy * px) >= half:
                    continue
                along = dx * px + dy * py
                if 0.0 < along < r and along >= least_share * r:
                    seen[i, t] = False
                    break
