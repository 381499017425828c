"""One step among 40 people with priors against plain vectorised NumPy, and against its own floor of error functions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from typing import Any

import numba
import numpy as np

from benchmarks.references import reference
from benchmarks.track.track import PARTICLES, ROOT, SEED, per_call
from occlog.array_types import Floats
from occlog.core.geometry.visibility import seen_from
from occlog.core.numerics.special_functions import fast_erf
from occlog.core.occlusion.occlusion_probability import MIN_POINTS_PER_POSITION, extent, make_grid, rays_to
from occlog.core.plane import on_floor
from occlog.filtering.likelihood.directions import log_likelihood_among
from occlog.io.formats.scenes.scene import read_scene
from occlog.measure.priors.from_positions import virtual_priors
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Occluders, Truth
from occlog.scans.grouping import BearingRows, Scan, scans_of
from occlog.scans.occluder_priors import OccluderFeed
from occlog.simulate.config import ObserveConfig, WorldConfig
from occlog.simulate.sensors.cameras import observe
from occlog.simulate.stage import simulate_truth
from occlog.track.methods.apf import filter as apf
from occlog.track.methods.apf.config import ApfConfig
from occlog.track.methods.apf.model import OCCLUDER_SUPPORT_SIGMAS, pack_scan

NAME = "occlusion"
SUMMARY = "APF step, 1000 particles, 8 cameras, a static occluder, 40 priors: time to that of plain vectorised NumPy"
LIMIT = 1 / 25
DIAMETER = 3.33
STEPS = 60
ORDER = (0, 4, 2, 6, 1, 5, 3, 7)
"""Corners and sides by turns, as the first of them are used alone."""


@dataclass(frozen=True)
class Moment:
    """A filter in the middle of its work, and the scan that comes next."""

    scene: Scene
    state: apf.ApfState
    scan: Scan


def moment(cameras: int, **settings: Any) -> Moment:
    """The filter after some steps in the reference scene."""
    full = read_scene(ROOT / "examples" / "room100.yaml")
    scene = Scene(
        tuple(full.cameras[i] for i in sorted(ORDER[:cameras])),
        (),
        full.occluders,
        (),
        full.room,
        length_unit=full.length_unit,
    )
    scans, rng = _scans(scene), np.random.default_rng(SEED)
    state = apf.init(scene, ApfConfig(particles=PARTICLES, **settings), rng)
    for scan in scans[:-1]:
        state, _ = apf.step(state, scan, rng)
    return Moment(scene, state, scans[-1])


def _scans(scene: Scene) -> list[Scan]:
    truth = Truth.concat(simulate_truth(scene, WorldConfig(steps=STEPS, occluders=40), SEED))
    bearings = Bearings.concat(observe(scene, [truth], ObserveConfig(diameter=DIAMETER), SEED))
    feed = OccluderFeed([Occluders.concat(list(virtual_priors([truth], 8.0, 1.2, SEED)))], DIAMETER, 10**10)
    found = scans_of([bearings], scene, BearingRows({c.name for c in scene.cameras}))
    scans = [(group.t_ns, scan) for group in found if (scan := group.of_target(0)) is not None]
    return [scan._replace(occluders=feed.at(t)) for t, scan in scans]


def plain_step(at: Moment) -> Callable[[], Any]:
    """The same step in plain NumPy by Eq. 7, random numbers included."""
    ref = reference("apf_reference")
    people = at.scan.occluders
    assert people is not None
    covariance = people.sigma[:, None, None] ** 2 * np.eye(2)
    priors = reference("occlusion_reference").RefPriors(people.mean, covariance, DIAMETER, improved=False)
    cameras = [
        ref.RefCamera(c.ground, c.yaw, c.focal_px[0], c.fov, c.range, c.sigma_position, c.sigma_yaw)
        for c in at.scene.cameras
    ]
    plain = ref.RefScene(at.scene.region, [o.polygon for o in at.scene.occluders], cameras)
    p, rng = at.state.particles, np.random.default_rng(0)
    particles = ref.RefParticles(p.xy, p.destination, p.speed, p.regime, at.state.weights)
    reading = np.where(at.scan.seen, -at.scan.u_px, np.nan)
    low, size = at.scene.region.min(axis=0), np.ptp(at.scene.region, axis=0)
    config = ref.RefConfig(miss=0.0)

    def step() -> Any:
        positions = low + size * rng.random((PARTICLES, 2))
        draws = ref.Draws(
            rng.random(),
            rng.random(PARTICLES),
            rng.standard_normal((PARTICLES, 2)),
            np.resize(positions[ref.on_floor(positions, plain)], (PARTICLES, 2)),
        )
        return ref.step(particles, reading, np.full(len(cameras), 2.0), plain, config, 1.0, draws, priors)

    return step


def erf_counts(at: Moment) -> dict[str, float]:
    """Error functions of a likelihood: written plainly, without priors that cannot matter, and with the grid."""
    model, priors, xy = at.state.model, at.scan.occluders, at.state.particles.xy
    assert priors is not None
    free = on_floor(xy, *model.floor)
    grid = make_grid(xy, free, priors, OCCLUDER_SUPPORT_SIGMAS)
    plain = culled = gridded = 0.0
    for i in range(len(at.scene.cameras)):
        rows = np.flatnonzero(seen_from(xy, i, model.sensors) & free)
        x0, y0 = model.sensors.xy[i]
        each = per_place(xy[rows], x0, y0, priors) if len(rows) else 0.0
        use_grid = 0 < len(grid.points) <= MIN_POINTS_PER_POSITION * len(rows)
        plain += 4.0 * len(xy) * len(priors.sigma)
        culled += each * len(rows)
        gridded += per_place(grid.points, x0, y0, priors) * len(grid.points) if use_grid else each * len(rows)
    return {"plain": plain, "culled": culled, "gridded": gridded}


def per_place(xy: Floats, x0: float, y0: float, priors: Any) -> float:
    """Error functions a place: 2 to 4 of each prior that is near the sight lines."""
    rays = rays_to(xy, np.arange(len(xy)), x0, y0)
    count = 0.0
    for j in range(len(priors.sigma)):
        mx, my, reach = priors.mean[j, 0] - x0, priors.mean[j, 1] - y0, extent(j, priors, OCCLUDER_SUPPORT_SIGMAS)
        a, b = rays.ux * mx + rays.uy * my, rays.ux * my - rays.uy * mx
        if np.abs(b).min() > reach + priors.radius[j] or a.max() < -reach or np.all(a > rays.r + reach):
            continue
        count += 2.0 + (not a.min() > reach) + (not np.all(a < rays.nearest - reach))
    return count


@numba.njit(error_model="numpy", fastmath={"contract"})
def _many(x: Floats, out: Floats) -> None:
    for k in range(x.shape[0]):
        out[k] = fast_erf(x[k])


def erf_ns() -> float:
    """Nanoseconds of an error function in a vectorised loop, the least of many measurements."""
    x, out = np.random.default_rng(0).normal(size=1000), np.empty(1000)
    _many(x, out)
    return min(per_call(lambda: _many(x, out), 200) for _ in range(20))  # us for 1000 are ns for one


def step_us(at: Moment, calls: int = 20) -> float:
    """Microseconds of a step."""
    rng = np.random.default_rng(1)
    return per_call(lambda: apf.step(at.state, at.scan, rng), calls)


def run(repeats: int = 5) -> dict[str, Any]:
    """Ratio of a step's time to the baseline's, both measured in turn; median over repeats."""
    at = moment(8)
    plain, ours, theirs = plain_step(at), [], []
    step_us(at, 3)
    for _ in range(repeats):
        ours.append(step_us(at))
        theirs.append(per_call(plain, 5))
    ratio = median(a / b for a, b in zip(ours, theirs, strict=True))
    return {
        "ratio": ratio,
        "limit": LIMIT,
        "parts": {
            "step us": median(ours),
            "plain NumPy step us": median(theirs),
            "times as fast": 1.0 / ratio,
            **_floor(at, median(ours), repeats),
            **_by_cameras(repeats),
        },
    }


def _floor(at: Moment, step: float, repeats: int) -> dict[str, float]:
    """How far the step is from the time of its error functions alone."""
    counts, ns = erf_counts(at), erf_ns()
    model = at.state.model
    detections_of_step, xy = pack_scan(at.scan, model.read_px, True), at.state.particles.xy
    free, occlusion = on_floor(xy, *model.floor), model.occlusion._replace(far=OCCLUDER_SUPPORT_SIGMAS)
    packed = model.sensors, model.noise, model.informed
    work = median(
        per_call(lambda: log_likelihood_among(xy, detections_of_step, *packed, free, at.scan.occluders, occlusion))  # type: ignore[arg-type]
        for _ in range(repeats)
    )
    return {
        "fast erf ns": ns,
        "erf of a likelihood, written plainly": counts["plain"],
        "erf, near priors only": counts["culled"],
        "erf, interpolated": counts["gridded"],
        "floor of a step written plainly us": 2e-3 * ns * counts["plain"],
        "floor of a step, near priors only us": 2e-3 * ns * counts["culled"],
        "floor of a step, interpolated us": 2e-3 * ns * counts["gridded"],
        "step to the floor written plainly": step / (2e-3 * ns * counts["plain"]),
        "likelihood (twice a step) us": work,
    }


def _by_cameras(repeats: int) -> dict[str, float]:
    out = {}
    for likelihood in ("independent", "recursion"):
        for n in (2, 4, 8):
            at = moment(n, likelihood=likelihood)
            out[f"{likelihood}, {n} cameras us"] = median(step_us(at, 10) for _ in range(repeats))
    return out
