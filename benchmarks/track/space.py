"""One step of `direct3d`, and of the filter of one plane of `pps`, against the better of two plain forms."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from statistics import median
from typing import Any

import numpy as np

from benchmarks.track import _space_problem as problem
from benchmarks.track._space_problem import Plain, Recording, numba_step, numpy_step, scan_of
from occlog.array_types import Floats
from occlog.core.geometry.projected_planes import XY
from occlog.filtering.kernel_density import moments, resample_with_kernel, silverman_bandwidth
from occlog.filtering.motion.white_acceleration import moved
from occlog.filtering.particles import effective_sample_size, normalise_log_weights
from occlog.track.methods.in_space import direct3d, projected_planes
from occlog.track.methods.in_space.config import Direct3dConfig, PpsConfig
from occlog.track.methods.in_space.planes import log_likelihood, plane_angles, sights_in_plane
from occlog.track.methods.in_space.sensing import make_space, pack_directions

NAME = "space"
SUMMARY = "step of direct3d and of a plane of pps, 10000 particles: time to the better of plain NumPy and a numba loop"
LIMIT = 1.0
PARTICLES = 10_000
STEPS = 60
Run = Callable[[Recording], tuple[float, Floats]]


def run(repeats: int = 5) -> dict[str, Any]:
    """The worse of both ratios; processor time, median over repeats taken in turn."""
    given = problem.recording(STEPS)
    parts: dict[str, Any] = {}
    ratios = []
    for name, ours, d in (("direct3d", ours_in_space, 3), ("plane", ours_in_plane, 2)):
        forms: dict[str, Run] = {
            "": ours,
            "NumPy ": partial(_plain, numpy_step, d),
            "numba loop ": partial(_plain, numba_step, d),
        }
        estimates = [f(given)[1] for f in forms.values()]  # compiles, too
        for other in estimates[1:]:
            # In a plane ours has the projected noise, which is a little larger than that of the azimuth.
            np.testing.assert_allclose(other, estimates[0], rtol=0, atol=1e-6 if d == 3 else 0.05)
        times = {form: [] for form in forms}
        for _ in range(repeats):
            for form, work in forms.items():
                times[form].append(work(given)[0])
        ratios.append(median(a / min(b, c) for a, b, c in zip(*times.values(), strict=True)))
        parts |= {f"{name} {form}step us": median(t) for form, t in times.items()}
        parts[f"{name} ratio"] = ratios[-1]
    return {"ratio": max(ratios), "limit": LIMIT, "parts": parts}


def ours_in_space(given: Recording) -> tuple[float, Floats]:
    """Microseconds a step, and the means (T, 6) of the position and velocity."""
    rng = np.random.default_rng(problem.SEED)
    start = (*given.start, *problem.SPREAD)
    config = Direct3dConfig(
        particles=PARTICLES,
        initial_particle_factor=1,
        start=start,
        acceleration=tuple(problem.ACCELERATION),
        process_noise_density=problem.DENSITY,
        false_alarm_probability=0.0,
        proposal="motion",
    )
    state = direct3d.init(problem.scene(), config, rng)
    scans, means = [scan_of(given, k) for k in range(STEPS)], []
    begin = time.process_time()
    for scan in scans:
        state, e = direct3d.step(state, scan, rng)
        means.append((*e.xy, e.height.z, *e.velocity, e.height.vz) if e.height is not None else ())
    return 1e6 * (time.process_time() - begin) / STEPS, np.array(means)


def ours_in_plane(given: Recording) -> tuple[float, Floats]:
    """The same of the plane xy, with what `pps` does for each of its planes."""
    rng = np.random.default_rng(problem.SEED)
    config = PpsConfig(
        particles=PARTICLES,
        acceleration=tuple(problem.ACCELERATION),
        process_noise_density=problem.DENSITY,
        false_alarm_probability=0.0,
    )
    space = make_space(problem.scene(), config)
    motion, chances = projected_planes.plane_motions(space.motion)[XY], space.chances
    cloud, weights = _start(given, 2, rng)
    scans, means, width = [scan_of(given, k) for k in range(STEPS)], [], silverman_bandwidth(PARTICLES, 4)
    begin = time.process_time()
    for k, scan in enumerate(scans):
        heard = pack_directions(scan, space.ears, given.start[:2], use_score=True)
        cloud = moved(cloud, motion, problem.STEP_S, rng) if k else cloud
        own = sights_in_plane(XY, heard, plane_angles(heard))
        log_weights = np.log(weights) + log_likelihood(cloud[:2], own, heard, chances)
        weights, _ = normalise_log_weights(log_weights)
        mean, covariance = moments(cloud, weights)
        means.append(mean)
        if effective_sample_size(weights) < config.resampling_threshold * PARTICLES:
            cloud = resample_with_kernel(cloud, weights, mean, covariance, PARTICLES, width, rng)
            weights = np.full(PARTICLES, 1.0 / PARTICLES)
    return 1e6 * (time.process_time() - begin) / STEPS, np.array(means)


def _plain(step: Callable[..., tuple[Plain, Floats]], d: int, given: Recording) -> tuple[float, Floats]:
    rng = np.random.default_rng(problem.SEED)
    particles, means = Plain(*_start(given, d, rng)), []
    angles = np.stack([given.theta, given.phi], axis=-1)[..., : d - 1]
    h = silverman_bandwidth(PARTICLES, 2 * d)
    begin = time.process_time()
    for k in range(STEPS):
        dt = problem.STEP_S if k else 0.0
        particles, mean = step(particles, dt, problem.ACCELERATION[:d], angles[k], rng, h)
        means.append(mean)
    return 1e6 * (time.process_time() - begin) / STEPS, np.array(means)


def _start(given: Recording, d: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Particles around the start; all six rows are drawn, as `direct3d` does."""
    rows = [*range(d), *range(3, 3 + d)]
    cloud = given.start[:, None] + problem.SPREAD[:, None] * rng.standard_normal((6, PARTICLES))
    return np.ascontiguousarray(cloud[rows]), np.full(PARTICLES, 1.0 / PARTICLES)
