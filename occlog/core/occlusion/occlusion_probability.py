"""Probability that no moving occluder hides a position from a camera: fast forms of [Ercan] Eq. 7.

For each position x, P = prod_j (1 - q_j) over the M priors, q_j the probability that
occluder j's centre lies in the rectangle from the camera to x with the occluder's
diameter as its width.  With u the unit vector from the camera to x, v across it, a prior
N(mu, Sigma) has across the line of sight mean b = v.mu and variance s^2 = v' Sigma v, and
along it, given the offset w across, mean a + rho (w - b) with rho = u' Sigma v / s^2 and
variance det Sigma / s^2.  Eq. 7 takes w = 0; the improved form takes w at the mean of the
truncated normal between -D/2 and D/2.  Both are exact for isotropic priors (rho = 0).

For speed, priors more than `far` standard deviations from every line of sight of the particles, behind the camera or
beyond all positions are omitted, and error functions that are 1 for all particles are not computed. (`far` is 5.5, with
a tail of 2e-8, or less for proposals.)

Interpolation over a cloud of particles: where every prior is Gaussian and wide relative to the cloud, P
(`occlog.core.occlusion.occlusion_probability`) is smooth over the cloud's bounding box. It is then computed at
Chebyshev points of the box only and interpolated by Chebyshev polynomials. Their degrees follow from the box and the
narrowest prior; the last coefficients determine the error, and where it is too large, P is computed position by
position.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import array_kernel
from occlog.core.numerics.special_functions import fast_erf

from .blocking_probability import normal_between, shares
from .priors import Priors

PRINTED, IMPROVED, QUADRATURE = 0, 1, 2
ROOT_HALF = math.sqrt(0.5)
ROUND = 1e-9
"""A prior with eigenvalues that differ by less, relative, is isotropic."""


class CameraRays(NamedTuple):
    """Lines of sight from a camera to n positions: unit vectors and lengths, with bounds of both."""

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
def rays_to(xy: Floats, rows: Ints, x0: float, y0: float) -> CameraRays:
    """Return the lines of sight from (x0, y0) to the positions with indices `rows` (n,) among `xy` (L, 2)."""
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
    return CameraRays(ux, uy, r, gx, gy, nearest, farthest, cos, sin)


@array_kernel
def blocking_into(
    q: Floats, rays: CameraRays, x0: float, y0: float, j: int, priors: Priors, form: int, far: float
) -> bool:
    """Write the probabilities that occluder j hides the ends of the rays to `q`; False, without a change, if all are 0.

    Args:
        q: (n,) filled in place.
        rays: rays from (x0, y0) to n positions.
        x0: position of the camera.
        y0: position of the camera.
        j: index of the occluder.
        priors: priors of all occluders.
        form: `PRINTED` ([Ercan] Eq. 7), `IMPROVED` or `QUADRATURE`; only normal priors that are neither isotropic nor
            degenerate depend on it.
        far: standard deviations at which a normal prior is cut off.
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
        behind = along + slack_along < rays.nearest - reach  # all of it is nearer than every position
        isotropic_into(q, rays.ux, rays.uy, rays.r, mx, my, radius, ROOT_HALF / sigma, before, behind)
        return True
    # Known position: inside the rectangle or not
    if priors.first[j] == priors.first[j + 1] and sigma == 0.0:
        for k in range(q.shape[0]):
            a, b = rays.ux[k] * mx + rays.uy[k] * my, rays.ux[k] * my - rays.uy[k] * mx
            q[k] = 1.0 if (abs(b) <= radius) & (a >= 0.0) & (a <= rays.r[k]) & (rays.r[k] > 0.0) else 0.0
        return True
    # All others: position by position
    for k in range(q.shape[0]):
        ux, uy, r = rays.ux[k], rays.uy[k], rays.r[k]
        a, b = ux * mx + uy * my, ux * my - uy * mx
        near = abs(b) <= reach + radius and -reach <= a <= r + reach
        q[k] = hiding(ux, uy, r, x0, y0, j, priors, form) if near else 0.0
    return True


@array_kernel
def visibility_probability(
    xy: Floats, rows: Ints, x0: float, y0: float, priors: Priors, form: int, far: float
) -> Floats:
    """Return the (n,) probabilities P = prod_j (1 - q_j) that no occluder hides positions from a camera at (x0, y0).

    Occluders are independent of each other; q_j is the probability that occluder j hides the position.

    Args:
        xy: (L, 2) positions.
        rows: (n,) indices of the positions that are wanted.
        x0: position of the camera.
        y0: position of the camera.
        priors: priors of the occluders.
        form: `PRINTED` ([Ercan] Eq. 7), `IMPROVED` or `QUADRATURE`.
        far: standard deviations at which a normal prior is cut off.
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
def blocking_probabilities(
    xy: Floats, rows: Ints, x0: float, y0: float, priors: Priors, form: int, far: float
) -> Floats:
    """Return the (M, n) probabilities that single occluders hide positions from a camera at (x0, y0).

    Args:
        xy: (L, 2) positions.
        rows: (n,) indices of the positions that are wanted.
        x0: position of the camera.
        y0: position of the camera.
        priors: priors of the M occluders.
        form: `PRINTED` ([Ercan] Eq. 7), `IMPROVED` or `QUADRATURE`.
        far: standard deviations at which a normal prior is cut off.
    """
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
    """Return the greatest distance from the mean of prior j that counts.

    It is `far` standard deviations of a normal prior, or the distance of the farthest corner of a polygon.
    """
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
    """Write the blocking probabilities of an isotropic normal prior to `q`, in place ([Ercan] Eq. 7, exact here).

    Four loops without branches, for vectorisation.

    Args:
        q: (n,) filled.
        ux: (n,) x of the rays' unit vectors.
        uy: (n,) y of the rays' unit vectors.
        r: (n,) lengths of the rays.
        mx: mean of the prior, relative to the camera.
        my: mean of the prior, relative to the camera.
        radius: half of the occluder's diameter.
        scale: 1 / (sqrt 2 sigma) of the prior's standard deviation sigma.
        before: the whole prior is in front of the camera.
        behind: the whole prior is nearer than the end of every ray.
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
    """Return the probability that occluder j hides the position at distance r in direction (ux, uy) from a camera.

    Degenerate priors and polygons are exact with every form.

    Args:
        ux: unit vector to the position.
        uy: unit vector to the position.
        r: distance of the position.
        x0: position of the camera.
        y0: position of the camera.
        j: index of the occluder.
        priors: priors of all occluders.
        form: `PRINTED` ([Ercan] Eq. 7), `IMPROVED` or `QUADRATURE`.
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
    # The major axis along and across the line of sight
    ca = ux * priors.axis[j, 0] + uy * priors.axis[j, 1]
    sa = ux * priors.axis[j, 1] - uy * priors.axis[j, 0]
    # Across the line of sight: variance s^2 = v' Sigma v, and the mass between -D/2 and D/2
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
    """Return the density of the standard normal distribution at x."""
    return math.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi)


MAX_DEGREE = 24
"""Polynomials of a higher degree need more points than most clouds have particles."""
MIN_POINTS_PER_POSITION = 0.5
"""Points per position from which on interpolation is not worth its trouble."""
MIN_CAMERA_DISTANCE = 2.0
"""How far a camera must be from the middle of the box, in half diagonals: P is not smooth at the camera."""


class HiddenGrid(NamedTuple):
    """Chebyshev grid over the bounding box of a cloud of L positions; without points where interpolation is slower."""

    points: Floats  # (K, 2), the second coordinate running faster
    first: Floats  # (nx, L) Chebyshev polynomials of the positions' first coordinate
    second: Floats  # (ny, L) of the second
    fit_first: Floats  # (nx, nx) coefficients from values at the points
    fit_second: Floats  # (ny, ny)
    x: float  # middle of the box
    y: float
    size: float  # half of its diagonal
    tolerance: float  # greatest error of P, relative to its greatest value


@array_kernel
def make_grid(xy: Floats, free: Bools, priors: Priors, far: float) -> HiddenGrid:
    """Return the Chebyshev grid over the bounding box of the free positions, for interpolated visibility probabilities.

    It has no points if it would not be faster than L single positions, or if a prior is not normal or is degenerate.

    Args:
        xy: (L, 2) positions.
        free: (L,) positions that count.
        priors: priors of the occluders.
        far: standard deviations at which a normal prior is cut off; the tail beyond is the tolerance of the
            interpolation.
    """
    # Tolerance: the tail that `far` omits
    tolerance = 0.5 * math.erfc(far / math.sqrt(2.0))
    narrowest = np.inf
    for j in range(priors.minor.shape[0]):
        narrowest = min(narrowest, priors.minor[j] if priors.first[j] == priors.first[j + 1] else 0.0)
    # Bounding box of the free positions
    low_x, low_y, high_x, high_y, count = np.inf, np.inf, -np.inf, -np.inf, 0
    for p in range(xy.shape[0]):
        if free[p]:
            low_x, high_x = min(low_x, xy[p, 0]), max(high_x, xy[p, 0])
            low_y, high_y = min(low_y, xy[p, 1]), max(high_y, xy[p, 1])
            count += 1
    # Degrees: from the box and the narrowest prior; none where interpolation is not worth it
    nx, ny = 0, 0
    hx, hy = 0.5 * (high_x - low_x), 0.5 * (high_y - low_y)
    if count > 0 and 0.0 < narrowest < np.inf:
        nx, ny = terms(hx / narrowest, tolerance), terms(hy / narrowest, tolerance)
        if max(nx, ny) > MAX_DEGREE or nx * ny > MIN_POINTS_PER_POSITION * count:
            nx, ny = 0, 0
    # Chebyshev points of the first kind
    x, y = low_x + hx, low_y + hy
    hx, hy = max(hx, 1e-300), max(hy, 1e-300)
    points = np.empty((nx * ny, 2))
    for a in range(nx):
        for b in range(ny):
            points[a * ny + b, 0] = x + hx * math.cos(math.pi * (a + 0.5) / nx)
            points[a * ny + b, 1] = y + hy * math.cos(math.pi * (b + 0.5) / ny)
    return HiddenGrid(
        points=points,
        first=polynomials(xy[:, 0], x, hx, nx),
        second=polynomials(xy[:, 1], y, hy, ny),
        fit_first=fit(nx),
        fit_second=fit(ny),
        x=x,
        y=y,
        size=math.sqrt(hx * hx + hy * hy),
        tolerance=tolerance,
    )


@array_kernel
def terms(half: float, tolerance: float) -> int:
    """Return the number of Chebyshev polynomials for an interval of +- `half` deviations of the narrowest prior.

    The coefficients of a Gaussian decrease as (half / 2)^n / sqrt(n!); those below `tolerance` are omitted.
    """
    n, size = 0, 2.0
    while size > tolerance and n <= MAX_DEGREE:
        n += 1
        size *= 0.5 * half / math.sqrt(n)
    return n + 2


@array_kernel
def polynomials(values: Floats, middle: float, half: float, n: int) -> Floats:
    """Return the (n, L) Chebyshev polynomials of degrees 0 to n - 1 at `values` (L,) in the interval middle +- half."""
    out = np.ones((n, values.shape[0]))
    if n > 1:
        for p in range(values.shape[0]):
            out[1, p] = (values[p] - middle) / half
    for k in range(2, n):
        for p in range(values.shape[0]):
            out[k, p] = 2.0 * out[1, p] * out[k - 1, p] - out[k - 2, p]
    return out


@array_kernel
def fit(n: int) -> Floats:
    """Return the (n, n) matrix from values at n Chebyshev points to coefficients: the discrete cosine transform."""
    out = np.empty((n, n))
    for k in range(n):
        for a in range(n):
            out[k, a] = (1.0 if k == 0 else 2.0) / n * math.cos(math.pi * k * (a + 0.5) / n)
    return out


@array_kernel
def unhidden_over(
    grid: HiddenGrid, xy: Floats, rows: Ints, x0: float, y0: float, priors: Priors, form: int, far: float
) -> Floats:
    """Return the (n,) probabilities that positions are not hidden from a camera at (x0, y0), interpolated on a grid.

    They approximate `visibility_probability`, and equal it where the grid is not faster, the camera is too near to it,
    or the error would be too large.

    Args:
        grid: grid over the positions `xy` (`make_grid`).
        xy: (L, 2) positions.
        rows: (n,) indices of the positions that are wanted.
        x0: position of the camera.
        y0: position of the camera.
        priors: priors of the occluders.
        form: `PRINTED` ([Ercan] Eq. 7), `IMPROVED` or `QUADRATURE`.
        far: standard deviations at which a normal prior is cut off.
    """
    nx, ny = grid.first.shape[0], grid.second.shape[0]
    away = math.sqrt((grid.x - x0) ** 2 + (grid.y - y0) ** 2)
    if nx * ny == 0 or nx * ny > MIN_POINTS_PER_POSITION * rows.shape[0] or away < MIN_CAMERA_DISTANCE * grid.size:
        return visibility_probability(xy, rows, x0, y0, priors, form, far)
    values = visibility_probability(grid.points, np.arange(nx * ny), x0, y0, priors, form, far)
    coefficients = coefficients_of(values, grid.fit_first, grid.fit_second)
    largest = 0.0
    for k in range(nx * ny):
        largest = max(largest, values[k])
    if left_over(coefficients) > grid.tolerance * largest:
        return visibility_probability(xy, rows, x0, y0, priors, form, far)
    return evaluate(coefficients, grid.first, grid.second, rows)


@array_kernel
def coefficients_of(values: Floats, fit_first: Floats, fit_second: Floats) -> Floats:
    """Return the (nx, ny) Chebyshev coefficients of values (nx ny,) at grid points, second coordinate running faster.

    `fit_first` (nx, nx) and `fit_second` (ny, ny) are the cosine transforms of `fit` for both coordinates.
    """
    nx, ny = fit_first.shape[0], fit_second.shape[0]
    half, out = np.zeros((nx, ny)), np.zeros((nx, ny))
    for k in range(nx):
        for a in range(nx):
            for b in range(ny):
                half[k, b] += fit_first[k, a] * values[a * ny + b]
    for k in range(nx):
        for m in range(ny):
            for b in range(ny):
                out[k, m] += fit_second[m, b] * half[k, b]
    return out


@array_kernel
def left_over(coefficients: Floats) -> float:
    """Return the largest magnitude of the last two coefficients in either direction, to estimate the truncation error.

    `coefficients` (nx, ny) are those of a Chebyshev series in two coordinates.
    """
    nx, ny = coefficients.shape
    size = 0.0
    for k in range(nx):
        for m in range(ny):
            if k >= nx - 2 or m >= ny - 2:
                size = max(size, abs(coefficients[k, m]))
    return size


@array_kernel
def evaluate(coefficients: Floats, first: Floats, second: Floats, rows: Ints) -> Floats:
    """Return the (n,) values of a Chebyshev series at the positions `rows` (n,), clipped to [0, 1].

    Args:
        coefficients: (nx, ny).
        first: (nx, L) polynomials of the first coordinate of L positions.
        second: (ny, L) polynomials of the second coordinate.
        rows: (n,) indices of the positions.
    """
    nx, ny, L = first.shape[0], second.shape[0], first.shape[1]
    total, inner = np.zeros(L), np.empty(L)
    for k in range(nx):
        inner[:] = coefficients[k, 0]
        m = 1
        while m < ny:  # four at a time: fewer passes over memory
            c0 = coefficients[k, m]
            c1 = coefficients[k, m + 1] if m + 1 < ny else 0.0
            c2 = coefficients[k, m + 2] if m + 2 < ny else 0.0
            c3 = coefficients[k, m + 3] if m + 3 < ny else 0.0
            s0, s1 = second[m], second[min(m + 1, ny - 1)]
            s2, s3 = second[min(m + 2, ny - 1)], second[min(m + 3, ny - 1)]
            for p in range(L):
                inner[p] += c0 * s0[p] + c1 * s1[p] + (c2 * s2[p] + c3 * s3[p])
            m += 4
        for p in range(L):
            total[p] += inner[p] * first[k, p]
    out = np.empty(rows.shape[0])
    for m in range(rows.shape[0]):
        out[m] = min(1.0, max(0.0, total[rows[m]]))
    return out
