"""Online estimation of the time-correlated position error that all cameras share: variance and correlation time.

Boxes computed from one position (a ground-plane detector's, projected into all views), errors of the body model, and
common errors of calibrations shift the observed position alike in all cameras, for seconds. The disagreement of cameras
does not show it. A posterior over a grid of standard deviations and correlation times is computed from the positions at
successive time steps (`kernels.common_error`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from occlog.array_types import NS, Floats, Ints

from ..config import JipdaConfig
from ..kernels.lasting_errors.common_error import MODELS, MOMENTS, OUTLIER_VARIANCE, advance_bank

SIGMAS_M = (0.007, 0.015, 0.025, 0.04, 0.06, 0.085, 0.12, 0.17)
CORRELATION_TIMES_S = (0.3, 0.75, 2.0, 5.0)
"""Grid of standard deviations per axis [m] and correlation times [s]."""
PRIOR_SIGMA_M = 0.02
"""The prior falls as exp(-s / `PRIOR_SIGMA_M`)."""
EVIDENCE_WEIGHT = 0.3
"""Weight of the log likelihoods: errors of the motion model are common to successive positions, too."""
MODEL_RATES = np.array([[0.0, 0.1, 0.05], [0.05, 0.0, 0.05], [0.3, 0.7, 0.0]])
"""Transition rates between standing, going straight on and manoeuvring [1/s]."""
STANDING_DENSITY_M2 = 2e-4
"""Density of the random walk of who stands [m^2/s]."""
MIN_INTERVAL_S, MAX_INTERVAL_S = 0.2, 2.5
"""Positions closer in time are skipped; after a longer gap a sequence begins again."""


@dataclass(frozen=True)
class CommonErrorStatistics:
    """Posterior of the common position error on a grid of G pairs (standard deviation, correlation time).

    `log` (G,) is the unnormalised log posterior, `square` (G,) the variances per axis, `time` (G,) the correlation
    times [s]; `key`, `t_ns` and `moments` (n, 2, G, 3, 10) are the track keys, last times and filter banks of n people;
    `metre` is the length of a metre in the scene's unit.
    """

    metre: float
    log: Floats  # (G,) log posterior, not normalised
    square: Floats  # (G,) variances
    time: Floats  # (G,) correlation times [s]
    key: Ints  # (n,) people, ascending
    t_ns: Ints  # (n,) of their last positions
    moments: Floats  # (n, 2, G, 3, 10)


def prior_common_error(metre: float) -> CommonErrorStatistics:
    """Return the prior of the common position error on a grid of standard deviations and correlation times.

    `metre` is the length of a metre in the scene's unit.
    """
    sigma = np.repeat(SIGMAS_M, len(CORRELATION_TIMES_S))
    G = len(sigma)
    none = np.zeros(0, dtype=np.int64)
    return CommonErrorStatistics(
        metre=metre,
        log=-sigma / PRIOR_SIGMA_M,
        square=(sigma * metre) ** 2,
        time=np.tile(CORRELATION_TIMES_S, len(SIGMAS_M)),
        key=none,
        t_ns=none,
        moments=np.zeros((0, 2, G, MODELS, MOMENTS)),
    )


def common_error(known: CommonErrorStatistics) -> tuple[float, float]:
    """Return the posterior mean of the common error's variance per axis [scene unit^2], and its correlation time [s].

    The correlation time is the geometric mean weighted by the variance.
    """
    weight = np.exp(known.log - known.log.max())
    weight /= weight.sum()
    square = float(weight @ known.square)
    return square, float(np.exp((weight * known.square) @ np.log(known.time) / square))


def new_variance(common: tuple[float, float], step: float) -> float:
    """Return the conditional variance of a Gauss-Markov error, given its values one time step before and after.

    Args:
        common: variance and correlation time [s] of the error.
        step: length of a time step [s].
    """
    square = math.exp(-2.0 * step / common[1])
    return common[0] * (1.0 - square) / (1.0 + square)


def update_common_error(
    known: CommonErrorStatistics,
    t_ns: int,
    *,
    key: Ints,
    position: Floats,
    noise: Floats,
    config: JipdaConfig,
) -> CommonErrorStatistics:
    """Return the posterior of the common position error, updated with the positions of one time step.

    Args:
        known: posterior before the time step; not changed.
        t_ns: time of the time step.
        key: (n,) track keys, ascending; other people are forgotten.
        position: (n, 2) positions from the boxes of this time step alone; NaN: too few boxes.
        noise: (n,) variances of their white errors per axis.
        config: process noise of the motion models.
    """
    old = np.searchsorted(known.key, key)
    has = old < len(known.key)
    has[has] = known.key[old[has]] == key[has]
    last = np.full(len(key), -1)
    last[has] = known.t_ns[old[has]]
    dt = np.where(has, (t_ns - last) / NS, np.inf)
    used = np.isfinite(position[:, 0]) & (dt > MIN_INTERVAL_S)
    fresh = dt > MAX_INTERVAL_S
    keep = has | used
    moments = np.zeros((len(key), *known.moments.shape[1:]))
    moments[has] = known.moments[old[has]]
    rows = np.flatnonzero(used)
    log = known.log
    if len(rows):
        now = moments[rows]
        log = log + EVIDENCE_WEIGHT * advance_bank(
            now, fresh[rows], np.where(fresh, 0.0, dt)[rows], position[rows], noise[rows], known.square, known.time,
            MODEL_RATES, np.array([
                STANDING_DENSITY_M2 * known.metre**2, config.process_noise_density, config.manoeuvre_noise_density,
            ]), config.sigma_initial_velocity**2, OUTLIER_VARIANCE * known.metre**2,
        )  # fmt: skip
        moments[rows] = now
        last[rows] = t_ns
    return replace(known, log=log - log.max(), key=key[keep], t_ns=last[keep], moments=moments[keep])
