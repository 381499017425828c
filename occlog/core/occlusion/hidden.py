"""Probability that no moving occluder hides a place from a camera: fast forms of [Ercan] Eq. 7.

For each place x, P = prod_j (1 - q_j) over the M priors, q_j the probability that
occluder j's centre lies in the rectangle from the camera to x with the occluder's
diameter as its width.  With u the unit vector from the camera to x, v across it, a prior
N(mu, Sigma) has across the sight line mean b = v.mu and variance s^2 = v' Sigma v, and
along it, given the offset w across, mean a + rho (w - b) with rho = u' Sigma v / s^2 and
variance det Sigma / s^2.  Eq. 7 takes w = 0; the improved form takes w at the mean of the
truncated normal between -D/2 and D/2.  Both are exact for isotropic priors (rho = 0).

What is avoided: priors that are more than `far` standard deviations from every sight line
of the cloud, behind the camera or beyond all places are left out, and error functions
that count as 1 for the whole cloud are not computed.  (`far` is 5.5, where the tail is
2e-8, or less where a proposal only has to be near.)
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.jit import array_kernel
from occlog.core.numerics.special_functions import fast_erf

from .blocking_shares import normal_between, shares
from .priors import Priors

PRINTED, IMPROVED, QUADRATURE = 0, 1, 2
ROOT_HALF = math.sqrt(0.5)
ROUND = 1e-9
"""A prior whose eigenvalues differ by less, relative, is isotropic."""


class Rays(NamedTuple):
    """Sight lines from a camera to n places, and where they all are."""

    ux: Floats  # (n,) unit vectors
    uy: Floats
    r: Floats  # (n,) lengths
    gx: float  # middle direction
    gy: float
    nearest: float  # of r
    farthest: float
    cos: float  # least cosine and greatest sine of the angles from the middle direction
    sin: float


@array_kernel
def rays_to(xy: Floats, rows: Ints, x0: float, y0: float) -> Rays:
    """Sight lines from (x0, y0) to the places `xy[rows]`."""
    n = rows.shape[0]
    ux, uy, r = np.empty(n), np.empty(n), np.empty(n)
    gx, gy = 0.0, 0.0
    for k in range(n):
        dx, dy = xy[rows[k], 0] - x0, xy[rows[k], 1] - y0
        r[k] = math.sqrt(dx * dx + dy * dy)
        scale = 1.0 / r[k] if r[k] > 0.0 else 0.0
        ux[k], uy[k] = dx * scale, dy * scale
        gx += ux[k]
        gy += uy[k]
    size = math.sqrt(gx * gx + gy * gy)
    gx, gy = (gx / size, gy / size) if size > 0.0 else (1.0, 0.0)
    nearest, farthest, cos, sin = np.inf, 0.0, 1.0, 0.0
    for k in range(n):
        nearest, farthest = min(nearest, r[k]), max(farthest, r[k])
        cos = min(cos, gx * ux[k] + gy * uy[k])
        sin = max(sin, abs(gx * uy[k] - gy * ux[k]))
    return Rays(ux, uy, r, gx, gy, nearest, farthest, cos, sin)


@array_kernel
def blocking_into(q: Floats, rays: Rays, x0: float, y0: float, j: int, priors: Priors, form: int, far: float) -> bool:
    """Probabilities (n,) that occluder j hides the places at the ends of the rays; False, and `q` as it was, for none.

    Args:
        q: (n,) filled.
        rays: from (x0, y0).
        x0: the camera's position.
        y0: the same.
        j: row of the prior.
        priors: all of them.
        form: PRINTED, IMPROVED or QUADRATURE; only priors that are neither isotropic nor degenerate depend on it.
        far: standard deviations at which a normal distribution counts as over.
    """
    mx, my = priors.mean[j, 0] - x0, priors.mean[j, 1] - y0
    sigma, radius = priors.sigma[j], priors.radius[j]
    # Gate: the prior's mean along and across the middle ray, and how much the other rays may change both
    along, across = rays.gx * mx + rays.gy * my, rays.gx * my - rays.gy * mx
    slack_along = abs(along) * (1.0 - rays.cos) + abs(across) * rays.sin
    slack_across = abs(across) * (1.0 - rays.cos) + abs(along) * rays.sin
    reach = extent(j, priors, far)
    if abs(across) - slack_across > reach + radius:
        return False
    if along + slack_along < -reach or along - slack_along > rays.farthest + reach:
        return False
    # Isotropic priors: Eq. 7 is exact
    if (
        form != QUADRATURE
        and priors.first[j] == priors.first[j + 1]
        and sigma > 0.0
        and sigma - priors.minor[j] <= ROUND * sigma
    ):
        before = along - slack_along > reach  # all of it is in front of the camera
        behind = along + slack_along < rays.nearest - reach  # all of it is nearer than every place
        isotropic_into(q, rays.ux, rays.uy, rays.r, mx, my, radius, ROOT_HALF / sigma, before, behind)
        return True
    # Known position: inside the rectangle or not
    if priors.first[j] == priors.first[j + 1] and sigma == 0.0:
        for k in range(q.shape[0]):
            a, b = rays.ux[k] * mx + rays.uy[k] * my, rays.ux[k] * my - rays.uy[k] * mx
            q[k] = 1.0 if (abs(b) <= radius) & (a >= 0.0) & (a <= rays.r[k]) & (rays.r[k] > 0.0) else 0.0
        return True
    # All others: place by place
    for k in range(q.shape[0]):
        ux, uy, r = rays.ux[k], rays.uy[k], rays.r[k]
        a, b = ux * mx + uy * my, ux * my - uy * mx
        near = abs(b) <= reach + radius and -reach <= a <= r + reach
        q[k] = hiding(ux, uy, r, x0, y0, j, priors, form) if near else 0.0
    return True


@array_kernel
def unhidden(xy: Floats, rows: Ints, x0: float, y0: float, priors: Priors, form: int, far: float) -> Floats:
    """(n,) probabilities P = prod_j (1 - q_j) that no occluder hides the places `xy[rows]` from a camera at (x0, y0).

    See `blocking_into` for the arguments; occluders are independent of each other.
    """
    n = rows.shape[0]
    share = np.ones(n)
    if n == 0 or priors.sigma.shape[0] == 0:
        return share
    rays, q = rays_to(xy, rows, x0, y0), np.empty(n)
    for j in range(priors.sigma.shape[0]):
        if blocking_into(q, rays, x0, y0, j, priors, form, far):
            for k in range(n):
                share[k] *= 1.0 - q[k]
    return share


@array_kernel
def hiding_all(xy: Floats, rows: Ints, x0: float, y0: float, priors: Priors, form: int, far: float) -> Floats:
    """(M, n) probabilities q that each occluder hides the places `xy[rows]` from a camera at (x0, y0)."""
    n = rows.shape[0]
    out = np.zeros((priors.sigma.shape[0], n))
    if n == 0:
        return out
    rays = rays_to(xy, rows, x0, y0)
    for j in range(priors.sigma.shape[0]):
        blocking_into(out[j], rays, x0, y0, j, priors, form, far)
    return out


@array_kernel
def extent(j: int, priors: Priors, far: float) -> float:
    """How far from its mean prior j reaches: so many standard deviations, or to its farthest corner."""
    if priors.first[j] == priors.first[j + 1]:
        gaussian: float = far * priors.sigma[j]
        return gaussian
    reach = 0.0
    for c in range(priors.first[j], priors.first[j + 1]):
        dx, dy = priors.corners[c, 0] - priors.mean[j, 0], priors.corners[c, 1] - priors.mean[j, 1]
        reach = max(reach, math.sqrt(dx * dx + dy * dy))
    return reach


@array_kernel
def isotropic_into(
    q: Floats,
    ux: Floats,
    uy: Floats,
    r: Floats,
    mx: float,
    my: float,
    radius: float,
    scale: float,
    before: bool,
    behind: bool,
) -> None:
    """Probabilities q of an isotropic prior; `scale` is 1 / (sqrt 2 sigma).

    Four loops, so that none has a branch.
    """
    n = q.shape[0]
    if before and behind:
        for k in range(n):
            b = ux[k] * my - uy[k] * mx
            q[k] = 0.5 * (fast_erf((radius - b) * scale) + fast_erf((radius + b) * scale))
    elif before:
        for k in range(n):
            a, b = ux[k] * mx + uy[k] * my, ux[k] * my - uy[k] * mx
            across = fast_erf((radius - b) * scale) + fast_erf((radius + b) * scale)
            q[k] = 0.25 * across * (1.0 + fast_erf((r[k] - a) * scale))
    elif behind:
        for k in range(n):
            a, b = ux[k] * mx + uy[k] * my, ux[k] * my - uy[k] * mx
            across = fast_erf((radius - b) * scale) + fast_erf((radius + b) * scale)
            q[k] = 0.25 * across * (1.0 + fast_erf(a * scale))
    else:
        for k in range(n):
            a, b = ux[k] * mx + uy[k] * my, ux[k] * my - uy[k] * mx
            across = fast_erf((radius - b) * scale) + fast_erf((radius + b) * scale)
            q[k] = 0.25 * across * (fast_erf((r[k] - a) * scale) + fast_erf(a * scale))


@array_kernel
def hiding(ux: float, uy: float, r: float, x0: float, y0: float, j: int, priors: Priors, form: int) -> float:
    """q: probability that occluder j hides the place at distance r in direction (ux, uy) from (x0, y0).

    Degenerate priors and polygons are exact with every form.
    """
    radius, sigma, minor = priors.radius[j], priors.sigma[j], priors.minor[j]
    mx, my = priors.mean[j, 0] - x0, priors.mean[j, 1] - y0
    if r == 0.0:
        return 0.0
    if form == QUADRATURE or minor == 0.0 or priors.first[j] < priors.first[j + 1]:
        camera = np.array([[x0, y0]])
        exact: float = shares(x0 + r * ux, y0 + r * uy, camera, priors, j)[1]
        return exact
    a, b = ux * mx + uy * my, ux * my - uy * mx
    # The major axis along and across the sight line
    ca = ux * priors.axis[j, 0] + uy * priors.axis[j, 1]
    sa = ux * priors.axis[j, 1] - uy * priors.axis[j, 0]
    # Across the sight line: variance s^2 = v' Sigma v, and the mass between -D/2 and D/2
    s2 = (sa * sigma) ** 2 + (ca * minor) ** 2
    s = math.sqrt(s2)
    low, high = (-radius - b) / s, (radius - b) / s
    across = normal_between(low, high)
    if across <= 0.0:
        return 0.0
    # Along it, given the offset w across: mean a + rho (w - b), variance det Sigma / s^2
    rho = ca * sa * (sigma - minor) * (sigma + minor) / s2
    offset = -b  # Eq. 7: w = 0, the middle of the rectangle
    if form == IMPROVED:
        # w at the mean of the normal truncated to the rectangle's width
        offset = s * (density(low) - density(high)) / across
        offset = min(max(offset, -radius - b), radius - b)
    scale = ROOT_HALF * s / (sigma * minor)
    middle = a + rho * offset
    q: float = across * 0.5 * (math.erf((r - middle) * scale) + math.erf(middle * scale))
    return q


@array_kernel
def density(x: float) -> float:
    """Standard normal density."""
    return math.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi)
