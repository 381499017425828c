"""The azimuth of a person from a region in the image, with its uncertainty.

The azimuth is that of the line of sight through the region's centre of mass: all points of
a vertical line have the same azimuth, whatever the camera's pitch and roll.

Uncertainty, as the covariance of the centre in the image:

    P = read^2 I + c^2 V_p,    V_p the spread of a person's pixels at this position,
    c^2 = POSTURE^2 + ODD^2 m^2 + CUT^2 [the box reaches the left or right border],

and what the region is wider across than a person, v = (g' V g - g' V_p g)+ with V the
region's own spread and g the gradient of the azimuth: two people in one region are off
its centre by about sqrt(v).  The variance of the azimuth is g' P g + v, and of u_px
that times (du_px / d azimuth)^2.  m, 0 to 1, is what the region has less or more of
foreground than a person in full view, as a share: part is hidden, or part is another's.
With a standard deviation given in pixels P = sigma_px^2 I + (c^2 - POSTURE^2) V_p.
The numbers make normalised errors about 1 on the video of PETS 2009 S2.L1, people in the
clear (POSTURE) and partly hidden (ODD), frames 0 to 399; CUT is half of a person's width.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.core.geometry.camera import wrap_angle
from occlog.records.scene import Camera

POSTURE_SHARE = 0.35
OUTLIER_RATIO = 0.6
TRUNCATION_PX = 1.0
STEP_PX = 0.5  # of the finite differences


class RegionBearings(NamedTuple):
    """Azimuths of K image regions in the world and horizontal image positions, each with its standard deviation.

    `bearing` and `sigma` in rad; `u_px` is the offset from the centre of the levelled image, positive to the right,
    with `sigma_px` [px]. All (K,), NaN for a camera without pose.
    """

    bearing: Floats  # (K,) [rad]
    sigma: Floats  # (K,) [rad]
    u_px: Floats  # (K,)
    sigma_px: Floats  # (K,)


class BearingNoise(NamedTuple):
    """Settings of the noise of region centres.

    `sigma_px` is the standard deviation of the centre of a person in full view [px], in place of the model's
    posture and reading noise, None for these; `scale` is a factor on all standard deviations.
    """

    sigma_px: float | None = None  # of a person in full view [px], instead of POSTURE and reading; None: from these
    scale: float = 1.0  # factor on all standard deviations


AS_MODELLED = BearingNoise()
"""The noise of the module's model."""


def shape_covariance(person: Floats, fill: Floats, cut: Bools, noise: BearingNoise = AS_MODELLED) -> Floats:
    """(K, 3) covariances xx, xy, yy [px^2] of regions' centres of mass as measurements of people's vertical axes.

    Args:
        person: (K, 3) covariance xx, xy, yy of a person's pixels at the position [px^2].
        fill: (K,) foreground pixels relative to a person in full view.
        cut: (K,) mask of regions that reach the left or right border of the image.
        noise: if it states `sigma_px`, the share of posture is omitted here.
    """
    odd = np.minimum(np.abs(1.0 - fill), 1.0)
    posture = POSTURE_SHARE if noise.sigma_px is None else 0.0
    c2 = posture**2 + (OUTLIER_RATIO * odd) ** 2 + TRUNCATION_PX**2 * cut
    covs: Floats = c2[:, None] * person
    return covs


def sights(
    camera: Camera,
    centres: Floats,
    covs: Floats,
    spreads: Floats,
    persons: Floats,
    noise: BearingNoise = AS_MODELLED,
) -> RegionBearings:
    """Azimuths, with their noise, of K region centres in an image; NaN for a camera without pose.

    Args:
        camera: camera; its reading noise `sigma_read_px` is added unless `noise` states `sigma_px`.
        centres: (K, 2) centres [px].
        covs: (K, 3) their covariances xx, xy, yy, without reading noise [px^2].
        spreads: (K, 3) covariances of the regions' pixels [px^2]; what exceeds a person adds to the noise.
        persons: (K, 3) covariances of a person's pixels there [px^2].
        noise: standard deviation in pixels, if given, and factor on all standard deviations.
    """
    if not camera.placed:
        return RegionBearings(*np.full((4, len(centres)), np.nan))
    if not len(centres):
        return RegionBearings(*np.empty((4, 0)))
    bearing = camera.bearings(centres)
    gx, gy = _gradient(camera, centres)
    read2 = (camera.sigma_read_px if noise.sigma_px is None else noise.sigma_px) ** 2
    excess = np.maximum(_across(spreads, gx, gy) - _across(persons, gx, gy), 0.0)
    variance = _across(covs, gx, gy) + read2 * (gx**2 + gy**2) + excess
    u_px = camera.u_px(bearing)
    focal = float(camera.focal_px[0])
    sigma = noise.scale * np.sqrt(variance)
    return RegionBearings(bearing, sigma, u_px, sigma * focal * (1.0 + (u_px / focal) ** 2))


def _gradient(camera: Camera, centres: Floats) -> tuple[Floats, Floats]:
    """Derivatives of the azimuth by pixel column (N,) and row (N,) [rad/px] at `centres` (N, 2) [px]."""
    right, down = np.array([STEP_PX, 0.0]), np.array([0.0, STEP_PX])
    gx = wrap_angle(camera.bearings(centres + right) - camera.bearings(centres - right)) / (2.0 * STEP_PX)
    gy = wrap_angle(camera.bearings(centres + down) - camera.bearings(centres - down)) / (2.0 * STEP_PX)
    return gx, gy


def _across(covs: Floats, gx: Floats, gy: Floats) -> Floats:
    """(N,) variances g' C g along gradients (gx, gy), each (N,), of covariances (N, 3): xx, xy, yy."""
    total: Floats = covs[:, 0] * gx**2 + 2.0 * covs[:, 1] * gx * gy + covs[:, 2] * gy**2
    return total
