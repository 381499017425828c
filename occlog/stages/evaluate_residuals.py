"""Reported bearings minus what a sensor should have reported, and whether they are within the gate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ..columns import Bools, Floats, Ints
from ..core.camera import wrap_angle
from ..core.sight import behind_objects
from ..records import Bearings
from .evaluate_config import EvaluateConfig
from .evaluate_paths import Expected, Path, Sensor


class Residuals(NamedTuple):
    """Reported minus expected, in pixels, radians and standard deviations; NaN where nothing was reported."""

    px: Floats
    rad: Floats
    normalised: Floats


def residuals(rows: Bearings, expected: Expected) -> Residuals:
    """Residuals of N rows against (N,) expectations, or against (N, M): each row against M objects.

    A target that is not in front of a camera is infinitely far off.
    """
    shape = (len(rows), *(1 for _ in expected.bearing.shape[1:]))
    columns = (rows.bearing, rows.u_px, rows.sigma_px, rows.sigma)
    bearing, u_px, sigma_px, sigma = (c.reshape(shape) for c in columns)
    rad = wrap_angle(bearing - expected.bearing)
    pixels = np.isfinite(u_px) & np.isfinite(sigma_px)
    behind = pixels & np.isnan(expected.u_px)
    px = np.where(behind, np.inf, u_px - expected.u_px)
    normalised = np.where(pixels, px / np.sqrt(expected.variance_px + sigma_px**2), rad / sigma)
    return Residuals(px, rad, np.where(behind, np.inf, normalised))


def gated(residual: Residuals, config: EvaluateConfig) -> Floats:
    """Absolute residual as a share of the gate: up to 1 is within; NaN where nothing was reported."""
    by_sigma = np.abs(residual.normalised) / config.gate_sigma
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
