"""Interaction of targets that touch: magnetic repulsion and inertia, [Qu] Sec. 3.3, Eqs. 7 and 8.

[Qu] leaves the constants and the inertia model open; the forms here are those of the project's notes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel

from .motion import mean_into

AT_REST = 0.5
"""Displacements shorter than this [px] have no direction."""


class Interaction(NamedTuple):
    """Constants of the interaction likelihood of trackers that touch."""

    alpha: float  # of Eq. 8, >= 1
    sigma: float  # Sigma of Eq. 8 over the mean of the two radii along the line between the centres
    iterations: int  # K of Alg. 1
    inertia: float  # g, weight gained by moving as before
    angle: float  # spread of directions [rad]
    speed: float  # spread of speeds [px a frame]


@kernel
def add_inertia(log_weights: Floats, particles: Floats, previous: Floats, before: Floats, model: Interaction) -> None:
    """Add the logarithms of the inertia weights 1 + g exp(-dtheta^2 / angle^2) exp(-(|v| - |v_ref|)^2 / speed^2).

    dtheta is the angle between v, the displacement to a particle, and v_ref; it is 0 where one of
    the two is at most `AT_REST`.

    Args:
        log_weights: (N,) changed in place.
        particles: (N, 5).
        previous: (2,) the centre in the last frame.
        before: (2,) v_ref, the displacement to expect [px].
        model: the constants.
    """
    usual = math.hypot(before[0], before[1])
    for p in range(particles.shape[0]):
        vx, vy = particles[p, 0] - previous[0], particles[p, 1] - previous[1]
        speed, turn = math.hypot(vx, vy), 0.0
        if min(speed, usual) > AT_REST:
            turn = math.acos(min(max((vx * before[0] + vy * before[1]) / (speed * usual), -1.0), 1.0))
        far = (turn / model.angle) ** 2 + ((speed - usual) / model.speed) ** 2
        log_weights[p] += math.log(1.0 + model.inertia * math.exp(-far))


@kernel
def repulsion(x: float, y: float, mine: Floats, estimate: Floats, touching: Bools, model: Interaction) -> float:
    """Interaction weight of a particle, [Qu] Eq. 8: the product of 1 - exp(-l^2 / Sigma^2) / alpha over its neighbours.

    l is the distance of the particle's centre from the neighbour's estimate.

    Args:
        x: centre of the particle, to the right [px].
        y: centre of the particle, down [px].
        mine: (5,) estimate of its tracker.
        estimate: (n, 5).
        touching: (n,) neighbours that touch its tracker.
        model: the constants.
    """
    out = 1.0
    for j in range(touching.shape[0]):
        if touching[j]:
            sigma = model.sigma * half_reach(mine, estimate[j])
            l2 = (x - estimate[j, 0]) ** 2 + (y - estimate[j, 1]) ** 2
            out *= 1.0 - math.exp(-l2 / (sigma * sigma)) / model.alpha
    return out


@kernel
def half_reach(one: Floats, other: Floats) -> float:
    """Mean of how far two ellipses (5,) reach along the line between their centres."""
    theta = math.atan2(other[1] - one[1], other[0] - one[0])
    total = 0.0
    for e in (one, other):
        total += math.hypot(e[2] * math.cos(theta - e[4]), e[3] * math.sin(theta - e[4]))
    return 0.5 * total


@kernel
def repel_into(
    weights: Floats, estimate: Floats, particles: Floats, rows: Ints, touching: Bools, model: Interaction
) -> None:
    """Iterate the interaction of the trackers of a view K times, each time with the estimates of the time before.

    Only the weights phi^K of the last iteration are applied ([Qu] Alg. 1).  Where they would
    make all weights of a tracker 0, its weights stay as they were.

    Args:
        weights: (n, N) summing to 1; those of `rows` are changed in place.
        estimate: (n, 5) means by these weights; those of `rows` are changed in place.
        particles: (n, N, 5).
        rows: trackers of the view.
        touching: (n, n) see `Neighbours`.
        model: the constants.
    """
    base = weights.copy()
    for _ in range(model.iterations):
        before = estimate.copy()
        for i in rows:
            if not touching[i].any():
                continue
            total = 0.0
            for p in range(particles.shape[1]):
                x, y = particles[i, p, 0], particles[i, p, 1]
                weights[i, p] = base[i, p] * repulsion(x, y, before[i], before, touching[i], model)
                total += weights[i, p]
            if total > 0.0:
                weights[i] /= total
            else:
                weights[i] = base[i]
            mean_into(estimate[i], particles[i], weights[i])
