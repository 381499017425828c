"""Identities of labelled bearings by the continuity of motion: exchanged labels, and labels that jump.

Every label has an extended Kalman filter with its bearings of all sensors.  Where bearings of label a are improbable
at the prediction of a and probable at that of b, and those of b the other way round, the labels have been exchanged.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel

GATE_CHI2 = 16.0
"""Squared normalised innovation of a bearing beyond which it contradicts its label."""
FALSE_PROBABILITY = 0.05
"""Probability that a bearing is of nothing; it bounds what one bearing can say."""
MIN_LOG_ODDS, MIN_LOG_ODDS_SENSOR, MIN_LOG_ODDS_BACK = 20.0, 30.0, 12.0
"""Log odds from which an exchange is accepted: of all sensors, of one sensor, and back to the labels as given."""
MIN_SHARE_EACH = 0.25
"""Minimum share of each of both labels in the log odds."""
LEARNING_RATE, MIN_SCALE, MAX_SCALE, MAX_LEARNED_CHI2 = 0.05, 1.0, 30.0, 9.0
"""Rate at which the motion's variance is learned, limits of its factor, and of the squares from which it is."""
MAX_OPEN_S = 1.0
"""Time within which evidence of an exchange must suffice [s]."""
MAX_AGE_S = 2.0
"""A prediction that is older [s] says nothing of identities."""
TOGETHER_S = 0.5
"""Bearings within this time [s] determine a position."""
MIN_LOST, FOUND_WEIGHT = 4.0, 0.5
"""Count of bearings outside the gate from which a filter begins again; weight of those inside, which count against."""
MIN_CONFIRMED = 5
"""Bearings inside the gate from which a filter that began again is right."""
RESTART_CHI2 = 9.0
"""Squared normalised residual up to which bearings meet in one position."""
MIN_DETERMINANT = 1e-3
"""Information with a smaller determinant, relative to its squared trace, does not determine a position."""
MAX_RELATIVE_DEVIATION = 0.25
"""Largest standard deviation of a position from which a filter begins, over the distance of the nearest sensor."""
GAUSS_NEWTON_STEPS = 3
"""Steps of the search of a position."""
EXCHANGED, JUMPED = 0.0, 1.0
"""Kinds of events."""


class LabelledRows(NamedTuple):
    """N labelled bearings, in the order of time."""

    seconds: Floats  # (N,)
    sensor: Ints  # (N,)
    label: Ints  # (N,) number from 0
    azimuth: Floats  # (N,) [rad]; NaN: not detected, or no direction in the plane
    variance: Floats  # (N,) [rad^2]


class WalkingSpeed(NamedTuple):
    """Motion of targets, an Ornstein-Uhlenbeck process."""

    variance: float  # of the velocity per axis
    rate: float  # 1 / time constant [1/s]
    noise: float  # variance of the position per axis and second


class ContinuityState(NamedTuple):
    """Filters of K labels, the identities of their labels by S sensors, and open evidence."""

    mean: Floats  # (K, 4)
    covariance: Floats  # (K, 4, 4)
    known: Ints  # (K,) 1: it has a prediction
    at_s: Floats  # (K,) time of the prediction
    updated_s: Floats  # (K,) time of the last bearing inside the gate
    last: Floats  # (K, 2) position then
    spread: Floats  # (K,) trace of its covariance
    scale: Floats  # (K,) factor of the motion's variances
    factors: Floats  # (K, 2) sum of the logarithms of this factor after each bearing inside the gate, and their number
    lost: Floats  # (K,) bearings outside the gate, less those inside by `FOUND_WEIGHT`, since they last were even
    lost_s: Floats  # (K,) time of the first of them
    accepted: Ints  # (K,) bearings inside the gate since the filter began
    jump: Floats  # (K, 7) a jump that waits: begin (inf: none), time (-inf: none) and position
    # before, distance, deviation, time of the new position
    recent: Floats  # (K, S, 3) last bearing of each sensor: time, azimuth, variance
    identity: Ints  # (S, K) identity of each sensor's labels
    odds: Floats  # (S + 1, K, K) log odds of bearings of a for b; the last: of all sensors
    open_s: Floats  # (S + 1, K, K) time of the first evidence of an exchange; inf: none


class SensorPositions(NamedTuple):
    """Where S sensors are."""

    x: Floats  # (S,)
    y: Floats  # (S,)
    variance: Floats  # (S,) of the position per axis


@kernel
def _innovation(
    mean: Floats, covariance: Floats, sensors: SensorPositions, s: int, azimuth: float, variance: float
) -> tuple[float, float, float, float, float]:
    """Innovation of an azimuth, its variance, that of the measurement, and the derivative by the position."""
    dx, dy = mean[0] - sensors.x[s], mean[1] - sensors.y[s]
    r2 = max(dx * dx + dy * dy, 1e-12)
    gx, gy = -dy / r2, dx / r2
    off = (azimuth - math.atan2(dy, dx) + math.pi) % (2.0 * math.pi) - math.pi
    noise = variance + sensors.variance[s] / r2
    spread = gx * gx * covariance[0, 0] + 2.0 * gx * gy * covariance[0, 1] + gy * gy * covariance[1, 1] + noise
    return off, spread, noise, gx, gy


@kernel
def _log_density(off: float, spread: float) -> float:
    """Log density of an innovation that may be of nothing."""
    inside = math.exp(-0.5 * off * off / spread) / math.sqrt(2.0 * math.pi * spread)
    return math.log((1.0 - FALSE_PROBABILITY) * inside + FALSE_PROBABILITY / (2.0 * math.pi))


@kernel
def _predict(k: int, now: float, state: ContinuityState, walk: WalkingSpeed) -> None:
    """Move one filter to a time."""
    dt = now - state.at_s[k]
    if not dt > 0.0:
        return
    keep = math.exp(-walk.rate * dt)
    move = (1.0 - keep) / walk.rate
    V = walk.variance * state.scale[k]
    vv = V * (1.0 - keep * keep)
    xv = V * walk.rate * move * move
    xx = V / walk.rate**2 * (2.0 * walk.rate * dt - 3.0 + 4.0 * keep - keep * keep) + walk.noise * dt
    P = state.covariance[k]
    for a in range(2):
        state.mean[k, a] += move * state.mean[k, 2 + a]
        state.mean[k, 2 + a] *= keep
    F = np.eye(4)
    F[0, 2] = F[1, 3] = move
    F[2, 2] = F[3, 3] = keep
    P = F @ P @ F.T
    for a in range(2):
        P[a, a] += xx
        P[2 + a, 2 + a] += vv
        P[a, 2 + a] += xv
        P[2 + a, a] += xv
    state.covariance[k] = P
    state.at_s[k] = now


@kernel
def _meet(
    k: int, since: float, now: float, state: ContinuityState, sensors: SensorPositions, walk: WalkingSpeed
) -> bool:
    """Begin a filter where the bearings of two sensors or more since a time meet; False where they do not."""
    S = len(sensors.x)
    use = np.empty(S, dtype=np.int64)
    n = 0
    for s in range(S):
        if now - state.recent[k, s, 0] <= TOGETHER_S and state.recent[k, s, 0] >= since:
            use[n] = s
            n += 1
    if n < 2:
        return False
    # Least squares of the distances from the lines of sight
    a = b = c = e = f = 0.0
    for i in range(n):
        s = use[i]
        nx, ny = -math.sin(state.recent[k, s, 1]), math.cos(state.recent[k, s, 1])
        off = nx * sensors.x[s] + ny * sensors.y[s]
        a, b, c, e, f = a + nx * nx, b + nx * ny, c + ny * ny, e + nx * off, f + ny * off
    det = a * c - b * b
    if not det > MIN_DETERMINANT * (a + c) * (a + c):
        return False
    at = np.array([(c * e - b * f) / det, (a * f - b * e) / det])
    # Gauss-Newton by the angles; the last pass leaves the residuals
    none, worst = np.zeros((2, 2)), 0.0
    for step in range(GAUSS_NEWTON_STEPS + 1):
        a = b = c = e = f = worst = 0.0
        for i in range(n):
            s = use[i]
            late = now - state.recent[k, s, 0]
            off, spread, _, gx, gy = _innovation(at, none, sensors, s, state.recent[k, s, 1], state.recent[k, s, 2])
            spread += (gx * gx + gy * gy) * walk.variance * late * late
            a, b, c = a + gx * gx / spread, b + gx * gy / spread, c + gy * gy / spread
            e, f = e + gx * off / spread, f + gy * off / spread
            worst = max(worst, off * off / spread)
        det = a * c - b * b
        if not det > MIN_DETERMINANT * (a + c) * (a + c):
            return False
        if step < GAUSS_NEWTON_STEPS:
            at[0] += (c * e - b * f) / det
            at[1] += (a * f - b * e) / det
    nearest = math.inf
    for i in range(n):
        nearest = min(nearest, math.hypot(at[0] - sensors.x[use[i]], at[1] - sensors.y[use[i]]))
    if not (worst <= RESTART_CHI2 and (a + c) / det <= (MAX_RELATIVE_DEVIATION * nearest) ** 2):
        return False
    P = np.zeros((4, 4))
    P[0, 0], P[0, 1], P[1, 0], P[1, 1] = c / det, -b / det, -b / det, a / det
    P[2, 2] = P[3, 3] = walk.variance
    state.mean[k, :2], state.mean[k, 2:], state.covariance[k] = at, 0.0, P
    state.known[k], state.lost[k] = 1, 0.0
    state.at_s[k] = state.updated_s[k] = now
    return True


@kernel
def _update(k: int, r: int, rows: LabelledRows, sensors: SensorPositions, state: ContinuityState) -> None:
    """Update one filter by a bearing inside the gate, in Joseph's form."""
    off, spread, noise, gx, gy = _innovation(
        state.mean[k], state.covariance[k], sensors, rows.sensor[r], rows.azimuth[r], rows.variance[r]
    )
    P = state.covariance[k]
    gain = (P[:, 0] * gx + P[:, 1] * gy) / spread
    L = np.eye(4)
    for a in range(4):
        state.mean[k, a] += gain[a] * off
        L[a, 0] -= gain[a] * gx
        L[a, 1] -= gain[a] * gy
    state.covariance[k] = L @ P @ L.T + noise * np.outer(gain, gain)


@kernel
def _compare(first: int, last: int, rows: LabelledRows, sensors: SensorPositions, state: ContinuityState) -> bool:
    """Add the bearings of one time step to the evidence for exchanges; whether any is open.

    Evidence is collected for pairs of which one bearing contradicts its identity, and for those that are open.
    """
    K, S, now = len(state.known), len(sensors.x), rows.seconds[first]
    suspect = np.zeros(K, dtype=np.bool_)
    for r in range(first, last):
        k = state.identity[rows.sensor[r], rows.label[r]]
        if state.known[k] and not math.isnan(rows.azimuth[r]):
            off, spread, _, _, _ = _innovation(
                state.mean[k], state.covariance[k], sensors, rows.sensor[r], rows.azimuth[r], rows.variance[r]
            )
            suspect[k] |= off * off > GATE_CHI2 * spread
    pending = False
    for a in range(K):
        for b in range(a + 1, K):
            opened = False
            for s in range(S + 1):
                opened |= state.open_s[s, a, b] < math.inf
            fresh = state.known[a] and state.known[b]
            fresh = fresh and now - state.updated_s[a] <= MAX_AGE_S and now - state.updated_s[b] <= MAX_AGE_S
            if not opened and not (fresh and (suspect[a] or suspect[b])):
                continue
            for r in range(first, last):
                s = rows.sensor[r]
                k = state.identity[s, rows.label[r]]
                if (k != a and k != b) or math.isnan(rows.azimuth[r]):
                    continue
                other = b if k == a else a
                azimuth, variance = rows.azimuth[r], rows.variance[r]
                off, spread, _, _, _ = _innovation(state.mean[k], state.covariance[k], sensors, s, azimuth, variance)
                away, wide, _, _, _ = _innovation(
                    state.mean[other], state.covariance[other], sensors, s, azimuth, variance
                )
                gain = _log_density(away, wide) - _log_density(off, spread)
                state.odds[s, k, other] += gain
                state.odds[S, k, other] += gain
            for s in range(S + 1):
                late = now - state.open_s[s, a, b] > MAX_OPEN_S
                if late or not fresh or state.odds[s, a, b] + state.odds[s, b, a] <= 0.0:
                    state.odds[s, a, b] = state.odds[s, b, a] = 0.0
                    state.open_s[s, a, b] = math.inf
                elif state.open_s[s, a, b] == math.inf:
                    state.open_s[s, a, b] = now
                pending |= state.open_s[s, a, b] < math.inf
    return pending


@kernel
def _accept(s: int, a: int, b: int, state: ContinuityState) -> bool:
    """Whether the evidence suffices that a sensor's labels (S: of all sensors) of two identities are exchanged."""
    S = len(state.identity)
    to_b, to_a = state.odds[s, a, b], state.odds[s, b, a]
    least = MIN_LOG_ODDS if s == S else MIN_LOG_ODDS_SENSOR
    if (s == S and (state.identity[:, a] == b).all()) or (s < S and state.identity[s, a] == b):
        least = MIN_LOG_ODDS_BACK
    return bool(to_b + to_a >= least and min(to_b, to_a) >= MIN_SHARE_EACH * least)


@kernel
def _decide(first: int, rows: LabelledRows, state: ContinuityState, identity: Ints, events: Floats) -> int:
    """Exchange the identities of the labels for which evidence suffices, from its first row; the number of events."""
    S, K, n = len(state.identity), len(state.known), 0
    exchanged = np.zeros(S, dtype=np.bool_)
    for a in range(K):
        for b in range(a + 1, K):
            for q in range(S + 1):
                s = S - q  # all sensors first
                since = state.open_s[s, a, b]
                if since == math.inf or not _accept(s, a, b, state):
                    continue
                for t in range(S):
                    exchanged[t] = t == s or (s == S and state.odds[t, a, b] + state.odds[t, b, a] >= 0.0)
                    for k in range(K):
                        if exchanged[t] and (state.identity[t, k] == a or state.identity[t, k] == b):
                            state.identity[t, k] = a + b - state.identity[t, k]
                r = first - 1
                while r >= 0 and rows.seconds[r] >= since:
                    if exchanged[rows.sensor[r]] and (identity[r] == a or identity[r] == b):
                        identity[r] = a + b - identity[r]
                    r -= 1
                for t in range(S + 1):
                    if s == S or t in (s, S):
                        state.odds[t, a, b] = state.odds[t, b, a] = 0.0
                        state.open_s[t, a, b] = math.inf
                events[n] = np.array([EXCHANGED, since, 0.0, float(a), float(b), float(s), 0.0, 0.0])
                n += 1
    return n


@kernel
def follow_labels(
    rows: LabelledRows,
    sensors: SensorPositions,
    walk: WalkingSpeed,
    state: ContinuityState,
    identity: Ints,
    against: Bools,
    begun: int,
) -> tuple[Floats, float]:
    """Find the identities of labelled bearings by the continuity of their motion.

    Args:
        rows: whole time steps.
        sensors: their sensors.
        walk: how targets move.
        state: after the rows before; changed.
        identity: (N,) of each row; those of the rows from `begun` on are written, and those of earlier ones corrected.
        against: (N,) whether a bearing contradicts the motion of its target; written from `begun` on.
        begun: first row that was not there before.

    Returns:
        (E, 8) events: kind, time; of an exchange 0, both identities, the sensor (their number: all of them), 0 and 0;
        of a jump the time before, the identity, the times at which the new position is found and sure, the distance and
        its standard deviation.  The time of the earliest bearing that may still change its identity, inf without any.
    """
    N, n = len(rows.seconds), 0
    events = np.zeros((N + len(state.known) ** 2 * (len(sensors.x) + 1), 8))
    first = begun
    while first < N:
        last = first + 1
        while last < N and rows.seconds[last] == rows.seconds[first]:
            last += 1
        now = rows.seconds[first]
        for k in range(len(state.known)):
            if state.known[k] and now - state.recent[k, :, 0].max() > MAX_AGE_S:
                # After a pause a label begins again
                state.known[k], state.lost[k] = 0, 0.0
                state.jump[k, 0], state.jump[k, 1] = math.inf, -math.inf
            elif state.known[k]:
                _predict(k, now, state, walk)
        pending = _compare(first, last, rows, sensors, state)
        if pending:
            n += _decide(first, rows, state, identity, events[n:])
        for r in range(first, last):
            s = rows.sensor[r]
            k = state.identity[s, rows.label[r]]
            identity[r] = k
            if not math.isnan(rows.azimuth[r]):
                state.recent[k, s, 0], state.recent[k, s, 1], state.recent[k, s, 2] = (
                    now,
                    rows.azimuth[r],
                    rows.variance[r],
                )
        n += _take(first, last, rows, identity, against, sensors, walk, state, events[n:])
        first = last
    return events[:n], float(state.open_s.min()) if state.open_s.size else math.inf


@kernel
def _take(
    first: int,
    last: int,
    rows: LabelledRows,
    identity: Ints,
    against: Bools,
    sensors: SensorPositions,
    walk: WalkingSpeed,
    state: ContinuityState,
    events: Floats,
) -> int:
    """Update all filters by the bearings of one time step; the number of jumps that were found."""
    K, now, n = len(state.known), rows.seconds[first], 0
    inside = np.zeros(last - first, dtype=np.bool_)
    accepted, rejected = np.zeros(K), np.zeros(K)
    for r in range(first, last):
        k = identity[r]
        if state.known[k] and not math.isnan(rows.azimuth[r]):
            off, spread, _, _, _ = _innovation(
                state.mean[k], state.covariance[k], sensors, rows.sensor[r], rows.azimuth[r], rows.variance[r]
            )
            inside[r - first] = off * off <= GATE_CHI2 * spread
            accepted[k] += inside[r - first]
            rejected[k] += not inside[r - first]
    for k in range(K):
        if rejected[k] > 0.0 and state.lost[k] == 0.0:
            state.lost_s[k] = now
            if state.jump[k, 0] == math.inf and state.accepted[k] >= MIN_CONFIRMED:
                # The position before; it stays until a new one is sure
                state.jump[k, 1], state.jump[k, 2], state.jump[k, 3] = (
                    state.updated_s[k],
                    state.last[k, 0],
                    state.last[k, 1],
                )
                state.jump[k, 5] = state.spread[k]
        state.lost[k] = max(0.0, state.lost[k] + rejected[k] - FOUND_WEIGHT * accepted[k])
    for r in range(first, last):
        k = identity[r]
        # Bearings at the same time that agree with the motion say that it is right
        sure = (
            state.known[k] == 1
            and state.accepted[k] >= MIN_CONFIRMED
            and accepted[k] >= 1.0
            and rejected[k] <= max(1.0, 0.5 * accepted[k])
        )
        against[r] = sure and not inside[r - first] and not math.isnan(rows.azimuth[r])
    for r in range(first, last):
        k = identity[r]
        # Where most bearings contradict, those that do not agree by chance
        if not inside[r - first] or rejected[k] > max(1.0, accepted[k]):
            continue
        off, spread, noise, _, _ = _innovation(
            state.mean[k], state.covariance[k], sensors, rows.sensor[r], rows.azimuth[r], rows.variance[r]
        )
        # Variance of the motion: squared innovations are 1 on average, as far as the motion makes them
        gain = LEARNING_RATE * (1.0 - noise / spread) * (min(off * off / spread, MAX_LEARNED_CHI2) - 1.0)
        state.scale[k] = min(max(state.scale[k] * math.exp(gain), MIN_SCALE), MAX_SCALE)
        state.factors[k, 0] += math.log(state.scale[k])
        state.factors[k, 1] += 1.0
        _update(k, r, rows, sensors, state)
        state.updated_s[k] = now
        state.last[k, 0], state.last[k, 1] = state.mean[k, 0], state.mean[k, 1]
        state.spread[k] = state.covariance[k, 0, 0] + state.covariance[k, 1, 1]
        state.accepted[k] += 1
        if state.accepted[k] == MIN_CONFIRMED and state.jump[k, 0] < math.inf:
            begin, before, away, wide = state.jump[k, 0], state.jump[k, 1], state.jump[k, 4], state.jump[k, 5]
            events[n] = np.array([JUMPED, begin, before, float(k), state.jump[k, 6], now, away, wide])
            n += 1
            state.jump[k, 0], state.jump[k, 1] = math.inf, -math.inf
    for r in range(first, last):
        k = identity[r]
        lost = state.known[k] == 1 and state.lost[k] >= MIN_LOST
        lost = lost and min(state.open_s[:, k].min(), state.open_s[:, :, k].min()) == math.inf
        if (state.known[k] and not lost) or not _meet(
            k, state.lost_s[k] if lost else -math.inf, now, state, sensors, walk
        ):
            continue
        own = state.covariance[k, 0, 0] + state.covariance[k, 1, 1]
        if lost and state.jump[k, 1] > -math.inf:
            if state.jump[k, 0] == math.inf:
                state.jump[k, 0], state.jump[k, 5] = state.lost_s[k], math.sqrt(state.jump[k, 5] + own)
            state.jump[k, 6] = now
            state.jump[k, 4] = math.hypot(state.mean[k, 0] - state.jump[k, 2], state.mean[k, 1] - state.jump[k, 3])
        state.accepted[k] = 0
        state.last[k, 0], state.last[k, 1], state.spread[k] = state.mean[k, 0], state.mean[k, 1], own
    return n
