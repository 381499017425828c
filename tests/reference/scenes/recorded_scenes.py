"""Small recordings worked out by hand, for the tests of recorded experiments."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tracker_scenes import SECOND, observe, room100, walk

from occlog.records.tables import UNLABELLED, Bearings, Tracks, Truth

SCENE = replace(room100(pillar=False, cameras=4), length_unit="m")  # at (0, 0), (50, 0), (100, 0), (100, 50)


def truth(xy, role="target", first=0):
    """Objects at (T, n, 2) places, a second apart."""
    xy = np.asarray(xy, dtype=float)
    T, n = xy.shape[:2]
    return Truth.of(
        t_ns=np.repeat(np.arange(T) * SECOND, n),
        target_id=np.tile(np.arange(first, first + n), T),
        role=[role] * (T * n),
        x=xy[..., 0].ravel(),
        y=xy[..., 1].ravel(),
        z=np.full(T * n, np.nan),
    )


def rows(places, sensor="cam1", target=UNLABELLED):
    """A camera's bearings of one place a second, without noise."""
    camera = next(c for c in SCENE.cameras if c.name == sensor)
    places = np.asarray(places, dtype=float)
    bearing = np.arctan2(*(places - camera.ground).T[::-1])
    n = len(places)
    return Bearings.of(
        t_ns=np.arange(n) * SECOND,
        sensor=[sensor] * n,
        target_id=np.full(n, target),
        seen=np.ones(n, dtype=bool),
        bearing=bearing,
        sigma=np.full(n, 0.02),
        u_px=-70 * np.tan(bearing - camera.yaw),
        sigma_px=np.full(n, 2.0),
        score=np.full(n, np.nan),
    )


def track_at(places, deviation=0.1):
    """A track through one place a second."""
    n = len(places)
    x, y = np.asarray(places, dtype=float).T
    flat, var = np.zeros(n), np.full(n, deviation**2)
    return Tracks.of(
        t_ns=np.arange(n) * SECOND,
        target_id=np.zeros(n, int),
        x=x,
        y=y,
        vx=flat,
        vy=flat,
        cov_xx=var,
        cov_xy=flat,
        cov_yy=var,
    )


def walked(steps=30, unit="m"):
    """A target that walks about and is seen by four cameras, without labels."""
    rng = np.random.default_rng(4)
    scene = replace(SCENE, length_unit=unit)
    table = observe(scene, walk(steps, rng), rng)
    return scene, replace(table, target_id=np.full(len(table), UNLABELLED, dtype=np.int32))
