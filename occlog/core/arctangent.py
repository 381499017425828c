"""The arctangent of two arguments without branches, so that loops over it are vectorised by the compiler.

Angles are folded to an eighth of a turn and half of that, where atan(t) = t P(t^2) with P of
degree 10, interpolated at Chebyshev's points.  The error is below 1e-15 everywhere.
"""

from __future__ import annotations

import math

from .jit import array_kernel

HALF_EIGHTH = math.sqrt(2.0) - 1.0
"""tan(pi / 8)."""


@array_kernel
def fast_atan2(y: float, x: float) -> float:
    """Azimuth [rad, -pi..pi] of (x, y) within 1e-15; 0 for (0, 0); finite arguments only."""
    ax, ay = abs(x), abs(y)
    large, small = max(ax, ay), min(ax, ay)
    # atan(t) = pi/4 + atan((t - 1) / (t + 1))
    folded = small > HALF_EIGHTH * large
    above = small - large if folded else small
    below = small + large if folded else large
    t = above / (below if below > 0.0 else 1.0)
    z = t * t
    p = 0.021133752033748357 * z - 0.043479198390465365
    p = p * z + 0.0568830340363325
    p = p * z - 0.066402251735395
    p = p * z + 0.07689952488233016
    p = p * z - 0.09090773003240828
    p = p * z + 0.11111106177375227
    p = p * z - 0.14285714180900647
    p = p * z + 0.19999999998854168
    p = p * z - 0.33333333333328435
    angle = t + t * z * p
    angle = angle + 0.25 * math.pi if folded else angle
    angle = 0.5 * math.pi - angle if ay > ax else angle
    angle = math.pi - angle if x < 0.0 else angle
    return -angle if y < 0.0 else angle
