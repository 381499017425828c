"""How well a set of cameras would locate a target: the metric of [Ercan] Sec. 5.

The mean square error of the best linear estimate of the position x from the cameras'
measurements Z is Tr(Sigma_x - Sigma_Zx' Sigma_Z^-1 Sigma_Zx).  A camera that does not see
the target counts as if it had reported its expected value.  What a camera sees depends on
its field of view, on what stands in the room and on the priors of the moving occluders.

Expectations are weighted sums over the particles; those that involve a camera's image are
over the particles in its view only, as h/d has no meaning elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.core.geometry.visibility import Sensors, seen_from
from occlog.core.numerics.jit import array_kernel
from occlog.core.occlusion.occlusion_probability import IMPROVED, blocking_probabilities
from occlog.core.occlusion.priors import Priors
from occlog.filtering.likelihood.directions import PoseNoise

MIN_DETECTION_PROBABILITY = 1e-12
"""Cameras that see the target with a smaller probability are excluded from Sigma_Z."""
MIN_EIGENVALUE = 1e-9
"""Eigenvalues of Sigma_Z, in units of the cameras' variances, that are not above this tell nothing."""
OCCLUDER_SUPPORT_SIGMAS = 3.5
"""Standard deviations at which a prior of an occluder counts as over."""


class CameraMoments(NamedTuple):
    """Covariances of the target position and the measurements of N cameras ([Ercan] Sec. 5), and P(camera sees target).

    The sets of cameras to select are compared by the mean square error computed from them.
    """

    x: Floats  # (2, 2) Sigma_x
    zx: Floats  # (N, 2) Sigma_Zx
    z: Floats  # (N, N) Sigma_Z
    seen: Floats  # (N,) P{eta_i = 1}


def views(xy: Floats, cameras: Sequence[int], sensors: Sensors) -> Bools:
    """Return (N, L) booleans: whether each of N cameras has a free view of each position in `xy` (L, 2).

    A free view means within field of view and range, with no static obstacle between. `cameras` are rows of `sensors`.
    """
    return np.array([seen_from(xy, i, sensors) for i in cameras]).reshape(len(cameras), len(xy))


def joint_visibility(
    xy: Floats,
    weights: Floats,
    cameras: Sequence[int],
    sensors: Sensors,
    inside: Bools,
    priors: Priors,
    hit: Floats,
    hiding: int = IMPROVED,
) -> Floats:
    """Return (N, N) probabilities that two cameras both detect the target, on the diagonal that one does: Eq. 8.

    Args:
        xy: (L, 2) positions of the particles.
        weights: (L,) weights of the particles, sum 1.
        cameras: N rows of the sensors.
        sensors: positions, fields of view and walls of all S sensors.
        inside: (N, L) whether a camera has a free view of a particle, from `views`.
        priors: position priors of the moving occluders; empty: none hides the target.
        hit: (N,) probabilities that a camera detects a target in plain view.
        hiding: form of the probability that one occluder hides the target, of
            `occlog.core.occlusion.occlusion_probability`.
    """
    rows = np.arange(len(xy))
    q = np.zeros((len(cameras), len(priors.sigma), len(xy)))
    if len(priors.sigma):
        for n, i in enumerate(cameras):
            q[n] = blocking_probabilities(
                xy, rows, sensors.xy[i, 0], sensors.xy[i, 1], priors, hiding, OCCLUDER_SUPPORT_SIGMAS
            )
    pairs = np.outer(hit, hit)
    pairs[np.diag_indices(len(cameras))] = hit
    return np.asarray(_together(q, inside, weights)) * pairs


@array_kernel
def _together(q: Floats, inside: Bools, weights: Floats) -> Floats:
    """Return (N, N) probabilities that neither of two cameras is blocked by any occluder, over weighted particles.

    On the diagonal it is the probability for one camera. In a pair an occluder is taken to block at most one of the two
    ([Ercan] Eq. 8).

    Args:
        q: (N, M, L) probability that an occluder blocks the view of a camera to a particle.
        inside: (N, L) whether a camera has a free view of a particle, apart from the occluders.
        weights: (L,) weights of the particles, sum 1.
    """
    N, M, L = q.shape
    out = np.empty((N, N))
    clear = np.empty(L)
    for i in range(N):
        for j in range(i + 1):
            for p in range(L):
                clear[p] = weights[p] if inside[i, p] and inside[j, p] else 0.0
            for m in range(M):
                if i == j:
                    for p in range(L):
                        clear[p] *= 1.0 - q[i, m, p]
                else:
                    for p in range(L):
                        clear[p] *= max(0.0, 1.0 - q[i, m, p] - q[j, m, p])
            out[i, j] = out[j, i] = clear.sum()
    return out


def perspective_moments(
    xy: Floats,
    weights: Floats,
    cameras: Sequence[int],
    sensors: Sensors,
    noise: PoseNoise,
    read_px: Floats,
    inside: Bools,
    together: Floats,
) -> CameraMoments:
    """Return the moments of N cameras with the perspective model, [Ercan] Eqs. 10-13.

    Args:
        xy: (L, 2) positions of the particles.
        weights: (L,) weights of the particles, sum 1.
        cameras: N rows of the sensors.
        sensors: positions, fields of view and walls of all S sensors.
        noise: errors of the poses and focal lengths of the S sensors.
        read_px: (S,) reading noise of the sensors [px].
        inside: (N, L) whether a camera has a free view of a particle, from `views`.
        together: (N, N) detection probabilities of pairs of cameras, from `joint_visibility`.
    """
    N, rows = len(cameras), np.asarray(cameras, dtype=np.int64)
    away, cov = _centred(xy, weights)
    z, variance = np.zeros((N, len(xy))), np.zeros((N, len(xy)))
    for n, i in enumerate(rows.tolist()):
        dx, dy = (xy - sensors.xy[i]).T
        c, s = sensors.axis[i]
        d = np.where(inside[n], c * dx + s * dy, 1.0)
        ratio = np.where(inside[n], (c * dy - s * dx) / d, 0.0)
        f = noise.focal_px[i]
        z[n] = f * ratio
        spread = 1.0 + ratio**2  # Eq. 2
        angle2 = spread * noise.sigma_yaw[i] ** 2 + (noise.sigma_position[i] / d) ** 2
        variance[n] = read_px[i] ** 2 + f**2 * spread * angle2
    # Covariances over the particles in view (Eqs. 11-13)
    share = inside @ weights
    own = inside * weights / np.maximum(share, MIN_DETECTION_PROBABILITY)[:, None]
    z = np.where(inside, z - (own * z).sum(axis=1)[:, None], 0.0)
    both = (inside * weights) @ inside.T
    sigma_z = together * ((z * weights) @ z.T / np.maximum(both, MIN_DETECTION_PROBABILITY))
    sigma_z[np.diag_indices(N)] += np.diag(together) * (own * variance).sum(axis=1)
    # P E(z x~) over the particles in view
    sigma_zx = np.diag(together)[:, None] * ((own * z) @ away)
    return CameraMoments(cov, sigma_zx, sigma_z, np.diag(together).copy())


def weak_moments(
    xy: Floats,
    weights: Floats,
    cameras: Sequence[int],
    sensors: Sensors,
    noise: PoseNoise,
    read_px: Floats,
    together: Floats,
) -> CameraMoments:
    """Return the moments of N cameras with the weak perspective model, [Ercan] Eqs. 14-16.

    A camera that has the mean of the particles behind it does not count (its probability of detection is 0).

    Args:
        xy: (L, 2) positions of the particles.
        weights: (L,) weights of the particles, sum 1.
        cameras: N rows of the sensors.
        sensors: positions and axes of all S sensors.
        noise: errors of the poses and focal lengths of the S sensors.
        read_px: (S,) reading noise of the sensors [px].
        together: (N, N) detection probabilities of pairs of cameras, from `joint_visibility`.
    """
    rows = np.asarray(cameras, dtype=np.int64)
    _, cov = _centred(xy, weights)
    c, s = sensors.axis[rows].T
    across = np.column_stack([-s, c])
    depth = np.einsum("ni,ni->n", weights @ xy - sensors.xy[rows], sensors.axis[rows])
    depth = np.maximum(depth, 0.0)
    f = noise.focal_px[rows]
    variance = (noise.sigma_yaw[rows] ** 2 + (read_px[rows] / f) ** 2) * depth**2 + noise.sigma_position[rows] ** 2
    seen = np.diag(together) * (depth > 0.0)
    sigma_z = together * (across @ cov @ across.T + np.diag(variance))
    return CameraMoments(cov, seen[:, None] * (across @ cov), sigma_z, seen)


def _centred(xy: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Return (L, 2) deviations of positions `xy` from their weighted mean, and their (2, 2) covariance."""
    away = xy - weights @ xy
    return away, (away * weights[:, None]).T @ away


def mean_square_errors(moments: CameraMoments, subsets: np.ndarray[tuple[int, int], np.dtype[np.int64]]) -> Floats:
    """Return (n,) mean square errors of the best linear position estimate from n subsets of N cameras, [Ercan] Sec. 5.

    They lie between 0 and Tr(Sigma_x). Cameras that cannot see the target add nothing, and neither do directions in
    which Sigma_Z is not positive (its terms are expectations over different particles).

    Args:
        moments: covariances of position and measurements of the N cameras.
        subsets: (n, k) indices of the cameras of each subset.
    """
    whole = float(np.trace(moments.x))
    if subsets.shape[1] == 0:
        return np.full(len(subsets), whole)
    blind = moments.seen < MIN_DETECTION_PROBABILITY
    z, zx = moments.z.copy(), np.where(blind[:, None], 0.0, moments.zx)
    z[blind], z[:, blind] = 0.0, 0.0
    # Normalise by each camera's standard deviation
    scale = np.sqrt(np.where(blind | (np.diag(z) <= 0.0), 1.0, np.diag(z)))
    z, zx = z / np.outer(scale, scale), zx / scale[:, None]
    z[blind, blind] = 1.0
    # Tr(Sigma_Zx' Sigma_Z^-1 Sigma_Zx) by eigenvalues, without the directions that tell nothing
    values, vectors = np.linalg.eigh(z[subsets[:, :, None], subsets[:, None, :]])
    parts = np.einsum("nki,nkj->nij", vectors, zx[subsets])
    inverse = np.where(values > MIN_EIGENVALUE, 1.0 / np.maximum(values, MIN_EIGENVALUE), 0.0)
    gain = np.einsum("nij,ni->n", parts**2, inverse)
    return np.asarray(np.clip(whole - gain, 0.0, whole))
