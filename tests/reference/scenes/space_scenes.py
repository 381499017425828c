"""A room with microphone arrays, and exact directions of a still source."""

from __future__ import annotations

import numpy as np

from occlog.measure.scans.scan import Scan
from occlog.records.scene import MicrophoneArray, Scene
from occlog.track.in_space import direct3d
from occlog.track.in_space.config import Direct3dConfig

SOURCE = np.array([3.0, 2.0, 1.4])
ROOM = np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 6.0], [0.0, 6.0]])
PLACES = [(0.0, 0.0, 1.0), (8.0, 0.0, 2.5), (4.0, 6.0, 0.5)]
SIGMA = 0.02


def room(places=PLACES, **options) -> Scene:
    arrays = tuple(MicrophoneArray(f"a{i}", np.array(p), sigma=SIGMA, **options) for i, p in enumerate(places))
    return Scene(arrays=arrays, room=ROOM, room_height=3.0)


def scan(scene: Scene, t_s: float, sensors, xyz=SOURCE, labelled=True, elevation=True) -> Scan:
    """Exact directions of a source."""
    to = xyz - np.array([scene.arrays[i].position for i in sensors])
    n = len(sensors)
    none = np.full(n, np.nan)
    return Scan.of(
        round(t_s * 1e9),
        sensors,
        target_id=np.full(n, 0 if labelled else -1),
        bearing=np.arctan2(to[:, 1], to[:, 0]),
        sigma=np.full(n, SIGMA),
        elevation=np.arctan2(to[:, 2], np.hypot(to[:, 0], to[:, 1])) if elevation else none,
        sigma_elevation=np.full(n, SIGMA) if elevation else none,
    )


def run(scene: Scene, scans, seed=0, **settings):
    rng = np.random.default_rng(seed)
    state = direct3d.init(scene, Direct3dConfig(**settings), rng)
    for one in scans:
        state, estimate = direct3d.step(state, one, rng)
    return estimate


def place(estimate):
    return np.array([*estimate.xy, estimate.height.z])
