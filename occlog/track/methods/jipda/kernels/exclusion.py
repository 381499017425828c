"""Exclusion prior: two people cannot be at the same position at one time.

The density of two people's positions is multiplied by psi(d) = 1 - exp(-d^2 / (2 s^2)), with d their distance: a Markov
random field motion prior (Khan, Balch and Dellaert 2005, IEEE T-PAMI 27(11), Sec. 4), here in closed form. psi times a
Gaussian is the difference of two Gaussians, and the rest of a state follows its position by linear regression. This
distinguishes two people who meet and turn back from two who pass, since the latter would have to walk through each
other.
"""

from __future__ import annotations

import math

from occlog.array_types import Floats
from occlog.core.numerics.jit import kernel

EXCLUSION_GATE_CHI2 = 16.0
"""Maximum squared distance of pairs, in variances of their difference."""


@kernel
def apply_exclusion(
    mean: Floats, covariance: Floats, weight: Floats, position: Floats, spread: Floats, existence: Floats, s: float
) -> None:
    """Multiply the states of all pairs of people by the exclusion prior 1 - exp(-d^2 / (2 s^2)), in place.

    Args:
        mean: (N, A, n) state means of N people by A motion models, position x, y first; changed.
        covariance: (N, A, n, n) covariances of the states; changed.
        weight: (N, A) model weights, multiplied by the share of the density that is left; changed.
        position: (N, 2) positions of the same people, from all models together.
        spread: (N, 2, 2) covariances of these positions.
        existence: (N,) existence probabilities, < 1.
        s: exclusion radius in the unit of the positions, > 0.
    """
    s2 = s * s
    for i in range(position.shape[0]):
        for j in range(position.shape[0]):
            square = (position[i, 0] - position[j, 0]) ** 2 + (position[i, 1] - position[j, 1]) ** 2
            variance = spread[i, 0, 0] + spread[i, 1, 1] + spread[j, 0, 0] + spread[j, 1, 1] + s2
            if i == j or square > EXCLUSION_GATE_CHI2 * variance:
                continue
            for a in range(mean.shape[1]):
                weight[i, a] *= _without(mean[i, a], covariance[i, a], position[j], spread[j], existence[j], s2)


@kernel
def _without(mean: Floats, covariance: Floats, position: Floats, spread: Floats, existence: float, s2: float) -> float:
    """Multiply a Gaussian state by 1 - p exp(-d^2 / (2 s^2)), d the distance to another person; match its moments.

    Return the share of the density that is left, 0 to 1.

    Args:
        mean: (n,) state, position first; changed in place.
        covariance: (n, n) covariance of the state; changed in place.
        position: (2,) mean position of the other person.
        spread: (2, 2) covariance of this position.
        existence: p, existence probability of the other person.
        s2: square of s.
    """
    # r = x_i - x_j has mean (x, y) and covariance P; times exp(-r^2 / 2 s^2): s^2 G r and s^2 G P, G = (P + s^2)^-1
    x, y = mean[0] - position[0], mean[1] - position[1]
    xx, xy, yy = (
        covariance[0, 0] + spread[0, 0],
        covariance[0, 1] + spread[0, 1],
        covariance[1, 1] + spread[1, 1],
    )
    det = (xx + s2) * (yy + s2) - xy * xy
    g_xx, g_xy, g_yy = (yy + s2) / det, -xy / det, (xx + s2) / det
    Z = existence * s2 / math.sqrt(det) * math.exp(-0.5 * (g_xx * x * x + 2.0 * g_xy * x * y + g_yy * y * y))
    near_x, near_y = s2 * (g_xx * x + g_xy * y), s2 * (g_xy * x + g_yy * y)
    near_xx = s2 * (g_xx * xx + g_xy * xy)
    near_xy = s2 * (g_xx * xy + g_xy * yy)
    near_yy = s2 * (g_xy * xy + g_yy * yy)
    # The difference: 1 - Z of the density is left
    left = 1.0 - Z
    to_x, to_y = (x - Z * near_x) / left, (y - Z * near_y) / left
    d_xx = (xx + x * x - Z * (near_xx + near_x * near_x)) / left - to_x * to_x - xx
    d_xy = (xy + x * y - Z * (near_xy + near_x * near_y)) / left - to_x * to_y - xy
    d_yy = (yy + y * y - Z * (near_yy + near_y * near_y)) / left - to_y * to_y - yy
    # Regression of the state on r: K = C[:, :2] P^-1
    det = xx * yy - xy * xy
    i_xx, i_xy, i_yy = yy / det, -xy / det, xx / det
    n = mean.shape[0]
    for row in range(n):
        across, down = covariance[row, 0], covariance[row, 1]
        mean[row] += (across * i_xx + down * i_xy) * (to_x - x) + (across * i_xy + down * i_yy) * (to_y - y)
    gain = covariance[:, :2].copy()
    for row in range(n):
        across, down = gain[row, 0], gain[row, 1]
        gain[row, 0], gain[row, 1] = across * i_xx + down * i_xy, across * i_xy + down * i_yy
    for row in range(n):
        for column in range(row, n):
            total = gain[row, 0] * (d_xx * gain[column, 0] + d_xy * gain[column, 1])
            total += gain[row, 1] * (d_xy * gain[column, 0] + d_yy * gain[column, 1])
            covariance[row, column] += total
            if column > row:
                covariance[column, row] = covariance[row, column]
    return left
