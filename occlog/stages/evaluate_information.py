"""What the bearings of one sensor tell about the target's position: the one place that knows kinds of sensors.

Cameras count by Eq. 2 of [Ercan] with the bearing's own read noise, about (x, y) only;
directions without pixels by their standard deviations, which are of angles about the
sensor's own z axis, whatever its pose ([Lee] Eq. 2.40).
"""

from __future__ import annotations

import numpy as np

from ..columns import Bools, Floats
from ..core import bounds3d, crlb
from .evaluate_looks import Looks
from .evaluate_paths import Sensor


def ground_information(sensor: Sensor, seen: Looks) -> Floats:
    """(N, 2, 2) Fisher information of the azimuths of one sensor about (x, y); elevations tell of heights only.

    Of a tilted array the world's azimuth has errors of both of its angles.  Both are taken in
    at the true height (or at the reported elevation if there is none), and the height is then
    left free: what remains is the information of the azimuth with the variance that it really has.
    """
    information = _without_pixels(sensor, seen)
    if sensor.camera is None:
        return information
    pixels = np.isfinite(seen.sigma_px)
    return np.asarray(np.where(pixels[:, None, None], _of_pixels(sensor, seen, pixels), information))


def space_information(sensor: Sensor, seen: Looks) -> Floats:
    """(N, 3, 3) Fisher information of all that one sensor told about (x, y, z).

    A row without elevation tells its azimuth only; so does a planar array, whose azimuth is the world's.
    """
    pixels = np.isfinite(seen.sigma_px) & (sensor.camera is not None)
    tells = np.isfinite(seen.elevation)
    sigma_theta = np.where(pixels, np.inf, seen.sigma)
    sigma_phi = np.where(tells, seen.sigma_elevation, np.inf)
    xyz = np.column_stack([seen.xy, seen.z])
    total = bounds3d.direction_information(xyz, sensor.position, np.eye(3), sigma_theta, sigma_phi)
    if not sensor.upright:
        own = bounds3d.direction_information(xyz, sensor.position, sensor.rotation, sigma_theta, sigma_phi)
        total = np.where(tells[:, None, None], own, total)
    if pixels.any():
        total[:, :2, :2] += np.where(pixels[:, None, None], _of_pixels(sensor, seen, pixels), 0.0)
    return total


def _of_pixels(sensor: Sensor, seen: Looks, pixels: Bools) -> Floats:
    camera = sensor.camera
    assert camera is not None
    noise = np.where(pixels, seen.sigma_px, 1.0)
    return crlb.camera_information(
        seen.xy, sensor.ground, camera.yaw, float(camera.focal_px[0]), camera.sigma_position, camera.sigma_yaw, noise
    )


def _without_pixels(sensor: Sensor, seen: Looks) -> Floats:
    by_azimuth = crlb.bearing_information(seen.xy, sensor.ground, seen.sigma)
    tells = np.isfinite(seen.elevation)
    if sensor.upright or not tells.any():
        return by_azimuth
    flat = np.hypot(*(seen.xy - sensor.ground).T)
    z = np.where(np.isnan(seen.z), sensor.height + flat * np.tan(seen.elevation), seen.z)
    xyz = np.column_stack([seen.xy, np.where(tells, z, sensor.height)])
    sigma_phi = np.where(tells, seen.sigma_elevation, np.inf)
    whole = bounds3d.direction_information(xyz, sensor.position, sensor.rotation, seen.sigma, sigma_phi)
    return np.asarray(np.where(tells[:, None, None], bounds3d.ground_information(whole), by_azimuth))
