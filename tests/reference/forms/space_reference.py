"""Independent forms for directions in space and their projections on planes."""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats
from occlog.core.geometry.projected_planes import direction_angles, projected_angle_gradients, projected_covariance


def pair_covariance(covariance: Floats, pair: tuple[int, int]) -> Floats:
    """(..., 2, 2) covariance of two planes' angles out of (..., 3, 3); singular where both angles say the same."""
    return np.asarray(covariance[..., pair, :][..., :, pair])


def pair_information(
    xyz: Floats, position: Floats, rotation: Floats, sigma_theta: float, sigma_phi: float, pair: tuple[int, int]
) -> Floats:
    """(N, 3, 3) Fisher information about positions of the angles of two planes of one sensor with their covariance.

    It equals the information of the direction wherever the two angles are not the same measurement
    (xy and yz are where y is the sensor's).
    """
    theta, phi = direction_angles((xyz - position) @ rotation)
    G = projected_angle_gradients(xyz - position)[:, pair, :]
    R = pair_covariance(projected_covariance(theta, phi, sigma_theta, sigma_phi, rotation), pair)
    return np.asarray(np.swapaxes(G, 1, 2) @ np.linalg.solve(R, G))


def measured_angle_gradients(theta: Floats, phi: Floats, rotation: Floats) -> Floats:
    """(N, 3, 2) gradients of the projected angles by the measured theta and phi, by the chain rule.

    The ray is R d(theta, phi); the gradients by the ray are those of `projected_angle_gradients`.
    """
    s, c = np.sin(phi), np.cos(phi)
    ray = np.column_stack([s * np.cos(theta), s * np.sin(theta), c]) @ rotation.T
    by_theta = np.column_stack([-s * np.sin(theta), s * np.cos(theta), np.zeros_like(s)]) @ rotation.T
    by_phi = np.column_stack([c * np.cos(theta), c * np.sin(theta), -s]) @ rotation.T
    gradients = projected_angle_gradients(ray)
    return np.stack([np.einsum("npa,na->np", gradients, by) for by in (by_theta, by_phi)], axis=-1)
