"""Ranges, signal strengths and differences in a trajectory's cost, with or without lines of sight.

1. *Start.*  Paths through the modes that the measurements of a second have, those that turn least
(`occlog.track.methods.map.search.window_modes`).  The search begins from each, and the cheapest trajectory is taken.
One that is nearly as cheap and significantly elsewhere is a rival: covariances hold both, by their posterior odds.
2. *Search.* Each measurement of a distance is replaced by the quadratic term of Gauss and Newton about the trajectory
   found so far, with the slope and the weight that it has there
   (`occlog.filtering.likelihood.distances.score_and_information`, iteratively reweighted least squares); the search
   for the minimum is repeated until no position moves by a tenth of its standard deviation.  Where most measurements
   of a while are rejected the path may be lost there: then the search is repeated with measurements that are
   blunter initially, and the better one of the two is kept.

Noises are those that are stated: residuals do not change them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.errors import UsageError, option
from occlog.filtering.likelihood.distances import (
    RangeMeasurements,
    inlier_probability,
    log_density,
    residuals_at_own_position,
    score_and_information,
)
from occlog.track.interface import BearingResiduals, SmoothedTrajectory

from .kernels.interior_point import covariance
from .kernels.invariant import second_moment
from .kernels.paths_around_obstacles import Obstacle, PathsAroundObstacles
from .kernels.problem import QuadraticPriors
from .kernels.terms import priors_cost
from .occlusion import OccluderCostTerms
from .record import TargetRecord
from .search.problem_of_record import Pending, problem_of
from .search.robust import RivalMode, RobustSearchResult, Watch, has_converged, search_from
from .search.start import ConsensusPath
from .search.window_modes import mode_starts
from .station_biases import StationBiases, begin_biases

ROUNDS = 15
"""How often the search is repeated at most."""
WIDE = (0.3, 0.1, 0.1, 0.03, 0.03, 0.01)
"""Shares of the extent by which measurements are blunter while a lost path is sought."""
RIVAL_LOG_ODDS = 4.6
"""A mode of which the negative log posterior is higher by at most this (odds of 1 to 100) is a rival."""
RIVAL_SIGMAS = 3.0
"""Distance from a mode, in its standard deviations, at which another one is elsewhere."""
IN_A_ROW = 12
"""A path is lost where most of this number of successive measurements are rejected."""


def mixed_search(
    pending: Pending, record: TargetRecord, around: tuple[Obstacle, ...], watch: Watch
) -> RobustSearchResult:
    """Search for the most probable trajectory with distance measurements, with or without bearings.

    Args:
        pending: unreleased part of the target's record: settings, sensors, and the prior of its first state.
        record: measurements of the target at T times.
        around: obstacles that the trajectory must not run through.
        watch: called with each iterate of the search; None: not.

    Returns:
        The best mode, with its rivals and the biases of stations.

    Raises:
        UsageError: the solver does not take distances, or they are combined with priors of occluders, or biases of
            ranges are to be estimated with a lag.
    """
    config = pending.config
    if record.occluders:
        raise UsageError(
            "map: priors of occluders and measurements of distances do not go together; leave one out, or use apf",
            id="conflicting-options",
        )
    if config.solver != "newton":
        raise UsageError(
            f"map: solver {config.solver} takes bearings alone; use newton with measurements of distances",
            id="not-applicable",
        )
    assert record.measured is not None
    here = local(record.measured, pending.origin)
    # Search from each of the most probable paths: room, walls and the motion in full tell modes apart
    biases = begin_biases(here, len(record.t_ns))
    if biases is not None and config.lag_s is not None:
        raise UsageError(
            f"map: biases of ranges are estimated from whole records; leave {option('lag')} or "
            f"{option('range_bias')} out",
            id="conflicting-options",
        )
    seen = here if biases is None else biases.corrected(here)
    paths = mode_starts(problem_of(pending, record), record, pending, seen)
    modes = [_settled(here, path, pending, record, around, watch) for path in paths]
    costs = [_total(here, record, mode) for mode in modes]
    blurred = modes[int(np.argmin(costs))]
    seen = here if blurred.biases is None else blurred.biases.corrected(here)
    if config.loss != "square" and _lost(seen, blurred.mode.solution.X[record.measured_state]):
        # Nothing pulls a lost path back: again, with measurements that reach as far as it may be
        for share in WIDE:
            blurred = _once(seen, _path(blurred), pending, record, around, watch, share * pending.extent)
        modes.append(_settled(here, _path(blurred), pending, record, around, watch))
        costs.append(_total(here, record, modes[-1]))
    return _with_rivals_of(modes, costs)


def _with_rivals_of(modes: list[RobustSearchResult], costs: list[float]) -> RobustSearchResult:
    """Return the mode of least cost with its rivals: modes nearly as probable and significantly elsewhere.

    `costs` are the negative log posteriors of `modes`; a rival is at most `RIVAL_LOG_ODDS` above the least.
    """
    order = np.argsort(costs, kind="stable").tolist()
    best, X = modes[order[0]], modes[order[0]].mode.solution.X
    rivals: list[RivalMode] = []
    taken = [(X, covariance(best.mode.problem, X))] if len(modes) > 1 else []
    for k in order[1:]:
        if costs[k] > costs[order[0]] + RIVAL_LOG_ODDS:
            break
        other = modes[k].mode.solution.X
        elsewhere = [_significantly_away(other, *one) for one in taken]
        if all(away.any() for away in elsewhere):
            taken.append((other, covariance(modes[k].mode.problem, other)))
            rivals.append(RivalMode(*taken[-1], costs[k] - costs[order[0]], elsewhere[0]))
    with_them: RobustSearchResult = best._replace(rivals=tuple(rivals))
    return with_them


def _significantly_away(other: Floats, X: Floats, spread: Floats) -> Bools:
    """Return a mask (T,): positions of the states `other` differ from those of `X` by more than `RIVAL_SIGMAS`.

    Both are (T, 4) states x, vx, y, vy; `spread` (T, 4, 4) are the covariances of X.
    """
    away = (other - X)[:, ::2]
    away2 = np.einsum("ti,tij,tj->t", away, np.linalg.inv(spread[:, ::2, ::2]), away)
    return np.asarray(away2 > RIVAL_SIGMAS**2)


def with_rivals(X: Floats, spread: Floats, rivals: Sequence[RivalMode]) -> Floats:
    """Return second moments (T, 4, 4) about the states X (T, 4) of a mixture of the mode and its rivals.

    `spread` (T, 4, 4) are the mode's covariances, returned without rivals. Modes are weighted by exp(-cost) alone, not
    by their volume: where the motion is smoother than stated, as it usually is, volumes prefer those that the
    measurements leave more room, and are wrong.
    """
    if not rivals:
        return spread
    weight = np.exp([-rival.excess for rival in rivals])
    total, out = 1.0 + weight.sum(), spread.copy()
    for w, rival in zip(weight / total, rivals, strict=True):
        out += w * (second_moment(X, rival.X, rival.spread) - spread)
    return out


def _total(rows: RangeMeasurements, record: TargetRecord, found: RobustSearchResult) -> float:
    """Return the cost of a search result with exact distance terms, and with that of rejected bearings included.

    `rows` are the distance measurements of the record, in the coordinates of the search.
    """
    return _cost(rows, record.measured_state, found) + found.score - found.mode.solution.cost


def _settled(
    rows: RangeMeasurements,
    path: ConsensusPath,
    pending: Pending,
    record: TargetRecord,
    around: tuple[Obstacle, ...],
    watch: Watch,
) -> RobustSearchResult:
    """Iterate the search from a path until positions and station biases converge, at most `ROUNDS` times.

    Args:
        rows: distance measurements in the coordinates of the search.
        path: where the search begins, and the bearings that agree with it.
        pending: unreleased part of the target's record.
        record: measurements of the target.
        around: obstacles.
        watch: called with each iterate; None: not.
    """
    biases = begin_biases(rows, len(record.t_ns))
    for _ in range(ROUNDS):
        found = _once(rows if biases is None else biases.corrected(rows), path, pending, record, around, watch)
        settled = has_converged(path.X, found.mode)
        if biases is not None:
            biases = biases.updated(rows, record.measured_state, found.mode.problem, path.X, found.mode.solution.X)
            settled &= biases.settled
        if settled:
            break
        path = _path(found)
    return found._replace(biases=biases)


def _once(
    rows: RangeMeasurements,
    path: ConsensusPath,
    pending: Pending,
    record: TargetRecord,
    around: tuple[Obstacle, ...],
    watch: Watch,
    wide: float = 0.0,
) -> RobustSearchResult:
    """Search once, with distance measurements linearised about a path.

    Args:
        rows: distance measurements in the coordinates of the search.
        path: where the search begins, and the bearings that agree with it.
        pending: unreleased part of the target's record.
        record: measurements of the target.
        around: obstacles.
        watch: called with each iterate; None: not.
        wide: standard deviation of an additional position error by which measurements are widened [scene unit].
    """
    square = pending.config.loss == "square"
    hints = terms(rows, record.measured_state, path.X, square=square, wide=wide)
    occlusion = OccluderCostTerms(np.zeros(len(path.agree)), hints)
    return search_from(pending, record, around, watch, path, (1.0, 1.0), among=occlusion)


def _path(found: RobustSearchResult) -> ConsensusPath:
    """Return a search result as a start: its states, and the bearings more probably true than false."""
    return ConsensusPath(found.mode.solution.X, found.used if found.inlier is None else found.inlier, 0.0)


def _lost(rows: RangeMeasurements, X: Floats) -> bool:
    """Return whether the path is lost: most of some `IN_A_ROW` successive distance measurements are rejected.

    `X` (m, 4) is the state x, vx, y, vy at the time of each of the m measurements `rows`.
    """
    doubted = inlier_probability(residuals_at_own_position(rows, X[:, ::2])[0], rows.errors) < 0.5
    several = min(IN_A_ROW, len(doubted))
    return bool(several) and bool((np.convolve(doubted, np.ones(several), "valid") > 0.5 * several).any())


def _cost(rows: RangeMeasurements, state: Ints, found: RobustSearchResult) -> float:
    """Return the cost of a search result with its linearised distance terms replaced by exact ones.

    `rows` are m distance measurements, `state` (m,) the index of each one's time.
    """
    assert found.hints is not None
    assert found.hints.hints is not None
    X = found.mode.solution.X
    prior = 0.0
    if found.biases is not None:
        rows, prior = found.biases.corrected(rows), found.biases.cost(rows)
    own = log_density(residuals_at_own_position(rows, X[state][:, ::2])[0], rows.errors)
    return float(found.mode.solution.cost - priors_cost(found.hints.hints, X) - own.sum() + prior)


def local(rows: RangeMeasurements, origin: Floats) -> RangeMeasurements:
    """Return distance measurements with the station positions relative to `origin` (2,)."""
    return rows._replace(position=rows.position - origin, other=rows.other - origin)


def terms(rows: RangeMeasurements, state: Ints, X: Floats, *, square: bool, wide: float = 0.0) -> QuadraticPriors:
    """Return quadratic terms (Gauss-Newton) that replace distance measurements near a trajectory.

    Args:
        rows: m measurements in the coordinates of X.
        state: (m,) index of each one's time, ascending.
        X: (T, 4) states x, vx, y, vy about which they are linearised.
        square: use the square loss, in which all measurements count as true; else they are reweighted.
        wide: standard deviation of an additional position error by which measurements are widened.
    """
    r, g = residuals_at_own_position(rows, X[state][:, ::2])
    variance = 1.0 + wide**2 * (g**2).sum(axis=1)
    root = np.sqrt(variance)
    r, g = r / root, g / root[:, None]
    slope, w = (r, np.ones(len(r))) if square else score_and_information(r, rows.errors.widened(variance))[:2]
    bend = w[:, None] * np.column_stack([g[:, 0] ** 2, g[:, 0] * g[:, 1], g[:, 1] ** 2])
    return QuadraticPriors(state, np.ascontiguousarray(X[state][:, ::2]), -slope[:, None] * g, bend)


def with_distances(
    out: SmoothedTrajectory,
    pending: Pending,
    record: TargetRecord,
    found: PathsAroundObstacles,
    biases: StationBiases | None,
) -> SmoothedTrajectory:
    """Return the smoothed trajectory with residuals, likelihoods and counts of its distance measurements added.

    Args:
        out: the states that are released, with diagnostics of bearings.
        pending: unreleased part of the target's record.
        record: measurements of the target.
        found: the estimate, of all states.
        biases: estimated biases of the ranges of stations; None: none are estimated.
    """
    assert record.measured is not None
    keep, X = len(out.t_ns), found.solution.X
    own = record.measured_state < keep
    rows, state = local(record.measured, pending.origin).take(own), record.measured_state[own]
    if biases is not None:
        rows = biases.corrected(rows)
    residual, gradient = residuals_at_own_position(rows, X[state][:, ::2])
    # Residuals, and their variance: 1 less the leverage
    spread = covariance(found.problem, X)[:keep]
    if biases is not None:
        spread = spread + biases.spread(keep)
    spread = spread[:, ::2, ::2][state]
    inlier = inlier_probability(residual, rows.errors)
    leverage = inlier * np.einsum("ni,nij,nj->n", gradient, spread, gradient)
    fit = BearingResiduals(state, rows.station, residual, np.clip(1.0 - leverage, 0.0, 1.0), inlier)
    if out.fit is not None:
        joined = BearingResiduals._make(np.concatenate(both) for both in zip(out.fit, fit, strict=True))
        fit = BearingResiduals._make(column[np.argsort(joined.row, kind="stable")] for column in joined)
    used, saw = [set(u) for u in out.used], [set(s) for s in out.seen_by]
    for t, station, weight in zip(state.tolist(), rows.station.tolist(), inlier.tolist(), strict=True):
        used[t].add(station)
        if weight >= 0.5:
            saw[t].add(station)
    score = np.bincount(state, weights=-0.5 * residual**2 - np.log(np.sqrt(2.0 * np.pi) * rows.sigma), minlength=keep)
    there = np.bincount(state, minlength=keep) > 0
    known = np.where(np.isnan(out.log_likelihood), 0.0, out.log_likelihood)
    return out._replace(
        log_likelihood=np.where(there, known + score, out.log_likelihood),
        n_observing=np.array([len(u) for u in used]),
        n_detected=np.array([len(s) for s in saw]),
        used=tuple(tuple(sorted(u)) for u in used),
        seen_by=tuple(tuple(sorted(s)) for s in saw),
        fit=fit,
        noise=None,
        biases=() if biases is None else biases.stated(),
    )
