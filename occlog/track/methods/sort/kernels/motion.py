"""Kalman filter and smoother of independent coordinates, each with a value and a rate under white acceleration.

A covariance of value and rate is a row of three: variance of the value, covariance, variance of the rate.
"""

from __future__ import annotations

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.core.numerics.jit import kernel


def predicted(covariance: Floats, density: Floats, dt: float) -> Floats:
    """Return covariances (..., 3) a time `dt` [s] later under white acceleration of spectral `density` (...).

    `covariance` (..., 3) are variance of the value, covariance of value and rate, variance of the rate.
    """
    vv, vr, rr = np.moveaxis(covariance, -1, 0)
    return np.stack(
        [
            vv + 2.0 * dt * vr + dt * dt * rr + density * dt**3 / 3.0,
            vr + dt * rr + density * dt**2 / 2.0,
            rr + density * dt,
        ],
        axis=-1,
    )


def updated(mean: Floats, covariance: Floats, z: Floats, noise: Floats) -> tuple[Floats, Floats]:
    """Return means (..., 2) and covariances (..., 3) of values and rates after measurements of the values.

    Args:
        mean: (..., 2) value and rate before.
        covariance: (..., 3) variance of the value, covariance, variance of the rate.
        z: (...) measured values.
        noise: (...) variances of the measurements.
    """
    gain = covariance[..., :2] / (covariance[..., 0] + noise)[..., None]
    after = mean + gain * (z - mean[..., 0])[..., None]
    kept = 1.0 - gain[..., 0]
    rate = covariance[..., 2] - gain[..., 1] * covariance[..., 1]
    return after, np.stack([covariance[..., 0] * kept, covariance[..., 1] * kept, rate], axis=-1)


@kernel
def smooth(
    times: Floats, seen: Bools, z: Floats, noise: Floats, density: Floats, speed: Floats
) -> tuple[Floats, Floats]:
    """Return smoothed values and rates of D coordinates at K times, by the Rauch-Tung-Striebel smoother.

    Args:
        times: (K,) times [s], increasing.
        seen: (K,) whether there is a measurement; the first has one.
        z: (K, D) measurements.
        noise: (K, D) variances of the measurements.
        density: (D,) spectral densities of the acceleration.
        speed: (D,) prior variances of the rates.

    Returns:
        (K, D, 2) means and (K, D, 3) covariances: variance of the value, covariance, variance of the rate.
    """
    steps, size = z.shape
    mean, cov = np.empty((steps, size, 2)), np.empty((steps, size, 3))
    for d in range(size):
        # Filter: the first measurement and the prior of the rate begin it
        mean[0, d, 0], mean[0, d, 1] = z[0, d], 0.0
        cov[0, d, 0], cov[0, d, 1], cov[0, d, 2] = noise[0, d], 0.0, speed[d]
        for k in range(1, steps):
            dt, q = times[k] - times[k - 1], density[d]
            m0, m1 = mean[k - 1, d, 0] + dt * mean[k - 1, d, 1], mean[k - 1, d, 1]
            p00 = cov[k - 1, d, 0] + 2.0 * dt * cov[k - 1, d, 1] + dt * dt * cov[k - 1, d, 2] + q * dt**3 / 3.0
            p01 = cov[k - 1, d, 1] + dt * cov[k - 1, d, 2] + q * dt**2 / 2.0
            p11 = cov[k - 1, d, 2] + q * dt
            if seen[k]:
                g0, g1 = p00 / (p00 + noise[k, d]), p01 / (p00 + noise[k, d])
                off = z[k, d] - m0
                m0, m1 = m0 + g0 * off, m1 + g1 * off
                p11 -= g1 * p01
                p00, p01 = p00 * (1.0 - g0), p01 * (1.0 - g0)
            mean[k, d, 0], mean[k, d, 1] = m0, m1
            cov[k, d, 0], cov[k, d, 1], cov[k, d, 2] = p00, p01, p11
        # Smoother: G = P F' (F P F' + Q)^-1
        for k in range(steps - 2, -1, -1):
            dt, q = times[k + 1] - times[k], density[d]
            a, b, c = cov[k, d, 0], cov[k, d, 1], cov[k, d, 2]
            s00, s01, s11 = a + 2.0 * dt * b + dt * dt * c + q * dt**3 / 3.0, b + dt * c + q * dt**2 / 2.0, c + q * dt
            det = s00 * s11 - s01 * s01
            c00, c01, c10, c11 = a + dt * b, b, b + dt * c, c
            g00, g01 = (c00 * s11 - c01 * s01) / det, (c01 * s00 - c00 * s01) / det
            g10, g11 = (c10 * s11 - c11 * s01) / det, (c11 * s00 - c10 * s01) / det
            e0 = mean[k + 1, d, 0] - mean[k, d, 0] - dt * mean[k, d, 1]
            e1 = mean[k + 1, d, 1] - mean[k, d, 1]
            mean[k, d, 0] += g00 * e0 + g01 * e1
            mean[k, d, 1] += g10 * e0 + g11 * e1
            d00, d01, d11 = cov[k + 1, d, 0] - s00, cov[k + 1, d, 1] - s01, cov[k + 1, d, 2] - s11
            h00, h01, h10, h11 = (
                g00 * d00 + g01 * d01,
                g00 * d01 + g01 * d11,
                g10 * d00 + g11 * d01,
                g10 * d01 + g11 * d11,
            )
            cov[k, d, 0] = a + h00 * g00 + h01 * g01
            cov[k, d, 1] = b + h00 * g10 + h01 * g11
            cov[k, d, 2] = c + h10 * g10 + h11 * g11
    return mean, cov
