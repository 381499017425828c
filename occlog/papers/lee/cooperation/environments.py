"""The environments of [Lee] Ch. 3 with simulated bearings: those of Fig. 3-4, of Fig. 3-7 and of Sec. 3.4.

The room's ranges are those on the ground, so its sensors are at the height of the objects.

The thesis does not print which way the turns go, the positions of the field's cameras, and the
ranges of the room's sensors.  They are chosen as in the files of the same names in `examples/`.

Of Fig. 3-4 the text has the starts of the three objects, the number of samples, the models and the
noise; the paths are only drawn, and the figure is lost.  So each run draws its own paths: speeds
of 0.2 to 0.3 m/s towards the sensor's side of the field, and one of the three models in each of the
sections of Fig. 3-7.  The sensor is at the origin, as the bearings of Eqs. 3.2 and 3.4 are.
"""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.interpolate import TimeGrid
from occlog.core.plane import inside_polygon
from occlog.io.formats.scenes.paths import paths_from_yaml
from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.records.scene import MotionScript, Scene
from occlog.records.tables import Bearings
from occlog.scans.sources import bearings_of_doa, within_times
from occlog.simulate.config import ObserveConfig
from occlog.simulate.sensors.arrays import observe_arrays
from occlog.simulate.sensors.cameras import observe
from occlog.simulate.world.scripted_paths import silences, simulate_paths

FIELD = """
occlog_scene: 1
length_unit: m
room: [[0, 0], [50, 0], [50, 50], [0, 50]]
microphone_arrays:
- {name: mic, position: [25, 25], sigma_deg: 1.7320508075688772, range: 22.9, resolution_deg: 3, planar: true, rate_hz: 1}
cameras:
- {name: cam1, position: [0, 0, 3], yaw_deg: 45, focal_px: 320, image_size_px: [640, 480], noise: {measurement_noise_px: 2}}
- {name: cam2, position: [50, 0, 3], yaw_deg: 135, focal_px: 320, image_size_px: [640, 480], noise: {measurement_noise_px: 2}}
- {name: cam3, position: [0, 50, 3], yaw_deg: 315, focal_px: 320, image_size_px: [640, 480], noise: {measurement_noise_px: 2}}
"""  # noqa: E501
FIELD_PATHS = """
occlog_paths: 1
length_unit: m
seconds: 200
rate_hz: 1
targets:
- id: 1
  position: [5, 3]
  velocity: [0.2, 0.2]
  segments:
  - {from_s: 50, until_s: 100, lateral: -0.01}
  - {until_s: 150, lateral: 0.01}
  - {until_s: 200, lateral: 0.01}
- id: 2
  position: [22, 3]
  velocity: [-0.2, 0.2]
  segments:
  - {from_s: 50, until_s: 100, lateral: -0.01}
  - {until_s: 150, lateral: 0.01}
  - {until_s: 200, lateral: -0.01}
- id: 3
  from_s: 20
  until_s: 195
  position: [48.6, 3.5]
  velocity: [-0.15, 0.15]
  segments:
  - {from_s: 100, until_s: 150, lateral: -0.01}
"""
ROOM = """
occlog_scene: 1
length_unit: m
room: [[0, 0], [14.63, 0], [14.63, 8.23], [0, 8.23]]
microphone_arrays:
- {name: A1, position: [3.2, 1.9, 0.9], sigma_deg: 1.7320508075688772, range: 3.05, resolution_deg: 3, planar: true, rate_hz: 100}
- {name: A2, position: [7.6, 6.8, 0.9], sigma_deg: 1.7320508075688772, range: 4.71, resolution_deg: 3, planar: true, rate_hz: 100}
cameras:
- {name: V1, position: [1.9, 6.3, 1.2], yaw_deg: -37, focal_px: 160, image_size_px: [320, 240], rate_hz: 6, noise: {measurement_noise_px: 2}}
- {name: V2, position: [13.4, 5.0, 1.2], yaw_deg: 187, focal_px: 160, image_size_px: [320, 240], rate_hz: 6, noise: {measurement_noise_px: 2}}
- {name: V3, position: [5.5, 0.3, 1.2], yaw_deg: 98, focal_px: 160, image_size_px: [320, 240], rate_hz: 6, noise: {measurement_noise_px: 2}}
"""  # noqa: E501
ROOM_PATHS = """
occlog_paths: 1
length_unit: m
seconds: 19
rate_hz: 100
targets:
- id: 1
  position: [2.9, 4.5]
  velocity: [0, -0.3]
  silent: [[5, 7]]
  segments:
  - {from_s: 3.6, until_s: 7.1, lateral: 0.15}
  - {from_s: 13.5, until_s: 15, lateral: 0.2}
- id: 2
  position: [4.8, 3.5]
  velocity: [0.3, -0.1]
  segments:
  - {from_s: 4.5, until_s: 6.1, lateral: 0.45}
  - {from_s: 7.5, until_s: 8.5, lateral: 0.3}
  - {until_s: 9.5, lateral: -0.3}
  - {from_s: 13, until_s: 16, lateral: -0.25}
- id: 3
  position: [5.1, 8.2]
  velocity: [0, 0]
  silent: [[0, 13]]
  segments:
  - {from_s: 13, velocity: [0, -1.3]}
"""
OPEN = """
occlog_scene: 1
length_unit: m
room: [[-20, -20], [70, -20], [70, 70], [-20, 70]]
microphone_arrays:
- {name: mic, position: [0, 0], sigma_deg: 2.23606797749979, planar: true, rate_hz: 1}
cameras:
- {name: cam1, position: [-20, -20, 3], yaw_deg: 45, focal_px: 320, image_size_px: [640, 480],
     noise: {measurement_noise_px: 2}}
- {name: cam2, position: [70, -20, 3], yaw_deg: 135, focal_px: 320, image_size_px: [640, 480],
     noise: {measurement_noise_px: 2}}
- {name: cam3, position: [-20, 70, 3], yaw_deg: 315, focal_px: 320, image_size_px: [640, 480],
     noise: {measurement_noise_px: 2}}
"""
OPEN_STARTS = ((50.0, 30.0), (35.0, 50.0), (45.0, 45.0))
"""Initial positions of the objects of Fig. 3-4 [m]."""
OPEN_SPEEDS, OPEN_SIDE = (0.2, 0.3), math.radians(45.0)
"""Least and greatest speed [m/s], and how far a first course may be from that to the origin."""
STRETCHES = ((50, 100), (100, 150), (150, 200))
"""Times between which one model holds, as in Fig. 3-7 [s]; the first section is straight."""
HEIGHT = 0.9
"""Height of the sound sources [m]."""
PAIR = "\n".join(line for line in FIELD.splitlines() if "cam3" not in line)
"""The field with the two cameras alone with axes at a right angle."""
TEXTS = {"field": (FIELD, FIELD_PATHS), "pair": (PAIR, FIELD_PATHS), "room": (ROOM, ROOM_PATHS)}


class Environment(NamedTuple):
    """A simulated scene: true paths of K targets at T times, all bearings, and what A arrays can hear.

    `heard` (A, T, K) is 1 where array a can hear target k: it is present, sounds, and is in range.
    """

    scene: Scene
    truth: TimeGrid
    bearings: Bearings
    heard: Floats  # (A, T, K) 1 where array a can hear target k: it is there, sounds, and is in range


@functools.lru_cache(maxsize=4)
def environment(name: str, seed: int, run: int, variance: float | None = None) -> Environment:
    """Simulate `open` ([Lee] Fig. 3-4), `field` or `pair` (Fig. 3-7), or `room` (Sec. 3.4); results are cached.

    Args:
        name: name of the environment.
        seed: seed of all random numbers.
        run: number of the run.
        variance: variance of the arrays' noise [deg^2], above 0; None: that of the scene.
    """
    own = int(np.random.SeedSequence(seed, spawn_key=(run, 2009)).generate_state(1)[0])
    text, paths = (OPEN, "") if name == "open" else TEXTS[name]
    scene = scene_from_yaml(text, name)
    if variance is not None:
        sigma = math.radians(math.sqrt(variance))
        scene = replace(scene, arrays=tuple(replace(a, sigma=sigma) for a in scene.arrays))
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(run, 2009, 34)))
    while True:
        script = paths_from_yaml(paths or _drawn_paths(rng), name)
        grids = list(simulate_paths(script, *_steps(script), HEIGHT, 0, own))
        positions = np.concatenate([g.xyz for g in grids])
        if paths or _within(scene, positions):
            break
    truth = TimeGrid(np.concatenate([g.t_ns for g in grids]), grids[0].ids, grids[0].target, positions)
    silent = silences(script, 0)
    observation = ObserveConfig(diameter=0.0)
    cameras, sounds = (
        observe(scene, grids, observation, own),
        observe_arrays(scene, grids, observation, own, silent=silent),
    )
    bearings = Bearings.concat(list(within_times([list(cameras), list(bearings_of_doa(sounds, scene))])))
    return Environment(scene, truth, bearings, _heard(scene, truth, silent))


def _steps(script: MotionScript) -> tuple[int, float]:
    """Number of steps of a script and the time between them [s]."""
    assert script.rate_hz is not None
    assert script.seconds is not None
    step_s = 1.0 / script.rate_hz
    return round(script.seconds / step_s) + 1, step_s


def _drawn_paths(rng: np.random.Generator) -> str:
    """Draw paths from the starts of [Lee] Fig. 3-4; return them as YAML text."""
    lines = ["occlog_paths: 1", "length_unit: m", "seconds: 200", "rate_hz: 1", "targets:"]
    for number, (x, y) in enumerate(OPEN_STARTS, start=1):
        speed, side = rng.uniform(*OPEN_SPEEDS), rng.uniform(-OPEN_SIDE, OPEN_SIDE)
        course = math.atan2(-y, -x) + side
        vx, vy = (speed * part(course) for part in (math.cos, math.sin))
        lines += [f"- id: {number}", f"  position: [{x}, {y}]", f"  velocity: [{vx:.6f}, {vy:.6f}]", "  segments:"]
        for since, until in STRETCHES:
            lateral = 0.01 * int(rng.integers(-1, 2))
            lines.append(f"  - {{from_s: {since}, until_s: {until}, lateral: {lateral}}}")
    return "\n".join(lines)


def _within(scene: Scene, positions: Floats) -> bool:
    """Whether all positions (T, K, 3) are inside the scene's room."""
    flat = np.ascontiguousarray(positions[..., :2].reshape(-1, 2))
    return bool(inside_polygon(flat, scene.surroundings).all())


def _heard(scene: Scene, truth: TimeGrid, silent: dict[int, Ints]) -> Floats:
    out = np.zeros((len(scene.arrays), *truth.xyz.shape[:2]))
    for a, array in enumerate(scene.arrays):
        away = truth.xyz - array.position
        out[a] = np.nan_to_num(np.linalg.norm(away, axis=2), nan=np.inf) <= array.range
    for k, number in enumerate(truth.ids.tolist()):
        for since, until in silent.get(number, np.empty((0, 2))).tolist():
            out[:, (truth.t_ns >= since) & (truth.t_ns < until), k] = 0.0
    return out
