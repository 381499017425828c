"""A scene and a scan as the arrays that the filters in space want."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.sight.projected_planes import direction, direction_angles, polar_from_elevation
from occlog.records.scene import Scene
from occlog.scans.scan import Scan
from occlog.track.in_space.kernels.likelihood import UNIFORM, UNIFORM_AZIMUTH, Sights

LEAST_SIGMA = 1e-9
"""Angles without any noise get this much [rad], so that densities stay finite."""


class Ears(NamedTuple):
    """Places and poses of S sensors, cameras first."""

    position: Floats  # (S, 3)
    rotation: Floats  # (S, 3, 3) world-from-sensor; a camera's is that of the world, since it tells azimuths
    reach: Floats  # (S,)
    sigma_yaw: Floats  # (S,) of the pose [rad]
    sigma_position: Floats  # (S,)


class ScanDirections(NamedTuple):
    """R directions of a scan of N sensors in the frames of the sensors: what the likelihoods in space need of it."""

    sights: Sights
    theta: Floats  # (R,) measured azimuths in the sensor's frame [rad]
    rotation: Floats  # (R, 3, 3) world-from-sensor
    uniform: Floats  # (R,) density of clutter
    sensor: Ints  # (N,) place in `sensor_names` of each sensor that had a frame
    flat: Bools  # (R,) azimuth only


def pack_ears(scene: Scene) -> Ears:
    """Places, poses and ranges of all sensors."""
    cameras, arrays = scene.cameras, scene.arrays
    eye = np.eye(3)
    return Ears(
        np.array([c.position for c in cameras] + [a.position for a in arrays], dtype=np.float64).reshape(-1, 3),
        np.array([eye] * len(cameras) + [a.rotation for a in arrays]).reshape(-1, 3, 3),
        np.array([c.range for c in cameras] + [a.range for a in arrays], dtype=np.float64),
        np.array([c.sigma_yaw for c in cameras] + [0.0] * len(arrays)),
        np.array([c.sigma_position for c in cameras] + [0.0] * len(arrays)),
    )


def pack_directions(scan: Scan, ears: Ears, near: Floats, *, use_score: bool) -> ScanDirections:
    """The directions of a scan in the frames of their sensors; those not seen tell nothing and have no row.

    Args:
        scan: rows by sensor.
        ears: the sensors.
        near: (2,) where the target is about; an error of a camera's place counts as at that distance.
        use_score: weigh candidates by their score, where they have one.
    """
    start = np.flatnonzero(np.diff(scan.sensor, prepend=-1))
    before = np.concatenate([[0], np.cumsum(scan.seen)])
    first = np.concatenate([before[start], before[-1:]])
    keep = np.asarray(scan.seen)
    sensor, bearing = scan.sensor[keep], scan.bearing[keep]
    up, sigma_up = scan.elevation[keep], scan.sigma_elevation[keep]
    flat = np.isnan(up) | np.isnan(sigma_up)
    rotation = np.where(flat[:, None, None], np.eye(3), ears.rotation[sensor])
    world = direction(bearing, polar_from_elevation(np.where(flat, 0.0, up)))
    theta, phi = direction_angles((world[:, None, :] @ rotation)[:, 0])
    weigh = np.isfinite(scan.score[keep]) & ~scan.labelled[keep] & use_score
    sights = Sights(
        first=first,
        labelled=scan.labelled[start],
        position=ears.position[sensor],
        frame=_frames(theta, rotation),
        phi=np.where(flat, np.nan, phi),
        sigma_theta=_with_pose(scan.sigma[keep], sensor, ears, near),
        sigma_phi=np.maximum(np.where(flat, 1.0, sigma_up), LEAST_SIGMA),
        reach=ears.reach[sensor],
        share=np.where(weigh, scan.score[keep], 1.0),
    )
    uniform = np.where(flat, UNIFORM_AZIMUTH, UNIFORM)
    return ScanDirections(
        sights=sights, theta=theta, rotation=rotation, uniform=uniform, sensor=scan.sensor[start], flat=flat
    )


def _frames(theta: Floats, rotation: Floats) -> Floats:
    """(R, 3, 3) rows along the azimuth, to its left, and up, in the world."""
    c, s = np.cos(theta)[:, None], np.sin(theta)[:, None]
    x, y = rotation[:, :, 0], rotation[:, :, 1]
    frame = np.empty((len(theta), 3, 3))
    frame[:, 0], frame[:, 1], frame[:, 2] = c * x + s * y, c * y - s * x, rotation[:, :, 2]
    return frame


def _with_pose(sigma: Floats, sensor: Ints, ears: Ears, near: Floats) -> Floats:
    """(R,) standard deviations of azimuths with the errors of the sensors' poses."""
    offset = near - ears.position[sensor, :2]
    distance = np.maximum(np.hypot(offset[:, 0], offset[:, 1]), 3.0 * ears.sigma_position[sensor])
    shift = ears.sigma_position[sensor] / np.where(distance > 0, distance, 1.0)
    return np.maximum(np.sqrt(sigma**2 + ears.sigma_yaw[sensor] ** 2 + shift**2), LEAST_SIGMA)


def agrees(places: Floats, heard: ScanDirections, gate: float) -> Bools:
    """(K, N) whether a sensor has a direction within `gate` standard deviations of each place; False for none.

    Args:
        places: (K, 3).
        heard: the scan.
        gate: of each angle, and of the sight line where its azimuth means little (near the pole).
    """
    s = heard.sights
    counts = np.diff(s.first)
    if not len(s.phi):
        return np.zeros((len(places), len(counts)), dtype=np.bool_)
    to = places[:, None, :, None] - s.position[:, :, None]
    local = (s.frame @ to)[..., 0]
    ground = np.hypot(local[..., 0], local[..., 1])
    off = np.abs(np.arctan2(local[..., 1], local[..., 0]))
    phi = np.arctan2(ground, local[..., 2])
    spread = np.hypot(np.sin(s.phi), np.cos(s.phi) * s.sigma_phi)
    arc = np.abs(2.0 * np.sin(0.5 * off)) * np.sin(phi)
    good = (off <= gate * s.sigma_theta) | (arc <= gate * s.sigma_theta * spread)
    good &= heard.flat | (np.abs(phi - s.phi) <= gate * s.sigma_phi)
    out = np.zeros((len(places), len(counts)), dtype=np.bool_)
    some = counts > 0
    out[:, some] = np.logical_or.reduceat(good, s.first[:-1][some], axis=1)
    return out
