"""A room with microphone arrays, and exact directions of a still source."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.filtering.motion.coordinated_turn import acceleration_root
from occlog.records.scene import MicrophoneArray, Scene
from occlog.scans.grouping import Scan
from occlog.track.methods.in_space import direct3d
from occlog.track.methods.in_space.config import Direct3dConfig

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


def walk(start, steps: int, dt: float, q: float, rng) -> np.ndarray:
    """(steps, 6) states of a target with white acceleration of density q."""
    states = np.empty((steps, 6))
    states[0] = start
    root = acceleration_root(q, dt)
    for k in range(1, steps):
        ahead = states[k - 1].copy()
        ahead[:3] += dt * ahead[3:]
        states[k] = ahead + (root @ rng.standard_normal((2, 3))).ravel()
    return states


def noisy_scan(scene: Scene, t_s: float, xyz, sigma: float, rng) -> Scan:
    """Directions of a source from all arrays, with noise in azimuth and polar angle."""
    n = len(scene.arrays)
    one = scan(scene, t_s, range(n), xyz=np.asarray(xyz))
    spread = np.full(n, sigma)
    return one._replace(
        bearing=one.bearing + sigma * rng.standard_normal(n),
        elevation=one.elevation + sigma * rng.standard_normal(n),
        sigma=spread,
        sigma_elevation=spread,
    )


class Followed(NamedTuple):
    """A target as a filter had it, and as its smoother has it."""

    filtered: tuple[np.ndarray, np.ndarray]  # places (T, 3) and their covariances (T, 3, 3)
    smoothed: tuple[np.ndarray, np.ndarray]
    estimates: list


def follow(module, scene: Scene, scans, config, rng) -> Followed:
    """Run a filter in space over scans, and its smoother back over them."""
    state, estimates, traces = module.init(scene, config, rng), [], []
    for one in scans:
        state, estimate = module.step(state, one, rng)
        estimates.append(estimate)
        traces.append(module.METHOD.smoothing.trace(state))
    past = module.METHOD.smoothing.back(traces, config, rng)
    return Followed(in_space(estimates), in_space(past), estimates)


def in_space(estimates) -> tuple[np.ndarray, np.ndarray]:
    """Places (T, 3) and covariances (T, 3, 3)."""
    positions = np.array([[*e.xy, e.height.z] for e in estimates])
    rows = [
        [[*e.covariance[0], e.height.covariance[0]], [*e.covariance[1], e.height.covariance[1]], e.height.covariance]
        for e in estimates
    ]
    return positions, np.array(rows)


def nees(found, truth) -> np.ndarray:
    """(T,) normalised squared errors."""
    off = found[0] - truth
    return np.einsum("ti,ti->t", off, np.linalg.solve(found[1], off[:, :, None])[:, :, 0])
