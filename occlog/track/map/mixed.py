"""Ranges, signal strengths and differences in a trajectory's cost, beside sight lines or without any.

1. *Start.* Extended Kalman filters run along the record, one from each place that the first measurements fit best; they
   pass over what is false.  The most probable one is smoothed (Rauch, Tung and Striebel 1965).
2. *Search.* Each measurement of a distance is replaced by the quadratic term of Gauss and Newton about the trajectory
   found so far, with the probability that it is true as its weight (iteratively reweighted least squares); the search
   for the minimum is repeated until no position moves by a tenth of its standard deviation.

Noises are those that are stated: residuals do not change them.
"""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.sight.distances import Distances, at_own, beliefs
from occlog.errors import UsageError
from occlog.track.interface import Fit, Smoothed
from occlog.track.map.kernels.detours import Detours
from occlog.track.map.kernels.newton_search import covariance
from occlog.track.map.kernels.obstacles import Obstacle
from occlog.track.map.kernels.problem import Hints
from occlog.track.map.kernels.terms import beliefs as line_beliefs

from .consensus import Agreed
from .filtered_start import filtered_start
from .hiding import Told
from .pending import Pending, problem_of
from .record import Record
from .robust import Sought, search_from, still, trust_of
from .search import Watch

ROUNDS = 15
"""How often the search is repeated at most."""


def mixed_search(pending: Pending, record: Record, around: tuple[Obstacle, ...], watch: Watch) -> Sought:
    """Search for the mode with measurements of distances.

    UsageError for a solver that does not take them, or for priors of occluders besides.
    """
    config = pending.config
    if record.occluders:
        raise UsageError(
            "map: priors of occluders and measurements of distances do not go together; leave one out, or use apf"
        )
    if config.solver != "newton":
        raise UsageError(f"map: solver {config.solver} takes bearings alone; use newton with measurements of distances")
    assert record.measured is not None
    problem = problem_of(pending, record)
    here = local(record.measured, pending.origin)
    # Start
    X = filtered_start(problem, record, pending, here)
    trust = trust_of(config, 1.0)
    lines = problem.lines
    believed = np.ones(len(lines.step), dtype=np.bool_)
    if config.loss != "square" and len(lines.step):
        believed = line_beliefs(lines, X, trust) >= 0.5
    # Search with terms about the trajectory found so far
    found: Sought | None = None
    for _ in range(ROUNDS):
        told = Told(np.zeros(len(lines.step)), terms(here, record.measured_state, X, square=config.loss == "square"))
        found = search_from(pending, record, around, watch, Agreed(X, believed, 0.0), (1.0, 1.0), among=told)
        before, X = X, found.mode.solution.X
        believed = found.used if found.believed is None else found.believed
        if still(before, found.mode):
            break
    assert found is not None
    return found


def local(rows: Distances, origin: Floats) -> Distances:
    """The measurements in coordinates about an origin (2,)."""
    return rows._replace(place=rows.place - origin, other=rows.other - origin)


def terms(rows: Distances, state: Ints, X: Floats, *, square: bool) -> Hints:
    """The quadratic terms of Gauss and Newton about a trajectory.

    Args:
        rows: m measurements in the coordinates of X.
        state: (m,) states that they are of, rising.
        X: (T, 4) states.
        square: believe all of them.
    """
    r, g = at_own(rows, X[state][:, ::2])
    w = np.ones(len(r)) if square else beliefs(r, rows.bend)
    bend = w[:, None] * np.column_stack([g[:, 0] ** 2, g[:, 0] * g[:, 1], g[:, 1] ** 2])
    return Hints(state, np.ascontiguousarray(X[state][:, ::2]), -(w * r)[:, None] * g, bend)


def with_distances(out: Smoothed, pending: Pending, record: Record, found: Detours) -> Smoothed:
    """The states with what they say of measurements of distances, which stand in no row of the record.

    Args:
        out: the states that are given out.
        pending: the target.
        record: its record.
        found: the estimate.
    """
    assert record.measured is not None
    keep, X = len(out.t_ns), found.solution.X
    own = record.measured_state < keep
    rows, state = local(record.measured, pending.origin).take(own), record.measured_state[own]
    residual, gradient = at_own(rows, X[state][:, ::2])
    # Residuals, and their variance: 1 less the leverage
    spread = covariance(found.problem, X)[:keep][:, ::2, ::2][state]
    believed = beliefs(residual, rows.bend)
    leverage = believed * np.einsum("ni,nij,nj->n", gradient, spread, gradient)
    fit = Fit(state, rows.station, residual, np.clip(1.0 - leverage, 0.0, 1.0), believed)
    if out.fit is not None:
        joined = Fit._make(np.concatenate(both) for both in zip(out.fit, fit, strict=True))
        fit = Fit._make(column[np.argsort(joined.row, kind="stable")] for column in joined)
    used, saw = [set(u) for u in out.used], [set(s) for s in out.seen_by]
    for t, station, told in zip(state.tolist(), rows.station.tolist(), believed.tolist(), strict=True):
        used[t].add(station)
        if told >= 0.5:
            saw[t].add(station)
    score = np.bincount(state, weights=-0.5 * residual**2 - np.log(np.sqrt(2.0 * np.pi) * rows.sigma), minlength=keep)
    there = np.bincount(state, minlength=keep) > 0
    known = np.where(np.isnan(out.log_likelihood), 0.0, out.log_likelihood)
    return out._replace(
        log_likelihood=np.where(there, known + score, out.log_likelihood),
        n_looked=np.array([len(u) for u in used]),
        n_seen=np.array([len(s) for s in saw]),
        used=tuple(tuple(sorted(u)) for u in used),
        seen_by=tuple(tuple(sorted(s)) for s in saw),
        fit=fit,
        noise=None,
    )
