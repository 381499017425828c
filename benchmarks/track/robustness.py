"""False bearings and misses among moving occluders with priors: what they cost when the filter expects them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from benchmarks.track.simulated import Recording, follow, record, rmse, room100
from occlog.measure.priors.from_positions import virtual_priors
from occlog.records.scene import Scene
from occlog.scans.occluder_priors import OccluderFeed
from occlog.simulate.config import ObserveConfig, WorldConfig
from occlog.track.methods.apf.config import ApfConfig

NAME = "robustness"
SUMMARY = "RMSE with 5 % false bearings and 10 % misses to that without, 4 cameras, 40 occluders with priors"
LIMIT = 1.25
CAMERAS = 4
OCCLUDERS = 40
STEPS = 1000
SKIP = 20
FALSE, MISS = 0.05, 0.1
SIGMA, Q = 8.0, 1.2  # of the Kalman filters of the occluders: RMS error 6.67
DAY_NS = 86_400_000_000_000


def with_priors(recording: Recording, config: ApfConfig, seed: int) -> Recording:
    """The recording with priors of the occluders at every scan."""
    feed = OccluderFeed(virtual_priors([recording.truth], SIGMA, Q, seed), config.occluder_diameter, DAY_NS)
    return recording._replace(scans=[s._replace(occluders=feed.at(s.t_ns)) for s in recording.scans])


def one(scene: Scene, seed: int) -> dict[str, float]:
    """RMSE without and with disturbances, with and without the detection model, for the same world and noise."""
    plain = ApfConfig(particles=1000)
    model = ApfConfig(particles=1000, detection_probability=1.0 - MISS, false_alarm_probability=FALSE)
    out = {}
    for what, how in (
        ("clean", ObserveConfig()),
        ("disturbed", ObserveConfig(miss_probability=MISS, false_alarm_probability=FALSE)),
    ):
        recording = with_priors(record(scene, WorldConfig(steps=STEPS, occluders=OCCLUDERS), how, seed), plain, seed)
        for name, config in (("default", plain), ("detection model", model)):
            _, found = follow(scene, recording, config, seed)
            out[f"{what}, {name}"] = rmse(found, recording.xy, SKIP)
            out[f"{what}, {name}: restarts"] = sum(e.fallback == "restart" for e in found)
    return out


def run(repeats: int = 5) -> dict[str, Any]:
    """Ratio of root-mean-square errors over two seeds a repeat: ten by default."""
    scene = room100(CAMERAS)
    runs = [one(scene, seed) for seed in range(2 * repeats)]
    table = {name: np.array([r[name] for r in runs]) for name in runs[0]}
    clean, disturbed = table["clean, default"], table["disturbed, detection model"]
    ratios = disturbed / clean
    error = float(np.std(ratios, ddof=1) / math.sqrt(len(ratios)))
    parts: dict[str, Any] = {"runs": len(runs), "mean of ratios": f"{ratios.mean():.3f} +- {error:.3f}"}
    parts |= {name: float(np.mean(values)) for name, values in table.items()}
    pooled = float(np.sqrt(np.mean(disturbed**2) / np.mean(clean**2)))
    return {"ratio": pooled, "limit": LIMIT, "parts": parts}
