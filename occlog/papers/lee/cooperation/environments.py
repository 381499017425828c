"""The two environments of [Lee] Ch. 3, the field of Fig. 3-7 and the room of Sec. 3.4, with simulated bearings.

The room's ranges are those on the ground, so its sensors are at the height of the objects.

The thesis does not print which way the turns go, where the cameras of the field stand, and the
ranges of the room's sensors.  They are chosen as in the files of the same names in `examples/`.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.time_grid import Grid
from occlog.io.scenes.paths import paths_from_yaml
from occlog.io.scenes.scene import scene_from_yaml
from occlog.measure.scans.sources import bearings_of_doa, in_time
from occlog.records.scene import Scene
from occlog.records.tables import Bearings
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
- {name: cam1, position: [0, 0, 3], yaw_deg: 45, focal_px: 320, image_size_px: [640, 480], noise: {read_px: 2}}
- {name: cam2, position: [50, 0, 3], yaw_deg: 135, focal_px: 320, image_size_px: [640, 480], noise: {read_px: 2}}
- {name: cam3, position: [0, 50, 3], yaw_deg: 315, focal_px: 320, image_size_px: [640, 480], noise: {read_px: 2}}
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
- {name: V1, position: [1.9, 6.3, 1.2], yaw_deg: -37, focal_px: 160, image_size_px: [320, 240], rate_hz: 6, noise: {read_px: 2}}
- {name: V2, position: [13.4, 5.0, 1.2], yaw_deg: 187, focal_px: 160, image_size_px: [320, 240], rate_hz: 6, noise: {read_px: 2}}
- {name: V3, position: [5.5, 0.3, 1.2], yaw_deg: 98, focal_px: 160, image_size_px: [320, 240], rate_hz: 6, noise: {read_px: 2}}
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
HEIGHT = 0.9
"""Height of the sound sources [m]."""
TEXTS = {"field": (FIELD, FIELD_PATHS), "room": (ROOM, ROOM_PATHS)}


class Environment(NamedTuple):
    """A scene, the true paths of A arrays' K targets at T times, and all bearings."""

    scene: Scene
    truth: Grid
    bearings: Bearings
    heard: Floats  # (A, T, K) 1 where array a can hear target k: it is there, sounds, and is in range


@functools.lru_cache(maxsize=4)
def environment(name: str, seed: int, run: int) -> Environment:
    """Simulate `field` or `room` with the noise of a run."""
    scene, script = scene_from_yaml(TEXTS[name][0], name), paths_from_yaml(TEXTS[name][1], name)
    assert script.rate_hz is not None
    assert script.seconds is not None
    step_s = 1.0 / script.rate_hz
    own = int(np.random.SeedSequence(seed, spawn_key=(run, 2009)).generate_state(1)[0])
    grids = list(simulate_paths(script, round(script.seconds / step_s) + 1, step_s, HEIGHT, 0, own))
    truth = Grid(
        np.concatenate([g.t_ns for g in grids]), grids[0].ids, grids[0].target, np.concatenate([g.xyz for g in grids])
    )
    silent = silences(script, 0)
    looks = ObserveConfig(diameter=0.0)
    cameras, sounds = observe(scene, grids, looks, own), observe_arrays(scene, grids, looks, own, silent=silent)
    bearings = Bearings.concat(list(in_time([list(cameras), list(bearings_of_doa(sounds, scene))])))
    return Environment(scene, truth, bearings, _heard(scene, truth, silent))


def _heard(scene: Scene, truth: Grid, silent: dict[int, Ints]) -> Floats:
    out = np.zeros((len(scene.arrays), *truth.xyz.shape[:2]))
    for a, array in enumerate(scene.arrays):
        away = truth.xyz - array.position
        out[a] = np.nan_to_num(np.linalg.norm(away, axis=2), nan=np.inf) <= array.range
    for k, number in enumerate(truth.ids.tolist()):
        for since, until in silent.get(number, np.empty((0, 2))).tolist():
            out[:, (truth.t_ns >= since) & (truth.t_ns < until), k] = 0.0
    return out
