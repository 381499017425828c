"""Reported bearings minus what a sensor should have reported, and whether they are within the gate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.sight.camera import wrap_angle
from occlog.core.sight.projected_planes import direction, direction_angles, polar_from_elevation
from occlog.core.sight.visibility import behind_objects
from occlog.records.tables import Bearings

from .config import EvaluateConfig
from .paths import Expected, Path, Sensor


class Residuals(NamedTuple):
    """Reported minus expected, in pixels, radians and standard deviations; NaN where nothing was reported.

    Of an array that reports an elevation `rad` and `normalised` are of the azimuth about its
    own z axis, which is what its noise is of, where the height of the object is known.
    """

    px: Floats
    rad: Floats
    normalised: Floats
    elevation: Floats  # [rad] about the sensor's own z axis; NaN without elevation or height
    elevation_normalised: Floats

    @property
    def distance(self) -> Floats:
        """How many standard deviations off, by all that was reported."""
        flat = np.abs(self.normalised)
        return np.where(np.isnan(self.elevation), flat, np.hypot(flat, self.elevation_normalised))


def residuals(rows: Bearings, expected: Expected, sensor: Sensor) -> Residuals:
    """Residuals of N rows against (N,) expectations, or against (N, M): each row against M objects.

    A target that is not in front of a camera is infinitely far off.
    """
    shape = (len(rows), *(1 for _ in expected.bearing.shape[1:]))
    columns = (rows.bearing, rows.u_px, rows.sigma_px, rows.sigma, rows.sigma_elevation)
    bearing, u_px, sigma_px, sigma, sigma_up = (c.reshape(shape) for c in columns)
    rad = wrap_angle(bearing - expected.bearing)
    up = np.full(expected.bearing.shape, np.nan)
    if np.isfinite(rows.elevation).any():
        across, up = _in_own_frame(rows, expected, sensor, shape)
        rad = np.where(np.isnan(up), rad, across)
    pixels = np.isfinite(u_px) & np.isfinite(sigma_px)
    behind = pixels & np.isnan(expected.u_px)
    px = np.where(behind, np.inf, u_px - expected.u_px)
    normalised = np.where(pixels, px / np.sqrt(expected.variance_px + sigma_px**2), rad / sigma)
    return Residuals(
        px=px,
        rad=rad,
        normalised=np.where(behind, np.inf, normalised),
        elevation=up,
        elevation_normalised=up / sigma_up,
    )


def _in_own_frame(rows: Bearings, expected: Expected, sensor: Sensor, shape: tuple[int, ...]) -> tuple[Floats, Floats]:
    """Residuals [rad] of azimuth and elevation about the sensor's own axes.

    A sight line near the z axis may be reported from beyond it, with an azimuth half a
    turn off: it is read the way that is nearer.
    """
    line = direction(rows.bearing, polar_from_elevation(rows.elevation)) @ sensor.rotation
    theta, phi = (angle.reshape(shape) for angle in direction_angles(line))
    sigma, sigma_up = rows.sigma.reshape(shape), rows.sigma_elevation.reshape(shape)
    across, up = wrap_angle(theta - expected.theta), expected.phi - phi
    beyond, over = wrap_angle(theta + np.pi - expected.theta), wrap_angle(expected.phi + phi)
    nearer = np.hypot(beyond / sigma, over / sigma_up) < np.hypot(across / sigma, up / sigma_up)
    return np.where(nearer, beyond, across), np.where(nearer, over, up)


def gated(residual: Residuals, config: EvaluateConfig) -> Floats:
    """Residual as a share of the gate: up to 1 is within; NaN where nothing was reported.

    An azimuth with an elevation is within the ellipse of `gate_sigma` standard deviations.
    """
    by_sigma = residual.distance / config.gate_sigma
    if config.gate_px is None:
        return by_sigma
    return np.asarray(np.where(np.isnan(residual.px), by_sigma, np.abs(residual.px) / config.gate_px))


def behind_moving(
    sensor: Sensor, t_ns: Ints, xy: Floats, target: int, everyone: Mapping[int, Path], config: EvaluateConfig
) -> Bools:
    """(N,) bool: which looks at a target a moving object blocks ([Ercan] Fig. 3).

    Cameras only, and only if the configuration gives the objects a diameter.
    """
    rest = [path for k, path in everyone.items() if k != target]
    if config.occluder_diameter is None or sensor.camera is None or not rest:
        return np.zeros(len(t_ns), dtype=np.bool_)
    places = np.stack([path.at(t_ns, config.limit_ns)[0] for path in rest], axis=1)
    return behind_objects(sensor.ground, xy, places, config.occluder_diameter)
