"""One step of the filter of several motion models, for a target among unlabelled bearings, against two plain forms.

`kernel` is `occlog.track.methods.imm.kernel.step`, `filter` the whole of `occlog.track.methods.imm.filter.step` with
association `any`: the same with the room for it, probabilities that targets exist and sound, and a report.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from statistics import median
from typing import Any

import numpy as np

from benchmarks.track import _imm_problem as problem
from benchmarks.track._imm_problem import (
    PARTICLES,
    SIGMA,
    SPREAD,
    START,
    STEP_S,
    STEPS,
    Recording,
    numba_step,
    numpy_step,
)
from occlog.array_types import Floats
from occlog.filtering.motion.coordinated_turn import acceleration_root, three_models
from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.scans.grouping import Scan
from occlog.track.methods.imm import filter as imm_filter
from occlog.track.methods.imm import kernel as imm
from occlog.track.methods.imm.config import ImmConfig

NAME = "imm"
SUMMARY = "step of imm, 5000 particles under 3 models, 3 bearings: time to the better of plain NumPy and a numba loop"
LIMIT = 1.0
SCENE = "occlog_scene: 1\nlength_unit: m\nmicrophone_arrays: [{name: a, position: [0, 0], sigma_deg: 2}]\n"
Run = Callable[[Recording], tuple[float, Floats]]


def run(repeats: int = 5) -> dict[str, Any]:
    """The worse of both ratios; processor time, median over repeats taken in turn."""
    given = problem.recording()
    forms: dict[str, Run] = {
        "kernel": kernel,
        "filter": whole,
        "NumPy": partial(_plain, numpy_step),
        "numba loop": partial(_plain, numba_step),
    }
    errors = {name: _rmse(work(given)[1], given) for name, work in forms.items()}  # compiles, too
    times: dict[str, list[float]] = {name: [] for name in forms}
    for _ in range(repeats):
        for name, work in forms.items():
            times[name].append(work(given)[0])
    best = [min(a, b) for a, b in zip(times["NumPy"], times["numba loop"], strict=True)]
    ratios = {n: median(a / b for a, b in zip(times[n], best, strict=True)) for n in ("kernel", "filter")}
    parts: dict[str, Any] = {f"{name} step us": median(t) for name, t in times.items()}
    parts |= {f"{name} ratio": r for name, r in ratios.items()} | {f"{name} RMSE": e for name, e in errors.items()}
    return {"ratio": max(ratios.values()), "limit": LIMIT, "parts": parts}


def kernel(given: Recording) -> tuple[float, Floats]:
    """Microseconds a step of the kernel, and the means (T, 4)."""
    rng, means = np.random.default_rng(problem.SEED), []
    cloud = imm.ImmParticles(_start(rng), np.zeros(PARTICLES, dtype=np.int64))
    models, sigma = three_models(problem.ALPHA), np.full(3, SIGMA)
    begin = time.process_time()
    for k in range(STEPS):
        dt = STEP_S * (k > 0)
        motion = imm.MotionModels(models, acceleration_root(problem.SIGMA_V**2, dt))
        draws = imm.draw(rng, 3, PARTICLES)
        found = imm.step(cloud, motion, dt, draws, bearing=given.angle[k], sigma=sigma, position=problem.PLACE)
        cloud = found.cloud
        means.append(found.estimate.mean)
    return 1e6 * (time.process_time() - begin) / STEPS, np.array(means)


def whole(given: Recording) -> tuple[float, Floats]:
    """The same of the filter of method `imm`."""
    rng, means = np.random.default_rng(problem.SEED), []
    start = (START[0], START[2], SPREAD[0], START[1], START[3], SPREAD[1])
    config = ImmConfig(
        particles=PARTICLES,
        start=tuple(map(float, start)),
        association="any",
        turn_acceleration=problem.ALPHA,
        process_noise_velocity=problem.SIGMA_V,
    )
    state = imm_filter.init(scene_from_yaml(SCENE, "scene"), config, rng)
    array, sigma = np.zeros(3, dtype=np.int64), np.full(3, SIGMA)
    begin = time.process_time()
    for k in range(STEPS):
        scan = Scan.of(round(k * STEP_S * 1e9), array, bearing=given.angle[k], sigma=sigma)
        state, report = imm_filter.step(state, scan, rng)
        means.append(report.beliefs[0].estimate.mean)
    return 1e6 * (time.process_time() - begin) / STEPS, np.array(means)


def _plain(step: Callable[..., tuple[Floats, Floats]], given: Recording) -> tuple[float, Floats]:
    rng, means = np.random.default_rng(problem.SEED), []
    states = _start(rng)
    begin = time.process_time()
    for k in range(STEPS):
        states, mean = step(states, STEP_S * (k > 0), given.angle[k], rng)
        means.append(mean)
    return 1e6 * (time.process_time() - begin) / STEPS, np.array(means)


def _start(rng: np.random.Generator) -> Floats:
    return START + SPREAD * rng.standard_normal((PARTICLES, 4))


def _rmse(means: Floats, given: Recording) -> float:
    return float(np.sqrt(np.mean(np.sum((means[:, ::2] - given.truth) ** 2, axis=1))))
