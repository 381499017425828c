"""Online estimation of the errors of position sensors: variance and time correlation, learned from innovations.

A position of a sensor is z = p + b + g + w: the target's position p, a sensor error b correlated in time (exp(-t /
tau)), the gait displacement g about a straight path, and white noise w. Ground-plane detectors, lidar clusters and
radar seldom state the sizes of b and w.

A bank of Kalman filters follows each target that is surely detected, one for each combination of total variance, share
of b in it, tau and process noise; the likelihoods of the innovations of all targets are the evidence for the
combinations (multiple models: Bar-Shalom, Li and Kirubarajan 2001, Sec. 11.6). The evidence is tempered, since no
combination is exact and successive innovations are dependent. A stated variance is used as it is; its scale is
estimated for the verdict.

If there are position sensors only, b is the common error of the filter's state. With cameras, b and g are added to the
noise of positions as white noise of equal power at frequency 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.core.numerics.jit import kernel

from ..config import JipdaConfig
from ..interface import PositionSource

SIGMA_RATIOS = np.array([0.2, 0.3, 0.45, 0.7, 1.0, 1.5, 2.2, 3.3, 5.0])
"""Total standard deviations in the bank, as multiples of the stated or initial one."""
LASTING_SHARES = np.array([0.0, 0.25, 0.5, 0.75, 0.9, 0.97])
"""Shares of the total variance that are correlated in time."""
CORRELATION_TIMES_S = np.array([1.0, 2.0])
PROCESS_NOISE_RATIOS = np.array([1.0 / 3.0, 1.0, 3.0])
"""Process noises in the bank, as multiples of that of the walk."""
GAIT_SIGMA_M, GAIT_CORRELATION_S = 0.04, 0.5
"""Standard deviation of the position about a straight walk [m], and its correlation time."""
TEMPERATURE = 8.0
"""The evidence of this many innovations counts once."""
PRIOR_LOG_SIGMA = 0.5
"""Standard deviation of the logarithm of an unstated standard deviation about the setting."""
MAX_INNOVATION_CHI2 = 10.0
"""Clipping of squared normalised innovations: manoeuvres and wrong associations are no measurement noise."""
MAX_GAP_S = 3.0
"""A target that is not detected for longer starts again."""
PERIOD_LEARNING_RATE = 0.05
"""Weight of a new interval in the mean time between frames."""
MANOEUVRE_DENSITY, MAX_MANOEUVRE_S = 1.0, 1.0
"""Spectral density of the acceleration of sudden turns and stops [m^2/s^3]; time that they last at most."""
WALK_RATIO = 2.0
"""Process noise of a walk that positions alone show, relative to the setting: no body says who turns."""
MIN_INNOVATIONS = 100
"""Minimum number of innovations for a verdict on a stated standard deviation."""
DIMENSIONS = 4
"""States of the bank per axis: position and velocity of the walk, b and g."""


@dataclass(frozen=True)
class ErrorBank:
    """Bank of Kalman filters of one position sensor: G combinations of error parameters, N targets.

    Parameters (G,): `total` variance as a multiple of the stated one (or of the setting's), `share` of it correlated in
    time, correlation time `tau` [s], process noise `q`; `evidence` (G,) is the log-likelihood of all `innovations`. Per
    target: key, time and number of positions, `mean` (N, G, 4, 2) of position, velocity, sensor error b and gait g on
    both axes, and `covariance` (N, G, 4, 4). Also the counts of stated variances, and the mean time between frames [s].
    """

    total: Floats  # (G,) total variance as a multiple of the stated one, or of the setting's
    share: Floats  # (G,) of it, correlated in time
    tau: Floats  # (G,) [s]
    q: Floats  # (G,) process noise
    evidence: Floats  # (G,) log-likelihood of all innovations
    innovations: int
    key: Ints  # (N,) targets
    t_ns: Ints  # (N,) of the last position of each
    steps: Ints  # (N,) positions of each
    mean: Floats  # (N, G, 4, 2)
    covariance: Floats  # (N, G, 4, 4)
    stated: Floats  # (3,) sum of the mean variances of stated positions, their number, and that of the others
    frame_ns: int = -1  # time of the last frame; -1: none
    period_s: float = math.inf  # mean time between frames


@dataclass(frozen=True)
class PositionErrors:
    """Error models of all position sensors, which are the last of the filter's views; one bank each.

    `first` is the index of the first sensor among the views, `alone` whether there is no camera, `sigma` the initial
    standard deviation per axis and `gait_variance` the variance of the position about a straight walk, in the scene's
    unit.
    """

    first: int  # index of the first source among the views
    alone: bool  # there is no camera
    sigma: float  # initial standard deviation, in the scene's unit
    gait_variance: float
    banks: tuple[ErrorBank, ...]


@dataclass(frozen=True)
class PositionNoise:
    """Noise model of a position sensor: white noise, and an error b that is correlated in time.

    `total` is the total variance per axis as a multiple of the stated one (or of the setting's), `white` the share of
    it that is white, `lasting` the variance of b [scene unit^2] and `tau` its correlation time [s].
    """

    white: float  # share of the total variance that is white
    total: float  # total variance as a multiple of the stated one, or of the setting's
    lasting: float  # variance of b
    tau: float  # of b [s]


def prior_position_errors(views: Sequence[object], metre: float, config: JipdaConfig) -> PositionErrors:
    """Return the error models before any position, for the position sensors among the views.

    `metre` is the length of a metre in the scene's unit.
    """
    sources = [each for each in views if isinstance(each, PositionSource)]
    return PositionErrors(
        first=len(views) - len(sources),
        alone=len(sources) == len(views),
        sigma=config.position_sigma,
        gait_variance=(GAIT_SIGMA_M * metre) ** 2,
        banks=tuple(_empty_bank(config) for _ in sources),
    )


def _empty_bank(config: JipdaConfig) -> ErrorBank:
    """Return a sensor's filter bank without targets: all combinations of the parameter grids, zero evidence."""
    combinations = [
        (ratio**2, share, tau, q * config.process_noise_density)
        for ratio in SIGMA_RATIOS
        for share in LASTING_SHARES
        for tau in (CORRELATION_TIMES_S if share else CORRELATION_TIMES_S[:1])
        for q in PROCESS_NOISE_RATIOS
    ]
    total, share, tau, q = np.array(combinations).T
    G, none = len(total), np.zeros(0, dtype=np.int64)
    return ErrorBank(
        total=total,
        share=share,
        tau=tau,
        q=q,
        evidence=np.zeros(G),
        innovations=0,
        key=none,
        t_ns=none,
        steps=none,
        mean=np.zeros((0, G, DIMENSIONS, 2)),
        covariance=np.zeros((0, G, DIMENSIONS, DIMENSIONS)),
        stated=np.zeros(3),
    )


def is_stated(bank: ErrorBank) -> bool:
    """Return whether the sensor states the variance of most of its positions."""
    return bool(bank.stated[1] > bank.stated[2])


def _weights(bank: ErrorBank) -> Floats:
    """Return (G,) posterior probabilities of the parameter combinations of a sensor's filter bank.

    If the sensor states no variances, the prior of the total standard deviation is log-normal about the setting.
    """
    log = bank.evidence / TEMPERATURE
    if not is_stated(bank):
        # Shares and times that have more combinations are not more probable
        log = log - 0.5 * (0.5 * np.log(bank.total) / PRIOR_LOG_SIGMA) ** 2
    weight = np.exp(log - log.max())
    return np.asarray(weight / weight.sum())


def position_noise_of(errors: PositionErrors, c: int) -> PositionNoise:
    """Return the posterior mean noise model of the position sensor with index `c` among the views.

    If it states variances, the multiple of them is fixed at 1, and the rest is averaged under this condition.
    """
    bank = errors.banks[c - errors.first]
    weight = _weights(bank)
    base = errors.sigma**2
    if is_stated(bank):
        base = float(bank.stated[0] / bank.stated[1])
        log = np.where(bank.total == 1.0, bank.evidence / TEMPERATURE, -np.inf)
        weight = np.exp(log - log.max())
        weight = weight / weight.sum()
    total, lasting = float(weight @ bank.total), float(weight @ (bank.total * bank.share))
    rate = float(weight @ (bank.total * bank.share / bank.tau))
    tau = lasting / rate if rate > 0.0 else float(CORRELATION_TIMES_S[0])
    return PositionNoise(1.0 - lasting / total, total, base * lasting, tau)


def learned_sigma_ratio(errors: PositionErrors, c: int) -> float:
    """Return the ratio of the learned to the stated standard deviation of position sensor `c`.

    `c` is its index among the views. NaN if it states none, or with fewer than `MIN_INNOVATIONS` innovations.
    """
    bank = errors.banks[c - errors.first]
    if not is_stated(bank) or bank.innovations < MIN_INNOVATIONS:
        return math.nan
    return float(math.exp(0.5 * (_weights(bank) @ np.log(bank.total))))


def learned_sigma(errors: PositionErrors, c: int) -> float:
    """Return the standard deviation per axis of positions of sensor `c`, stated or learned [scene unit].

    `c` is the sensor's index among the views.
    """
    bank, noise = errors.banks[c - errors.first], position_noise_of(errors, c)
    base = float(bank.stated[0] / bank.stated[1]) if is_stated(bank) else errors.sigma**2
    return math.sqrt(noise.total * base)


def position_covariances(errors: PositionErrors, c: int, stated: Floats) -> Floats:
    """Return measurement covariances (n, 3) xx, xy, yy of n positions of a sensor for the update [scene unit^2].

    With position sensors alone it is the white part (the correlated error is in the filter's state); with cameras, the
    correlated error and the gait are included as white noise of equal power.

    Args:
        errors: error models of all position sensors.
        c: index of the sensor among the views.
        stated: (n, 3) covariances that the sensor states; NaN: not stated.
    """
    noise, bank = position_noise_of(errors, c), errors.banks[c - errors.first]
    known: Bools = np.asarray(np.isfinite(stated).all(axis=1))
    unit = errors.sigma**2 * np.array([1.0, 0.0, 1.0])
    out = np.where(known[:, None], stated, unit if is_stated(bank) else noise.total * unit)
    out = out * noise.white
    if not errors.alone:
        # White noise of equal power at zero frequency
        power = noise.lasting / math.tanh(0.5 * bank.period_s / noise.tau)
        power += errors.gait_variance / math.tanh(0.5 * bank.period_s / GAIT_CORRELATION_S)
        out = out + power * np.array([1.0, 0.0, 1.0])
    return np.asarray(out)


def manoeuvre_variance(errors: PositionErrors, c: int, metre: float) -> float:
    """Return the variance per axis [scene unit^2] of the prediction error by a manoeuvre between two frames.

    `c` is the index of the sensor among the views; 0 for a camera. `metre` is the length of a metre in the scene's
    unit.
    """
    if c < errors.first:
        return 0.0
    period = errors.banks[c - errors.first].period_s
    return MANOEUVRE_DENSITY * metre**2 * min(period, MAX_MANOEUVRE_S) ** 3 / 3.0


def lasting_error(errors: PositionErrors) -> tuple[float, float]:
    """Return variance per axis [scene unit^2] and correlation time [s] of the time-correlated position error.

    It is that of the sensor with the smallest variance.
    """
    noises = [position_noise_of(errors, errors.first + k) for k in range(len(errors.banks))]
    least = min(noises, key=lambda each: each.lasting)
    return least.lasting, least.tau


def update_position_errors(
    errors: PositionErrors, c: int, t_ns: int, position: Floats, stated: Floats, key: Ints, all_keys: Ints
) -> PositionErrors:
    """Return the error models with the bank of one position sensor updated by the positions of one frame.

    Targets that are gone, or were not detected for `MAX_GAP_S`, are dropped; new ones are added.

    Args:
        errors: error models before the frame; not changed.
        c: index of the sensor among the views.
        t_ns: time of the frame.
        position: (n, 2) positions, each surely of one target.
        stated: (n, 3) covariances xx, xy, yy that the sensor states; NaN: not stated.
        key: (n,) keys of the targets of these positions.
        all_keys: keys of the targets that still exist.
    """
    k = c - errors.first
    bank = errors.banks[k]
    variance = 0.5 * (stated[:, 0] + stated[:, 2])
    known = np.isfinite(variance)
    counted = bank.stated + np.array([variance[known].sum(), known.sum(), (~known).sum()])
    since = (t_ns - bank.frame_ns) / NS
    if bank.frame_ns < 0 or not 0.0 < since <= MAX_GAP_S:
        period = bank.period_s
    else:
        period = since if math.isinf(bank.period_s) else bank.period_s + PERIOD_LEARNING_RATE * (since - bank.period_s)
    bank = replace(bank, stated=counted, frame_ns=t_ns, period_s=period)
    base = np.where(known, variance, errors.sigma**2)
    # Forget targets that are gone
    alive = np.isin(bank.key, all_keys) & (t_ns - bank.t_ns <= MAX_GAP_S * NS) & (bank.t_ns < t_ns)
    bank = _select(bank, np.flatnonzero(alive))
    evidence, count = bank.evidence.copy(), 0
    _, mine, old = np.intersect1d(key, bank.key, return_indices=True)
    if len(mine):
        mean, covariance = bank.mean.copy(), bank.covariance.copy()
        dt = (t_ns - bank.t_ns[old]) / NS
        _advance(bank, mean, covariance, old, dt, position[mine], base[mine], errors.gait_variance, evidence)
        steps, last = bank.steps.copy(), bank.t_ns.copy()
        count = int((steps[old] > 1).sum())
        steps[old] += 1
        last[old] = t_ns
        bank = replace(bank, mean=mean, covariance=covariance, steps=steps, t_ns=last)
    bank = replace(bank, evidence=evidence, innovations=bank.innovations + count)
    new = np.setdiff1d(np.arange(len(key)), mine)
    bank = _begin(bank, key[new], t_ns, position[new], base[new], errors.gait_variance)
    return replace(errors, banks=(*errors.banks[:k], bank, *errors.banks[k + 1 :]))


def _select(bank: ErrorBank, rows: Ints) -> ErrorBank:
    """Return the bank with the targets at the indices `rows` only; the evidence stays."""
    return replace(
        bank,
        key=bank.key[rows],
        t_ns=bank.t_ns[rows],
        steps=bank.steps[rows],
        mean=bank.mean[rows],
        covariance=bank.covariance[rows],
    )


def _begin(bank: ErrorBank, key: Ints, t_ns: int, position: Floats, base: Floats, gait: float) -> ErrorBank:
    """Return the bank with n new targets added.

    Args:
        bank: filter bank before; not changed.
        key: (n,) keys of the targets.
        t_ns: time of their first positions.
        position: (n, 2) first positions.
        base: (n,) variances per axis that the bank's multiples refer to: stated, or of the setting.
        gait: variance per axis of the gait displacement.
    """
    n, G = len(key), len(bank.total)
    mean, P = np.zeros((n, G, DIMENSIONS, 2)), np.zeros((n, G, DIMENSIONS, DIMENSIONS))
    mean[:, :, 0] = position[:, None]
    lasting = base[:, None] * bank.total * bank.share
    # p = z - b - g - w
    P[:, :, 0, 0], P[:, :, 1, 1] = base[:, None] * bank.total + gait, INITIAL_SPEED_VARIANCE * (gait / GAIT_SIGMA_M**2)
    P[:, :, 2, 2], P[:, :, 3, 3] = lasting, gait
    P[:, :, 0, 2] = P[:, :, 2, 0] = -lasting
    P[:, :, 0, 3] = P[:, :, 3, 0] = -gait
    return replace(
        bank,
        key=np.concatenate([bank.key, key]),
        t_ns=np.concatenate([bank.t_ns, np.full(n, t_ns, dtype=np.int64)]),
        steps=np.concatenate([bank.steps, np.ones(n, dtype=np.int64)]),
        mean=np.concatenate([bank.mean, mean]),
        covariance=np.concatenate([bank.covariance, P]),
    )


INITIAL_SPEED_VARIANCE = 1.0
"""Variance of a velocity per axis before the second position [m^2/s^2]."""


def _advance(
    bank: ErrorBank,
    mean: Floats,
    covariance: Floats,
    rows: Ints,
    dt: Floats,
    position: Floats,
    base: Floats,
    gait: float,
    evidence: Floats,
) -> None:
    """Predict and update n targets in place, and add the log likelihoods of their innovations to `evidence`.

    The first innovation of a target does not count: its velocity is unknown.

    Args:
        bank: parameters, and number of positions of each target; not changed.
        mean: (N, G, 4, 2) means of the bank, changed in the rows.
        covariance: (N, G, 4, 4) changed in the rows.
        rows: (n,) indices of the targets.
        dt: (n,) time since their last positions [s].
        position: (n, 2) measured positions.
        base: (n,) variances per axis that the bank's multiples refer to: stated, or of the setting.
        gait: variance per axis of the gait displacement.
        evidence: (G,) changed.
    """
    counted: Bools = np.asarray(bank.steps[rows] > 1)
    _advance_bank(
        mean, covariance, rows, dt, position, base, bank.total, bank.share, bank.tau, bank.q, gait, counted, evidence
    )


@kernel
def _advance_bank(
    mean: Floats,
    covariance: Floats,
    rows: Ints,
    dt: Floats,
    position: Floats,
    base: Floats,
    total: Floats,
    share: Floats,
    tau: Floats,
    q: Floats,
    gait: float,
    counted: Bools,
    evidence: Floats,
) -> None:
    """Predict and update the Kalman filters of n targets and G parameter combinations, in place.

    The states are position and velocity of the walk, sensor error b and gait displacement g; both axes share a
    covariance.

    Args:
        mean: (N, G, 4, 2) changed in the rows.
        covariance: (N, G, 4, 4) changed in the rows.
        rows: (n,) indices of the targets.
        dt: (n,) time since their last positions [s].
        position: (n, 2) measured positions.
        base: (n,) variances per axis that the multiples `total` refer to.
        total: (G,) total variance of each combination, as a multiple of `base`.
        share: (G,) share of it that is correlated in time.
        tau: (G,) correlation times [s].
        q: (G,) process noise densities.
        gait: variance of g per axis.
        counted: (n,) whether the log likelihood of the innovation is added.
        evidence: (G,) changed.
    """
    F, A = np.zeros((4, 4)), np.empty((4, 4))
    for n in range(rows.shape[0]):
        t = dt[n]
        for g in range(total.shape[0]):
            m, P = mean[rows[n], g], covariance[rows[n], g]
            lasting = base[n] * total[g] * share[g]
            white = base[n] * total[g] - lasting
            F[0, 0], F[0, 1], F[1, 1] = 1.0, t, 1.0
            F[2, 2], F[3, 3] = math.exp(-t / tau[g]), math.exp(-t / GAIT_CORRELATION_S)
            A[:] = F @ P @ F.T
            A[0, 0] += q[g] * t**3 / 3.0
            A[0, 1] += q[g] * t**2 / 2.0
            A[1, 0] += q[g] * t**2 / 2.0
            A[1, 1] += q[g] * t
            A[2, 2] += lasting * (1.0 - F[2, 2] * F[2, 2])
            A[3, 3] += gait * (1.0 - F[3, 3] * F[3, 3])
            S, distance = white, 0.0
            for i in (0, 2, 3):
                for j in (0, 2, 3):
                    S += A[i, j]
            for axis in range(2):
                m[0, axis] += t * m[1, axis]
                m[2, axis] *= F[2, 2]
                m[3, axis] *= F[3, 3]
                off = position[n, axis] - m[0, axis] - m[2, axis] - m[3, axis]
                distance += off * off / S
                for i in range(4):
                    m[i, axis] += (A[i, 0] + A[i, 2] + A[i, 3]) / S * off
            for i in range(4):
                for j in range(4):
                    gain = (A[i, 0] + A[i, 2] + A[i, 3]) / S
                    P[i, j] = A[i, j] - gain * (A[0, j] + A[2, j] + A[3, j])
            if counted[n]:
                evidence[g] += -math.log(S) - 0.5 * min(distance, MAX_INNOVATION_CHI2)
