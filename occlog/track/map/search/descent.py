"""Search for the most probable trajectory from a start: inside the constraints, in windows, around obstacles."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from occlog.array_types import Floats
from occlog.track.map.config import MapConfig
from occlog.track.map.kernels.detours import Detours, find_detours, settle
from occlog.track.map.kernels.interior_point.feasible import move_inside
from occlog.track.map.kernels.interior_point.newton_search import MU_FIRST, Iterate, Options, Solution, minimise
from occlog.track.map.kernels.obstacles import Hold, Obstacle
from occlog.track.map.kernels.problem import Problem
from occlog.track.map.kernels.quadratic_program import sequential_programs
from occlog.track.map.kernels.start import linear_problem
from occlog.track.map.kernels.windows import minimise_windows
from occlog.track.map.qp_solvers import program_solver

ROUGH = 1e-3
"""Windows that only start the whole are solved to this tolerance, as a share of the room's extent."""
APART, MU = 1e-4, 1e-4
"""Distance to the constraints, as a share of the room's extent, and weight of their barrier where the whole begins."""
LOOKS = 3
"""Linear problems solved in turn, each with the distances of the one before."""

Watch = Callable[[Iterate], None] | None


def linear_start(problem: Problem, X: Floats, config: MapConfig, extent: float) -> Floats:
    """The minimum of linear problems: first with all targets at one distance, then at those found."""
    distance = np.full(len(problem.lines.step), 0.3 * extent)
    for _ in range(LOOKS):
        X = minimise(linear_problem(problem, distance), X, Options(ROUGH * extent, config.iterations)).X
        away = X[problem.lines.step, ::2] - problem.lines.place
        distance = np.maximum(np.einsum("ni,ni->n", away, problem.lines.axis), 0.01 * extent)
    return X


def search_around(
    problem: Problem,
    start: Floats,
    around: tuple[Obstacle, ...],
    config: MapConfig,
    extent: float,
    watch: Watch = None,
    mu: float = MU_FIRST,
) -> Detours:
    """The minimum around all obstacles that the start leads to; long records are first solved in windows.

    Args:
        problem: what is minimised.
        start: (T, 4) states inside the constraints.
        around: the obstacles.
        config: settings.
        extent: size of the place.
        watch: called with each iterate of the whole.
        mu: weight of the barrier at first; small for a start that is near the minimum.
    """
    options, space = Options(config.tolerance * extent, config.iterations, mu), (extent, config.clearance)
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


def roughly(problem: Problem, start: Floats, config: MapConfig, extent: float) -> tuple[Floats, int]:
    """States near the minimum, inside the constraints but not on their border, and the iterations that they took.

    Args:
        problem: what is minimised, without obstacles.
        start: (T, 4) states inside the constraints.
        config: settings.
        extent: size of the place.
    """
    options = Options(ROUGH * extent, config.iterations, MU)

    def search(here: Problem, X: Floats, first: int) -> tuple[Problem, Solution]:  # noqa: ARG001
        return here, minimise(here, X, options)

    X, spent = minimise_windows(problem, start, config.window, search)
    return move_inside(X, problem.planes, APART * extent)[0], spent
