"""Noise of single sensors: how much their bearings scatter about straight walks of a second.

A position and a velocity are eliminated from the residuals of the bearings of a short window. With M the projection,
the squares of the remaining residuals have the mean sum_j M_ij^2 v_j, with v the variances in units of those that are
stated, and if these are right (v = 1) the covariance 2 M_ij^2: minimum norm quadratic unbiased estimation of variance
components (Rao 1971, J. Multivariate Analysis 1(4)). Targets that turn, and false bearings, make residuals larger in
some windows: the quieter windows count alone, with squares enlarged by what their selection has made them smaller.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import gammainc, gammaincinv

from occlog.array_types import Floats, Ints

QUIET_SHARE = 0.8
"""Share of the windows that count, those with the smallest residuals."""
MIN_WINDOWS, MAX_WINDOWS = 12, 3000
"""Windows that are needed, and windows that are kept, the first ones."""
MIN_FREEDOM = 1.0
"""Degrees of freedom that a window leaves, at least."""
MIN_SIGMAS = 4.5
"""Minimum number of standard errors of an excess variance that is found."""
MAX_VARIANCE = 3.0
"""Variance, in units of the stated one and of that of the other sensors, that matters: standard deviations 1.7 times
too small."""


class WindowScatter(NamedTuple):
    """Residuals of a window after elimination of position and velocity; n sensors have bearings in it."""

    sensor: Ints  # (n,) numbers of the sensors
    squares: Floats  # (n,) sums of squared residuals
    shares: Floats  # (n, n) sums of M_ij^2
    freedom: float


class SensorNoise:
    """Scatter of the bearings of S sensors in short windows, accumulated chunk by chunk."""

    def __init__(self, sensors: int) -> None:
        """Start without residuals of `sensors` sensors."""
        self._sensors = sensors
        self._windows: list[WindowScatter] = []

    def add(self, sensor: Ints, residual: Floats, basis: Floats) -> None:
        """Add a window of N bearings of one target.

        Args:
            sensor: (N,) numbers of the sensors.
            residual: (N,) residuals in standard deviations.
            basis: (N, k) orthonormal basis of the residuals that position and velocity explain.
        """
        freedom = len(sensor) - basis.shape[1]
        if freedom < MIN_FREEDOM or len(self._windows) == MAX_WINDOWS:
            return
        own, at = np.unique(sensor, return_inverse=True)
        of = np.zeros((len(own), len(sensor)))
        of[at, np.arange(len(sensor))] = 1.0
        M = np.eye(len(sensor)) - basis @ basis.T
        self._windows.append(WindowScatter(own, of @ (M @ residual) ** 2, of @ M**2 @ of.T, float(freedom)))

    @property
    def judged(self) -> bool:
        """Return whether there are enough windows for a judgement."""
        return len(self._windows) >= MIN_WINDOWS

    def variances(self) -> tuple[Floats, Floats]:
        """Return (S,) variances of the sensors' bearings in units of the stated ones, and (S,) their standard errors.

        Errors are those if the stated variances are right. Both are NaN for sensors without residuals, and for all
        sensors if there are too few windows.
        """
        if not self.judged:
            return np.full(self._sensors, np.nan), np.full(self._sensors, np.nan)
        total = np.array([float(one.squares.sum()) for one in self._windows])
        freedom = np.array([one.freedom for one in self._windows])
        # Quiet windows, by the probability of their chi-square with the median scale
        scale = float(np.median(total / (2.0 * gammaincinv(0.5 * freedom, 0.5))))
        rank = gammainc(0.5 * freedom, 0.5 * total / max(scale, 1e-300))
        quiet = np.argsort(rank, kind="stable")[: round(QUIET_SHARE * len(rank))].tolist()
        # Mean of chi-square over its mean below a quantile
        quantile = gammaincinv(0.5 * freedom, QUIET_SHARE)
        factor = QUIET_SHARE / gammainc(0.5 * freedom + 1.0, quantile)
        squares, shares = np.zeros(self._sensors), np.zeros((self._sensors, self._sensors))
        for k in quiet:
            one = self._windows[k]
            squares[one.sensor] += factor[k] * one.squares
            shares[np.ix_(one.sensor, one.sensor)] += one.shares
        # Normal equations of the variances
        inverse, known = np.linalg.pinv(shares, hermitian=True), np.diag(shares) > 0.0
        error = np.sqrt(2.0 * np.maximum(np.diag(inverse), 0.0))
        return np.where(known, inverse @ squares, np.nan), np.where(known, error, np.nan)

    def found(self, limit: Floats) -> list[tuple[int, float]]:
        """Return number and variance of each sensor with bearings that scatter more than stated, significantly.

        Targets that move irregularly make those of all sensors scatter: a sensor is compared with the median of the
        others if that is above 1.

        Args:
            limit: (S,) variances that matter, at least `MAX_VARIANCE`.
        """
        variance, error = self.variances()
        out = []
        known = np.flatnonzero(np.isfinite(variance))
        for s in known.tolist():
            usual = max(float(np.median(variance[known[known != s]])), 1.0) if len(known) > 1 else 1.0
            if variance[s] > limit[s] * usual and variance[s] - usual > MIN_SIGMAS * error[s]:
                out.append((s, float(variance[s])))
        return out
