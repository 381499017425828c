"""Method `map`: most probable trajectories from bearings of cameras that need not overlap ([Rahimi]).

The record of a target is solved as a whole, or with `lag_s` in windows that move along:
then a state is given out when that much time has been seen after it, and what came before
the window is summed up in a Gaussian of its first state.

Departures from the paper: times are those of the measurements, at any intervals; variances
hold the errors of the cameras' poses ([Ercan] Eq. 2); the quadratic programs are replaced by
Newton's method inside the constraints (`occlog.track.map.kernels.interior_point.newton_search`); room, walls
and the cameras' ranges are constraints besides.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.errors import InputError
from occlog.scans.scan import Scan
from occlog.track.interface import Batch, Fit, Noise, OccluderTerms, Smoothed
from occlog.track.map.kernels.detours import Detours, find_detours
from occlog.track.map.kernels.evidence import sandwich
from occlog.track.map.kernels.interior_point.newton_search import Options, Solution, covariance
from occlog.track.map.kernels.invariant import invariant, second_moment
from occlog.track.map.kernels.obstacles import Obstacle
from occlog.track.map.kernels.problem import Problem
from occlog.track.map.kernels.terms import losses
from occlog.track.map.kernels.windows import summary
from occlog.track.map.search.descent import Watch
from occlog.track.map.search.pending import Pending, begin, forgets_ns
from occlog.track.map.search.robust import Sought, plain_search, robust_search

from .barriers import obstacles
from .believed_bearings import judge
from .config import MapConfig
from .fixed_lag import lag_ns, settled
from .mixed import mixed_search, with_distances
from .record import EMPTY, Record, after, fill, join, record_of

UNOBSERVABLE, CONTRADICTION, WALL = "unobservable", "contradiction", "wall"
UNFINISHED, DOUBTED = "unfinished", "doubted"


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
    except (ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
        raise InputError(
            f"map: numbers too large or too small to compute with ({error}); look at sigma_px, u_px and sigma of the "
            "bearings, and at the settings of the motion"
        ) from error
    # Give out the states that have seen enough after them
    problem, solution, stuck = found.problem, found.solution, sought.stuck
    walls = np.array([o.seen_through is None for o in around], dtype=np.bool_)
    through = np.asarray(found.left_alone[walls].any(axis=0), dtype=np.bool_)
    judged = judge(pending, whole, sought, found)
    out = _smoothed(pending, problem, solution, spread[:keep], whole, stuck, through, judged)
    if whole.measured is not None:
        out = with_distances(out, pending, whole, found)
    if last:
        return pending._replace(record=EMPTY, X=np.empty((0, 4))), out
    # Marginalise what is given out: it becomes a Gaussian of the first state that is left
    before = summary(problem, solution, keep) if keep else pending.before
    return pending._replace(before=before, record=after(whole, keep), X=solution.X[keep:], scales=sought.scales), out


def _estimate(
    sought: Sought, around: tuple[Obstacle, ...], pending: Pending, *, stated: bool = False
) -> tuple[Detours, Floats]:
    """The estimate that is given out, and its covariances (T, 4, 4).

    Args:
        sought: the mode.
        around: the obstacles.
        pending: the target.
        stated: covariances are made with the stated noises, whatever residuals tell.
    """
    config, extent, mode = pending.config, pending.extent, sought.mode
    honest = config.adapt and config.consensus and config.loss != "square" and not stated
    if not config.front or (config.estimate == "mode" and config.covariance == "hessian"):
        spread = covariance(mode.problem, mode.solution.X)
        return mode, sandwich(mode.problem, mode.solution.X, spread) if honest else spread
    options = Options(config.tolerance * extent, config.iterations)
    other = invariant(mode.problem, mode.solution, options, extent)
    estimate = mode.solution.X if config.estimate == "mode" else other.solution.X
    # Spread about the estimate, without sight lines that are met by chance alone
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
    found = find_detours(flat, solved, around, options, extent, config.clearance, mode.holds, mode.left_alone)
    if len(found.holds) == len(mode.holds):
        return found, spread
    return found, covariance(found.problem, found.solution.X)


def _smoothed(
    pending: Pending,
    problem: Problem,
    solution: Solution,
    spread: Floats,
    record: Record,
    stuck: Bools,
    through: Bools,
    judged: tuple[Fit, Noise],
) -> Smoothed:
    """The first states, as many as there are covariances, as they are given out."""
    X = solution.X
    T, keep = len(X), len(spread)
    looked, seen = np.bincount(record.state, minlength=T), np.bincount(record.state[record.rows.seen], minlength=T)
    sigma = np.sqrt(np.linalg.eigvalsh(spread[:, ::2, ::2])[:, -1])
    vague = sigma > pending.config.vague * pending.extent
    fit, noise = judged
    doubted = np.bincount(fit.row, weights=fit.believed >= 0.5, minlength=T) < 0.5 * seen
    flags = np.select(
        [stuck[:keep], through[:keep], vague, doubted[:keep]], [CONTRADICTION, WALL, UNOBSERVABLE, DOUBTED], ""
    )
    if not solution.converged:
        flags = np.where(flags == "", UNFINISHED, flags)
    order = np.array([0, 2, 1, 3])
    bounds = np.searchsorted(record.state, np.arange(keep + 1)).tolist()
    sensors = record.rows.sensor.tolist()
    saw_it = record.rows.seen.copy()
    saw_it[saw_it] = fit.believed >= 0.5
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
            tuple(s for s, saw in zip(sensors[a:b], saw_it[a:b].tolist(), strict=True) if saw)
            for a, b in pairwise(bounds)
        ),
        iterations=solution.iterations,
        converged=solution.converged,
        fit=Fit._make(column[fit.row < keep] for column in fit),
        noise=noise,
    )


def _scores(problem: Problem, X: Floats) -> Floats:
    """(T,) log likelihood of the measurements of each state: of Gaussian errors, by the loss."""
    lines = problem.lines
    away = X[lines.step, ::2] - lines.place
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
    forgets_ns=forgets_ns,
    occluders=lambda config: OccluderTerms(config.occluder_diameter, config.prior_max_age_s),
    measured=True,
)
