"""Cameras around a room, points in it, and noisy centres of them in the images."""

import numpy as np
from epipolar_rigs import looking

from occlog.track.methods.images.ground.triangulation import CameraRig, CentresInViews


def room_rig(rng, views):
    """Cameras around a room, at least 25 degrees apart."""
    while True:
        angles = rng.uniform(0, 2 * np.pi, views)
        apart = np.abs(np.sin(angles[:, None] - angles))[np.triu_indices(views, 1)]
        if not len(apart) or apart.min() > np.sin(np.radians(25)):
            break
    return [
        looking(str(k), np.array([8 * np.cos(a), 8 * np.sin(a), 2.5]), (0, 0, 1), 600.0) for k, a in enumerate(angles)
    ]


def rig_of(cameras):
    names = ("focal_px", "principal_px", "rotation", "position")
    return CameraRig(*(np.array([getattr(camera, name) for camera in cameras]) for name in names))


def covariances(rng, n, views, size=3.0):
    root = rng.normal(0, size, (n, views, 2, 2))
    return root @ root.transpose(0, 1, 3, 2) + 0.5 * np.eye(2)


def seen(rng, cameras, points, cov):
    exact = np.stack([camera.project(points) for camera in cameras], axis=1)
    noise = np.einsum("nvij,nvj->nvi", np.linalg.cholesky(cov), rng.standard_normal(exact.shape))
    return CentresInViews(np.ones(exact.shape[:2], dtype=bool), exact + noise, cov)


def room(rng, n):
    return rng.uniform([-2, -2, 0.2], [2, 2, 1.8], (n, 3))
