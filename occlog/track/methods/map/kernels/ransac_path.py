"""Which lines of sight are of one target: the most probable choice along a trajectory, by multiple hypotheses.

A hypothesis is a Kalman filter with the motion of the trajectory ([Rahimi] Eq. 1) and a choice of true lines of sight
so far.  Each line of sight splits it into one that believes and one that does not; the most probable ones go on, and of
those that are nearly the same the better one (Reid 1979, An algorithm for tracking multiple targets, IEEE TAC 24(6),
of one target).  Costs are -2 log of likelihoods, relative to that of a line of sight that is met exactly:

* one that is accepted costs e^2 / S + log(S / R), e the distance of the predicted position from it, S the variance of
  that, R the part of the measurement;
* one that is not costs k^2, so that beyond k standard deviations of a position that is well known it counts as false.

Hypotheses begin where two lines of sight cross, or at several distances along one, initially, or later at a price.
The residual e is linear in the position; only R depends on the distance.  Time and memory are linear in the states.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel

from .problem import ChainSteps

BEAM_WIDTH = 20
"""Hypotheses that are kept."""
MAX_CROSSINGS = 5
"""Crossings of a state at which hypotheses begin."""
START_RANGES = 6
"""Distances along a line of sight that crosses no other, at which hypotheses begin."""
MIN_CROSSINGS = 8
"""Crossings with lines of sight of states around are tried where there are fewer in all."""
NEIGHBOUR_TIME_S = 3.0
"""Seconds within which they are."""
MIN_CROSSING_SINE = 1e-3
"""Lines of sight at a smaller angle do not cross."""
MERGE_DISTANCE_SIGMAS = 0.3
"""Hypotheses that differ in all coordinates by fewer standard deviations are the same."""
JUMP_COST_OUTLIERS = 2.0
"""A target that is lost and found elsewhere costs as much as this many false lines of sight, and the new position."""
BITS = 62
"""Maximum number of lines of sight of a state; others are rejected."""


class BearingHalfLines(NamedTuple):
    """N bearings as half-lines from their sensors, sorted by state.

    `step` (N,): index of the state; `sensor` (N,): number of the sensor; origin `position` (N, 2) and unit `direction`
    (N, 2); the variance across the line at distance d is a d^2 + b, with `a` [rad^2] and `b` [scene unit^2]; `reach`
    (N,): farthest distance.
    """

    step: Ints  # (N,)
    sensor: Ints  # (N,) lines of one sensor do not cross
    position: Floats  # (N, 2)
    direction: Floats  # (N, 2) unit vectors
    a: Floats  # (N,) [rad^2]
    b: Floats  # (N,) squared length
    reach: Floats  # (N,) farthest distance


class HypothesisBeam(NamedTuple):
    """The `BEAM_WIDTH` hypotheses of a multiple-hypothesis search at one state; unused entries have cost inf.

    Each has a filtered state `x` (4,) x, vx, y, vy with covariance `P` (4, 4), `cost` (-2 log likelihood), `bits`:
    which bearings of this state it accepts, and `parent`: its hypothesis at the state before (-1: none).
    """

    x: Floats  # (BEAM_WIDTH, 4)
    P: Floats  # (BEAM_WIDTH, 4, 4)
    cost: Floats  # (BEAM_WIDTH,)
    bits: Ints  # (BEAM_WIDTH,) which lines of sight of the state are accepted
    parent: Ints  # (BEAM_WIDTH,) which hypothesis of the state before; -1: none


@kernel
def off_line2(rays: BearingHalfLines, n: int, x: float, y: float, extra: float) -> tuple[float, float]:
    """Return the squared Mahalanobis distance of a position from bearing `n`, and the cost log(1 + extra / variance).

    The first is inf behind the sensor and beyond its reach.

    Args:
        rays: the bearings as half-lines.
        n: index of the bearing.
        x: first coordinate of the position.
        y: second coordinate of the position.
        extra: variance of the position across the line.
    """
    dx, dy = x - rays.position[n, 0], y - rays.position[n, 1]
    along = rays.direction[n, 0] * dx + rays.direction[n, 1] * dy
    if along <= 0.0 or along > rays.reach[n]:
        return math.inf, 0.0
    across = rays.direction[n, 0] * dy - rays.direction[n, 1] * dx
    variance = max(rays.a[n] * along * along + rays.b[n], 1e-300)
    return across * across / (variance + extra), math.log1p(extra / variance)


@kernel
def off_line(rays: BearingHalfLines, n: int, x: float, y: float, extra: float, k2: float) -> float:
    """Return the cost of bearing `n` at position (x, y), at most `k2`, that of a false bearing.

    `extra` is the variance of the position across the line.
    """
    distance2, vague = off_line2(rays, n, x, y, extra)
    return min(distance2 + vague, k2)


@kernel
def crossing(rays: BearingHalfLines, i: int, j: int, moved2: float) -> tuple[float, float, float, float]:
    """Return the intersection of two bearings: x, y, largest standard deviation, area of uncertainty.

    Standard deviation and area are inf if they do not intersect within reach.

    Args:
        rays: the bearings as half-lines.
        i: index of the bearing at the time that the intersection is for.
        j: index of a bearing at the same or another time, at which the target may have been elsewhere.
        moved2: variance, per axis, of the target's motion between these times.
    """
    sine = rays.direction[i, 0] * rays.direction[j, 1] - rays.direction[i, 1] * rays.direction[j, 0]
    if abs(sine) < MIN_CROSSING_SINE:
        return 0.0, 0.0, math.inf, math.inf
    dx, dy = rays.position[j, 0] - rays.position[i, 0], rays.position[j, 1] - rays.position[i, 1]
    far_i = (dx * rays.direction[j, 1] - dy * rays.direction[j, 0]) / sine
    far_j = (dx * rays.direction[i, 1] - dy * rays.direction[i, 0]) / sine
    if far_i <= 0.0 or far_j <= 0.0 or far_i > rays.reach[i] or far_j > rays.reach[j]:
        return 0.0, 0.0, math.inf, math.inf
    x, y = rays.position[i, 0] + far_i * rays.direction[i, 0], rays.position[i, 1] + far_i * rays.direction[i, 1]
    var_i = rays.a[i] * far_i * far_i + rays.b[i]
    var_j = rays.a[j] * far_j * far_j + rays.b[j] + moved2
    return x, y, math.sqrt(var_i + var_j) / abs(sine), math.sqrt(var_i * var_j) / abs(sine)


@kernel
def _around(first: Ints, seconds: Floats, t: int, longest: float) -> tuple[int, int]:
    """Return the range (begin, end) of the bearings of state `t`, extended to nearby states if it has few.

    Args:
        first: (T + 1,) index of the first bearing of each state.
        seconds: (T,) times of the states.
        t: index of the state.
        longest: states farther away in time are not used [s].
    """
    T = seconds.shape[0]
    a, b = t, t
    while first[b + 1] - first[a] < MIN_CROSSINGS:
        before = seconds[t] - seconds[a - 1] if a > 0 else math.inf
        after = seconds[b + 1] - seconds[t] if b < T - 1 else math.inf
        if min(before, after) > longest:
            break
        if before <= after:
            a -= 1
        else:
            b += 1
    return first[a], first[b + 1]


@kernel
def candidates(
    rays: BearingHalfLines, first: Ints, seconds: Floats, t: int, speed: float, widest: float, k2: float, out: Floats
) -> int:
    """Write the best intersections of bearings for a state to `out` (MAX_CROSSINGS, 7); return their number.

    Columns: x, y, standard deviation, area, cost of the nearby bearings, and the indices of the two bearings; sorted by
    cost.

    Args:
        rays: the bearings as half-lines.
        first: (T + 1,) index of the first bearing of each state.
        seconds: (T,) times of the states.
        t: index of the state.
        speed: typical speed of the target.
        widest: standard deviation beyond which an intersection is uninformative.
        k2: cost of a false bearing.
        out: changed in place.
    """
    begin, end = _around(first, seconds, t, NEIGHBOUR_TIME_S)
    count = 0
    for i in range(first[t], first[t + 1]):
        for j in range(begin, end):
            own = first[t] <= j < first[t + 1]
            if rays.sensor[i] == rays.sensor[j] or (own and j <= i):
                continue
            away = speed * (seconds[rays.step[j]] - seconds[t])
            x, y, sigma, area = crossing(rays, i, j, away * away)
            if sigma > widest:
                continue
            # Consensus: the cost of all lines of sight around
            cost = 0.0
            for n in range(begin, end):
                away = speed * (seconds[rays.step[n]] - seconds[t])
                cost += off_line(rays, n, x, y, away * away, k2)
            # Keep the best ones, by rising cost
            if count == MAX_CROSSINGS and cost >= out[MAX_CROSSINGS - 1, 4]:
                continue
            m = min(count, MAX_CROSSINGS - 1)
            while m > 0 and out[m - 1, 4] > cost:
                out[m] = out[m - 1]
                m -= 1
            out[m, 0], out[m, 1], out[m, 2], out[m, 3], out[m, 4] = x, y, sigma, area, cost
            out[m, 5], out[m, 6] = i, j
            count = min(count + 1, MAX_CROSSINGS)
    return count


@kernel
def empty_beam() -> HypothesisBeam:
    """Return a beam without hypotheses: all costs are inf."""
    return HypothesisBeam(
        np.zeros((BEAM_WIDTH, 4)),
        np.zeros((BEAM_WIDTH, 4, 4)),
        np.full(BEAM_WIDTH, math.inf),
        np.zeros(BEAM_WIDTH, dtype=np.int64),
        np.full(BEAM_WIDTH, -1, dtype=np.int64),
    )


@kernel
def _put(to: HypothesisBeam, m: int, source: HypothesisBeam, s: int) -> None:
    """Copy hypothesis s of the beam `source` to entry m of the beam `to`."""
    to.x[m], to.P[m], to.cost[m] = source.x[s], source.P[s], source.cost[s]
    to.bits[m], to.parent[m] = source.bits[s], source.parent[s]


@kernel
def _predict(beam: HypothesisBeam, A: Floats, sigma: Floats) -> None:
    """Predict all hypotheses by one motion step, in place.

    A (4, 4) is the transition matrix, `sigma` (4, 4) the noise covariance.
    """
    for m in range(BEAM_WIDTH):
        if beam.cost[m] < math.inf:
            beam.x[m] = A @ beam.x[m]
            beam.P[m] = A @ beam.P[m] @ A.T + sigma


@kernel
def inlier_cost(rays: BearingHalfLines, n: int, x: Floats, P: Floats) -> tuple[float, float, float]:
    """Return the cost of accepting bearing `n`, the position's distance from it (left: > 0), and the variance of that.

    The state has mean x (4,) x, vx, y, vy and covariance P (4, 4). The cost is inf behind the sensor or out of range.
    """
    c, s = rays.direction[n, 0], rays.direction[n, 1]
    dx, dy = x[0] - rays.position[n, 0], x[2] - rays.position[n, 1]
    along = c * dx + s * dy
    vague = c * c * P[0, 0] + 2.0 * c * s * P[0, 2] + s * s * P[2, 2]
    if along <= 0.0 or along > rays.reach[n] + 3.0 * math.sqrt(vague):
        return math.inf, 0.0, 1.0
    across = c * dy - s * dx
    R = max(rays.a[n] * (along * along + vague) + rays.b[n], 1e-300)
    S = R + s * s * P[0, 0] - 2.0 * c * s * P[0, 2] + c * c * P[2, 2]
    return across * across / S + math.log(S / R), across, S


@kernel
def _update(beam: HypothesisBeam, m: int, rays: BearingHalfLines, n: int, across: float, S: float) -> None:
    """Update hypothesis `m` by bearing `n`, which it accepts (Kalman update), in place; its cost is not changed.

    `across` is the distance of its position from the line (left: > 0), `S` the variance of that.
    """
    c, s = rays.direction[n, 0], rays.direction[n, 1]
    gain = np.empty(4)
    for i in range(4):
        gain[i] = (c * beam.P[m, i, 2] - s * beam.P[m, i, 0]) / S
    for i in range(4):
        beam.x[m, i] -= gain[i] * across
        for j in range(4):
            beam.P[m, i, j] -= gain[i] * gain[j] * S


@kernel
def _split(beam: HypothesisBeam, rays: BearingHalfLines, n: int, bit: int, k2: float, spare: HypothesisBeam) -> None:
    """Split all hypotheses on whether a bearing is true, and keep the most probable ones, in place.

    Args:
        beam: changed in place.
        rays: the bearings as half-lines.
        n: index of the bearing.
        bit: number of the bearing within its state.
        k2: cost of a false bearing.
        spare: space for hypotheses; overwritten.
    """
    mask = np.int64(1) << bit
    costs, across, S = np.full(2 * BEAM_WIDTH, math.inf), np.zeros(BEAM_WIDTH), np.ones(BEAM_WIDTH)
    for m in range(BEAM_WIDTH):
        if beam.cost[m] == math.inf:
            continue
        if beam.bits[m] & mask:  # it began with this line of sight
            costs[2 * m] = beam.cost[m]
            continue
        costs[2 * m] = beam.cost[m] + k2
        extra, across[m], S[m] = inlier_cost(rays, n, beam.x[m], beam.P[m])
        costs[2 * m + 1] = beam.cost[m] + extra
    order = np.argsort(costs)
    for m in range(BEAM_WIDTH):
        which = order[m]
        old = which // 2
        _put(spare, m, beam, old)
        spare.cost[m] = costs[which]
        if which % 2 == 1 and costs[which] < math.inf:
            spare.bits[m] |= mask
            _update(spare, m, rays, n, across[old], S[old])
    for m in range(BEAM_WIDTH):
        _put(beam, m, spare, m)


@kernel
def _begin(
    beam: HypothesisBeam, x: float, y: float, spread: Floats, speed: float, cost: float, bits: int, parent: int
) -> None:
    """Start a hypothesis at (x, y), with velocity 0, in place of the most costly one of the beam.

    Args:
        beam: changed in place.
        x: first coordinate.
        y: second coordinate.
        spread: (3,) variances xx, xy, yy of the position.
        speed: standard deviation of the velocity per axis.
        cost: cost of the hypothesis.
        bits: accepted bearings of this state, one bit each.
        parent: hypothesis at the state before; -1: none.
    """
    m = int(np.argmax(beam.cost))
    beam.x[m], beam.P[m] = 0.0, 0.0
    beam.x[m, 0], beam.x[m, 2] = x, y
    beam.P[m, 0, 0], beam.P[m, 0, 2], beam.P[m, 2, 0], beam.P[m, 2, 2] = spread[0], spread[1], spread[1], spread[2]
    beam.P[m, 1, 1] = beam.P[m, 3, 3] = speed * speed
    beam.cost[m], beam.bits[m], beam.parent[m] = cost, bits, parent


@kernel
def _births(
    beam: HypothesisBeam,
    rays: BearingHalfLines,
    first: Ints,
    seconds: Floats,
    t: int,
    price: float,
    parent: int,
    ground: Floats,
    k2: float,
) -> None:
    """Start hypotheses at the best intersections of bearings of a state, or along its bearings if none intersect.

    Args:
        beam: changed in place.
        rays: the bearings as half-lines.
        first: (T + 1,) index of the first bearing of each state.
        seconds: (T,) times of the states.
        t: index of the state.
        price: cost of beginning here.
        parent: hypothesis at the state before; -1: none.
        ground: (3,) typical speed, standard deviation at which an intersection is uninformative, and extent of the
            scene.
        k2: cost of a false bearing.
    """
    found, spread = np.empty((MAX_CROSSINGS, 7)), np.empty(3)
    speed, extent2 = ground[0], ground[2] ** 2
    count = candidates(rays, first, seconds, t, speed, ground[1], k2, found)
    for m in range(count):
        i, j = int(found[m, 5]), int(found[m, 6])
        bits = np.int64(1) << min(i - first[t], BITS)
        if first[t] <= j < first[t + 1]:
            bits |= np.int64(1) << min(j - first[t], BITS)
        spread[0] = spread[2] = found[m, 2] ** 2
        spread[1] = 0.0
        rare = 2.0 * math.log(max(extent2 / max(found[m, 3], 1e-300), 1.0))
        _begin(beam, found[m, 0], found[m, 1], spread, speed, price + rare, bits, parent)
    if count:
        return
    for i in range(first[t], first[t + 1]):
        c, s, far = rays.direction[i, 0], rays.direction[i, 1], min(rays.reach[i], ground[2])
        for r in range(START_RANGES):
            d = far * 0.6 ** (START_RANGES - r)
            along, across = (0.35 * d) ** 2, rays.a[i] * d * d + rays.b[i]
            spread[0] = c * c * along + s * s * across
            spread[1] = c * s * (along - across)
            spread[2] = s * s * along + c * c * across
            rare = 2.0 * math.log(max(extent2 / math.sqrt(max(along * across, 1e-300)), 1.0))
            x, y = rays.position[i, 0] + d * c, rays.position[i, 1] + d * s
            _begin(beam, x, y, spread, speed, price + rare, np.int64(1) << min(i - first[t], BITS), parent)


@kernel
def _merge(beam: HypothesisBeam) -> None:
    """Merge nearly equal hypotheses in place: the more costly one gets cost inf."""
    for m in range(BEAM_WIDTH):
        for n in range(m):
            if beam.cost[m] == math.inf or beam.cost[n] == math.inf:
                continue
            similar = True
            for i in range(4):
                away2 = (beam.x[m, i] - beam.x[n, i]) ** 2
                if away2 > MERGE_DISTANCE_SIGMAS**2 * min(beam.P[m, i, i], beam.P[n, i, i]):
                    similar = False
                    break
            if similar:
                beam.cost[m if beam.cost[m] >= beam.cost[n] else n] = math.inf


@kernel
def agreed_path(
    rays: BearingHalfLines, first: Ints, seconds: Floats, steps: ChainSteps, ground: Floats, k: float
) -> tuple[Floats, Bools, float]:
    """Find the most probable choice of true bearings along a trajectory, by a multiple-hypothesis search.

    Args:
        rays: N bearings as half-lines.
        first: (T + 1,) index of the first bearing of each state, N at the end.
        seconds: (T,) times of the states.
        steps: the motion chain.
        ground: (3,) typical speed, standard deviation beyond which an intersection is unused, and extent of the scene.
        k: standard deviations beyond which a bearing counts as false.

    Returns:
        Filtered states (T, 4) x, vx, y, vy of the best hypothesis, accepted bearings (N,), and its cost.
    """
    T, k2 = seconds.shape[0], k * k
    parent, bits = np.full((T, BEAM_WIDTH), -1, dtype=np.int8), np.zeros((T, BEAM_WIDTH), dtype=np.int64)
    positions = np.zeros((T, BEAM_WIDTH, 4), dtype=np.float32)
    beam, spare = empty_beam(), empty_beam()
    beam.x[0], beam.P[0], beam.cost[0] = steps.mean, steps.spread, 0.0
    skipped = 0.0
    for t in range(T):
        if t > 0:
            _predict(beam, steps.A[steps.kind[t - 1]], steps.sigma[steps.kind[t - 1]])
        for m in range(BEAM_WIDTH):
            beam.bits[m], beam.parent[m] = 0, m
        if first[t + 1] > first[t]:
            # Begin: all lines of sight before are false, or the target was lost
            best = int(np.argmin(beam.cost))
            lost = beam.cost[best] + JUMP_COST_OUTLIERS * k2
            _births(beam, rays, first, seconds, t, min(skipped, lost), best if lost < skipped else -1, ground, k2)
            # Accept or reject each line of sight
            for n in range(first[t], min(first[t + 1], first[t] + BITS)):
                _split(beam, rays, n, n - first[t], k2, spare)
            _merge(beam)
            skipped += k2 * (first[t + 1] - first[t])
        parent[t], bits[t], positions[t] = beam.parent, beam.bits, beam.x
    # Follow the most probable hypothesis back
    X, inlier = np.zeros((T, 4)), np.zeros(rays.step.shape[0], dtype=np.bool_)
    m = int(np.argmin(beam.cost))
    least = beam.cost[m]
    for back in range(T):
        t = T - 1 - back
        if m < 0:
            X[t] = X[t + 1]
            continue
        X[t] = positions[t, m]
        for n in range(first[t], min(first[t + 1], first[t] + BITS)):
            inlier[n] = (bits[t, m] >> (n - first[t])) & 1 == 1
        m = parent[t, m]
    return X, inlier, least
