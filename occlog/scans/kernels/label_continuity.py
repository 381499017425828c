"""Identities of labelled bearings by the continuity of motion: exchanged labels, and labels that jump.

Every label has an extended Kalman filter with its bearings of all sensors.  Where bearings of label a are improbable
at the prediction of a and probable at that of b, and those of b the other way round, the labels have been exchanged.

From the first bearing that contradicts a filter, a second filter, the rival, processes the bearings since then only. It
replaces the filter if later bearings are clearly more probable with it. If its first position is farther from the
confirmed track than the target can go, the label jumped. The distance is measured from the last two positions of the
track, since the last one may follow a false bearing.
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
MIN_LOG_ODDS_RIVAL = 6.0
"""Log odds from which a rival replaces the filter of a label, and at minus which it is dropped."""
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
MIN_CONFIRMED = 5
"""Bearings inside the gate from which a filter is confirmed."""
RESTART_CHI2 = 9.0
"""Squared normalised residual up to which bearings meet in one position."""
MIN_DETERMINANT = 1e-3
"""Information with a smaller determinant, relative to its squared trace, does not determine a position."""
MAX_RELATIVE_DEVIATION = 0.25
"""Largest standard deviation of a position from which a filter begins, over the distance of the nearest sensor."""
GAUSS_NEWTON_STEPS = 3
"""Steps of the search of a position."""
JUMP_SIGMAS = 2.0
"""A jump is longer than that many standard deviations of its distance."""
EXCHANGED, JUMPED = 0.0, 1.0
"""Kinds of events."""


class LabelledRows(NamedTuple):
    """N labelled bearings, sorted by time, with the indices of their sensors and labels."""

    seconds: Floats  # (N,)
    sensor: Ints  # (N,)
    label: Ints  # (N,) number from 0
    azimuth: Floats  # (N,) [rad]; NaN: not detected, or no direction in the plane
    variance: Floats  # (N,) [rad^2]


class WalkingSpeed(NamedTuple):
    """Motion model of targets: an Ornstein-Uhlenbeck velocity, and white noise of the position."""

    variance: float  # of the velocity per axis
    rate: float  # 1 / time constant [1/s]
    noise: float  # variance of the position per axis and second


class ContinuityState(NamedTuple):
    """Filters of K identities, the identity of each label in each of S sensors, and the evidence for exchanges.

    A filter has a Gaussian of (x, y, vx, vy); a rival is a second one, from the bearings since the first contradiction.
    """

    mean: Floats  # (K, 4)
    covariance: Floats  # (K, 4, 4)
    known: Ints  # (K,) 1: it has a prediction
    at_s: Floats  # (K,) time of the prediction
    last: Floats  # (K, 4) time of the last bearing inside the gate, position then, and trace of its covariance
    scale: Floats  # (K,) factor of the motion's variances
    factors: Floats  # (K, 2) sum of the logarithms of this factor after each bearing inside the gate, and their number
    accepted: Ints  # (K,) bearings inside the gate since the filter began
    agreed: Ints  # (K,) of these, since the last time step with a bearing outside
    confirmed: Ints  # (K,) bearings beyond the first one in time steps in which all agree, since the filter began
    before: Floats  # (K, 4) time, position and trace of its covariance after the update before the last one
    contradicted: Floats  # (K, 10) time of the first bearing that contradicts the filter (inf: none), the factor of the
    # motion's variance, and time (-inf: none), position and trace of the last two updates when it was confirmed
    rival_mean: Floats  # (K, 4) the rival
    rival_covariance: Floats  # (K, 4, 4)
    rival: Floats  # (K, 6) when it began (inf: none), where, the trace of its covariance there, log odds for it,
    # and its bearings inside the gate
    recent: Floats  # (K, S, 3) last bearing of each sensor: time, azimuth, variance
    identity: Ints  # (S, K) identity of each sensor's labels
    odds: Floats  # (S + 1, K, K) log odds of bearings of a for b; the last: of all sensors
    open_s: Floats  # (S + 1, K, K) time of the first evidence of an exchange; inf: none


class SensorPositions(NamedTuple):
    """Ground positions of S sensors, with the variance of their errors per axis."""

    x: Floats  # (S,)
    y: Floats  # (S,)
    variance: Floats  # (S,) of the position per axis


@kernel
def _innovation(
    mean: Floats, covariance: Floats, sensors: SensorPositions, s: int, azimuth: float, variance: float
) -> tuple[float, float, float, float, float]:
    """Return the innovation of an azimuth [rad], its variance, the measurement's variance, and the gradient by x, y.

    The measurement's variance includes that of the sensor's position.

    Args:
        mean: (4,) x, y, vx, vy; only the position counts.
        covariance: (4, 4) covariance of the state; only that of the position counts.
        sensors: positions of the sensors.
        s: index of the sensor.
        azimuth: measured azimuth [rad].
        variance: variance of the azimuth [rad^2].
    """
    dx, dy = mean[0] - sensors.x[s], mean[1] - sensors.y[s]
    r2 = max(dx * dx + dy * dy, 1e-12)
    gx, gy = -dy / r2, dx / r2
    off = (azimuth - math.atan2(dy, dx) + math.pi) % (2.0 * math.pi) - math.pi
    noise = variance + sensors.variance[s] / r2
    spread = gx * gx * covariance[0, 0] + 2.0 * gx * gy * covariance[0, 1] + gy * gy * covariance[1, 1] + noise
    return off, spread, noise, gx, gy


@kernel
def _log_density(off: float, spread: float) -> float:
    """Return the log density of an innovation `off` [rad] with variance `spread` [rad^2], allowing false bearings.

    A share `FALSE_PROBABILITY` of bearings is false and uniform over the circle.
    """
    inside = math.exp(-0.5 * off * off / spread) / math.sqrt(2.0 * math.pi * spread)
    return math.log((1.0 - FALSE_PROBABILITY) * inside + FALSE_PROBABILITY / (2.0 * math.pi))


@kernel
def _predict(mean: Floats, covariance: Floats, dt: float, scale: float, walk: WalkingSpeed) -> None:
    """Predict a filter by `dt` [s], in place: `mean` (4,) and `covariance` (4, 4) of x, y, vx, vy.

    `scale` multiplies the velocity variance of `walk`.
    """
    keep = math.exp(-walk.rate * dt)
    move = (1.0 - keep) / walk.rate
    V = walk.variance * scale
    vv = V * (1.0 - keep * keep)
    xv = V * walk.rate * move * move
    xx = V / walk.rate**2 * (2.0 * walk.rate * dt - 3.0 + 4.0 * keep - keep * keep) + walk.noise * dt
    for a in range(2):
        mean[a] += move * mean[2 + a]
        mean[2 + a] *= keep
    F = np.eye(4)
    F[0, 2] = F[1, 3] = move
    F[2, 2] = F[3, 3] = keep
    P = F @ covariance @ F.T
    for a in range(2):
        P[a, a] += xx
        P[2 + a, 2 + a] += vv
        P[a, 2 + a] += xv
        P[2 + a, a] += xv
    covariance[:] = P


@kernel
def _meet(
    recent: Floats,
    since: float,
    now: float,
    variance: float,
    sensors: SensorPositions,
    mean: Floats,
    covariance: Floats,
) -> bool:
    """Initiate a filter, in place, at the intersection of the last bearings of at least two sensors.

    Return False, with the filter unchanged, if there are fewer or they do not intersect well.

    Args:
        recent: (S, 3) last bearing of each sensor: time [s], azimuth [rad], variance [rad^2].
        since: earlier bearings do not count [s].
        now: time of the filter [s].
        variance: variance of a velocity component.
        sensors: positions of the sensors.
        mean: (4,) x, y, vx, vy; set in place.
        covariance: (4, 4); set in place.
    """
    S = len(sensors.x)
    use = np.empty(S, dtype=np.int64)
    n = 0
    for s in range(S):
        if now - recent[s, 0] <= TOGETHER_S and recent[s, 0] >= since:
            use[n] = s
            n += 1
    if n < 2:
        return False
    # Least squares of the distances from the lines of sight
    a = b = c = e = f = 0.0
    for i in range(n):
        s = use[i]
        nx, ny = -math.sin(recent[s, 1]), math.cos(recent[s, 1])
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
            late = now - recent[s, 0]
            off, spread, _, gx, gy = _innovation(at, none, sensors, s, recent[s, 1], recent[s, 2])
            spread += (gx * gx + gy * gy) * variance * late * late
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
    P[2, 2] = P[3, 3] = variance
    mean[:2], mean[2:] = at, 0.0
    covariance[:] = P
    return True


@kernel
def _update(mean: Floats, covariance: Floats, r: int, rows: LabelledRows, sensors: SensorPositions) -> None:
    """Update a filter by the bearing of row r, in place (Kalman update in Joseph form).

    Args:
        mean: (4,) x, y, vx, vy; changed in place.
        covariance: (4, 4); changed in place.
        r: row of the bearing, which is inside the gate.
        rows: all bearings.
        sensors: positions of the sensors.
    """
    off, spread, noise, gx, gy = _innovation(
        mean, covariance, sensors, rows.sensor[r], rows.azimuth[r], rows.variance[r]
    )
    P = covariance.copy()
    gain = (P[:, 0] * gx + P[:, 1] * gy) / spread
    L = np.eye(4)
    for a in range(4):
        mean[a] += gain[a] * off
        L[a, 0] -= gain[a] * gx
        L[a, 1] -= gain[a] * gy
    covariance[:] = L @ P @ L.T + noise * np.outer(gain, gain)


@kernel
def _compare(first: int, last: int, rows: LabelledRows, sensors: SensorPositions, state: ContinuityState) -> bool:
    """Add the bearings of one time step to the evidence for exchanges, in place; return whether any exchange is open.

    Evidence (log odds) is collected for pairs of identities with a bearing that contradicts its own, and for pairs for
    which it has begun.

    Args:
        first: first row of the time step.
        last: row after its last one.
        rows: all bearings.
        sensors: positions of the sensors.
        state: filters and evidence, changed in place.
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
            fresh = fresh and now - state.last[a, 0] <= MAX_AGE_S and now - state.last[b, 0] <= MAX_AGE_S
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
    """Return whether the evidence suffices that the labels of identities a and b are exchanged in sensor s.

    s = S, the number of sensors, means in all sensors. Less evidence is needed for an exchange back to the given
    labels.
    """
    S = len(state.identity)
    to_b, to_a = state.odds[s, a, b], state.odds[s, b, a]
    least = MIN_LOG_ODDS if s == S else MIN_LOG_ODDS_SENSOR
    if (s == S and (state.identity[:, a] == b).all()) or (s < S and state.identity[s, a] == b):
        least = MIN_LOG_ODDS_BACK
    return bool(to_b + to_a >= least and min(to_b, to_a) >= MIN_SHARE_EACH * least)


@kernel
def _decide(first: int, rows: LabelledRows, state: ContinuityState, identity: Ints, events: Floats) -> int:
    """Exchange the identities of labels with sufficient evidence, in place; return the number of events.

    Args:
        first: first row of the time step; earlier rows, back to the begin of an exchange, are corrected.
        rows: all bearings.
        state: filters and evidence, changed in place.
        identity: (n,) identity of each row's label, changed in place.
        events: (., 7) rows that are filled: `EXCHANGED`, begin [s], 0, a, b, sensor (number of sensors: all), 0.
    """
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
                state.contradicted[a, 0] = state.contradicted[b, 0] = math.inf
                state.rival[a, 0] = state.rival[b, 0] = math.inf
                for t in range(S + 1):
                    if s == S or t in (s, S):
                        state.odds[t, a, b] = state.odds[t, b, a] = 0.0
                        state.open_s[t, a, b] = math.inf
                events[n] = np.array([EXCHANGED, since, 0.0, float(a), float(b), float(s), 0.0])
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
    """Determine the identities of labelled bearings by the continuity of their motion.

    Args:
        rows: bearings of whole time steps.
        sensors: positions of the sensors.
        walk: motion model of the targets.
        state: filters after the rows before; changed in place.
        identity: (N,) identity of each row; those from `begun` on are written, earlier ones corrected, in place.
        against: (N,) whether a bearing contradicts the motion of its target; written from `begun` on.
        begun: first row that was not there before.

    Returns:
        (E, 7) events: kind, time [s]; of an exchange 0, both identities, the sensor (number of sensors: all) and 0; of
        a jump its speed, the identity, the factor of the motion's variance, the time at which the new position is
        confirmed, and the distance. Then the time of the earliest bearing that may still change its identity; inf
        without any.
    """
    N, n = len(rows.seconds), 0
    events = np.zeros((N + len(state.known) ** 2 * (len(sensors.x) + 1), 7))
    first = begun
    while first < N:
        last = first + 1
        while last < N and rows.seconds[last] == rows.seconds[first]:
            last += 1
        now = rows.seconds[first]
        for k in range(len(state.known)):
            if state.known[k] and now - state.recent[k, :, 0].max() > MAX_AGE_S:
                # After a pause a label begins again
                state.known[k], state.contradicted[k, 0], state.rival[k, 0] = 0, math.inf, math.inf
                state.contradicted[k, 2], state.agreed[k] = -math.inf, 0
            elif state.known[k] and now > state.at_s[k]:
                dt, state.at_s[k] = now - state.at_s[k], now
                _predict(state.mean[k], state.covariance[k], dt, state.scale[k], walk)
                if state.rival[k, 0] < math.inf:
                    _predict(state.rival_mean[k], state.rival_covariance[k], dt, state.scale[k], walk)
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
    """Update all filters by the bearings of one time step, in place; return the number of jumps.

    Args:
        first: first row of the step.
        last: row after its last one.
        rows: all bearings.
        identity: (n,) identity of each row's label.
        against: (n,) booleans, set for the rows of the step: the bearing contradicts the motion of its identity.
        sensors: positions of the sensors.
        walk: motion model of the targets.
        state: filters and rivals, changed in place.
        events: (., 7) rows that are filled for the jumps: kind, time [s], speed, identity, factor of the motion's
            variance, time at which the new position is confirmed, distance.
    """
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
        if rejected[k] > 0.0 and state.contradicted[k, 0] == math.inf:
            state.contradicted[k, 0] = now
            if min(state.agreed[k], state.confirmed[k]) >= MIN_CONFIRMED:
                state.contradicted[k, 1] = state.scale[k]
                state.contradicted[k, 2:6], state.contradicted[k, 6:] = state.last[k], state.before[k]
        elif accepted[k] > 0.0 and rejected[k] == 0.0 and state.rival[k, 0] == math.inf:
            state.contradicted[k, 0] = math.inf
        state.agreed[k] = 0 if rejected[k] > 0.0 else state.agreed[k] + int(accepted[k])
        if accepted[k] > 0.0 and rejected[k] == 0.0:
            # Bearings of one sensor alone agree with a wrong position, too
            state.confirmed[k] += int(accepted[k]) - 1
            state.before[k] = state.last[k]
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
    _take_rivals(first, last, rows, identity, sensors, state)
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
        _update(state.mean[k], state.covariance[k], r, rows, sensors)
        state.last[k] = _position(now, state.mean[k], state.covariance[k])
        state.accepted[k] += 1
    for k in range(K):
        variance = walk.variance * state.scale[k]
        if not state.known[k]:
            if _meet(state.recent[k], -math.inf, now, variance, sensors, state.mean[k], state.covariance[k]):
                state.known[k], state.accepted[k], state.confirmed[k], state.at_s[k] = 1, 0, 0, now
                state.last[k] = state.before[k] = _position(now, state.mean[k], state.covariance[k])
            continue
        since, m, P = state.contradicted[k, 0], state.rival_mean[k], state.rival_covariance[k]
        if state.rival[k, 0] < math.inf:
            n += _replace(k, now, state, events[n:])
        elif since < math.inf and _meet(state.recent[k], since, now, variance, sensors, m, P):
            state.rival[k, :4], state.rival[k, 4:] = _position(now, m, P), 0.0
    return n


@kernel
def _take_rivals(
    first: int, last: int, rows: LabelledRows, identity: Ints, sensors: SensorPositions, state: ContinuityState
) -> None:
    """Update the rival filters and their log odds by the bearings of one time step, in place.

    It is called before the filters themselves are updated.

    Args:
        first: first row of the step.
        last: row after its last one.
        rows: all bearings.
        identity: (n,) identity of each row's label.
        sensors: positions of the sensors.
        state: filters and rivals, changed in place.
    """
    for r in range(first, last):
        k = identity[r]
        if state.rival[k, 0] == math.inf or math.isnan(rows.azimuth[r]):
            continue
        s, azimuth, variance = rows.sensor[r], rows.azimuth[r], rows.variance[r]
        off, spread, _, _, _ = _innovation(state.mean[k], state.covariance[k], sensors, s, azimuth, variance)
        own, wide, _, _, _ = _innovation(state.rival_mean[k], state.rival_covariance[k], sensors, s, azimuth, variance)
        state.rival[k, 4] += _log_density(own, wide) - _log_density(off, spread)
        if own * own <= GATE_CHI2 * wide:
            state.rival[k, 5] += 1.0
            _update(state.rival_mean[k], state.rival_covariance[k], r, rows, sensors)


@kernel
def _replace(k: int, now: float, state: ContinuityState, events: Floats) -> int:
    """Replace the filter of identity k by its rival, or drop the rival, by the log odds; return the number of jumps.

    The number is 0 or 1.

    Args:
        k: identity.
        now: time [s].
        state: filters and rivals, changed in place.
        events: (., 7); a jump fills the first row: kind, time [s], speed, identity, factor of the motion's variance,
            time at which the new position is confirmed, distance.
    """
    rival, old = state.rival[k], state.contradicted[k]
    opened = min(state.open_s[:, k].min(), state.open_s[:, :, k].min()) < math.inf
    if rival[4] >= MIN_LOG_ODDS_RIVAL and rival[5] >= MIN_CONFIRMED and not opened:
        n = 0
        if old[2] > -math.inf:
            speed = min(_speed(old[2:6], rival), _speed(old[6:], rival))
            away = math.hypot(rival[1] - old[3], rival[2] - old[4])
            events[0] = np.array([JUMPED, old[0], speed, float(k), old[1], now, away])
            n = 1
        state.mean[k], state.covariance[k] = state.rival_mean[k], state.rival_covariance[k]
        state.last[k] = state.before[k] = _position(now, state.mean[k], state.covariance[k])
        state.accepted[k], state.agreed[k], state.confirmed[k] = int(rival[5]), 0, 0
        rival[0] = old[0] = math.inf
        old[2] = -math.inf
        return n
    if rival[4] <= -MIN_LOG_ODDS_RIVAL or now - rival[0] > MAX_AGE_S:
        rival[0] = old[0] = math.inf
    return 0


@kernel
def _position(now: float, mean: Floats, covariance: Floats) -> Floats:
    """Return (4,) time [s], x, y and trace of the position covariance of a filter at time `now`.

    `mean` (4,) and `covariance` (4, 4) are of x, y, vx, vy.
    """
    return np.array([now, mean[0], mean[1], covariance[0, 0] + covariance[1, 1]])


@kernel
def _speed(one: Floats, other: Floats) -> float:
    """Return the least speed between two positions, their distance less 2 standard deviations over the time between.

    Args:
        one: (4,) time [s], x, y and trace of the covariance of the earlier position.
        other: (4,) of the later one.
    """
    away = math.hypot(other[1] - one[1], other[2] - one[2])
    return float((away - JUMP_SIGMAS * math.sqrt(one[3] + other[3])) / max(other[0] - one[0], 1e-9))
