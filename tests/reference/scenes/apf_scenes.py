"""A step of the particle filter: states, readings and random numbers to give to both forms."""

from __future__ import annotations

import apf_reference as ref
import numpy as np
from tracker_scenes import PILLAR, ROOM, true_u

from occlog.filtering.motion.waypoint import WaypointParticles
from occlog.track.methods.apf import filter as apf

L = 300


class Recorder:
    """A generator that remembers the numbers it gave away, by size."""

    def __init__(self, seed):
        self.rng = np.random.default_rng(seed)
        self.single, self.uniform, self.normal = [], [], []

    def random(self, size=None):
        value = self.rng.random(size)
        if size is None:
            self.single.append(value)
        elif size == L:
            self.uniform.append(value)
        return value

    def standard_normal(self, size):
        self.normal.append(self.rng.standard_normal(size))
        return self.normal[-1]


def reference_scene(scene):
    cameras = [
        ref.RefCamera(c.ground, c.yaw, c.focal_px[0], c.fov, c.range, c.sigma_position, c.sigma_yaw)
        for c in scene.cameras
    ]
    return ref.RefScene(ROOM, [PILLAR] if scene.occluders else [], cameras)


def state_with(scene, config, seed, spread=4.0):
    """A filter in the middle of its work: particles with unequal weights, some waiting, some arrived."""
    rng = np.random.default_rng(seed)
    xy = rng.normal([30.0, 45.0], spread, (L, 2))
    destination = np.where(rng.random((L, 1)) < 0.2, xy + rng.normal(0, 0.5, (L, 2)), rng.uniform(0, 100, (L, 2)))
    particles = WaypointParticles(xy, destination, rng.uniform(0, 2, L), rng.integers(0, 3, L))
    weights = rng.dirichlet(np.full(L, 0.5))
    return apf.init(scene, config, rng)._replace(particles=particles, weights=weights, t_ns=0)


def readings(scene, seed):
    """Noisy readings near (31, 46); one camera sees nothing, one sees nonsense."""
    rng = np.random.default_rng(seed)
    u = np.array(true_u(scene, (31.0, 46.0))) + rng.normal(0, 3, 8)
    u[np.abs(u) > 70] = np.nan
    u[2] = np.nan
    if seed % 2:
        u[6] = 40.0
    return u
