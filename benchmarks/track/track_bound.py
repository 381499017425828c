"""RMSE of the auxiliary particle filter over the posterior Cramer-Rao bound, in the reference scene of [Ercan]."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.stage import evaluate
from occlog.io.scenes.scene import read_scene
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Tracks, Truth
from occlog.simulate.config import ObserveConfig, WorldConfig
from occlog.simulate.sensors.cameras import observe
from occlog.simulate.stage import simulate_truth
from occlog.track.apf.config import ApfConfig
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import Tracking

NAME = "track_bound"
SUMMARY = "RMSE over the posterior bound: 100x100 room, 8 cameras, random waypoints, ten seeds, first 20 steps left out"
LIMIT = 1.3
ROOT = Path(__file__).resolve().parents[2]
SEEDS = 10
STEPS = 300
SKIP_S = 20.0
WORLDS = {
    "random waypoints": (True, 0.0),
    "random waypoints, no occluder": (False, 0.0),
    "waypoints+ (redirect 0.095)": (True, 0.095),
    "waypoints+, no occluder": (False, 0.095),
}


def squares(scene: Scene, redirect: float, config: ApfConfig, seed: int, steps: int) -> tuple[float, float]:
    """Mean squared error and mean squared bound of one run, over the same steps.

    Args:
        scene: room and cameras.
        redirect: probability of a new destination within a second.
        config: of the filter.
        seed: of world, measurements and filter.
        steps: of one second.
    """
    world = WorldConfig(steps=steps, redirect=redirect)
    truth = Truth.concat(simulate_truth(scene, world, seed))
    bearings = Bearings.concat(observe(scene, [truth], ObserveConfig(), seed))
    tracks = Tracks.concat(part.tracks for part in track([bearings], scene, Tracking(config, seed)))
    result = evaluate(tracks, truth, bearings, scene, EvaluateConfig(sigma_v=world.sigma))
    late = result.errors.t_ns >= truth.t_ns[0] + round(SKIP_S * 1e9)
    same = np.isin(result.bound.t_ns, result.errors.t_ns[late])
    return float(np.mean(result.errors.error[late] ** 2)), float(np.mean(result.bound.bound[same] ** 2))


def ratio_of(scene: Scene, redirect: float, config: ApfConfig, seeds: int = SEEDS, steps: int = STEPS) -> float:
    """Root of the mean squared error over the root of the mean squared bound, both over all seeds."""
    found = np.array([squares(scene, redirect, config, seed, steps) for seed in range(seeds)])
    error, bound = found.mean(axis=0)
    return math.sqrt(error / bound)


def run(repeats: int = 1) -> dict[str, Any]:  # noqa: ARG001 - seeds are fixed, so repeats would say the same
    """The ratio in the paper's world, and in others with more particles."""
    scene = read_scene(ROOT / "examples" / "room100.yaml")
    parts: dict[str, float] = {}
    for particles in (ApfConfig().particles, 1000, 4000):
        for name, (pillar, redirect) in WORLDS.items():
            place = scene if pillar else replace(scene, occluders=())
            parts[f"{name}, L = {particles}"] = ratio_of(place, redirect, ApfConfig(particles=particles))
    return {"ratio": next(iter(parts.values())), "limit": LIMIT, "parts": parts}
