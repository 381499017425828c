"""Search among false bearings: start from consensus, bend the loss step by step, forget what false bearings demand.

A false bearing does harm in two ways: it pulls, and it puts the target in front of its camera.  The first is
what robust losses are for.  These have several minima, so that the search begins with the most probable choice of
true bearings (`occlog.track.methods.map.kernels.ransac_path`) and a loss that is next to convex, and then takes the
loss itself with all bearings (graduated non-convexity in two steps).  Against the second, only lines of sight that are
accepted constrain the trajectory; which these are is found in turn with the trajectory.

Search for the most probable trajectory from a start: inside the constraints, in windows, around obstacles.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats
from occlog.consistency.bearings import MIN_OVERLAP_SHARE, confirmed_by_another
from occlog.track.methods.map.config import MapConfig
from occlog.track.methods.map.kernels.interior_point import (
    MU_FIRST,
    Iterate,
    Options,
    Solution,
    covariance,
    minimise,
    move_inside,
)
from occlog.track.methods.map.kernels.noise_scales import evidence, rescaled
from occlog.track.methods.map.kernels.paths_around_obstacles import (
    Hold,
    Obstacle,
    PathsAroundObstacles,
    find_paths_around,
    settle,
)
from occlog.track.methods.map.kernels.problem import (
    CAUCHY,
    HUBER,
    SQUARE,
    BearingLinesByStep,
    TrajectoryProblem,
    linear_problem,
    some_lines,
    some_planes,
)
from occlog.track.methods.map.kernels.quadratic_program import sequential_programs
from occlog.track.methods.map.kernels.terms import depths, inlier_probabilities, leverages, residuals
from occlog.track.methods.map.kernels.windows import minimise_windows
from occlog.track.methods.map.occlusion import OccluderCostTerms, occlusion_terms
from occlog.track.methods.map.qp_solvers import program_solver
from occlog.track.methods.map.record import TargetRecord
from occlog.track.methods.map.station_biases import StationBiases

from .problem_of_record import BEND, START, Pending, bend_of, problem_of, start_of
from .start import ConsensusPath, ransac_path

ROUGH = 1e-3
"""Windows that only start the whole are solved to this tolerance, as a share of the room's extent."""
APART, MU = 1e-4, 1e-4
"""Distance to the constraints, as a share of the room's extent, and weight of their barrier where the whole begins."""
N_LINEAR_PROBLEMS = 3
"""Linear problems solved in turn, each with the distances of the one before."""

Watch = Callable[[Iterate], None] | None


def linear_start(problem: TrajectoryProblem, X: Floats, config: MapConfig, extent: float) -> Floats:
    """Return the states (T, 4) at the minimum of a linearised problem, as a start.

    Residuals are linear for fixed distances of the target: first one distance for all, then those of the last solution
    (`N_LINEAR_PROBLEMS` in all).

    Args:
        problem: cost and constraints of a trajectory of T states.
        X: (T, 4) states x, vx, y, vy inside the constraints.
        config: settings of the method.
        extent: size of the scene.
    """
    distance = np.full(len(problem.lines.step), 0.3 * extent)
    for _ in range(N_LINEAR_PROBLEMS):
        X = minimise(linear_problem(problem, distance), X, Options(ROUGH * extent, config.max_iterations)).X
        away = X[problem.lines.step, ::2] - problem.lines.position
        distance = np.maximum(np.einsum("ni,ni->n", away, problem.lines.axis), 0.01 * extent)
    return X


def search_around(
    problem: TrajectoryProblem,
    start: Floats,
    around: tuple[Obstacle, ...],
    config: MapConfig,
    extent: float,
    watch: Watch = None,
    mu: float = MU_FIRST,
) -> PathsAroundObstacles:
    """Return the minimum of the cost outside all obstacles from a start; long records are first solved in windows.

    Args:
        problem: cost and constraints of the trajectory.
        start: (T, 4) states inside the constraints.
        around: the obstacles.
        config: settings of the method.
        extent: size of the scene.
        watch: called with each iterate of the whole; None: not.
        mu: weight of the barrier initially; small for a start that is near the minimum.
    """
    options, space = Options(config.tolerance * extent, config.max_iterations, mu), (extent, config.wall_clearance)
    # Another solver: quadratic programs in turn (Eqs. 7 and 10)
    if config.solver != "newton":
        by_programs = sequential_programs(problem, start, options, program_solver(config.solver), watch)
        return find_paths_around(problem, (problem, by_programs), around, options, *space)
    # A short record at once: Newton's method inside the constraints
    if len(start) <= config.window_states:
        return find_paths_around(problem, (problem, minimise(problem, start, options, watch)), around, options, *space)
    # A long one first roughly in windows that move along, each around its own obstacles
    rough = options._replace(tolerance=ROUGH * extent)
    holds: list[Hold] = []
    alone = np.zeros((len(around), len(start)), dtype=np.bool_)

    def search(here: TrajectoryProblem, X: Floats, first: int) -> tuple[TrajectoryProblem, Solution]:
        own = tuple(o._replace(when=o.when[first : first + len(X)]) for o in around)
        found = find_paths_around(here, (here, minimise(here, X, rough)), own, rough, *space)
        holds.extend(Hold(h.obstacle, h.first + first, h.last + first) for h in found.holds)
        alone[:, first : first + len(X)] |= found.left_alone
        return found.problem, found.solution

    start, iterations = minimise_windows(problem, start, config.window_states, search)
    # Then as a whole, with the detours that the windows took
    settled = settle(problem, start, around, tuple(holds), options, *space) if holds else None
    if settled is None:
        holds.clear()
        # Not from the border itself, on which a search is stuck.
        start, _ = move_inside(start, problem.planes, APART * extent)
        settled = problem, minimise(problem, start, options._replace(mu=MU), watch)
    solved = settled[0], settled[1]._replace(iterations=settled[1].iterations + iterations)
    return find_paths_around(problem, solved, around, options, *space, holds, alone)


def roughly(problem: TrajectoryProblem, start: Floats, config: MapConfig, extent: float) -> tuple[Floats, int]:
    """Return approximate minimising states (T, 4), strictly inside the constraints, and the iterations used.

    Args:
        problem: cost and constraints, without obstacles.
        start: (T, 4) states inside the constraints.
        config: settings of the method.
        extent: size of the scene.
    """
    options = Options(ROUGH * extent, config.max_iterations, MU)

    def search(here: TrajectoryProblem, X: Floats, first: int) -> tuple[TrajectoryProblem, Solution]:  # noqa: ARG001
        return here, minimise(here, X, options)

    X, spent = minimise_windows(problem, start, config.window_states, search)
    return move_inside(X, problem.planes, APART * extent)[0], spent


OUTLIER_SIGMAS = BEND["mixture"]
"""Standard deviations at which a bearing is as likely false as true, with losses other than the mixture's."""

MIN_OUTLIER_SIGMAS = 2.0
"""Standard deviations within which a line of sight is never false."""
INITIAL_HUBER_K = 2.5
"""Parameter of Huber's loss initially."""
VARIANCE_STEP_FACTOR = 4.0
"""Factor between variances of the motion, or of lines of sight, that are tried."""
MAX_VARIANCE_FACTOR = 1e4
"""Variances are not multiplied by more."""
MIN_DEVIANCE_GAIN = 10.0
"""A factor is taken if -2 log of the likelihood falls by more."""
MIN_RESIDUAL_FACTOR, MIN_OUTLIER_SHARE = 1.3, 0.01
"""Residual factor, or share of rejected bearings, above which other variances are tried."""
MIN_CAVITY_SHARE = 0.01
"""Lines of sight of which the others tell more than this share are judged by their residuals alone."""
LOG_FACTOR_TOLERANCE = 0.1
"""Change of a factor's logarithm at which it has settled."""
MAX_OCCLUDER_ROUNDS, POSITION_TOLERANCE_SIGMAS = 6, 0.1
"""How often the search is repeated among moving occluders, until no position moves by more standard deviations."""
ROUNDS = 8
"""How often the search is repeated at most with what is accepted after the one before."""

Scales = tuple[float, float]
"""Factors of the stated variances of lines of sight and of steps."""


class RivalMode(NamedTuple):
    """A competing mode of the posterior that is nearly as probable: its T states.

    `X` (T, 4) and `spread` (T, 4, 4) are states and covariances, `excess` is by how much its negative log posterior is
    higher, `elsewhere` (T,) marks states at which its position differs significantly from the best mode's.
    """

    X: Floats  # (T, 4) states
    spread: Floats  # (T, 4, 4) covariances
    excess: float  # by how much its cost is higher
    elsewhere: Bools  # (T,) states at which its position is significantly away from that of the mode


class RobustSearchResult(NamedTuple):
    """Result of a search among false bearings: the mode of T states, and which of N bearings it accepts.

    `problem` has no half-planes of detours around obstacles, `mode` has; `stuck` (T,) are states with contradictory
    constraints, `used` (N,) the bearings in the problem, `scales` the variance factors, `score` the cost including that
    of unused bearings, `inlier` (N,) bearings more probably true than false (None: all), `chance` (N,) those of them
    fitted by chance alone, `careful` the minimum without those. Further: occluder terms, rival modes, station biases.
    """

    problem: TrajectoryProblem  # without the half-planes of detours
    mode: PathsAroundObstacles
    stuck: Bools  # (T,) states with constraints that contradict each other
    used: Bools  # (N,) which lines of sight the problem has
    scales: Scales
    score: float = math.nan  # cost with that of the lines of sight that the problem does not have
    inlier: Bools | None = None  # (N,) more probably true than false; None: all
    chance: Bools | None = None  # (N,) of these, met by chance alone; None: none
    careful: PathsAroundObstacles | None = None  # the minimum without those; None: missing
    hints: OccluderCostTerms | None = None  # what moving occluders say; None: nothing
    rivals: tuple[RivalMode, ...] = ()  # by rising cost
    biases: StationBiases | None = None  # of ranges; None: none are estimated


def plain_search(
    pending: Pending, record: TargetRecord, around: tuple[Obstacle, ...], watch: Watch
) -> RobustSearchResult:
    """Search from the paper's start, or from linearised problems, accepting all bearings.

    With priors of moving occluders the search is repeated with their terms until it converges.

    Args:
        pending: unreleased part of the target's record.
        record: measurements of the target.
        around: obstacles.
        watch: called with each iterate; None: not.
    """
    config = pending.config
    problem = problem_of(pending, record)
    # Start inside the constraints ([Rahimi] Sec. 6)
    start, stuck = start_of(pending, problem)
    used = ~stuck[problem.lines.step]
    if stuck.any():
        problem = without(problem, stuck)
    if config.initialisation == "linear":
        start = linear_start(problem, start, config, pending.extent)
    if config.loss == "mixture":
        # Far from the minimum the loss itself is flat.
        start, _ = roughly(problem._replace(loss=HUBER, k=INITIAL_HUBER_K), start, config, pending.extent)
    mode = search_around(problem, start, around, config, pending.extent, watch)
    hints: OccluderCostTerms | None = None
    # Among moving occluders: again with what they say there
    for _ in range(MAX_OCCLUDER_ROUNDS if record.occluders else 0):
        before = mode.solution.X
        hints = occlusion_terms(pending, record, before, covariance(mode.problem, before), used, hints)
        lean = hints.lean[used]
        problem = problem._replace(lines=problem.lines._replace(lean=lean), hints=hints.hints)
        start, _ = move_inside(before, problem.planes, APART * pending.extent)
        mode = search_around(problem, start, around, config, pending.extent, watch, mu=MU)
        if has_converged(before, mode):
            break
    return RobustSearchResult(problem, mode, stuck, used, (1.0, 1.0), hints=hints)


def robust_search(
    pending: Pending, record: TargetRecord, around: tuple[Obstacle, ...], watch: Watch
) -> RobustSearchResult:
    """Search from the path with which most bearings agree, rejecting false bearings.

    With priors of moving occluders the search is repeated with their terms. If bearings are fitted by chance alone, the
    result has a second minimum without them (`careful`), for the covariances.

    Args:
        pending: unreleased part of the target's record.
        record: measurements of the target.
        around: obstacles.
        watch: called with each iterate; None: not.
    """
    found = _most_probable(pending, record, around, watch)
    # Among moving occluders: again with what they say there
    for _ in range(MAX_OCCLUDER_ROUNDS if record.occluders else 0):
        before, inlier = found.mode.solution.X, found.used if found.inlier is None else found.inlier
        spread = covariance(found.mode.problem, before)
        hints = occlusion_terms(pending, record, before, spread, inlier, found.hints)
        path = ConsensusPath(before, inlier, 0.0)
        found = search_from(pending, record, around, watch, path, found.scales, among=hints)
        if has_converged(before, found.mode):
            break
    if found.chance is None or found.inlier is None or not found.chance.any():
        return found
    path = ConsensusPath(found.mode.solution.X, found.inlier & ~found.chance, 0.0)
    other = search_from(pending, record, around, None, path, found.scales, careful=True, among=found.hints)
    return found._replace(careful=other.mode)


def _most_probable(
    pending: Pending, record: TargetRecord, around: tuple[Obstacle, ...], watch: Watch
) -> RobustSearchResult:
    """Search from the consensus path, constrained by accepted bearings only.

    Where mostly one camera at a time sees the target, the start on the cameras' axes is tried, too, and the cheaper
    result is returned. Else, if some bearings are rejected or residuals are too large, the search is repeated with
    larger variances of motion and bearings, if these make the path clearly more probable.

    Args:
        pending: unreleased part of the target's record.
        record: measurements of the target.
        around: obstacles.
        watch: called with each iterate; None: not.
    """
    config = pending.config
    whole = problem_of(pending, record)

    def path(scales: Scales) -> ConsensusPath:
        agreed = ransac_path(
            rescaled(whole, *scales), record, pending.at, config, pending.extent, inlier_weights(config, scales[0])
        )
        return agreed._replace(cost=agreed.cost + len(agreed.agree) * float(np.log(scales[0])))

    # Start: what agrees with what is stated
    first = path(pending.scales)
    found = search_from(pending, record, around, watch, first, pending.scales)
    # Where one camera sees it at a time, distances hang on the motion: the paper's start may lead to a lower minimum
    sparse = _overlap(record) < MIN_OVERLAP_SHARE
    if sparse:
        far = _from_axes(pending, whole, inlier_weights(config, pending.scales[0]))
        other = search_from(pending, record, around, watch, far, pending.scales)
        found = min(found, other, key=lambda sought: sought.score)
    if sparse or config.loss == "square" or not config.adapt_noise or _plausible(found, first):
        return found
    # Scale of the motion, then of the bearings: coarse steps up as long as that is more probable
    best, scales = first, pending.scales
    for which in (1, 0):
        while True:
            tried = (
                (scales[0], scales[1] * VARIANCE_STEP_FACTOR)
                if which
                else (scales[0] * VARIANCE_STEP_FACTOR, scales[1])
            )
            noisier = path(tried)
            if not noisier.cost < best.cost - MIN_DEVIANCE_GAIN or max(tried) > MAX_VARIANCE_FACTOR:
                break
            best, scales = noisier, tried
    if scales == pending.scales:
        return found
    return search_from(pending, record, around, watch, best, scales)


def _overlap(record: TargetRecord) -> float:
    """Return the share of bearings that saw the target with one of another sensor close in time; 1 without bearings."""
    seen = record.rows.seen
    near = confirmed_by_another(record.rows.sensor[seen], (record.t_ns[record.state[seen]] - record.t_ns[0]) / NS)
    return float(near.mean()) if len(near) else 1.0


def _from_axes(pending: Pending, whole: TrajectoryProblem, trust: float) -> ConsensusPath:
    """Return a path from the start on the cameras' axes, by successively narrower losses, and the bearings that agree.

    Args:
        pending: unreleased part of the target's record.
        whole: problem with all bearings.
        trust: residual [standard deviations] up to which a bearing agrees.
    """
    config, extent = pending.config, pending.extent
    X, stuck = start_of(pending, whole)
    problem = without(whole, stuck) if stuck.any() else whole
    for loss, k in ((HUBER, INITIAL_HUBER_K), (CAUCHY, BEND["cauchy"])):
        X, _ = roughly(problem._replace(loss=loss, k=k), X, config, extent)
    return ConsensusPath(X, inlier_probabilities(whole.lines, X, trust) >= 0.5, math.inf)


def _plausible(found: RobustSearchResult, path: ConsensusPath) -> bool:
    """Return whether nearly all bearings agree with the path, and the residuals of the search are about as stated."""
    residual_evidence = evidence(
        found.mode.problem, found.mode.solution.X, covariance(found.mode.problem, found.mode.solution.X)
    )
    doubted = float(np.mean(~path.agree)) if len(path.agree) else 0.0
    return (
        max(residual_evidence.lines_scale, residual_evidence.steps_scale) < MIN_RESIDUAL_FACTOR
        and doubted < MIN_OUTLIER_SHARE
    )


def inlier_weights(config: MapConfig, lines2: float) -> float:
    """Return the residual [standard deviations] at which a bearing is equally likely true or false.

    `lines2` is the factor of the stated variance of bearings; `config` gives the loss and its parameter.
    """
    bend = bend_of(config) if config.loss == "mixture" else OUTLIER_SIGMAS
    # False ones are as likely as before, and the peak of true ones is lower.
    return float(np.sqrt(max(bend**2 - np.log(lines2), MIN_OUTLIER_SIGMAS**2)))


def search_from(
    pending: Pending,
    record: TargetRecord,
    around: tuple[Obstacle, ...],
    watch: Watch,
    path: ConsensusPath,
    scales: Scales,
    *,
    careful: bool = False,
    among: OccluderCostTerms | None = None,
) -> RobustSearchResult:
    """Search from an initial path, alternating with the choice of accepted bearings, until that no longer changes.

    Args:
        pending: unreleased part of the target's record.
        record: measurements of the target.
        around: obstacles.
        watch: called with each iterate; None: not.
        path: where the search begins, and the bearings that agree with it.
        scales: factors of the stated variances of bearings and motion; if they differ from `pending.scales`, they are
            re-estimated with the trajectory.
        careful: omit bearings that are fitted by chance alone, see `_overfits`.
        among: terms of moving occluders; None: none.
    """
    config, extent = pending.config, pending.extent
    (X, kept, _), iterations, learn = path, 0, scales != pending.scales and not careful
    banned = np.zeros(len(kept), dtype=np.bool_)
    for number in range(ROUNDS):
        # Constrain by what is accepted; drop what has no effect in front of its camera
        trust = inlier_weights(config, scales[0])
        problem = rescaled(problem_of(pending, record, kept), *scales)
        if config.loss == "mixture":
            problem = problem._replace(k=trust)
        if among is not None:
            problem = problem._replace(lines=problem.lines._replace(lean=among.lean), hints=among.hints)
        lines = problem.lines
        used = (kept | (depths(lines, X) > config.min_depth)) & ~banned
        problem = problem._replace(lines=some_lines(_frozen(lines, kept, X), used))
        X, stuck = move_inside(X, problem.planes, (START if number == 0 else APART) * extent)
        if stuck.any():
            problem = without(problem, stuck)
            used &= ~stuck[lines.step]
        if number == 0:
            # Begin with the lines of sight that agree, and a loss that is next to convex
            agreeing = problem._replace(lines=some_lines(problem.lines, kept[used]), loss=HUBER, k=INITIAL_HUBER_K)
            X, spent = roughly(agreeing, X, config, extent)
            iterations += spent
        # Search with the loss itself
        mode = search_around(problem, X, around, config, extent, watch, mu=MU)
        iterations += mode.solution.iterations
        # Believe what agrees with the trajectory, and refine the scales
        X = mode.solution.X
        inlier, chance = used, np.zeros_like(used)
        if config.loss == "square":
            break
        inlier = used & (inlier_probabilities(lines, X, trust) >= 0.5)
        spread = covariance(mode.problem, X)
        chance = inlier & _overfits(lines, X, spread, trust)
        if careful:
            banned, inlier = banned | chance, inlier & ~chance
        settled = bool((inlier == kept)[~stuck[lines.step]].all())
        if learn:
            residual_evidence = evidence(mode.problem, X, spread)
            before = scales
            scales = (
                max(scales[0] * residual_evidence.lines_scale, 1.0),
                max(scales[1] * residual_evidence.steps_scale, 1.0),
            )
            settled = settled and bool(np.abs(np.log(scales) - np.log(before)).max() < LOG_FACTOR_TOLERANCE)
        if settled:
            break
        kept = inlier
    mode = mode._replace(solution=mode.solution._replace(iterations=iterations))
    score = mode.solution.cost + 0.5 * trust**2 * float(np.count_nonzero(~used))
    return RobustSearchResult(problem, mode, stuck, used, scales, score, inlier, chance, hints=among)


def has_converged(before: Floats, mode: PathsAroundObstacles) -> bool:
    """Return whether no position moved by more than `POSITION_TOLERANCE_SIGMAS` of its standard deviation.

    `before` (T, 4) are the states before the search that gave `mode`.
    """
    X = mode.solution.X
    sigma = np.sqrt(covariance(mode.problem, X)[:, (0, 2), (0, 2)].sum(axis=1))
    return bool((np.hypot(*(X - before)[:, ::2].T) <= POSITION_TOLERANCE_SIGMAS * sigma).all())


def _overfits(lines: BearingLinesByStep, X: Floats, spread: Floats, trust: float) -> Bools:
    """Return a mask (N,) of bearings that are fitted by chance alone: by the others they are less probable than false.

    Next to a camera a trajectory fits any measurement of it.  With h the leverage of a bearing, the others predict it
    with 1/(1 - h) times its variance, so that accepting it costs r^2/(1 - h) - log(1 - h).

    Args:
        lines: N lines of sight.
        X: (T, 4) states x, vx, y, vy.
        spread: (T, 4, 4) their covariances.
        trust: residual at which a bearing is equally likely true or false.
    """
    rest = np.maximum(1.0 - leverages(lines, X, SQUARE, 1.0, spread), 1e-100)
    surprise = np.minimum(residuals(lines, X) ** 2, MAX_VARIANCE_FACTOR) / rest - np.log(rest)
    return np.asarray((surprise > trust**2 + 2.0 * lines.lean) & (rest < MIN_CAVITY_SHARE))


def _frozen(lines: BearingLinesByStep, kept: Bools, X: Floats) -> BearingLinesByStep:
    """Return the lines of sight, with the variances of rejected ones fixed at their values at X (T, 4).

    `kept` (N,) marks accepted ones; for the others the dependence on the distance is removed.
    """
    d2 = np.maximum(depths(lines, X) ** 2, 1e-300)
    loose = ~kept & (lines.c1 > 0.0)
    return lines._replace(c0=np.where(loose, lines.c0 + lines.c1 / d2, lines.c0), c1=np.where(loose, 0.0, lines.c1))


def without(problem: TrajectoryProblem, states: Bools) -> TrajectoryProblem:
    """Return the problem without the half-planes and lines of sight of the states marked in `states` (T,).

    A line of sight without its half-plane leads into its sensor, where the cost is discontinuous.
    """
    planes = some_planes(problem.planes, ~states[problem.planes.step])
    return problem._replace(planes=planes, lines=some_lines(problem.lines, ~states[problem.lines.step]))
