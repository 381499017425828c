"""One step of the auxiliary particle filter against that of the package `particles`, without moving occluders.

The package needs an older NumPy, so it runs in an environment of its own, which is made anew for
every run (`pip install particles==0.4 'numpy<2'`); both filters then track the same recording, in turn.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from benchmarks.peers._environments import environment, output_of
from benchmarks.references import FORMS
from occlog.array_types import Floats
from occlog.io.formats.scenes.scene import read_scene
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Truth
from occlog.scans.grouping import BearingRows, Scan, scans_of
from occlog.simulate.config import ObserveConfig, WorldConfig
from occlog.simulate.sensors.cameras import observe
from occlog.simulate.stage import simulate_truth
from occlog.track.methods.apf import filter as apf
from occlog.track.methods.apf.config import ApfConfig

NAME = "particles"
SUMMARY = "APF step, 1000 particles, 8 cameras, no moving occluders: time to that of the `particles` package"
LIMIT = 1.0
SCENE = Path(__file__).resolve().parents[2] / "examples" / "room100.yaml"
STEPS = 300
SEED = 5
SKIP = 20


def run(repeats: int = 3) -> dict[str, Any]:
    """Ratio of median step times over the same recording; median over repeats, taken in turn."""
    scene = read_scene(SCENE)
    truth, scans = recording(scene)
    with tempfile.TemporaryDirectory() as folder:
        python = environment(Path(folder) / "peer", "particles==0.4", "numpy<2")
        given = Path(folder) / "scans.npz"
        save(given, scene, truth, scans)
        _ours(scene, truth, scans)
        ours, theirs = [], []
        for _ in range(repeats):
            ours.append(_ours(scene, truth, scans))
            theirs.append(output_of(python, "_particles_peer.py", given, FORMS / "apf_reference.py"))
    ratio = median(a["step us"] / b["step us"] for a, b in zip(ours, theirs, strict=True))
    parts = {
        "step us": median(a["step us"] for a in ours),
        "particles step us": median(b["step us"] for b in theirs),
        "RMSE": ours[-1]["rmse"],
        "particles RMSE": theirs[-1]["rmse"],
        "particles version": theirs[-1]["version"],
    }
    return {"ratio": ratio, "limit": LIMIT, "parts": parts}


def recording(scene: Scene) -> tuple[Floats, list[Scan]]:
    """True places (T, 2) of the target and what the cameras report."""
    truth = Truth.concat(simulate_truth(scene, WorldConfig(steps=STEPS), SEED))
    bearings = Bearings.concat(observe(scene, [truth], ObserveConfig(), SEED))
    found = scans_of([bearings], scene, BearingRows({c.name for c in scene.cameras}))
    scans = [scan for group in found if (scan := group.of_target(0)) is not None]
    target = truth.take(truth.target_id == 0)
    return np.column_stack([target.x, target.y]), scans


def save(path: Path, scene: Scene, truth: Floats, scans: list[Scan]) -> None:
    """Write scene, readings and truth for the other filter."""
    cameras = [(*c.ground, c.yaw, c.focal_px[0], c.fov, c.range, c.sigma_position, c.sigma_yaw) for c in scene.cameras]
    z = np.array([np.where(scan.seen, -scan.u_px, np.nan) for scan in scans])
    np.savez(path, cameras=cameras, room=scene.region, pillar=scene.occluders[0].polygon, z=z, truth=truth)


def _ours(scene: Scene, truth: Floats, scans: list[Scan]) -> dict[str, Any]:
    rng, times, errors = np.random.default_rng(SEED), [], []
    # The package's filter does not look at the scan either
    state = apf.init(scene, ApfConfig(particles=1000, proposal="motion"), rng)
    for k, scan in enumerate(scans):
        begin = time.perf_counter()
        state, estimate = apf.step(state, scan, rng)
        times.append(1e6 * (time.perf_counter() - begin))
        errors.append(float(np.hypot(*(estimate.xy - truth[k]))))
    return {"step us": median(times[5:]), "rmse": float(np.sqrt(np.mean(np.square(errors[SKIP:]))))}
