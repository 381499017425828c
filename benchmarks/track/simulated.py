"""Simulated recordings in the reference scene of [Ercan], for the cases that measure accuracy over seeds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.io.formats.scenes.scene import read_scene
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Truth
from occlog.scans.grouping import BearingRows, Scan, scans_of
from occlog.simulate.config import ObserveConfig, WorldConfig
from occlog.simulate.sensors.cameras import observe
from occlog.simulate.stage import simulate_truth
from occlog.track.interface import Estimate
from occlog.track.methods.apf import filter as apf
from occlog.track.methods.apf.config import ApfConfig

ROOT = Path(__file__).resolve().parents[2]
ORDER = (1, 7, 5, 3, 2, 4, 6, 8)
TARGET = 0


class Recording(NamedTuple):
    """Scans of the target and where it truly was at their times."""

    truth: Truth
    scans: list[Scan]
    xy: Floats  # (T, 2)


def room100(cameras: int) -> Scene:
    """The reference scene with its first cameras, in their order of use."""
    scene = read_scene(ROOT / "examples" / "room100.yaml")
    names = [f"cam{i}" for i in ORDER[:cameras]]
    return replace(scene, cameras=tuple(c for c in scene.cameras if c.name in names))


def record(scene: Scene, world: WorldConfig, how: ObserveConfig, seed: int) -> Recording:
    """One simulated recording with a scan at every step."""
    truth = Truth.concat(simulate_truth(scene, world, seed))
    bearings = Bearings.concat(observe(scene, [truth], how, seed))
    found = scans_of([bearings], scene, BearingRows({c.name for c in scene.cameras}))
    scans = [scan for group in found if (scan := group.of_target(TARGET)) is not None]
    own = truth.target_id == TARGET
    at = np.searchsorted(truth.t_ns[own], [s.t_ns for s in scans])
    return Recording(truth, scans, np.column_stack([truth.x[own], truth.y[own]])[at])


def follow(scene: Scene, recording: Recording, config: ApfConfig, seed: int) -> tuple[apf.ApfState, list[Estimate]]:
    """The filter over a whole recording: its last state and all estimates."""
    rng = generator(seed, RandomStream.TRACK, TARGET)
    state, out = apf.init(scene, config, rng), []
    for scan in recording.scans:
        state, estimate = apf.step(state, scan, rng)
        out.append(estimate)
    return state, out


def rmse(estimates: list[Estimate], xy: Floats, skip: int) -> float:
    """Root of the mean squared distance, without the first steps."""
    miss = np.array([e.xy for e in estimates])[skip:] - xy[skip:]
    return float(np.sqrt(np.mean(np.sum(miss**2, axis=1))))


def nees(estimates: list[Estimate], xy: Floats, skip: int) -> float:
    """Mean normalised squared error; 2 if covariances are right."""
    rows = zip(estimates[skip:], xy[skip:], strict=True)
    return float(np.mean([(e.xy - p) @ np.linalg.solve(e.covariance, e.xy - p) for e, p in rows]))
