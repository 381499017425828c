"""Likelihood of a scan for a target at given places among moving occluders with priors: [Ercan] Sec. 4.2-4.3.

A camera sees a place in its view with probability P (`occlog.core.occlusion.hidden`).  Let a be
its factor for a place that it sees (A in `occlog.filtering.likelihood.directions`) and b that for a place
hidden by an occluder: the floor of a reading, and 1 where it reports nothing or
candidates.  Cameras then count, by `Occlusion.probability`, with

    INDEPENDENT        prod_i (P_i a_i + (1 - P_i) b_i)
    RECURSION, EXACT   sum over subsets Q of the cameras of p_Q prod_Q (a_i - b_i) prod_not-Q b_i

p_Q being the probability that no camera of Q is blocked, by Eq. 8 or without its
assumption.  With P_D = 1 and P_F = 0 this is Eq. 9.  P_i and 1 - P_i count as no less than
`Occlusion.floor`, and with the exponent `Occlusion.temper`; a sum over subsets counts as no less than `floor` times
prod_i max(a_i, b_i).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.core.numerics.jit import kernel
from occlog.core.occlusion.hidden_grid import make_grid, unhidden_over
from occlog.core.occlusion.hidden_together import add_joint
from occlog.core.occlusion.priors import Priors
from occlog.core.sight.visibility import Sensors, seen_from

from .directions import Detection, Noise, PackedScan, factors, multiply_into


class Occlusion(NamedTuple):
    """How moving occluders are taken into account.

    Attributes:
        probability: INDEPENDENT, RECURSION or EXACT.
        form: of q: PRINTED (Eq. 7), IMPROVED or QUADRATURE.
        floor: least probability that counts, 0 to 1.
        far: standard deviations at which a normal prior counts as over.
        temper: exponent of P_i and of 1 - P_i, INDEPENDENT only.  The errors of a prior last for many scans, in which
            the same evidence would be counted anew; with an exponent below 1 it counts as often as it is new.
    """

    probability: int
    form: int
    floor: float
    far: float
    temper: float = 1.0


INDEPENDENT, RECURSION, EXACT = 1, 2, 3


def log_likelihood_among(
    xy: Floats,
    scan: PackedScan,
    sensors: Sensors,
    noise: Noise,
    model: Detection,
    free: Bools,
    priors: Priors,
    occlusion: Occlusion,
) -> Floats:
    """(L,) log-likelihoods of a scan for targets at (L, 2) places; -inf where it is impossible.

    Args:
        xy: (L, 2) places.
        scan: the measurements.
        sensors: where sensors stand and what hides things from them.
        noise: their noise.
        model: probabilities.
        free: (L,) places where a target can be; -inf elsewhere.
        priors: of the moving occluders.
        occlusion: how they count.
    """
    # Separate kernels, so that only those that are used are compiled.
    if occlusion.probability == INDEPENDENT:
        return np.asarray(_independent(xy, scan, sensors, noise, model, free, priors, occlusion))
    total, a, b, assigned = _apart(xy, scan, sensors, noise, model, free)
    add_joint(
        total=total,
        xy=xy,
        sensor=scan.sensor,
        a=a,
        b=b,
        assigned=assigned,
        places=sensors.xy,
        priors=priors,
        exact=occlusion.probability == EXACT,
        form=occlusion.form,
        floor=occlusion.floor,
        far=occlusion.far,
    )
    return np.asarray(total)


@kernel
def _independent(
    xy: Floats,
    scan: PackedScan,
    sensors: Sensors,
    noise: Noise,
    model: Detection,
    free: Bools,
    priors: Priors,
    occlusion: Occlusion,
) -> Floats:
    """`log_likelihood_among` with cameras that count as independent of each other given the place."""
    L = xy.shape[0]
    total, product = np.zeros(L), np.ones(L)
    grid = make_grid(xy, free, priors, occlusion.far)
    for k in range(scan.sensor.shape[0]):
        i = scan.sensor[k]
        seen = seen_from(xy, i, sensors)
        factor, hidden = factors(xy, k, scan, sensors, noise, model, seen)
        if sensors.cos2[i] >= 0.0:  # a camera: people do not hide sounds from arrays
            # P_i at the places that the camera is assigned to, then P_i a_i + (1 - P_i) b_i
            rows = np.flatnonzero(seen & free)
            x0, y0 = sensors.xy[i, 0], sensors.xy[i, 1]
            share = unhidden_over(grid, xy, rows, x0, y0, priors, occlusion.form, occlusion.far)
            for m in range(rows.shape[0]):
                clear, blocked = max(share[m], occlusion.floor), max(1.0 - share[m], occlusion.floor)
                if occlusion.temper < 1.0:
                    clear, blocked = clear**occlusion.temper, blocked**occlusion.temper
                factor[rows[m]] = clear * factor[rows[m]] + blocked * hidden
        multiply_into(product, total, factor)
    for p in range(L):
        total[p] = total[p] + np.log(product[p]) if free[p] else -np.inf
    return total


@kernel
def _apart(
    xy: Floats, scan: PackedScan, sensors: Sensors, noise: Noise, model: Detection, free: Bools
) -> tuple[Floats, Floats, Floats, Bools]:
    """Split a scan into what moving occluders cannot hide and what they can.

    Returns:
        (L,) log-likelihoods of arrays, and of cameras that are not assigned to a place.
        (n, L) a and (n,) b of all looks.
        (n, L) whether a look's camera is assigned to a place, so that its factor is not in the first.
    """
    n, L = scan.sensor.shape[0], xy.shape[0]
    total, product = np.zeros(L), np.ones(L)
    a, b, assigned = np.empty((n, L)), np.ones(n), np.zeros((n, L), dtype=np.bool_)
    for k in range(n):
        i = scan.sensor[k]
        seen = seen_from(xy, i, sensors)
        factor, b[k] = factors(xy, k, scan, sensors, noise, model, seen)
        a[k] = factor
        if sensors.cos2[i] >= 0.0:
            for p in range(L):
                if seen[p] and free[p]:
                    assigned[k, p] = True
                    factor[p] = 1.0
        multiply_into(product, total, factor)
    for p in range(L):
        total[p] = total[p] + np.log(product[p]) if free[p] else -np.inf
    return total, a, b, assigned
