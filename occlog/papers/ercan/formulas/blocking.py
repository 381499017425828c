"""q_ij: probability that moving occluder j hides a position from camera i ([Ercan] Eq. 7, App. C).

Occluder j's centre has the prior N(mu, Sigma), eigenvalues sigma^2 and sigma^2 / alpha; it
hides the position x from a camera if it is in the rectangle A(x) from the camera to x, D wide.
With x' = (along, across) the line of sight,

    q = int_{-D/2}^{D/2} int_0^|x| N(x'; mu', Sigma') dx'_1 dx'_2                     (Eq. 17)

where the inner integral is a difference of error functions about a mean that is linear in
x'_2.  The forms:

    PRINTED     Eq. 7: the inner integral at x'_2 = 0 for all x'_2.
    IMPROVED    the inner integral at the mean of x'_2 given -D/2 <= x'_2 <= D/2.
    QUADRATURE  Eq. 17 by Gauss-Legendre slices, to about 1e-12.

All agree (and are exact) for isotropic priors and when the line of sight is along or across
the major axis.  Known positions, priors on a line and uniform priors over polygons are
exact in every form.  The rectangle is closed; at the camera itself nothing is hidden.
These are the plain forms; the tracker's kernels are tested against them.

p(eta | u): probability that exactly the cameras of eta see a position among moving occluders ([Ercan] Sec. 4.2).

eta_i = 1 if no occluder hides the position from camera i.  Occluders are independent of each
other.  p_Q, the probability that all cameras of a subset Q see the position, is

    recursion   prod_j (1 - sum_{i in Q} q_ij), factors below 0 taken as 0      (Eq. 8)
    exact       prod_j (1 - P(occluder j is in the union of A_i, i in Q))

Eq. 8 takes the rectangles A_i as disjoint, which they are not near the position, where all of
them end.  From p_Q the recursion of Eq. 9 gives p(eta); written out it is

    p(eta) = sum_{H subset of the hidden} (-1)^|H| p_{seen + H}.

    independent   p(eta) = prod_seen P_i prod_hidden (1 - P_i), P_i = prod_j (1 - q_ij)

needs no subsets.  Each of the three sums to 1 over all eta.  Where Eq. 8 was clipped, Eq. 9
can be below 0, and with more hidden cameras than occluders it is identically 0; `floor`
is the least value given back.

Subsets are numbers from 0 to 2^N - 1, bit i for camera i.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import erf, erfc

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import array_kernel, kernel
from occlog.core.occlusion.blocking_probability import shares
from occlog.core.occlusion.joint_occlusion import clear_exact
from occlog.core.occlusion.priors import Priors

PRINTED, IMPROVED, QUADRATURE = 0, 1, 2
FORMS = ("printed", "improved", "quadrature")
"""Names of the forms by number."""
ROOT_2 = math.sqrt(2.0)


def blocking(xy: Floats, camera_xy: Floats, priors: Priors, form: int) -> Floats:
    """(L, M) probabilities q that occluder j hides a position from a camera; ValueError for an unknown form.

    Args:
        xy: (L, 2) positions.
        camera_xy: (2,) ground position of the camera.
        priors: priors of M occluders.
        form: PRINTED, IMPROVED or QUADRATURE; they differ only for normal priors of two dimensions.
    """
    if form not in (PRINTED, IMPROVED, QUADRATURE):
        raise ValueError(f"form must be 0 to {len(FORMS) - 1}, not {form}")
    xy = np.ascontiguousarray(xy, dtype=np.float64)
    camera = np.ascontiguousarray(camera_xy, dtype=np.float64).reshape(1, 2)
    normal = (np.diff(priors.first) == 0) & (priors.minor > 0.0)
    out = np.zeros((len(xy), len(priors.sigma)))
    if form == QUADRATURE:
        _exact_into(out, xy, camera, priors, np.ones(len(normal), dtype=np.bool_))
    else:
        _exact_into(out, xy, camera, priors, ~normal)
        out[:, normal] = _eq_7(xy - camera, priors.mean[normal] - camera, priors, normal, form)
    return out


def blocking_all(xy: Floats, cameras: Floats, priors: Priors, form: int) -> Floats:
    """(L, N, M) probabilities that occluder j hides each of L positions from each of N cameras.

    Args:
        xy: (L, 2) positions.
        cameras: (N, 2) ground positions of the cameras.
        priors: priors of M occluders.
        form: PRINTED, IMPROVED or QUADRATURE; they differ only for normal priors of two dimensions.

    Raises:
        ValueError: an unknown form.
    """
    out = np.zeros((len(xy), len(cameras), len(priors.sigma)))
    for i, camera in enumerate(cameras):
        out[:, i] = blocking(xy, camera, priors, form)
    return out


@kernel
def _exact_into(out: Floats, xy: Floats, camera: Floats, priors: Priors, which: Bools) -> None:
    """Write exact probabilities, in place, to the columns of `out` that are selected by the mask `which`.

    Args:
        out: (L, M) probability that each of M occluders hides each of L positions, filled.
        xy: (L, 2) positions.
        camera: (1, 2) ground position of the camera.
        priors: priors of M occluders.
        which: (M,) mask of the columns.
    """
    for j in range(which.shape[0]):
        if which[j]:
            for p in range(xy.shape[0]):
                out[p, j] = min(1.0, shares(xy[p, 0], xy[p, 1], camera, priors, j)[1])


def _eq_7(x: Floats, mean: Floats, priors: Priors, which: Bools, form: int) -> Floats:
    """(L, m) probabilities q of Eq. 7, or of its improved form, in the letters of [Ercan] Sec. 4.2 and App. C.

    Args:
        x: (L, 2) positions relative to the camera.
        mean: (m, 2) means of the priors relative to the camera.
        priors: M priors, of which axes, standard deviations and radii are used.
        which: (M,) mask of the m priors.
        form: PRINTED or IMPROVED.
    """
    sigma, minor, R = priors.sigma[which], priors.minor[which], priors.radius[which]
    e, alpha = priors.axis[which], (sigma / minor) ** 2
    r = np.hypot(x[:, 0], x[:, 1])[:, None]
    direction = x / np.where(r > 0.0, r, 1.0)
    # theta: from the major axis to the line of sight; mu: mean in the prior's axes.
    cos, sin = direction @ e.T, direction[:, 1:] * e[:, 0] - direction[:, :1] * e[:, 1]
    mu_1, mu_2 = np.sum(mean * e, axis=1), mean[:, 1] * e[:, 0] - mean[:, 0] * e[:, 1]
    mu_o1 = cos * mu_1 + alpha * sin * mu_2
    g1_g1, g1_g2 = np.where(r > 0.0, cos**2 + alpha * sin**2, 1.0), (alpha - 1.0) * sin * cos
    phi = cos * mu_2 - sin * mu_1
    s = sigma * np.sqrt(g1_g1 / alpha)  # standard deviation of x'_2, with a mean that is phi
    low, high = (-R - phi) / s, (R - phi) / s
    across = _normal_between(low, high)
    if form == IMPROVED:
        density = np.exp(-0.5 * low**2) - np.exp(-0.5 * high**2)
        with np.errstate(divide="ignore", invalid="ignore"):
            middle = phi + s * density / (math.sqrt(2.0 * math.pi) * across)
        # Far out in the tail the quotient loses its digits; the mean is in the rectangle anyway.
        x_2 = np.clip(np.where(across > 0.0, middle, 0.0), -R, R)
        mu_o1 = mu_o1 - g1_g2 * x_2
    g = sigma * np.sqrt(g1_g1)
    q = across * _normal_between(-mu_o1 / g, (r * g1_g1 - mu_o1) / g)
    return np.asarray(np.where(r > 0.0, q, 0.0), dtype=np.float64)


def _normal_between(low: Floats, high: Floats) -> Floats:
    """Probability that a standard normal number is between low and high, elementwise, accurate in the tails."""
    low, high = np.broadcast_arrays(low / ROOT_2, high / ROOT_2)
    flip = high < 0.0
    low, high = np.where(flip, -high, low), np.where(flip, -low, high)
    tail = low > 0.0
    difference = np.where(tail, erfc(low) - erfc(high), erf(high) - erf(low))
    return np.asarray(0.5 * difference, dtype=np.float64)


MOST_CAMERAS = 16
"""Largest number of cameras of the forms with subsets, of which there are 2^16."""


def seen_by_recursion(q: Floats) -> Floats:
    """(L, 2^N) p_Q of [Ercan] Eq. 8: probability that all cameras of a subset Q see a position, from q (L, N, M).

    Column Q has bit i set for camera i; factors 1 - sum q are clipped at 0.
    """
    L, N, M = q.shape
    _check(N)
    sums = np.zeros((1 << N, L, M))
    for Q in range(1, 1 << N):
        lowest = (Q & -Q).bit_length() - 1
        sums[Q] = sums[Q & (Q - 1)] + q[:, lowest]
    return np.ascontiguousarray(np.prod(np.maximum(1.0 - sums, 0.0), axis=2).T)


def seen_exactly(xy: Floats, cameras: Floats, priors: Priors) -> Floats:
    """(L, 2^N) p_Q: exact probability that all cameras of a subset Q see each of the positions xy (L, 2).

    Column Q has bit i set for camera i; `cameras` is (N, 2). ValueError for more than `MOST_CAMERAS`.
    """
    _check(len(cameras))
    return np.asarray(
        _seen_exactly(
            np.ascontiguousarray(xy, dtype=np.float64), np.ascontiguousarray(cameras, dtype=np.float64), priors
        )
    )


def patterns(seen: Floats) -> Floats:
    """(L, 2^N) p(eta): probabilities of all patterns eta of cameras that see a position; column = sum of eta_i 2^i.

    They sum to 1, and are not limited below. `seen` (L, 2^N) has p_Q, the probability that all cameras of the
    subset Q see it.
    """
    out = seen.copy()
    columns: Ints = np.arange(seen.shape[1], dtype=np.int64)
    bit = 1
    while bit < seen.shape[1]:
        without = columns[columns & bit == 0]
        out[:, without] -= out[:, without | bit]
        bit <<= 1
    return out


@array_kernel
def _seen_exactly(xy: Floats, cameras: Floats, priors: Priors) -> Floats:
    out = np.empty((xy.shape[0], 1 << cameras.shape[0]))
    for p in range(xy.shape[0]):
        out[p] = clear_exact(xy[p, 0], xy[p, 1], cameras, priors)
    return out


def independent(q: Floats) -> Floats:
    """(L, 2^N) p(eta) of all patterns eta of seeing cameras, if cameras were independent; column = sum of eta_i 2^i.

    `q` (L, N, M) are the probabilities that occluder j hides a position from camera i.
    """
    seen, out = np.prod(1.0 - q, axis=2), np.ones((len(q), 1))
    for i in range(seen.shape[1]):  # camera i is bit i of the column
        out = np.concatenate([out * (1.0 - seen[:, i : i + 1]), out * seen[:, i : i + 1]], axis=1)
    return out


def _check(cameras: int) -> None:
    if cameras > MOST_CAMERAS:
        raise ValueError(f"subsets of {cameras} cameras: at most {MOST_CAMERAS} can be computed")
