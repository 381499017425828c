"""The example of [Rahimi] Sec. 6: a room with eight cameras that do not overlap, and a target that the walls reflect.

The scan of the paper has no figures and its text gives few numbers: this is the project's reference for the example.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from occlog.array_types import Floats, Ints
from occlog.core.geometry.camera import u_to_azimuth
from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Truth
from occlog.simulate.config import ObserveConfig
from occlog.simulate.sensors.cameras import observe
from occlog.track.methods.map.fit_motion.em import fit_em
from occlog.track.methods.map.fit_motion.parameters import Shape
from occlog.track.methods.map.fit_motion.smoother import MeasuredPath

HALF = 5.0
"""Half the side of the square room [m]."""
CORNERS = ((-1, -1), (1, -1), (1, 1), (-1, 1))
PLACES = [
    (-5, -5, 45),
    (0, -5, 90),
    (5, -5, 135),
    (5, 0, 180),
    (5, 5, 225),
    (0, 5, 270),
    (-5, 5, 315),
    (-5, 0, 0),
]
"""x, y [m] and yaw [deg] of the cameras."""
FOV_DEG, RANGE = 40.0, 3.5
FOCAL_PX, READ_PX = 100.0, 1.0
"""Focal length and reading noise [px]: a standard deviation of 0.01 in the paper's unit, f = 1."""
STEP_S, SPEED = 0.5, 0.5
SMOOTHING = 5.0
"""Standard deviation of the Gaussian that smooths a path [steps]."""
PATH, NOISE, FALSE, TRAINING = 0, 1, 2, 3
"""Purpose of random numbers, the last part of their key."""
TRAINING_PATHS, TRAINING_STEPS, TRAINING_NOISE = 40, 200, 1e-3


class Example(NamedTuple):
    """One random problem: true path of the target, and bearings of the cameras."""

    truth: Truth
    bearings: Bearings


@functools.cache
def sparse_scene(*, known_range: bool) -> Scene:
    """Scene of the room with its eight cameras; the same object at every call.

    `known_range`: whether cameras have their range, as in the world; else they have none, as in the paper's method.
    """
    room = [(a * HALF, b * HALF) for a, b in CORNERS]
    cameras = [(*place, RANGE if known_range else None) for place in PLACES]
    return scene_of("the example of [Rahimi]", room, cameras)


def scene_of(
    name: str,
    room: Sequence[tuple[float, float]],
    cameras: Iterable[tuple[float, float, float, float | None]],
    wall: Sequence[tuple[float, float]] = (),
) -> Scene:
    """Scene in metres with the cameras `cam1`, `cam2`, ... of [Rahimi] Sec. 6.

    Args:
        name: names the scene in messages.
        room: corners of the room [m].
        cameras: x, y [m], yaw [deg] and range [m] of each; without a limit if the range is None.
        wall: corners of a wall in the room [m]; empty: none.
    """
    lines = ["occlog_scene: 1", "length_unit: m", f"room: {[list(p) for p in room]}"]
    if wall:
        lines.append(f"static_occluders:\n- {{name: wall, polygon: {[list(p) for p in wall]}}}")
    lines.append("cameras:")
    for n, (x, y, yaw, reach) in enumerate(cameras, start=1):
        limit = "" if reach is None else f", range: {reach:g}"
        lines.append(
            f"- {{name: cam{n}, position: [{x}, {y}], yaw_deg: {yaw}, focal_px: {FOCAL_PX:g}, "
            f"fov_deg: {FOV_DEG:g}{limit}, noise: {{position: 0, yaw: 0, measurement_noise_px: {READ_PX:g}}}}}"
        )
    return scene_from_yaml("\n".join(lines) + "\n", name)


def reflected_path(steps: int, rng: np.random.Generator, smoothing: float = SMOOTHING) -> Floats:
    """Draw positions (steps, 2) [m] of a target that moves straight at constant speed, with reflections at the walls.

    The path is smoothed.

    Args:
        steps: number of positions, at intervals of `STEP_S`.
        rng: draws the first position and the direction.
        smoothing: standard deviation of the Gaussian that smooths the path [steps].
    """
    rest = math.ceil(4.0 * smoothing)
    first, angle = rng.uniform(-HALF, HALF, 2), rng.uniform(-math.pi, math.pi)
    way = SPEED * STEP_S * np.arange(steps + 2 * rest)[:, None] * np.array([math.cos(angle), math.sin(angle)])
    # Reflect: fold the straight path of the unfolded plane back at every wall
    folded = np.abs((first + way + HALF) % (4.0 * HALF) - 2.0 * HALF)
    path = gaussian_filter1d(HALF - folded, smoothing, axis=0)
    return np.asarray(path[rest : rest + steps])


def example(seed: int, run: int, steps: int, false: float = 0.0) -> Example:
    """Draw a random problem: the target's path, and the cameras' bearings.

    Args:
        seed: seed of all problems.
        run: number of the problem.
        steps: number of times, at intervals of `STEP_S`.
        false: share of the measurements that are replaced by ones drawn uniformly from the field of view.
    """
    xy = reflected_path(steps, _rng(seed, run, PATH))
    truth = truth_of(xy)
    noise_seed = int(_rng(seed, run, NOISE).integers(2**31))
    scene = sparse_scene(known_range=True)
    bearings = Bearings.concat(observe(scene, [truth], ObserveConfig(diameter=0.0), noise_seed))
    return Example(truth, with_false(bearings, scene, false, _rng(seed, run, FALSE)))


def truth_of(xy: Floats, step_s: float = STEP_S) -> Truth:
    """Table of true positions `xy` (T, 2) [m], at intervals of `step_s` [s]."""
    n = len(xy)
    return Truth.of(
        t_ns=times(n, step_s),
        target_id=np.zeros(n, dtype=np.int32),
        role=np.full(n, "target"),
        x=xy[:, 0],
        y=xy[:, 1],
        z=np.full(n, np.nan),
    )


def with_false(bearings: Bearings, scene: Scene, share: float, rng: np.random.Generator) -> Bearings:
    """Bearings of which a share is replaced by ones drawn uniformly from the field of view.

    Each measurement has its own draws, used or not, so that a larger share only adds to the false ones.

    Args:
        bearings: measurements; rows in which nothing is seen stay.
        scene: cameras of the measurements.
        share: probability that a measurement is replaced.
        rng: random numbers of the replacements.
    """
    chance, position = rng.random((2, len(bearings)))
    false = bearings.seen & (chance < share)
    if not false.any():
        return bearings
    half = FOCAL_PX * math.tan(math.radians(0.5 * FOV_DEG))
    u = np.where(false, half * (2.0 * position - 1.0), bearings.u_px)
    bearing, sigma = bearings.bearing.copy(), bearings.sigma.copy()
    for camera in scene.cameras:
        rows = false & (bearings.sensor == camera.name)
        bearing[rows] = u_to_azimuth(u[rows], camera.yaw, FOCAL_PX)
        sigma[rows] = READ_PX / (FOCAL_PX * (1.0 + (u[rows] / FOCAL_PX) ** 2))
    return bearings.with_columns(u_px=u, bearing=bearing, sigma=sigma)


@functools.lru_cache(maxsize=8)
def identified(seed: int, fit_step_s: float = STEP_S) -> tuple[float, float]:
    """Acceleration and jitter of constant-velocity motion (see `MapConfig`), fitted to paths that belong to no problem.

    The paths' positions are known to a millimetre. A turn takes several steps: a fit at the paper's step assumes that
    these are independent, one at a longer step sees the whole turn as one change.

    Args:
        seed: seed of the problems.
        fit_step_s: step at which the paths are sampled [s], a multiple of `STEP_S`.
    """
    rng, every = _rng(seed, 0, TRAINING), round(fit_step_s / STEP_S)
    t_ns = times(TRAINING_STEPS)[::every]
    paths = [MeasuredPath(t_ns, reflected_path(TRAINING_STEPS, rng)[::every]) for _ in range(TRAINING_PATHS)]
    return fitted_motion(paths, every * STEP_S)


def fitted_motion(paths: Sequence[MeasuredPath], step_s: float) -> tuple[float, float]:
    """Acceleration and jitter of constant-velocity motion (`MapConfig`), fitted to `paths` in steps of `step_s` [s]."""
    shape = Shape("cv", "white", similar=True, noise=False)
    fit = fit_em(paths, step_s, shape, longest_gap_s=step_s, noise=TRAINING_NOISE)
    return fit.parameters["acceleration"], fit.parameters["jitter"]


def times(steps: int, step_s: float = STEP_S) -> Ints:
    """Times (steps,) of a problem [ns], from 0, at intervals of `step_s` [s]."""
    return np.asarray(np.rint(np.arange(steps) * step_s * 1e9), dtype=np.int64)


def _rng(seed: int, run: int, purpose: int) -> np.random.Generator:
    """Generator for one purpose (`PATH`, `NOISE`, ...) in the problem `run`."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(run, 2004, purpose)))
