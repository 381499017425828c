"""A filter that has lost its target finds it again: steps after two cameras see it, over many runs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from benchmarks.track.simulated import Recording, record, room100
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.records.scene import Scene
from occlog.scans.grouping import Scan
from occlog.simulate.config import ObserveConfig, WorldConfig
from occlog.track.methods.apf import filter as apf
from occlog.track.methods.apf.config import ApfConfig

NAME = "recovery"
SUMMARY = "share of runs in which a lost target is not found within 20 steps of being seen by two cameras"
LIMIT = 0.05
RUNS = 100
OCCLUDERS = 40
CAMERAS = 4
HIDDEN = 60  # steps that nobody sees the target
FOUND = 5.0  # distance from which on it counts as found; the RMSE of a filter on track is 1.5
WITHIN = 20
AFTER = 60  # steps simulated after that
NEVER = 1000


def unseen(scan: Scan) -> Scan:
    """The scan of cameras that all look and do not see the target."""
    nothing = np.full(len(scan.sensor), np.nan)
    return scan._replace(
        seen=np.zeros(len(scan.sensor), dtype=np.bool_), bearing=nothing, sigma=nothing, u_px=nothing, sigma_px=nothing
    )


def opposite(recording: Recording) -> tuple[float, float, float]:
    """A start as far as possible from the target, and sure of itself."""
    x, y = np.where(recording.xy[0] > 50.0, 10.0, 90.0)
    return float(x), float(y), 2.0


def lost_from_start(scene: Scene, recording: Recording, config: ApfConfig, seed: int) -> int:
    """Steps seen by two cameras until a filter started at the wrong place has found the target."""
    rng = generator(seed, RandomStream.TRACK, 0)
    state = apf.init(scene, config, rng)
    return _until_found(state, recording, 0, rng)


def lost_in_hiding(scene: Scene, recording: Recording, config: ApfConfig, seed: int) -> int:
    """The same for a filter that was on track until the target was hidden for long."""
    rng = generator(seed, RandomStream.TRACK, 0)
    state = apf.init(scene, config, rng)
    for k, scan in enumerate(recording.scans[: 20 + HIDDEN]):
        state, _ = apf.step(state, scan if k < 20 else unseen(scan), rng)
    return _until_found(state, recording, 20 + HIDDEN, rng)


def _until_found(state: apf.ApfState, recording: Recording, first: int, rng: np.random.Generator) -> int:
    """Scans from the first one that two cameras see the target in, up to the first estimate near it.

    0 if two cameras never see it.
    """
    steps = 0
    for scan, xy in zip(recording.scans[first:], recording.xy[first:], strict=True):
        state, estimate = apf.step(state, scan, rng)
        if steps or np.count_nonzero(scan.seen) >= 2:
            steps += 1
            if math.dist(estimate.xy, xy) < FOUND:
                break
    else:
        return NEVER if steps else 0
    return steps


def run(repeats: int = 5, runs: int | None = None) -> dict[str, Any]:
    """The worse share of the two ways to be lost; 20 runs a repeat, so 100 by default."""
    runs = RUNS * repeats // 5 if runs is None else runs
    scene = room100(CAMERAS)
    steps: dict[str, list[int]] = {"started wrong": [], "hidden for long": []}
    for seed in range(runs):
        world = WorldConfig(steps=20 + HIDDEN + AFTER, occluders=OCCLUDERS)
        recording = record(scene, world, ObserveConfig(), seed)
        config = ApfConfig(particles=1000)
        wrong = ApfConfig(particles=1000, start=opposite(recording))
        steps["started wrong"].append(lost_from_start(scene, recording, wrong, seed))
        steps["hidden for long"].append(lost_in_hiding(scene, recording, config, seed))
    parts: dict[str, Any] = {"runs": runs}
    shares = []
    for name, found in steps.items():
        taken = np.array(found)[np.array(found) > 0]
        parts[f"{name}: runs in which two cameras see it"] = len(taken)
        shares.append(float(np.mean(taken > WITHIN)))
        parts[f"{name}: not found within {WITHIN} steps"] = shares[-1]
        parts[f"{name}: median steps"] = float(np.median(taken))
        parts[f"{name}: most steps"] = int(taken.max())
    return {"ratio": max(shares), "limit": LIMIT, "parts": parts}
