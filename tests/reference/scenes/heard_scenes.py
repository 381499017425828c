"""Small scenes with microphone arrays, and what is heard and seen in them; made here, not by the simulator."""

from __future__ import annotations

import numpy as np

from occlog.core.geometry.camera import wrap_angle
from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.records.tables import Bearings

NS = 1_000_000_000
ROOM = """
occlog_scene: 1
length_unit: m
room: [[0, 0], [20, 0], [20, 15], [0, 15]]
cameras:
- {name: c1, position: [0.5, 0.5, 2], yaw_deg: 45, focal_px: 500, image_size_px: [1000, 600], rate_hz: 5}
- {name: c2, position: [19.5, 0.5, 2], yaw_deg: 135, focal_px: 500, image_size_px: [1000, 600], rate_hz: 5}
- {name: c3, position: [10, 14.5, 2], yaw_deg: -90, focal_px: 300, image_size_px: [1000, 600], rate_hz: 5}
microphone_arrays:
- {name: a1, position: [2, 2, 1], sigma_deg: 2, rate_hz: 5}
- {name: a2, position: [18, 3, 1], sigma_deg: 2, rate_hz: 5}
"""


def room(text=ROOM):
    return scene_from_yaml(text, "room")


def rows(scene, paths, *, seconds=20.0, step_s=0.2, seed=0, sounds=None, cameras=False, labels=False, miss=0.0):
    """Bearings of all arrays (unlabelled unless `labels`) and cameras (labelled) to paths {number: t -> (x, y)}.

    `sounds(number, t)` says whether a target is heard.
    """
    rng, out = np.random.default_rng(seed), []
    for n in range(round(seconds / step_s) + 1):
        t = n * step_s
        for array in scene.arrays:
            for k, path in paths.items():
                noise, missed = array.sigma * rng.standard_normal(), rng.random() < miss
                away = np.asarray(path(t)) - array.position[:2]
                if missed or (sounds and not sounds(k, t)) or np.hypot(*away) > array.range:
                    continue
                angle = np.arctan2(away[1], away[0]) + noise
                out.append((round(t * NS), array.name, k if labels else -1, angle, array.sigma))
        for camera in scene.cameras if cameras else ():
            for k, path in paths.items():
                away = np.asarray(path(t)) - camera.position[:2]
                out.append((round(t * NS), camera.name, k, np.arctan2(away[1], away[0]), 0.002))
    return table(out)


def table(found):
    t_ns, sensor, target, angle, sigma = zip(*found, strict=True)
    n = len(found)
    return Bearings.of(
        t_ns=t_ns,
        sensor=sensor,
        target_id=target,
        seen=np.ones(n, dtype=bool),
        bearing=wrap_angle(np.array(angle)),
        sigma=sigma,
        u_px=np.full(n, np.nan),
        sigma_px=np.full(n, np.nan),
        score=np.full(n, np.nan),
    )


def line(x, y, vx, vy):
    return lambda t: (x + vx * t, y + vy * t)
