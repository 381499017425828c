"""Method `map`: most probable trajectories from bearings of cameras that need not overlap ([Rahimi]).

The record of a target is solved as a whole, or with `lag_s` in windows that move along:
then a state is given out when that much time has been seen after it, and what came before
the window is summed up in a Gaussian of its first state.

Departures from the paper: times are those of the measurements, at any intervals; variances
hold the errors of the cameras' poses ([Ercan] Eq. 2); the quadratic programs are replaced by
Newton's method inside the constraints (`occlog.track.map.kernels.newton_search`); room, walls and the cameras'
ranges are constraints besides.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats
from occlog.errors import InputError
from occlog.measure.scans.scan import Scan
from occlog.records.scene import Scene
from occlog.track.interface import Batch, Smoothed
from occlog.track.map.kernels.detours import Detours, find_detours, settle
from occlog.track.map.kernels.feasible import move_inside
from occlog.track.map.kernels.gauss_markov import GaussMarkov, constant_velocity
from occlog.track.map.kernels.invariant import invariant, second_moment
from occlog.track.map.kernels.newton_search import Iterate, Options, Solution, covariance, minimise
from occlog.track.map.kernels.obstacles import Hold, Obstacle
from occlog.track.map.kernels.problem import (
    CAUCHY,
    HUBER,
    SQUARE,
    HalfPlanes,
    Problem,
    chain,
    some_lines,
    some_planes,
)
from occlog.track.map.kernels.quadratic_program import sequential_programs
from occlog.track.map.kernels.start import linear_problem, start_on_axes
from occlog.track.map.kernels.terms import residuals
from occlog.track.map.kernels.windows import Knowledge, minimise_windows, summary

from .barriers import obstacles
from .config import MapConfig
from .fixed_lag import lag_ns, settled
from .measurements import Stations, constraints, sight_lines, stations
from .qp_solvers import program_solver
from .record import EMPTY, Record, after, fill, join, record_of

UNOBSERVABLE, CONTRADICTION, WALL, UNFINISHED = "unobservable", "contradiction", "wall", "unfinished"
ROUGH = 1e-3
"""Windows that only start the whole are solved to this tolerance, as a share of the room's extent."""
APART, MU = 1e-4, 1e-4
"""Distance to the constraints, as a share of the room's extent, and weight of their barrier where the whole begins."""
LOOKS = 3
"""Linear problems solved in turn, each with the distances of the one before."""

Watch = Callable[[Iterate], None] | None

LOSS = {"square": SQUARE, "huber": HUBER, "cauchy": CAUCHY}
BEND = {"square": 1.0, "huber": 1.345, "cauchy": 2.385}
"""Parameters of the losses that lose 5 % where all errors are Gaussian."""


class Pending(NamedTuple):
    """A target's record that is not given out yet, and what is known from before it."""

    config: MapConfig
    at: Stations
    origin: Floats  # (2,)
    extent: float
    before: Knowledge
    record: Record
    X: Floats  # (T, 4) states found so far; fewer than times: the rest is new


def motion_of(config: MapConfig) -> GaussMarkov:
    """How the target moves: the fitted model if there is one, or constant velocity with noise."""
    if config.A is None or config.Sigma is None:
        return constant_velocity(config.acceleration, config.jitter, config.step_s)
    A, sigma = (np.array(m, dtype=np.float64).reshape(4, 4) for m in (config.A, config.Sigma))
    return GaussMarkov(A, sigma, config.step_s)


def begin(scene: Scene, config: MapConfig, returned: bool = False) -> Pending:
    """Nothing known but where a target can be.

    Args:
        scene: room and sensors.
        config: settings.
        returned: the target is back after a gap, so that `config.start` no longer holds.
    """
    low, high = scene.surroundings.min(axis=0), scene.surroundings.max(axis=0)
    extent = float(np.hypot(*(high - low)))
    if not extent > 0:
        raise InputError("scene: the room has no extent, so that a trajectory has no scale; add `room`")
    origin = 0.5 * (low + high) if _moves_freely(config) else np.zeros(2)
    # Without a room a target can be as far as sensors see.
    farthest = scene.region.max(axis=0) - scene.region.min(axis=0)
    place, sigma = 0.5 * (low + high), float(np.hypot(*farthest))
    # After a gap the given start no longer holds: the target may be anywhere in the room.
    if config.start is not None and not returned:
        place, sigma = np.array(config.start[:2]), config.start[2]
    mean = np.zeros(4)
    mean[::2] = place - origin
    spread = np.diag([sigma**2, config.speed**2, sigma**2, config.speed**2])
    at = stations(scene, origin, walls=config.walls)
    return Pending(
        config=config,
        at=at,
        origin=origin,
        extent=extent,
        before=Knowledge(mean, spread),
        record=EMPTY,
        X=np.empty((0, 4)),
    )


def _moves_freely(config: MapConfig) -> bool:
    """Whether the motion is the same everywhere, so that coordinates may be counted from anywhere."""
    return bool(np.allclose(motion_of(config).A[:, ::2], np.eye(4)[:, ::2], rtol=0.0, atol=1e-12))


def advance(pending: Pending, scans: Sequence[Scan], last: bool, watch: Watch = None) -> tuple[Pending, Smoothed]:
    """One more block of a target's record, and the states that are settled by it.

    Args:
        pending: from `begin` or the call before.
        scans: of this target, after those of the last call; only labelled rows.
        last: nothing will follow, so that everything is given out.
        watch: called with each iterate of the search for the whole (not of windows that only start it);
            its positions count from `pending.origin`.
    """
    config = pending.config
    # Gather the record so far, with a state at least every `fill_s`
    whole = fill(join(pending.record, record_of(scans)), config.fill_s)
    T = len(whole.t_ns)
    keep = T if last else settled(whole.t_ns, lag_ns(config.lag_s))
    # Formulate: prior, likelihood and half-planes of the trajectory (Eqs. 1-5 and 8-9)
    problem = problem_of(pending, whole)
    # Start inside the constraints ([Rahimi] Sec. 6)
    start, stuck = start_of(pending, problem)
    if stuck.any():
        # A sight line without its half-plane leads into its sensor, where the cost is not continuous.
        lines = some_lines(problem.lines, ~stuck[problem.lines.step])
        problem = problem._replace(planes=_without(problem.planes, stuck), lines=lines)
    # Obstacles: walls, and views in which the target was not seen
    around = obstacles(whole, pending.at, config, pending.extent, T)
    try:
        if config.initial == "linear":
            start = _linear_start(problem, start, config, pending.extent)
        # Search for the mode around the obstacles (Eq. 6), and estimate the covariances there
        mode = _solve(problem, start, around, config, pending.extent, watch)
        found, spread = _estimate(problem, mode, around, pending)
    except (ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
        raise InputError(
            f"map: numbers too large or too small to compute with ({error}); look at sigma_px, u_px and sigma of the "
            "bearings, and at the settings of the motion"
        ) from error
    # Give out the states that have seen enough after them
    problem, solution = found.problem, found.solution
    walls = np.array([o.seen_through is None for o in around], dtype=np.bool_)
    through = np.asarray(found.left_alone[walls].any(axis=0), dtype=np.bool_)
    out = _smoothed(pending, problem, solution, spread[:keep], whole, stuck, through)
    if last:
        return pending._replace(record=EMPTY, X=np.empty((0, 4))), out
    # Marginalise what is given out: it becomes a Gaussian of the first state that is left
    before = summary(problem, solution, keep) if keep else pending.before
    return pending._replace(before=before, record=after(whole, keep), X=solution.X[keep:]), out


def _estimate(
    problem: Problem, mode: Detours, around: tuple[Obstacle, ...], pending: Pending
) -> tuple[Detours, Floats]:
    """The estimate that is given out, and its covariances (T, 4, 4).

    Args:
        problem: without the half-planes of detours.
        mode: its minimum around the obstacles.
        around: these obstacles.
        pending: the target.
    """
    config, extent = pending.config, pending.extent
    if not config.front or (config.estimate == "mode" and config.covariance == "hessian"):
        return mode, covariance(mode.problem, mode.solution.X)
    options = Options(config.tolerance * extent, config.iterations)
    other = invariant(mode.problem, mode.solution, options, extent)
    if config.estimate == "mode":
        spread = second_moment(mode.solution.X, other.solution.X, other.covariance)
        solution = mode.solution._replace(iterations=other.solution.iterations)
        return mode._replace(solution=solution), spread
    # It may lead through walls that the mode did not come near.
    flat = problem._replace(lines=other.problem.lines)
    solved = other.problem, other.solution
    found = find_detours(flat, solved, around, options, extent, config.clearance, mode.holds, mode.left_alone)
    if len(found.holds) == len(mode.holds):
        return found, other.covariance
    return found, covariance(found.problem, found.solution.X)


def problem_of(pending: Pending, record: Record) -> Problem:
    """What is minimised for a record ([Rahimi] Eq. 8); InputError for a motion model that does not fit its times."""
    config, before = pending.config, pending.before
    try:
        # Prior: a Gauss-Markov chain (Eqs. 1-3)
        steps = chain(motion_of(config), np.diff(record.t_ns) / NS, before.mean, before.spread)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise InputError(f"map: the motion model does not fit: {error}") from error
    # Likelihood: a residual for each bearing (Eq. 4)
    lines = sight_lines(record, pending.at)
    # Constraints: half-planes in front of the cameras (Eq. 9), and in the room
    planes = constraints(lines, record, pending.at, config, len(record.t_ns))
    bend = BEND[config.loss] if config.bend is None else config.bend
    return Problem(steps, lines, planes, LOSS[config.loss], bend)


def start_of(pending: Pending, problem: Problem) -> tuple[Floats, Bools]:
    """Where the search begins, inside the constraints; and the states whose constraints contradict each other.

    States that a camera saw begin on its optical axis, the others in the centre of the room ([Rahimi] Sec. 6);
    states that were found before begin there.
    """
    config, T = pending.config, problem.T
    depth = 0.1 * pending.extent if config.depth is None else config.depth
    X = start_on_axes(problem.lines, T, _centre(pending), depth)
    known = len(pending.X)
    X[:known] = pending.X
    margin = 1e-3 * pending.extent
    return move_inside(X, problem.planes, margin)


def _centre(pending: Pending) -> Floats:
    hull = pending.at.hull
    return np.asarray(pending.at.place.mean(axis=0) if hull is None else 0.5 * (hull.min(axis=0) + hull.max(axis=0)))


def _linear_start(problem: Problem, X: Floats, config: MapConfig, extent: float) -> Floats:
    """The minimum of linear problems: first with all targets at one distance, then at those found."""
    distance = np.full(len(problem.lines.step), 0.3 * extent)
    for _ in range(LOOKS):
        X = minimise(linear_problem(problem, distance), X, Options(ROUGH * extent, config.iterations)).X
        away = X[problem.lines.step, ::2] - problem.lines.place
        distance = np.maximum(np.einsum("ni,ni->n", away, problem.lines.axis), 0.01 * extent)
    return X


def _solve(
    problem: Problem, start: Floats, around: tuple[Obstacle, ...], config: MapConfig, extent: float, watch: Watch
) -> Detours:
    """The minimum around all obstacles; long records are first solved in windows."""
    options, space = Options(config.tolerance * extent, config.iterations), (extent, config.clearance)
    # Another solver: quadratic programs in turn (Eqs. 7 and 10)
    if config.solver != "newton":
        by_programs = sequential_programs(problem, start, options, program_solver(config.solver), watch)
        return find_detours(problem, (problem, by_programs), around, options, *space)
    # A short record at once: Newton's method inside the constraints
    if len(start) <= config.window:
        return find_detours(problem, (problem, minimise(problem, start, options, watch)), around, options, *space)
    # A long one first roughly in windows that move along, each around its own obstacles
    rough = options._replace(tolerance=ROUGH * extent)
    holds: list[Hold] = []
    alone = np.zeros((len(around), len(start)), dtype=np.bool_)

    def search(here: Problem, X: Floats, first: int) -> tuple[Problem, Solution]:
        own = tuple(o._replace(when=o.when[first : first + len(X)]) for o in around)
        found = find_detours(here, (here, minimise(here, X, rough)), own, rough, *space)
        holds.extend(Hold(h.obstacle, h.first + first, h.last + first) for h in found.holds)
        alone[:, first : first + len(X)] |= found.left_alone
        return found.problem, found.solution

    start, iterations = minimise_windows(problem, start, config.window, search)
    # Then as a whole, with the detours that the windows took
    settled = settle(problem, start, around, tuple(holds), options, *space) if holds else None
    if settled is None:
        holds.clear()
        # Not from the border itself, on which a search is stuck.
        start, _ = move_inside(start, problem.planes, APART * extent)
        settled = problem, minimise(problem, start, options._replace(mu=MU), watch)
    solved = settled[0], settled[1]._replace(iterations=settled[1].iterations + iterations)
    return find_detours(problem, solved, around, options, *space, holds, alone)


def _smoothed(
    pending: Pending, problem: Problem, solution: Solution, spread: Floats, record: Record, stuck: Bools, through: Bools
) -> Smoothed:
    """The first states, as many as there are covariances, as they are given out."""
    X = solution.X
    T, keep = len(X), len(spread)
    looked, seen = np.bincount(record.state, minlength=T), np.bincount(record.state[record.rows.seen], minlength=T)
    sigma = np.sqrt(np.linalg.eigvalsh(spread[:, ::2, ::2])[:, -1])
    vague = sigma > pending.config.vague * pending.extent
    flags = np.select([stuck[:keep], through[:keep], vague], [CONTRADICTION, WALL, UNOBSERVABLE], "")
    if not solution.converged:
        flags = np.where(flags == "", UNFINISHED, flags)
    order = np.array([0, 2, 1, 3])
    bounds = np.searchsorted(record.state, np.arange(keep + 1)).tolist()
    sensors = record.rows.sensor.tolist()
    return Smoothed(
        t_ns=record.t_ns[:keep],
        xy=X[:keep, ::2] + pending.origin,
        velocity=X[:keep, 1::2],
        covariance=spread[:, order[:, None], order],
        log_likelihood=_scores(problem, X)[:keep],
        n_looked=looked[:keep],
        n_seen=seen[:keep],
        fallback=tuple(flags.tolist()),
        used=tuple(tuple(sensors[a:b]) for a, b in pairwise(bounds)),
        seen_by=tuple(
            tuple(s for s, saw in zip(sensors[a:b], record.rows.seen[a:b].tolist(), strict=True) if saw)
            for a, b in pairwise(bounds)
        ),
        iterations=solution.iterations,
        converged=solution.converged,
    )


def _scores(problem: Problem, X: Floats) -> Floats:
    """(T,) log likelihood of the measurements of each state, all errors taken for Gaussian."""
    lines = problem.lines
    away = X[lines.step, ::2] - lines.place
    d2 = np.maximum(np.einsum("ni,ni->n", away, lines.axis) ** 2, 1e-300)
    variance = lines.c0 + lines.c1 / d2
    each = -0.5 * residuals(lines, X) ** 2 - 0.5 * np.log(2.0 * np.pi * variance)
    total = np.bincount(lines.step, weights=each, minlength=len(X))
    return np.where(np.bincount(lines.step, minlength=len(X)) > 0, total, np.nan)


def _without(planes: HalfPlanes, states: Bools) -> HalfPlanes:
    """The half-planes of all other states."""
    return some_planes(planes, ~states[planes.step])


METHOD = Batch(
    config=MapConfig,
    begin=begin,
    advance=advance,
    started=lambda config: config.start is not None,
    lag_ns=lambda config: lag_ns(config.lag_s),
)
