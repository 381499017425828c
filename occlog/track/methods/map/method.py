"""Method `map`: most probable trajectories from bearings of cameras that need not overlap ([Rahimi]).

The record of a target is solved as a whole, or with `lag_s` in windows that move along:
then a state is given out when that much time has been seen after it, and what came before
the window is summed up in a Gaussian of its first state.

Departures from the paper: times are those of the measurements, at any intervals; variances
hold the errors of the cameras' poses ([Ercan] Eq. 2); the quadratic programs are replaced by
Newton's method inside the constraints (`occlog.track.methods.map.kernels.interior_point`); room, walls
and the cameras' ranges are constraints also.

Fixed lag (`--lag`): which states of a trajectory have seen enough of what comes after them to be given out.

With a lag, the driver hands a target's scans over in blocks (`occlog.track.drivers.batch`).  After each block the
whole record that is held is solved again; states that lie at least the lag before its end are settled: they are given
out and forgotten, but for what they say of the states after them.  Memory does not grow with the recording.

Residuals of an estimate's bearings: which are accepted, and whether residuals are what was stated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.consistency.estimates import RivalTrajectory
from occlog.core.geometry.camera import wrap_angle
from occlog.errors import InputError
from occlog.scans.grouping import Scan
from occlog.track.interface import Batch, BearingResiduals, NoiseScales, OccluderTerms, SmoothedTrajectory

from .barriers import obstacles
from .config import MapConfig
from .kernels.interior_point import Options, Solution, covariance
from .kernels.invariant import invariant, second_moment
from .kernels.noise_scales import evidence, sandwich
from .kernels.paths_around_obstacles import Obstacle, PathsAroundObstacles, find_paths_around
from .kernels.problem import BearingLinesByStep, TrajectoryProblem
from .kernels.terms import depths, inlier_probabilities, leverages, losses, residuals
from .kernels.windows import summary
from .lines_and_distances import mixed_search, with_distances, with_rivals
from .measurements import lines_of_sight
from .record import EMPTY, TargetRecord, after, fill, join, record_of
from .search.problem_of_record import Pending, begin, memory_ns
from .search.robust import RivalMode, RobustSearchResult, Watch, inlier_weights, plain_search, robust_search
from .search.start import rays_of


def lag_ns(lag_s: float | None) -> int | None:
    """Return the lag in ns from the setting in s; None stays None: estimates wait for the end of the recording."""
    return None if lag_s is None else round(lag_s * NS)


def settled(t_ns: Ints, lag_ns: int | None) -> int:
    """Return the number of initial states that are old enough to be released; never the last one.

    Args:
        t_ns: (T,) times of the states, ascending, T >= 1.
        lag_ns: a state is released when it is at least this long before the last one; None: no state is.
    """
    if lag_ns is None:
        return 0
    return min(int(np.searchsorted(t_ns, t_ns[-1] - lag_ns, side="right")), len(t_ns) - 1)


def residuals_and_noise_scales(
    pending: Pending, record: TargetRecord, sought: RobustSearchResult, found: PathsAroundObstacles
) -> tuple[BearingResiduals, NoiseScales]:
    """Return normalised residuals of the bearings at the estimate, and estimated noise factors of bearings and motion.

    Args:
        pending: unreleased part of the target's record.
        record: measurements of the target.
        sought: result of the search: which bearings it used, and the variance factors.
        found: the estimate.
    """
    X, problem = found.solution.X, found.problem
    stated = lines_of_sight(record, pending.at)
    spread = covariance(problem, X)
    # Residuals as stated; by the angle where the target is not before the camera
    off = residuals(stated, X)
    behind = (depths(stated, X) <= 0.0) & ~stated.direction
    off[behind] = _angles(stated, record, pending, X)[behind]
    # Belief with the variances that were used
    if sought.hints is not None:
        stated = stated._replace(lean=sought.hints.lean)
    scaled = stated._replace(c0=stated.c0 * sought.scales[0], c1=stated.c1 * sought.scales[0])
    inlier = np.where(
        sought.used, inlier_probabilities(scaled, X, inlier_weights(pending.config, sought.scales[0])), 0.0
    )
    expected = np.ones(len(off))
    shares = leverages(problem.lines, X, problem.loss, problem.k, spread)
    expected[sought.used] = np.clip(1.0 - shares, 0.0, 1.0)
    residual_evidence = evidence(problem, X, spread)
    noise = NoiseScales(
        residual_evidence.lines_scale * sought.scales[0], residual_evidence.steps_scale * sought.scales[1]
    )
    # Of the bearing against the estimate, as those of a line are the other way round
    off[~behind] *= -1.0
    return BearingResiduals(stated.step, record.rows.sensor[record.rows.seen], off, expected, inlier), noise


def _angles(lines: BearingLinesByStep, record: TargetRecord, pending: Pending, X: Floats) -> Floats:
    """Return (N,) angles between N lines of sight and the target's states, >= 0, in standard deviations.

    Args:
        lines: lines of sight, of the rows of the record that saw the target.
        record: measurements of the target.
        pending: unreleased part of the target's record; gives the sensors.
        X: (T, 4) states x, vx, y, vy.
    """
    rays = rays_of(lines, record, pending.at)
    away = X[lines.step, ::2] - lines.position
    angle = np.arctan2(away[:, 1], away[:, 0]) - np.arctan2(rays.direction[:, 1], rays.direction[:, 0])
    sigma = np.sqrt(np.maximum(rays.a + rays.b / np.maximum(np.sum(away**2, axis=1), 1e-300), 1e-300))
    return np.asarray(np.minimum(np.abs(wrap_angle(angle)), math.pi) / sigma)


UNOBSERVABLE, INFEASIBLE_CONSTRAINTS, NO_PATH = "unobservable", "infeasible_constraints", "no_path"
NOT_CONVERGED, FEW_INLIERS, RIVAL_MODE = "not_converged", "few_inliers", "rival_mode"


def advance(
    pending: Pending, scans: Sequence[Scan], last: bool, watch: Watch = None
) -> tuple[Pending, SmoothedTrajectory]:
    """Add a block of scans to a target's record; return the remaining record and the states released.

    Args:
        pending: record so far, from `begin` or the call before; not changed.
        scans: of this target, after those of the last call; only labelled rows.
        last: no scans follow, so that all states are released.
        watch: called with each iterate of the search for the whole (not of windows that only start it);
            its positions are relative to `pending.origin`.

    Raises:
        InputError: the search fails, as with variances beyond all bounds, or a motion that the method cannot use.
    """
    config = pending.config
    # Gather the record so far, with a state at least every `max_state_gap_s`
    whole = fill(join(pending.record, record_of(scans)), config.max_state_gap_s)
    T = len(whole.t_ns)
    keep = T if last else settled(whole.t_ns, lag_ns(config.lag_s))
    # Obstacles: walls, and views in which the target was not seen
    around = obstacles(whole, pending.at, config, pending.extent, T)
    try:
        # Formulate (Eqs. 1-5 and 8-9), and search for the mode around the obstacles (Eq. 6)
        search = robust_search if config.consensus else plain_search
        if whole.measured is not None:
            search = mixed_search
        sought = search(pending, whole, around, watch)
        # Estimate, with covariances
        found, spread = _estimate(sought, around, pending, stated=whole.measured is not None)
        if sought.biases is not None:
            spread = spread + sought.biases.spread(T)
        spread = with_rivals(found.solution.X, spread, sought.rivals)
    except (ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
        raise InputError(
            f"map: {error}; check sigma_px, u_px and sigma of the bearings, their times, and the settings of the motion"
        ) from error
    # Give out the states that have seen enough after them
    problem, solution, stuck = found.problem, found.solution, sought.stuck
    walls = np.array([o.seen_through is None for o in around], dtype=np.bool_)
    through = np.asarray(found.left_alone[walls].any(axis=0), dtype=np.bool_)
    judged = residuals_and_noise_scales(pending, whole, sought, found)
    out = _smoothed(pending, problem, solution, spread[:keep], whole, stuck, through, judged, sought.rivals)
    if whole.measured is not None:
        out = with_distances(out, pending, whole, found, sought.biases)
    if last:
        return pending._replace(record=EMPTY, X=np.empty((0, 4))), out
    # Marginalise what is given out: it becomes a Gaussian of the first state that is left
    before = summary(problem, solution, keep) if keep else pending.before
    return pending._replace(before=before, record=after(whole, keep), X=solution.X[keep:], scales=sought.scales), out


def _estimate(
    sought: RobustSearchResult, around: tuple[Obstacle, ...], pending: Pending, *, stated: bool = False
) -> tuple[PathsAroundObstacles, Floats]:
    """Return the estimate that is released (mode or invariant estimate), and its covariances (T, 4, 4).

    Args:
        sought: result of the search: the mode.
        around: the obstacles.
        pending: unreleased part of the target's record; gives the settings.
        stated: covariances use the stated noises, whatever residuals show.
    """
    config, extent, mode = pending.config, pending.extent, sought.mode
    honest = config.adapt_noise and config.consensus and config.loss != "square" and not stated
    if not config.in_front_constraint or (config.estimate == "mode" and config.covariance == "hessian"):
        spread = covariance(mode.problem, mode.solution.X)
        return mode, sandwich(mode.problem, mode.solution.X, spread) if honest else spread
    options = Options(config.tolerance * extent, config.max_iterations)
    other = invariant(mode.problem, mode.solution, options, extent)
    estimate = mode.solution.X if config.estimate == "mode" else other.solution.X
    # Spread about the estimate, without lines of sight that are met by chance alone
    centre = other
    if sought.careful is not None:
        centre = invariant(sought.careful.problem, sought.careful.solution, options, extent)
    spread = centre.covariance
    if honest:
        spread = sandwich(centre.problem, centre.solution.X, spread)
    spread = second_moment(estimate, centre.solution.X, spread)
    if config.estimate == "mode":
        solution = mode.solution._replace(iterations=other.solution.iterations)
        return mode._replace(solution=solution), spread
    # It may lead through walls that the mode did not come near.
    flat = sought.problem._replace(lines=other.problem.lines)
    solved = other.problem, other.solution
    found = find_paths_around(flat, solved, around, options, extent, config.wall_clearance, mode.holds, mode.left_alone)
    if len(found.holds) == len(mode.holds):
        return found, spread
    return found, covariance(found.problem, found.solution.X)


def _smoothed(
    pending: Pending,
    problem: TrajectoryProblem,
    solution: Solution,
    spread: Floats,
    record: TargetRecord,
    stuck: Bools,
    through: Bools,
    judged: tuple[BearingResiduals, NoiseScales],
    rivals: tuple[RivalMode, ...],
) -> SmoothedTrajectory:
    """Return the first `len(spread)` states as a smoothed trajectory with diagnostics and flags.

    Args:
        pending: unreleased part of the target's record.
        problem: cost and constraints of a trajectory of T states.
        solution: minimum of the problem.
        spread: (keep, 4, 4) covariances of the states that are released.
        record: measurements of the target at T times.
        stuck: (T,) states with contradictory constraints.
        through: (T,) states inside a wall.
        judged: residuals of the bearings, and noise factors.
        rivals: competing modes.
    """
    X = solution.X
    T, keep = len(X), len(spread)
    observing, seen = np.bincount(record.state, minlength=T), np.bincount(record.state[record.rows.seen], minlength=T)
    sigma = np.sqrt(np.linalg.eigvalsh(spread[:, ::2, ::2])[:, -1])
    vague = sigma > pending.config.max_position_sigma * pending.extent
    fit, noise = judged
    doubted = np.bincount(fit.row, weights=fit.inlier_probability >= 0.5, minlength=T) < 0.5 * seen
    elsewhere = np.any([rival.elsewhere[:keep] for rival in rivals], axis=0) if rivals else np.zeros_like(vague)
    flags = np.select(
        [stuck[:keep], through[:keep], elsewhere, vague, doubted[:keep]],
        [INFEASIBLE_CONSTRAINTS, NO_PATH, RIVAL_MODE, UNOBSERVABLE, FEW_INLIERS],
        "",
    )
    if not solution.converged:
        flags = np.where(flags == "", NOT_CONVERGED, flags)
    order = np.array([0, 2, 1, 3])
    bounds = np.searchsorted(record.state, np.arange(keep + 1)).tolist()
    sensors = record.rows.sensor.tolist()
    saw_it = record.rows.seen.copy()
    saw_it[saw_it] = fit.inlier_probability >= 0.5
    return SmoothedTrajectory(
        t_ns=record.t_ns[:keep],
        xy=X[:keep, ::2] + pending.origin,
        velocity=X[:keep, 1::2],
        covariance=spread[:, order[:, None], order],
        log_likelihood=_scores(problem, X)[:keep],
        n_observing=observing[:keep],
        n_detected=seen[:keep],
        fallback=tuple(flags.tolist()),
        used=tuple(tuple(sensors[a:b]) for a, b in pairwise(bounds)),
        seen_by=tuple(
            tuple(s for s, saw in zip(sensors[a:b], saw_it[a:b].tolist(), strict=True) if saw)
            for a, b in pairwise(bounds)
        ),
        iterations=solution.iterations,
        converged=solution.converged,
        fit=BearingResiduals._make(column[fit.row < keep] for column in fit),
        noise=noise,
        rivals=None
        if record.measured is None
        else tuple(_rival(rival, X, record, keep) for rival in rivals if rival.elsewhere[:keep].any()),
    )


def _rival(rival: RivalMode, X: Floats, record: TargetRecord, keep: int) -> RivalTrajectory:
    """Summarise where a competing mode differs from the best one: number of states, distance, times, excess cost.

    Args:
        rival: the mode; it must differ significantly at one of the first `keep` states.
        X: (T, 4) states of the best mode.
        record: measurements, with the times of the states.
        keep: number of states that are released.
    """
    rows = np.flatnonzero(rival.elsewhere[:keep])
    away = np.hypot(*(rival.X - X)[rows, ::2].T)
    first, last = record.t_ns[rows[[0, -1]]].tolist()
    return RivalTrajectory(rival.excess, len(rows), keep, float(away.max()), first, last)


def _scores(problem: TrajectoryProblem, X: Floats) -> Floats:
    """Return (T,) log likelihoods of each state's bearings at X (T, 4) x, vx, y, vy; NaN without bearings.

    They are under the problem's loss, with the normalisation of a Gaussian.
    """
    lines = problem.lines
    away = X[lines.step, ::2] - lines.position
    d2 = np.maximum(np.einsum("ni,ni->n", away, lines.axis) ** 2, 1e-300)
    variance = lines.c0 + lines.c1 / d2
    each = -losses(lines, X, problem.loss, problem.k) - 0.5 * np.log(2.0 * np.pi * variance)
    total = np.bincount(lines.step, weights=each, minlength=len(X))
    return np.where(np.bincount(lines.step, minlength=len(X)) > 0, total, np.nan)


METHOD = Batch(
    config=MapConfig,
    begin=begin,
    advance=advance,
    started=lambda config: config.start is not None,
    lag_ns=lambda config: lag_ns(config.lag_s),
    forgets_ns=memory_ns,
    occluders=lambda config: OccluderTerms(config.occluder_diameter, config.prior_max_age_s),
    measured=True,
    biases=True,
)
