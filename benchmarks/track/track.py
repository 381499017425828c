"""One step of the auxiliary particle filter against plain vectorised NumPy, in the reference scene of [Ercan]."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import median
from types import ModuleType
from typing import Any

import numpy as np

from benchmarks.references import reference
from occlog.core.plane import on_floor
from occlog.filtering.likelihood.directions import log_likelihood
from occlog.filtering.motion import waypoint
from occlog.io.formats.scenes.scene import read_scene
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Truth
from occlog.scans.grouping import BearingRows, Scan, scans_of
from occlog.simulate.config import ObserveConfig, WorldConfig
from occlog.simulate.sensors.cameras import observe
from occlog.simulate.stage import simulate_truth
from occlog.track.methods.apf import filter as apf
from occlog.track.methods.apf.config import ApfConfig
from occlog.track.methods.apf.kernels import importance
from occlog.track.methods.apf.model import pack_scan
from occlog.track.methods.apf.proposal import destinations, move

NAME = "track"
SUMMARY = "APF step with a look at the scan, 1000 particles, 8 cameras, a static occluder: time to that of plain NumPy"
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
    found = scans_of([bearings], scene, BearingRows({c.name for c in scene.cameras}))
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
    looks = state.model.config.proposal == "scan"

    def step() -> Any:
        places = low + size * rng.random((PARTICLES, 2))
        places = np.resize(places[ref.on_floor(places, plain)], (PARTICLES, 2))
        first, second, noise = rng.random(), rng.random(PARTICLES), rng.standard_normal((PARTICLES, 2))
        if not looks:
            draws = ref.Draws(first, second, noise, places)
            return ref.step(particles, reading, read_px, plain, ref.RefConfig(), 1.0, draws)
        more = ref.ScanDraws(places, np.zeros(len(places)), first, second, noise, rng.standard_normal((PARTICLES, 2)))
        return ref.scan_step(particles, reading, read_px, plain, ref.RefConfig(), 1.0, more)

    return step


def parts_of(state: apf.ApfState, scan: Scan, rng: np.random.Generator) -> dict[str, Callable[[], Any]]:
    """The dearer parts of a step."""
    model, particles = state.model, state.particles
    detections_of_step = pack_scan(scan, model.read_px, True)
    free = on_floor(particles.xy, *model.floor)
    arrived = waypoint.reached(particles, model.motion, model.floor)
    packed = model.sensors, model.noise, model.detection
    positions = destinations(model, particles.xy, rng)
    chance, mean, variance = waypoint.hypotheses(
        particles, arrived, positions, np.zeros(len(positions)), 1.0, model.motion
    )
    given = mean.reshape(-1, 2), variance.reshape(-1), (chance * state.weights).reshape(-1) > 0.0
    rows = importance.measurements(detections_of_step, *packed)
    return {
        "likelihood (twice a step) us": lambda: log_likelihood(particles.xy, detections_of_step, *packed, free),
        "on the floor (3 times a step) us": lambda: on_floor(particles.xy, *model.floor),
        "approximations of the posterior us": lambda: importance.adapt(*given, detections_of_step.first, rows),
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


def timed(
    scene: Scene, scans: list[Scan], config: ApfConfig, rng: np.random.Generator, repeats: int
) -> tuple[float, float, float, apf.ApfState]:
    """Ratio of a step's time to the baseline's, both times [us], and the state before the step."""
    state = apf.init(scene, config, rng)
    for scan in scans[:-1]:
        state, _ = apf.step(state, scan, rng)
    plain = baseline_step(reference("apf_reference"), scene, state, scans[-1], rng)
    apf.step(state, scans[-1], rng)
    ours, theirs = [], []
    for _ in range(repeats):
        ours.append(per_call(lambda: apf.step(state, scans[-1], rng)))
        theirs.append(per_call(plain))
    return median(a / b for a, b in zip(ours, theirs, strict=True)), median(ours), median(theirs), state


def run(repeats: int = 5) -> dict[str, Any]:
    """Ratio of a step's time to the baseline's, both measured in turn; median over repeats."""
    scene = read_scene(ROOT / "examples" / "room100.yaml")
    scans, rng = simulated_scans(scene), np.random.default_rng(SEED)
    config = ApfConfig(particles=PARTICLES)
    ratio, ours, theirs, state = timed(scene, scans, config, rng, repeats)
    blind, our_blind, their_blind, _ = timed(scene, scans, replace(config, proposal="motion"), rng, repeats)
    return {
        "ratio": ratio,
        "limit": LIMIT,
        "parts": {
            "step us": ours,
            "plain NumPy step us": theirs,
            "step by the motion alone us": our_blind,
            "plain NumPy step by the motion us": their_blind,
            "ratio by the motion alone": blind,
            **{
                name: median(per_call(work) for _ in range(repeats))
                for name, work in parts_of(state, scans[-1], rng).items()
            },
            **halves(scene, config),
        },
    }
