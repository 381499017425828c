"""The worlds of [Lee] Ch. 2: one or two arrays, a target with known motion, and a trial of a filter on them.

In the thesis the filters know the initial state; it does not state their initial spread.  Here the
prior is finite, as the bound needs it, and its mean is drawn around the truth in every run.
"""

from __future__ import annotations

import functools
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import Floats
from occlog.core.bounds.in_space import (
    accelerated_path,
    direct_bound,
    plane_axes,
    plane_bound,
    plane_variance,
    sight_angles,
)
from occlog.core.geometry.projected_planes import AXES, XY, YZ
from occlog.filtering.motion.coordinated_turn import turn_matrix
from occlog.filtering.motion.white_acceleration import AccelerationModel
from occlog.papers.verdicts import Size
from occlog.pipeline.sweep.trial import Spec, Values
from occlog.records.scene import MicrophoneArray, Scene
from occlog.scans.grouping import Scan
from occlog.track.methods.in_space import direct3d, projected_planes
from occlog.track.methods.in_space.config import Direct3dConfig, PpsConfig

SIGMA = math.radians(math.sqrt(3.0))
"""Standard deviation of both angles; the thesis states variances of 3, in degrees squared."""
STARTS = {
    1: (3.0, 3.0, 1.0, 1.0, 1.0, 1.0),
    2: (1.0, 1.0, 3.0, 1.0, 1.0, 1.0),
    3: (2.0, 1.0, 2.0, 0.3, 0.3, 0.3),
    4: (2.0, 1.0, 2.0, 0.3, 0.3, 0.3),
}
"""Initial position [m] and velocity [m/s] by scenario."""
ACCELERATION = (0.0, 0.1, 0.5)
"""Known acceleration in scenarios 1 to 4 [m/s^2]."""
SECOND_ARRAY = (10.0, 10.0, 10.0)
"""Position of the second array, of scenario 4 [m]; the first is at the origin."""
STEP_S = 0.1
PRIOR = (0.3, 0.1)
"""Standard deviations of the prior in scenarios 1 to 4: of a position [m] and of a velocity [m/s]."""

TABLE, TABLE_START, TABLE_STEP_S = 0, (10.0, 130.0, 18.0, 1.0, -0.75, 0.75), 1.0
TABLE_TURN = -0.01
"""Lateral acceleration [m/s^2], from z towards y; only this sense gives the printed ranges of the angles."""
TABLE_PRIOR = (1.0, 0.05)
WRONG_FROM, WRONG_FOR = 50, 50
"""First step and number of steps with a wrong model of the plane yz; the thesis states how long, not when."""
AXIS_NAMES = ("x", "y", "z")
NOISE, FILTER = 0, 1
"""Purpose of random numbers, the last part of their key."""


class SpaceWorld(NamedTuple):
    """True path of a target at T instants, and S arrays that are not rotated.

    Attributes:
        states: (T, 6) position x, y, z [m] and velocity [m/s].
        dt: (T,) time since the instant before [s]; the first is 0.
        positions: (S, 3) positions of the arrays [m].
        prior: standard deviations of the filter's prior per axis, of the position [m] and of the velocity [m/s].
    """

    states: Floats
    dt: Floats
    positions: Floats
    prior: tuple[float, float]

    @property
    def P0(self) -> Floats:  # noqa: N802 - the paper's letter
        """Prior covariance (6, 6), diagonal, of x, y, z [m] and their velocities [m/s]."""
        return np.diag([self.prior[0] ** 2] * 3 + [self.prior[1] ** 2] * 3)

    @property
    def sensors(self) -> tuple[Floats, Floats]:
        """Positions (S, 3) [m] and rotations (S, 3, 3) of the arrays; the rotations are identities."""
        return self.positions, np.tile(np.eye(3), (len(self.positions), 1, 1))


def world(scenario: int, steps: int) -> SpaceWorld:
    """World of [Lee] Sec. 2.4, `scenario` 1 to 4, or of Tables 2.1 and 2.2 (`TABLE`), with `steps` instants."""
    if scenario == TABLE:
        return _table_world(steps)
    dt = np.full(steps, STEP_S)
    dt[0] = 0.0
    states = accelerated_path(np.array(STARTS[scenario]), np.tile(ACCELERATION, (steps, 1)), dt)
    positions = [(0.0, 0.0, 0.0), SECOND_ARRAY] if scenario == 4 else [(0.0, 0.0, 0.0)]
    return SpaceWorld(states, dt, np.array(positions), PRIOR)


def _table_world(steps: int) -> SpaceWorld:
    """World of [Lee] Tables 2.1 and 2.2, `steps` instants: one array; the target turns in yz, not in x."""
    states = np.empty((steps, 6))
    states[0] = TABLE_START
    turn = turn_matrix(TABLE_TURN / math.hypot(*TABLE_START[4:]), TABLE_STEP_S)  # of y, vy, z, vz
    for k in range(1, steps):
        before = states[k - 1]
        states[k, [0, 3]] = before[0] + TABLE_STEP_S * before[3], before[3]
        states[k, [1, 4, 2, 5]] = turn @ before[[1, 4, 2, 5]]
    dt = np.full(steps, TABLE_STEP_S)
    dt[0] = 0.0
    return SpaceWorld(states, dt, np.zeros((1, 3)), TABLE_PRIOR)


def scans(w: SpaceWorld, rng: Generator) -> list[Scan]:
    """Noisy measured angles of the arrays in the world `w`: a list of T scans, each with one report per array.

    A report has bearing and elevation with noise of standard deviation `SIGMA`, and target 0 as its label.
    """
    T, S = len(w.states), len(w.positions)
    angles = [sight_angles(w.states[:, :3], p, np.eye(3)) for p in w.positions]
    theta = np.stack([a for a, _ in angles], axis=1) + SIGMA * rng.standard_normal((T, S))
    phi = np.stack([p for _, p in angles], axis=1) + SIGMA * rng.standard_normal((T, S))
    times, sigma = np.rint(1e9 * np.cumsum(w.dt)).astype(np.int64), np.full(S, SIGMA)
    return [
        Scan.of(
            int(times[k]),
            np.arange(S),
            target_id=np.zeros(S, dtype=np.int32),
            bearing=theta[k],
            sigma=sigma,
            elevation=0.5 * math.pi - phi[k],
            sigma_elevation=sigma,
        )
        for k in range(T)
    ]


def scene_of(w: SpaceWorld) -> Scene:
    """Scene with the arrays of the world `w`, in metres, without a room."""
    arrays = tuple(MicrophoneArray(f"array{i}", p, sigma=SIGMA) for i, p in enumerate(w.positions))
    return Scene(arrays=arrays, length_unit="m")


def space_spec(size: Size, run: int, scenario: int, method: str, particles: int, **settings: Any) -> Spec:
    """Specification of a trial for `space_trial`.

    Args:
        size: number of instants, and the seed of the experiment.
        run: number of the run.
        scenario: 1 to 4, or `TABLE`.
        method: filter, `direct3d` or `pps`.
        particles: number of particles.
        **settings: settings of the filter; also `wrong`: true if the plane yz has a wrong model of motion for
            `WRONG_FOR` steps from `WRONG_FROM` (`TABLE` with `pps` only).
    """
    return {
        "paper": "lee2",
        "seed": size.seed,
        "run": run,
        "steps": size.steps,
        "scenario": scenario,
        "method": method,
        "particles": particles,
        "settings": settings,
    }


def space_trial(spec: Spec) -> dict[str, float]:
    """Run one filter on one world; equal seed, run and scenario have equal noise and prior for every method.

    Args:
        spec: see `space_spec`.

    Returns:
        Squared errors `x_k`, `y_k`, `z_k` at instant k [m^2], and `xy_yz`, the share of estimates from the planes xy
        and yz (NaN for the direct method).
    """
    w = world(spec["scenario"], spec["steps"])
    key = (spec["run"], 2009, spec["scenario"])
    noise = np.random.default_rng(np.random.SeedSequence(spec["seed"], spawn_key=(*key, NOISE)))
    rng = np.random.default_rng(np.random.SeedSequence(spec["seed"], spawn_key=(*key, FILTER)))
    spread = np.sqrt(np.diag(w.P0))
    start = tuple((w.states[0] + spread * noise.standard_normal(6)).tolist()) + tuple(spread.tolist())
    positions, pairs = _track(w, scans(w, noise), start, spec, rng)
    square = (positions - w.states[:, :3]) ** 2
    out = {f"{a}_{k}": float(square[k, i]) for i, a in enumerate(AXIS_NAMES) for k in range(len(square))}
    return {**out, "xy_yz": float(np.mean([sorted(p) == [XY, YZ] for p in pairs])) if pairs else math.nan}


def _track(
    w: SpaceWorld, given: list[Scan], start: tuple[float, ...], spec: Spec, rng: Generator
) -> tuple[Floats, list[list[int]]]:
    """Run the filter of `spec`: estimated positions (T, 3) [m], and the planes selected at each instant.

    Args:
        w: world of the trial.
        given: T scans.
        start: mean (6,), then standard deviations (6,), of the first state [m, m/s].
        spec: see `space_spec`; with `direct3d` the list of planes is empty.
        rng: random numbers of the particles.
    """
    table, settings = spec["scenario"] == TABLE, dict(spec["settings"])
    wrong = settings.pop("wrong", False)
    common: Values = {
        "particles": spec["particles"],
        "start": start,
        "initial_particle_factor": 1,
        "process_noise_density": 0.0,
        "track_loss_count": 0,
    }
    common = common if table else {**common, "acceleration": ACCELERATION}
    if spec["method"] == "direct3d":
        turn: Values = {"turn_acceleration": TABLE_TURN, "turn_plane": "yz"} if table else {}
        return _track_directly(w, given, Direct3dConfig(**common, **turn, **settings), rng), []
    models = [_table_motions(w, k, wrong and WRONG_FROM <= k < WRONG_FROM + WRONG_FOR) for k in range(len(given))]
    return _track_by_planes(w, given, PpsConfig(**common, **settings), models if table else None, rng)


def _track_directly(w: SpaceWorld, given: list[Scan], config: Direct3dConfig, rng: Generator) -> Floats:
    """Positions (T, 3) [m] that the direct 3-D filter estimates from the T scans `given` in the world `w`."""
    state, positions = direct3d.init(scene_of(w), config, rng), np.empty((len(given), 3))
    for k, scan in enumerate(given):
        state, estimate = direct3d.step(state, scan, rng)
        assert estimate.height is not None
        positions[k] = *estimate.xy, estimate.height.z
    return positions


def _track_by_planes(
    w: SpaceWorld,
    given: list[Scan],
    config: PpsConfig,
    models: list[tuple[AccelerationModel, ...]] | None,
    rng: Generator,
) -> tuple[Floats, list[list[int]]]:
    """Run the particle filter in projected planes (PPS) on T scans: positions (T, 3) [m], and the selected planes.

    Args:
        w: world of the trial.
        given: T scans.
        config: settings of the filter.
        models: for each scan the motion of each plane since the one before; None: the motion of `config`.
        rng: random numbers of the particles.

    Returns:
        The positions, and for each scan the numbers of the two planes that give its estimate.
    """
    state, positions = projected_planes.init(scene_of(w), config, rng), np.empty((len(given), 3))
    pairs = []
    for k, scan in enumerate(given):
        if models is not None:
            state = state._replace(motions=models[k])
        state, estimate = projected_planes.step(state, scan, rng)
        assert estimate.height is not None
        positions[k] = *estimate.xy, estimate.height.z
        pairs.append([p for _, p in state.pair])
    return positions, pairs


def _table_motions(w: SpaceWorld, k: int, wrong: bool) -> tuple[AccelerationModel, ...]:
    """Models of each plane's motion up to instant k in the world `w`: a turn in yz, elsewhere the known acceleration.

    Args:
        w: the world of the tables.
        k: number of the instant.
        wrong: whether the plane yz gets no turn.
    """
    change = (w.states[k] - w.states[max(k - 1, 0)])[3:] / TABLE_STEP_S
    still = np.zeros(2)
    parts = [AccelerationModel(change[list(axes)], still) for axes in AXES]
    parts[YZ] = AccelerationModel(still, still, 0.0 if wrong else TABLE_TURN)
    return tuple(parts)


@functools.lru_cache(maxsize=16)
def bounds(scenario: int, steps: int) -> tuple[Floats, Floats]:
    """Bounds (T, 3) of the standard deviations of x, y and z [m]: of the direct method, and of two planes.

    At each of T = `steps` instants of `scenario` the planes are the two with the least variances of their angles at the
    true position, over all arrays; on the axis that both have, the lower bound counts.
    """
    w = world(scenario, steps)
    xyz, sigmas = w.states[:, :3], (SIGMA, SIGMA)
    direct = direct_bound(xyz, dt=w.dt, sensors=w.sensors, sigmas=sigmas, P0=w.P0)[:, range(3), range(3)]
    own, variance = np.full((3, steps, 3), np.inf), np.empty((steps, 3))
    for p, axes in enumerate(AXES):
        rows = plane_axes(p)
        each = plane_bound(xyz, dt=w.dt, sensors=w.sensors, sigmas=sigmas, P0=w.P0[np.ix_(rows, rows)], plane=p)
        own[p][:, list(axes)] = each[:, range(2), range(2)]
        of_arrays = [plane_variance(xyz, at, np.eye(3), *sigmas, p) for at in w.positions]
        variance[:, p] = np.min(of_arrays, axis=0)
    chosen = np.argsort(variance, axis=1, kind="stable")[:, :2]
    flat = np.min(own[chosen.T, np.arange(steps)], axis=0)
    return np.sqrt(direct), np.sqrt(flat)
