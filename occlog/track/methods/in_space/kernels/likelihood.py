"""Likelihoods of directions in space, and in the planes xy, yz and zx, for clouds of particles.

A *sight* is one measured direction.  Its frame has the rows along, left and up: up is the
sensor's z axis, along the measured azimuth, so that a particle's azimuth from it is the
residual, wrapped as it should be.  A sight without an elevation (a camera's, a planar array's) has the
world's z axis and an azimuth only.

Clouds are (3, L) or, in a plane, (2, L): coordinates first, which is how compilers like it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import array_kernel
from occlog.core.numerics.special_functions import fast_atan2

NEAR_POLE = 8.0
"""Standard deviations of the polar angle within which a measurement may have come over the pole."""
UNIFORM = 1.0 / (2.0 * math.pi**2)
UNIFORM_AZIMUTH = 1.0 / (2.0 * math.pi)
"""Densities of false reports: even in both angles, and in one."""


class ScanDirectionSet(NamedTuple):
    """R measured directions of N sensors in one scan, each in a frame along its azimuth.

    The frame's rows are unit vectors along, left and up in the world; up is the axis from which polar angles are
    measured.
    """

    first: Ints  # (N + 1,) rows of each sensor
    labelled: Bools  # (N,)
    position: Floats  # (R, 3)
    frame: Floats  # (R, 3, 3) rows along, left, up in the world
    phi: Floats  # (R,) polar angles from up [rad]; NaN: azimuth only
    sigma_theta: Floats  # (R,) of the azimuth about up [rad]
    sigma_phi: Floats  # (R,) [rad]
    reach: Floats  # (R,) range of the sensor
    share: Floats  # (R,) weight of a candidate


class ReportProbabilities(NamedTuple):
    """Probabilities of detections, false alarms and clutter.

    `false`: of a labelled direction being a false alarm; `soften`: factor of a direction's likelihood for a target
    out of range; `candidate`: of the target being among a sensor's candidates; `clutter`: expected number of candidates
    of other objects in a scan.
    """

    false: float
    soften: float
    candidate: float
    clutter: float


def log_product(xyz: Floats, sights: ScanDirectionSet, soften: float) -> Floats:
    """Return (R, L) log densities of R directions for L positions [1/rad^2; 1/rad for an azimuth alone].

    Azimuth and polar angle are Gaussian and independent, in the sensor's frame ([Lee] Sec. 2.2.2 with the product in
    place of the cone). Near a pole the density of a direction that went over it is added, as (theta, -phi) and (theta +
    pi, phi) are equal.

    Args:
        xyz: (3, L) positions.
        sights: the directions.
        soften: factor of the density beyond the sensor's range, in (0, 1].
    """
    s = sights
    return _log_product(xyz, s.position, s.frame, s.phi, s.sigma_theta, s.sigma_phi, s.reach, math.log(soften))


@array_kernel
def _log_product(
    xyz: Floats,
    position: Floats,
    frame: Floats,
    phi: Floats,
    sigma_theta: Floats,
    sigma_phi: Floats,
    reach: Floats,
    log_soften: float,
) -> Floats:
    """Return (R, L) log densities of R directions for L positions: the kernel of `log_product`.

    Args:
        xyz: (3, L) positions.
        position: (R, 3) positions of the sensors.
        frame: (R, 3, 3) rows are unit vectors in the world: along the measured azimuth, to the left of it, and up (the
            axis of polar angles).
        phi: (R,) polar angles [rad]; NaN: an azimuth alone.
        sigma_theta: (R,) standard deviations of the azimuths [rad].
        sigma_phi: (R,) standard deviations of the polar angles [rad].
        reach: (R,) ranges of the sensors.
        log_soften: log of the factor of the density beyond the range.
    """
    R, L = phi.shape[0], xyz.shape[1]
    out = np.empty((R, L))
    for r in range(R):
        f, p = frame[r], position[r]
        far2 = reach[r] * reach[r]
        a = 0.5 / (sigma_theta[r] * sigma_theta[r])
        level = -0.5 * math.log(2.0 * math.pi) - math.log(sigma_theta[r])
        if math.isnan(phi[r]):  # an azimuth only
            for l in range(L):  # noqa: E741 - the papers' letter
                x, y, z = xyz[0, l] - p[0], xyz[1, l] - p[1], xyz[2, l] - p[2]
                u = f[0, 0] * x + f[0, 1] * y + f[0, 2] * z
                v = f[1, 0] * x + f[1, 1] * y + f[1, 2] * z
                t = fast_atan2(v, u)
                log_p = level - a * t * t
                out[r, l] = log_p + log_soften if x * x + y * y + z * z > far2 else log_p
            continue
        b = 0.5 / (sigma_phi[r] * sigma_phi[r])
        level -= 0.5 * math.log(2.0 * math.pi) + math.log(sigma_phi[r])
        for l in range(L):  # noqa: E741
            x, y, z = xyz[0, l] - p[0], xyz[1, l] - p[1], xyz[2, l] - p[2]
            u = f[0, 0] * x + f[0, 1] * y + f[0, 2] * z
            v = f[1, 0] * x + f[1, 1] * y + f[1, 2] * z
            w = f[2, 0] * x + f[2, 1] * y + f[2, 2] * z
            t = fast_atan2(v, u)
            d = fast_atan2(math.sqrt(u * u + v * v), w) - phi[r]
            log_p = level - a * t * t - b * d * d
            out[r, l] = log_p + log_soften if x * x + y * y + z * z > far2 else log_p
        # Near a pole: add the density of a direction that went over it
        pole = math.pi if phi[r] > 0.5 * math.pi else 0.0
        if abs(phi[r] - pole) < NEAR_POLE * sigma_phi[r]:
            for l in range(L):  # noqa: E741
                x, y, z = xyz[0, l] - p[0], xyz[1, l] - p[1], xyz[2, l] - p[2]
                u = f[0, 0] * x + f[0, 1] * y + f[0, 2] * z
                v = f[1, 0] * x + f[1, 1] * y + f[1, 2] * z
                w = f[2, 0] * x + f[2, 1] * y + f[2, 2] * z
                t = math.pi - abs(fast_atan2(v, u))
                d = fast_atan2(math.sqrt(u * u + v * v), w) + phi[r] - 2.0 * pole
                log_p = level - a * t * t - b * d * d
                log_p = log_p + log_soften if x * x + y * y + z * z > far2 else log_p
                top = max(out[r, l], log_p)
                out[r, l] = top + math.log(math.exp(out[r, l] - top) + math.exp(log_p - top))
    return out


def log_cone(xyz: Floats, sights: ScanDirectionSet, soften: float) -> Floats:
    """Return (R, L) log densities of directions, Gaussian in the angle between direction and position, [Lee] 2.2.2.

    The variance is the mean of those towards theta and phi, (sin^2(phi) sigma_theta^2 + sigma_phi^2) / 2, so that a
    cone is round where the true spread is not. Densities are per unit of both angles [1/rad^2]; for an azimuth alone
    they are Gaussian in the azimuth [1/rad].

    Args:
        xyz: (3, L) positions.
        sights: R directions.
        soften: factor of the density beyond the sensor's range, in (0, 1].
    """
    s = sights
    flat = np.isnan(s.phi)
    phi = np.where(flat, 0.5 * math.pi, s.phi)
    spread = np.sin(phi) ** 2 + (np.cos(phi) * s.sigma_phi) ** 2
    variance = 0.5 * (spread * s.sigma_theta**2 + s.sigma_phi**2)
    line = np.sin(phi)[:, None] * s.frame[:, 0] + np.cos(phi)[:, None] * s.frame[:, 2]
    area = np.log(np.sqrt(spread))  # of a unit of both angles
    out = _log_cone(xyz, s.position, line, variance, area, s.reach, math.log(soften))
    if flat.any():
        out[flat] = log_product(xyz, rows_of(sights, flat), soften)
    return out


@array_kernel
def _log_cone(
    xyz: Floats, position: Floats, line: Floats, variance: Floats, area: Floats, reach: Floats, log_soften: float
) -> Floats:
    """Compute (R, L) log densities that are Gaussian in the angle from a line of sight, for positions `xyz` (3, L).

    Args:
        xyz: (3, L) positions.
        position: (R, 3) sensors.
        line: (R, 3) unit vectors of the directions.
        variance: (R,) of the angle [rad^2].
        area: (R,) log of the solid angle of a unit of both angles.
        reach: (R,) ranges of the sensors.
        log_soften: log of the factor beyond the range.
    """
    R, L = variance.shape[0], xyz.shape[1]
    out = np.empty((R, L))
    for r in range(R):
        p, n = position[r], line[r]
        far2, a = reach[r] * reach[r], 0.5 / variance[r]
        level = area[r] - math.log(2.0 * math.pi * variance[r])
        for l in range(L):  # noqa: E741
            x, y, z = xyz[0, l] - p[0], xyz[1, l] - p[1], xyz[2, l] - p[2]
            cx, cy, cz = y * n[2] - z * n[1], z * n[0] - x * n[2], x * n[1] - y * n[0]
            angle = fast_atan2(math.sqrt(cx * cx + cy * cy + cz * cz), x * n[0] + y * n[1] + z * n[2])
            log_p = level - a * angle * angle
            out[r, l] = log_p + log_soften if x * x + y * y + z * z > far2 else log_p
    return out


def log_in_plane(ab: Floats, position: Floats, angle: Floats, sigma: Floats, reach: Floats, soften: float) -> Floats:
    """Return (R, L) log densities [1/rad] of R angles in a plane, for L positions on the plane's axes.

    Args:
        ab: (2, L) positions.
        position: (R, 2) of the sensors on the plane's axes.
        angle: (R,) measured angles, projected to the plane [rad].
        sigma: (R,) standard deviations [rad].
        reach: (R,) ranges; a position that is farther in the plane alone gets the factor `soften`.
        soften: factor, in (0, 1].
    """
    along = np.column_stack([np.cos(angle), np.sin(angle)])
    return _log_in_plane(ab, position, along, sigma, reach, math.log(soften))


@array_kernel
def _log_in_plane(
    ab: Floats, position: Floats, along: Floats, sigma: Floats, reach: Floats, log_soften: float
) -> Floats:
    """Compute `log_in_plane` for angles given as unit vectors: (R, L) log densities for L positions.

    Args:
        ab: (2, L) positions on the plane's axes.
        position: (R, 2) sensors.
        along: (R, 2) cosine and sine of the measured angles.
        sigma: (R,) standard deviations [rad].
        reach: (R,) ranges of the sensors.
        log_soften: log of the factor beyond the range.
    """
    R, L = sigma.shape[0], ab.shape[1]
    out = np.empty((R, L))
    for r in range(R):
        c, s = along[r, 0], along[r, 1]
        far2, a = reach[r] * reach[r], 0.5 / (sigma[r] * sigma[r])
        level = -0.5 * math.log(2.0 * math.pi) - math.log(sigma[r])
        for l in range(L):  # noqa: E741
            x, y = ab[0, l] - position[r, 0], ab[1, l] - position[r, 1]
            t = fast_atan2(c * y - s * x, c * x + s * y)
            log_p = level - a * t * t
            out[r, l] = log_p + log_soften if x * x + y * y > far2 else log_p
    return out


def scan_log_likelihood(
    each: Floats, first: Ints, labelled: Bools, share: Floats, uniform: Floats, chances: ReportProbabilities
) -> Floats:
    """Return (L,) log likelihoods of a scan, up to a constant, from the log densities of its directions.

    A labelled direction is the target's or, with probability `false`, from anywhere: whichever explains it better. Of
    unlabelled ones one is the target's with probability `candidate` and the others are clutter, `clutter` of them
    expected: (1 - candidate) + candidate / clutter sum_k share_k p_k / u_k.

    Args:
        each: (R, L) log densities of the directions p_k at L positions.
        first: (N + 1,) rows of sensor n are first[n] to first[n + 1] - 1.
        labelled: (N,) the sensor's directions are labelled as the target.
        share: (R,) weight of a candidate.
        uniform: (R,) density u of clutter.
        chances: the probabilities above.
    """
    total = np.zeros(each.shape[1])
    for n in range(len(first) - 1):
        a, b = int(first[n]), int(first[n + 1])
        if b == a:
            continue
        if labelled[n]:
            total += np.maximum(each[a] + math.log1p(-chances.false), _log(chances.false * float(uniform[a])))
        else:
            factor = chances.candidate / chances.clutter * share[a:b] / uniform[a:b]
            some = factor @ np.exp(each[a:b]) + (1.0 - chances.candidate)
            with np.errstate(divide="ignore"):
                total += np.log(some)
    return total


def rows_of(sights: ScanDirectionSet, keep: Bools) -> ScanDirectionSet:
    """Return the directions selected by the mask `keep` (R,).

    The fields `first` and `labelled` are kept as they are, and fit the full set only.
    """
    s = sights
    return s._replace(
        position=s.position[keep],
        frame=s.frame[keep],
        phi=s.phi[keep],
        sigma_theta=s.sigma_theta[keep],
        sigma_phi=s.sigma_phi[keep],
        reach=s.reach[keep],
        share=s.share[keep],
    )


def _log(x: float) -> float:
    """Return log x; -inf for x <= 0."""
    return math.log(x) if x > 0.0 else -math.inf
