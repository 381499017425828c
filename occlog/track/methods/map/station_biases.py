"""Constant errors of the ranges of stations, estimated with a trajectory: antenna delays, offsets of cables and clocks.

A range of station s is |x - p_s| + b_s and noise, b_s Gaussian about 0.  With A the Hessian of the trajectory's cost, B
its derivative by the biases and D theirs, the Newton step of both is that of a bordered system,

    P = (D - B' A^-1 B)^-1,  b <- b - P g_b,  dx / db = -A^-1 B

(Triggs et al. 2000, Bundle adjustment: a modern synthesis, Sec. 6.1) at a trajectory that is the minimum for the biases
so far.  P is the covariance of the biases, and adds (dx / db) P (dx / db)' to that of the states.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.filtering.likelihood.distances import (
    DELAYED,
    DIFFERENCE,
    RangeMeasurements,
    residuals_at_own_position,
    score_and_information,
)
from occlog.track.interface import StationBias

from .kernels.interior_point import derivatives, factor_rows, solve
from .kernels.problem import TrajectoryProblem

SETTLED_SIGMAS = 0.1
"""Steps of all biases, in their standard deviations, at which they have settled."""


class StationBiases(NamedTuple):
    """Constant biases of the ranges of S stations, estimated with a trajectory of T states.

    `station` (S,) are station numbers, ascending, `bias` (S,) by how much their ranges are too long, `covariance`
    (S, S); `step` (S,) is the last change, `moves` (T, 4, S) are the derivatives of the states by the biases, and
    `settled` whether the last two steps were small.
    """

    station: Ints  # (S,) numbers, ascending
    bias: Floats  # (S,) by how much ranges are too long
    covariance: Floats  # (S, S)
    step: Floats  # (S,) last change, of which ranges are taken to be uncertain
    moves: Floats  # (T, 4, S) derivatives of the states
    settled: bool = False  # the last two steps were small

    def corrected(self, rows: RangeMeasurements) -> RangeMeasurements:
        """Return the measurements with the biases subtracted from ranges, and the last change as additional noise."""
        own, ranges = self._of(rows)
        value, sigma = rows.value.copy(), rows.sigma.copy()
        value[ranges] -= self.bias[own]
        sigma[ranges] = np.hypot(sigma[ranges], self.step[own])
        return rows._replace(value=value, sigma=sigma)

    def cost(self, rows: RangeMeasurements) -> float:
        """Return the negative log prior of the biases, up to a constant; its standard deviation is `rows.bias`."""
        return 0.5 * float((self.bias**2).sum()) / rows.bias**2

    def updated(
        self, rows: RangeMeasurements, state: Ints, problem: TrajectoryProblem, before: Floats, X: Floats
    ) -> StationBiases:
        """Return the biases after a Newton step, no longer than the previous step.

        Args:
            rows: m measurements without correction, in the coordinates of X.
            state: (m,) index of each one's time.
            problem: cost and constraints of T states, with distance measurements as quadratic terms.
            before: (T, 4) states about which the terms were linearised.
            X: (T, 4) states x, vx, y, vy at the minimum of the problem.
        """
        own, ranges = self._of(rows)
        here, at = self.corrected(rows).take(ranges), state[ranges]
        r, g = residuals_at_own_position(here, before[at][:, ::2])
        pull = score_and_information(r, here.errors)
        # Slopes of the quadratic terms at the minimum
        slopes = pull.slope - pull.weight * np.einsum("ni,ni->n", g, (X - before)[at][:, ::2])
        S, T = len(self.station), len(X)
        border = np.zeros((T, 4, S))
        cell = at * S + own
        for axis in (0, 1):
            bent = pull.weight * g[:, axis] / here.sigma
            border[:, 2 * axis] = np.bincount(cell, bent, minlength=T * S).reshape(T, S)
        R, N = np.empty((T, 4, 4)), np.empty((T, 4, 4))
        factor_rows(problem.steps, derivatives(problem, X, 0.0)[1], R, N)
        moves, column = np.empty((T, 4, S)), np.empty((T, 4))
        for s in range(S):
            solve(R, N, np.ascontiguousarray(-border[:, :, s]), column)
            moves[:, :, s] = column
        D = np.diag(np.bincount(own, pull.weight / here.sigma**2, minlength=S) + rows.bias**-2)
        schur = D + np.einsum("tis,tik->sk", border, moves)
        size, axes = np.linalg.eigh(0.5 * (schur + schur.T))
        # Not less certain than the prior, whatever rounding and rejected ranges have left
        P = (axes / np.maximum(size, rows.bias**-2)) @ axes.T
        slope = self.bias / rows.bias**2 - np.bincount(own, slopes / here.sigma, minlength=S)
        step = -P @ slope
        step *= min(1.0, float((np.abs(self.step) / np.maximum(np.abs(step), 1e-300)).max()))
        small = np.maximum(np.abs(step), np.abs(self.step)) <= SETTLED_SIGMAS * np.sqrt(np.diag(P))
        return StationBiases(self.station, self.bias + step, P, step, moves, bool(small.all()))

    def spread(self, keep: int) -> Floats:
        """Return what the uncertain biases add to the covariances of the first `keep` states, (keep, 4, 4)."""
        return np.asarray(np.einsum("tis,sk,tjk->tij", self.moves[:keep], self.covariance, self.moves[:keep]))

    def stated(self) -> tuple[StationBias, ...]:
        """Return station number, bias and standard error of each station."""
        error = np.sqrt(np.diag(self.covariance))
        columns = (self.station.tolist(), self.bias.tolist(), error.tolist())
        return tuple(StationBias(*one) for one in zip(*columns, strict=True))

    def _of(self, rows: RangeMeasurements) -> tuple[Ints, Bools]:
        """Return, for each range, the index of its station in `station`; and (m,) which measurements are ranges."""
        ranges = biased(rows)
        return np.searchsorted(self.station, rows.station[ranges]), ranges


def biased(rows: RangeMeasurements) -> Bools:
    """Return a mask (m,) of measurements that are ranges, which a bias of their station may falsify."""
    return np.asarray(DELAYED[rows.kind] & (rows.kind != DIFFERENCE))


def begin_biases(rows: RangeMeasurements, T: int) -> StationBiases | None:
    """Return biases of 0 with their prior uncertainty, for T states.

    None if the prior standard deviation is 0 or there are no ranges.
    """
    station = np.unique(rows.station[biased(rows)])
    S = len(station)
    if not rows.bias or not S:
        return None
    prior = np.full(S, rows.bias)
    return StationBiases(station, np.zeros(S), np.diag(prior**2), prior, np.zeros((T, 4, S)))
