"""Error function and arctangent without branches, so that the compiler vectorises loops over them.

erf(x) = x P(x^2) / Q(x^2) with P and Q of degree 7, fitted to the least maximal error over
|x| <= 4.6; outside it counts as +-1.  The error is below 1e-10 everywhere.

atan2: angles are folded to an eighth of a turn and half of that, where atan(t) = t P(t^2) with P of
degree 10, interpolated at Chebyshev's points.  The error is below 1e-15 everywhere.
"""

from __future__ import annotations

import math

from .jit import array_kernel

HALF_EIGHTH = math.sqrt(2.0) - 1.0
"""tan(pi / 8)."""


@array_kernel
def fast_atan2(y: float, x: float) -> float:
    """Return the azimuth [rad, -pi..pi] of (x, y) within 1e-15; 0 for (0, 0); for finite arguments only."""
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


EDGE = 4.6
"""Argument above which erf counts as 1; erfc(4.6) = 8e-11."""


@array_kernel
def fast_erf(x: float) -> float:
    """Return the error function erf(x) with an error below 1e-10; NaN for NaN."""
    x = EDGE if x > EDGE else x
    x = -EDGE if x < -EDGE else x
    t = x * x
    p = 2.802750408941312e-09 * t + 9.631165514750929e-07
    p = p * t + 3.490777735056166e-05
    p = p * t + 6.396099896763068e-04
    p = p * t + 6.701406033769141e-03
    p = p * t + 6.400436560458334e-02
    p = p * t + 2.3582583634965334e-01
    p = p * t + 1.1283791661666842
    q = 7.907125568129946e-08 * t + 6.863903430993107e-06
    q = q * t + 1.5517943581152353e-04
    q = q * t + 2.2163359293082795e-03
    q = q * t + 2.1348308481710588e-02
    q = q * t + 1.374986514042587e-01
    q = q * t + 5.42328523710236e-01
    q = q * t + 1.0
    return x * p / q
