"""One step of the auxiliary particle filter against plain vectorised NumPy, in the reference scene of [Ercan]."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from types import ModuleType
from typing import Any

import numpy as np

from benchmarks.references import reference
from occlog.core.filter.likelihood import log_likelihood
from occlog.core.plane.floor import on_floor
from occlog.io.scenes.scene import read_scene
from occlog.measure.scans.grouping import Rows, scans_of
from occlog.measure.scans.scan import Scan
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Truth
from occlog.simulate.config import ObserveConfig, WorldConfig
from occlog.simulate.sensors.cameras import observe
from occlog.simulate.stage import simulate_truth
from occlog.track.apf import filter as apf
from occlog.track.apf.config import ApfConfig
from occlog.track.apf.kernels import waypoint
from occlog.track.apf.propose import move
from occlog.track.apf.sensing import pack_scan

NAME = "track"
SUMMARY = "APF step, 1000 particles, 8 cameras, a static occluder: time to that of plain vectorised NumPy"
LIMIT = 0.5
ROOT = Path(__file__).resolve().parents[2]
PARTICLES = 1000
STEPS = 60
SEED = 5


def simulated_scans(scene: Scene) -> list[Scan]:
    """Scans of one target among no moving occluders."""
    world = WorldConfig(steps=STEPS)
    truth = Truth.concat(simulate_truth(scene, world, SEED))
    bearings = Bearings.concat(observe(scene, [truth], ObserveConfig(), SEED))
    found = scans_of([bearings], scene, Rows({c.name for c in scene.cameras}))
    return [scan for group in found if (scan := group.of_target(0)) is not None]


def per_call(work: Callable[[], Any], calls: int = 20) -> float:
    """Microseconds of a call."""
    start = time.perf_counter()
    for _ in range(calls):
        work()
    return 1e6 * (time.perf_counter() - start) / calls


def baseline_step(ref: ModuleType, scene: Scene, state: apf.ApfState, scan: Scan, rng: np.random.Generator) -> Any:
    """The same step in plain NumPy, random numbers included, as a function without arguments."""
    cameras = [
        ref.RefCamera(c.ground, c.yaw, c.focal_px[0], c.fov, c.range, c.sigma_position, c.sigma_yaw)
        for c in scene.cameras
    ]
    plain = ref.RefScene(scene.region, [o.polygon for o in scene.occluders], cameras)
    p = state.particles
    particles = ref.RefParticles(p.xy, p.destination, p.speed, p.regime, state.weights)
    reading = np.where(scan.seen, -scan.u_px, np.nan)
    read_px = np.full(len(cameras), 2.0)
    low, size = scene.region.min(axis=0), np.ptp(scene.region, axis=0)

    def step() -> Any:
        places = low + size * rng.random((PARTICLES, 2))
        draws = ref.Draws(
            rng.random(),
            rng.random(PARTICLES),
            rng.standard_normal((PARTICLES, 2)),
            np.resize(places[ref.on_floor(places, plain)], (PARTICLES, 2)),
        )
        return ref.step(particles, reading, read_px, plain, ref.RefConfig(), 1.0, draws)

    return step


def parts_of(state: apf.ApfState, scan: Scan, rng: np.random.Generator) -> dict[str, Callable[[], Any]]:
    """The dearer parts of a step."""
    model, particles = state.model, state.particles
    looks = pack_scan(scan, model.read_px, True)
    free = on_floor(particles.xy, *model.floor)
    arrived = waypoint.reached(particles, model.motion, model.floor)
    packed = model.sensors, model.noise, model.detection
    return {
        "likelihood (twice a step) us": lambda: log_likelihood(particles.xy, looks, *packed, free),
        "on the floor (3 times a step) us": lambda: on_floor(particles.xy, *model.floor),
        "draw and move us": lambda: move(model, particles, arrived, 1.0, rng),
        "scan to arrays us": lambda: pack_scan(scan, model.read_px, True),
    }


def halves(scene: Scene, config: ApfConfig) -> dict[str, float]:
    """Microseconds a step with fewer cameras: the cost must grow about linearly."""
    out = {}
    for n in (2, 4, 8):
        some = Scene(scene.cameras[:n], (), scene.occluders, (), scene.room, length_unit=scene.length_unit)
        out[f"step with {n} cameras us"] = _run(some, simulated_scans(some), config)
    return out


def _run(scene: Scene, scans: list[Scan], config: ApfConfig) -> float:
    rng = np.random.default_rng(SEED)
    state, times = apf.init(scene, config, rng), []
    for scan in scans:
        start = time.perf_counter()
        state, _ = apf.step(state, scan, rng)
        times.append(1e6 * (time.perf_counter() - start))
    return median(times[5:])


def run(repeats: int = 5) -> dict[str, Any]:
    """Ratio of a step's time to the baseline's, both measured in turn; median over repeats."""
    scene = read_scene(ROOT / "examples" / "room100.yaml")
    scans, rng = simulated_scans(scene), np.random.default_rng(SEED)
    config = ApfConfig(particles=PARTICLES, proposal="motion")
    state = apf.init(scene, config, rng)
    for scan in scans[:-1]:
        state, _ = apf.step(state, scan, rng)
    plain = baseline_step(reference("apf_reference"), scene, state, scans[-1], rng)
    parts = parts_of(state, scans[-1], rng)
    apf.step(state, scans[-1], rng)
    ours, theirs = [], []
    for _ in range(repeats):
        ours.append(per_call(lambda: apf.step(state, scans[-1], rng)))
        theirs.append(per_call(plain))
    ratio = median(a / b for a, b in zip(ours, theirs, strict=True))
    return {
        "ratio": ratio,
        "limit": LIMIT,
        "parts": {
            "step us": median(ours),
            "plain NumPy step us": median(theirs),
            **{name: median(per_call(work) for _ in range(repeats)) for name, work in parts.items()},
            **halves(scene, config),
        },
    }
