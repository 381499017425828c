"""Bearings of several targets with their truth, tracks and diagnostics: hand-made on the ground and in space, and
simulated.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from evaluate_scenes import array, both, box, camera, directions, heard, heights, pixels, scene, tracks, truth

from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Diagnostics, Tracks, Truth
from occlog.simulate.config import ObserveConfig, WorldConfig
from occlog.simulate.sensors.cameras import observe
from occlog.simulate.stage import simulate_truth


class Case(NamedTuple):
    """What is compared."""

    place: Scene
    tracks: Tracks
    truth: Truth
    bearings: Bearings
    diagnostics: Diagnostics


def filter_diagnostics(ours: Tracks, random: np.random.Generator) -> Diagnostics:
    """How a filter fared that did not always use all sensors."""
    values: dict[str, Any] = {}
    for c in Diagnostics.columns():
        if not c.optional:
            values[c.name] = np.full(len(ours), "") if c.kind == "U" else np.zeros(len(ours), c.dtype)
    used = random.choice(["a,b,c,ear", "a,b", "c"], len(ours), p=[0.8, 0.1, 0.1])
    ess = random.uniform(5.0, 300.0, len(ours))
    return Diagnostics.of(**values | {"t_ns": ours.t_ns, "target_id": ours.target_id, "cameras": used, "ess": ess})


def cameras() -> Scene:
    noise = {"sigma_position": 0.02, "sigma_yaw": 0.002}
    return scene(
        camera("a", 0, 10, 0, **noise),
        camera("b", 10, 0, 90, **noise),
        camera("c", 20, 20, 225),
        occluders=(box("pillar", 8, 8, 11, 11),),
    )


def hand_made(seed: int) -> Case:
    """Two targets and a moving occluder with gaps of all widths; labels, candidates, false alarms; other clocks."""
    random, place = np.random.default_rng(seed), cameras()
    t = np.sort(np.concatenate([np.arange(0, 9, 0.25), np.arange(120, 126, 0.25)]))

    def at(k: int, s: np.ndarray) -> np.ndarray:
        return np.column_stack([5.0 + 3.0 * k + 0.05 * s % 9, 14.0 - 2.0 * k + np.sin(s + k)])

    true = [
        truth(s, at(k, s), k, z=np.where(random.random(len(s)) < 0.3, np.nan, 1.0 + k))
        for k, s in ((0, t[random.random(len(t)) < 0.9]), (1, t[random.random(len(t)) < 0.7][3:]), (2, t))
    ]
    walker = truth(t[::2], at(7, t[::2]), 7, "occluder")
    ours = []
    for number, k in ((0, 0), (1, 1), (40, 2)):
        s = t[random.random(len(t)) < 0.9][2 + k :] + random.choice([0.0, 0.03])
        ours.append(tracks(s, at(k, s) + random.normal(0, 0.2, (len(s), 2)), number, 0.04))
    rows = []
    for cam in place.cameras:
        s = t + {"a": 0.0, "b": 0.01, "c": 0.03}[cam.name]
        for k in range(3):
            away = at(k, s) - cam.ground
            bearing = np.arctan2(away[:, 1], away[:, 0]) - cam.yaw
            u = -100.0 * np.tan(bearing) + random.normal(0, 1.0, len(s))
            u[(random.random(len(s)) < 0.15) | (np.cos(bearing) < 0.1)] = np.nan
            u[random.random(len(s)) < 0.05] += 30.0
            label = -1 if k == 2 else k
            rows.append(pixels(cam, s, u, label).take(random.random(len(s)) < 0.9))
        false = s[random.random(len(s)) < 0.2]
        rows.append(pixels(cam, false, random.uniform(-50, 50, len(false)), -1))
    mine = both(*ours)
    return Case(place, mine, both(*true, walker), both(*rows), filter_diagnostics(mine, random))


def in_space(seed: int) -> Case:
    """Arrays that hear elevations, one of them tilted, and a camera; heights are known now and then."""
    random = np.random.default_rng(seed)
    ears = [array("ear", 1, 1, 2.0, sigma=0.02), array("tilted", 18, 2, 1.0, sigma=0.03, roll=0.6)]
    place = replace(scene(camera("c", 20, 20, 225)), arrays=tuple(ears))
    t = np.concatenate([np.arange(0, 6, 0.2), np.arange(80, 84, 0.2)])
    xyz = np.column_stack([8.0 + np.sin(t), 9.0 + np.cos(t), 1.5 + 0.2 * np.sin(3 * t)])
    true = truth(t, xyz[:, :2], 0, z=np.where(random.random(len(t)) < 0.2, np.nan, xyz[:, 2]))
    ours = heights(tracks(t, xyz[:, :2] + random.normal(0, 0.1, (len(t), 2)), 0, 0.01), xyz[:, 2] + 0.1, (0, 0, 0.04))
    rows = [heard(ear, t, xyz, 0) for ear in ears] + [directions("c", t, np.full(len(t), -2.3), 0.02)]
    return Case(place, ours, true, both(*rows), filter_diagnostics(ours, random))


def simulated(seed: int) -> Case:
    """What the simulation makes: hidden targets, misses and false alarms."""
    place = cameras()
    world = WorldConfig(steps=50, targets=3, occluders=2, diameter=1.0)
    true = Truth.concat(simulate_truth(place, world, seed))
    seen = Bearings.concat(
        observe(place, [true], ObserveConfig(diameter=1.0, miss_probability=0.1, false_alarm_probability=0.2), seed)
    )
    own, random = true.take(true.role == "target"), np.random.default_rng(seed)
    off = random.normal(0, 0.05, (2, len(own)))
    spread = {"cov_xx": np.full(len(own), 0.0025), "cov_xy": np.zeros(len(own)), "cov_yy": np.full(len(own), 0.0025)}
    ours = Tracks.of(
        t_ns=own.t_ns, target_id=own.target_id, x=own.x + off[0], y=own.y + off[1], vx=off[0], vy=off[1], **spread
    )
    return Case(place, ours, true, seen, filter_diagnostics(ours, random))


CASES = {"hand-made": hand_made, "in space": in_space, "simulated": simulated}
