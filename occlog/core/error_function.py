"""The error function without branches, so that loops over it are vectorised by the compiler.

erf(x) = x P(x^2) / Q(x^2) with P and Q of degree 7, fitted to the least maximal error over
|x| <= 4.6; outside it is +-1.  The error is below 1e-10 everywhere.
"""

from __future__ import annotations

from .jit import array_kernel

EDGE = 4.6
"""From here on erf counts as 1; erfc(4.6) = 8e-11."""


@array_kernel
def fast_erf(x: float) -> float:
    """erf(x) within 1e-10; NaN stays NaN."""
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
