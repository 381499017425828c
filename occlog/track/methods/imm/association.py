"""Joint association of one array's bearings with several targets.

An event states for every target whether the array heard it, and with which bearing.  A bearing
is of one target, of two that are nearer to each other than the array can tell apart (they are
heard as one), or of no target (clutter).  All events are enumerated; targets that share no bearing are
independent and are enumerated separately.

[Lee] Sec. 3.2 lets every target's filter take any bearing, so that two filters can follow one
source; here a bearing that another target explains counts less, and hearing nothing counts too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.geometry.camera import wrap_angle
from occlog.core.numerics.jit import kernel

MAX_JOINT_EVENTS = 50_000
"""Maximum number of summed association events of a cluster; beyond it the least likely bearings are omitted."""
MIN_DENSITY_TO_CLUTTER_RATIO = 1e-9
"""A bearing with a density for a target below this share of the clutter's cannot be the target's: without this
gate all targets would share all bearings."""
NEAR_SIGMAS = 3.0
"""Two targets' bearings further apart than this, beyond the resolution, are not heard as one."""
ROOT_2PI = math.sqrt(2.0 * math.pi)


class BearingFit(NamedTuple):
    """Densities of an array's N bearings at the particles of one target: L particles under each of J motion models."""

    each: Floats  # (N, J, L) density of each bearing for each particle [1/rad]; 0 out of the array's range
    within: Bools  # (J, L) in range
    fit: Floats  # (N,) its mean over the particles
    reached: float  # weight of the particles in range
    at: Floats  # (J, L) bearing of each particle [rad]


class Direction(NamedTuple):
    """Gaussian prediction of a target's bearing at an array: circular mean and standard deviation [rad]."""

    centre: float  # circular mean of the particles' bearings [rad]
    spread: float  # standard deviation of them [rad]


class BearingAssociation(NamedTuple):
    """Probabilities of how K targets and N bearings of one array belong together, and the evidence of the bearings.

    A bearing is of one target (`alone`), of two that are heard as one (`shared`), or of none; a target may have no
    bearing (`unheard`).
    """

    alone: Floats  # (K, N) bearing i is of target k and no other
    unheard: Floats  # (K,) no bearing is of target k
    shared: Floats  # (K, K, N) bearing i is of k and of another; symmetric, 0 for k with itself
    log_evidence: float  # log density of all bearings [1/rad^N]


def bearing_fit(
    predicted: Floats, weights: Floats, *, bearing: Floats, sigma: Floats, position: Floats, reach: float
) -> BearingFit:
    """Return the densities of an array's bearings at the particles of one target.

    Args:
        predicted: (J, L, 4) particles [x, vx, y, vy], L under each of J motion models.
        weights: (J, L) weights of the particles, sum 1.
        bearing: (N,) that the array heard [rad]; may be none.
        sigma: (N,) their standard deviations [rad], > 0.
        position: (2,) of the array.
        reach: range of the array [length]; may be infinite.
    """
    within, reached = in_range(predicted, weights, position, reach)
    at = np.arctan2(predicted[..., 2] - position[1], predicted[..., 0] - position[0])
    each = density(at, within, bearing, sigma)
    return BearingFit(each, within, each.reshape(len(each), at.size) @ weights.ravel(), reached, at)


def in_range(predicted: Floats, weights: Floats, position: Floats, reach: float) -> tuple[Bools, float]:
    """Return (J, L) booleans: the particle is in the array's range, and the total weight of such particles.

    Args:
        predicted: (J, L, 4) particles [x, vx, y, vy].
        weights: (J, L) weights of the particles, sum 1.
        position: (2,) of the array.
        reach: its range [length]; may be infinite.
    """
    if math.isinf(reach):
        return np.ones(weights.shape, dtype=np.bool_), 1.0
    dx, dy = predicted[..., 0] - position[0], predicted[..., 2] - position[1]
    within = dx * dx + dy * dy <= reach * reach
    return within, float(weights[within].sum())


def direction(heard: BearingFit, weights: Floats) -> Direction:
    """Return the circular mean and standard deviation of a target's bearing at an array, from its weighted particles.

    Args:
        heard: has the bearing of each particle.
        weights: (J, L) weights of the particles, sum 1.
    """
    c, s = float(np.vdot(weights, np.cos(heard.at))), float(np.vdot(weights, np.sin(heard.at)))
    length = min(math.hypot(c, s), 1.0)
    return Direction(math.atan2(s, c), math.sqrt(-2.0 * math.log(max(length, 1e-12))))


def density(at: Floats, within: Bools, bearing: Floats, sigma: Floats) -> Floats:
    """Return (N, J, L) normal densities [1/rad] of N bearings at L particles under J models.

    Args:
        at: (J, L) azimuths of the particles from the sensor [rad], in [-pi, pi].
        within: (J, L) whether a particle is in the sensor's range; the density of others is 0.
        bearing: (N,) measured bearings [rad].
        sigma: (N,) their standard deviations [rad].
    """
    out = np.empty((len(bearing), *at.shape))
    for i, (a, s) in enumerate(zip(wrap_angle(bearing).tolist(), sigma.tolist(), strict=True)):
        off = np.abs(a - at)
        np.minimum(off, 2.0 * math.pi - off, out=off)
        off *= off
        off *= -0.5 / (s * s)
        np.exp(off, out=off)
        off *= 1.0 / (ROOT_2PI * s)
        np.multiply(off, within, out=out[i])
    return out


def merged_bearing_density(
    one: BearingFit, mine: Direction, other: Direction, *, bearing: Floats, sigma: Floats, resolution: float
) -> Floats:
    """Return (N, J, L) densities [1/rad] of bearings of two targets heard as one, at the first target's particles.

    A bearing is taken for the middle of the two targets. The second is within the resolution with the probability of
    its Gaussian prediction, and then anywhere there, which adds resolution^2 / 12 to the variance. All zero where the
    targets are too far apart.

    Args:
        one: bearings at the particles of the first target.
        mine: predicted bearing of the first target.
        other: predicted bearing of the second.
        bearing: (N,) that the array heard [rad].
        sigma: (N,) their standard deviations [rad].
        resolution: largest difference of bearings that the array hears as one [rad]; 0: none.
    """
    gap = abs(wrap_angle(np.array(other.centre - mine.centre)))
    if resolution <= 0.0 or gap > resolution + NEAR_SIGMAS * (mine.spread + other.spread):
        return np.zeros_like(one.each)
    off = wrap_angle(other.centre - one.at)
    near = merge_probability(np.ascontiguousarray(off), max(other.spread, 1e-9), resolution)
    widened = np.sqrt(sigma**2 + resolution**2 / 12.0)
    return density(one.at, one.within, bearing, widened) * near


@kernel
def merge_probability(off: Floats, sigma: float, limit: float) -> Floats:
    """Return (J, L) probabilities that normals of mean `off` (J, L) and standard deviation sigma are within ± limit."""
    out = np.empty_like(off)
    scale = 1.0 / (math.sqrt(2.0) * sigma)
    for m in range(off.shape[0]):
        for l in range(off.shape[1]):  # noqa: E741 - the paper's letter
            out[m, l] = 0.5 * (math.erf((limit - off[m, l]) * scale) + math.erf((limit + off[m, l]) * scale))
    return out


def joint_data_association(
    alone: Floats, unheard: Floats, shared: Floats, separate: Floats, clutter: Floats
) -> BearingAssociation:
    """Return the association probabilities of N bearings and K targets, by enumeration of all joint events.

    Clusters of targets with common bearings are enumerated separately.

    Args:
        alone: (K, N) density of bearing i and that target k is heard with it [1/rad]; 0: impossible.
        unheard: (K,) probability that target k is not heard.
        shared: (K, K, N) density of bearing i and that both targets are heard with it [1/rad], symmetric.
        separate: (K, K) probability that two targets that are both heard are heard apart, symmetric.
        clutter: (N,) density of bearing i if it is clutter [1/rad], > 0.
    """
    K, N = alone.shape
    out = BearingAssociation(np.zeros((K, N)), np.ones(K), np.zeros((K, K, N)), float(np.log(clutter).sum()))
    evidence = out.log_evidence
    ratio = np.maximum(alone, shared.max(axis=1, initial=0.0)) / clutter
    for group, own in _groups(ratio > MIN_DENSITY_TO_CLUTTER_RATIO, ratio):
        some = np.ix_(group, group)
        a, u, s, total = _all_events(
            alone[group] / clutter,
            unheard[group],
            shared[some] / clutter,
            separate[some],
            own,
        )
        out.alone[group], out.unheard[group], out.shared[some] = a, u, s
        evidence += math.log(total) if total > 0.0 else -math.inf
    return out._replace(log_evidence=evidence)


def _clusters(possible: Bools) -> list[Ints]:
    """Return clusters of targets (arrays of indices) that have possible bearings in common, directly or through others.

    `possible` (K, N): bearing i may be of target k.
    """
    left, found = list(range(len(possible))), []
    while left:
        mine = [left.pop(0)]
        heard = possible[mine[0]].copy()
        grown = True
        while grown:
            joins = [k for k in left if (possible[k] & heard).any()]
            grown = bool(joins)
            for k in joins:
                left.remove(k)
                mine.append(k)
                heard |= possible[k]
        found.append(np.array(sorted(mine), dtype=np.int64))
    return found


def _groups(possible: Bools, ratio: Floats) -> list[tuple[Ints, Bools]]:
    """Return groups of targets that are enumerated together, with at most `MAX_JOINT_EVENTS` events each.

    If a cluster has more, the least likely bearing of a target with alternatives is dropped, which separates targets; a
    target's last bearing is dropped only if no target has an alternative.

    Args:
        possible: (K, N) booleans: bearing i may be of target k.
        ratio: (K, N) density of that over the density of clutter.

    Returns:
        For each group the indices of its k targets, and (k, N) booleans: bearings that remain possible.
    """
    left, found = _clusters(possible), []
    keep = possible.copy()
    while left:
        group = left.pop()
        own = keep[group]
        if np.prod(1.0 + own.sum(axis=1)) <= MAX_JOINT_EVENTS:
            found.append((group, own))
            continue
        several = own & (own.sum(axis=1, keepdims=True) > 1)
        options = several if several.any() else own
        best = np.where(own, ratio[group], 0.0).max(axis=1, keepdims=True)
        k, i = np.unravel_index(np.argmin(np.where(options, ratio[group] / best, np.inf)), own.shape)
        keep[group[k], i] = False
        left += [group[part] for part in _clusters(keep[group])]
    return found


@kernel
def _all_events(
    alone: Floats, unheard: Floats, shared: Floats, separate: Floats, possible: Bools
) -> tuple[Floats, Floats, Floats, float]:
    """Return marginal probabilities over all association events of K targets and N bearings, and their total weight.

    Densities are in units of the clutter density. If no event is possible, no target is heard and the total is 0.

    Args:
        alone: (K, N) relative density of bearing i and that target k is heard with it.
        unheard: (K,) probability that target k is not heard.
        shared: (K, K, N) relative density of bearing i and that both targets are heard with it.
        separate: (K, K) probability that two targets that are both heard are heard apart.
        possible: (K, N) booleans: bearing i may be of target k.

    Returns:
        (K, N) probabilities that bearing i is of target k alone; (K,) that target k is not heard; (K, K, N) that
        bearing i is of both; the sum of the weights of all events.
    """
    K, N = alone.shape
    p_alone, p_unheard, p_shared = np.zeros((K, N)), np.zeros(K), np.zeros((K, K, N))
    choice = np.full(K, -1, dtype=np.int64)  # bearing of each target; -1: unheard
    total = 0.0
    while True:
        weight = _event(choice, alone, unheard, shared, separate)
        if weight > 0.0:
            total += weight
            for k in range(K):
                if choice[k] < 0:
                    p_unheard[k] += weight
                    continue
                other = _partner(choice, k)
                if other < 0:
                    p_alone[k, choice[k]] += weight
                else:
                    p_shared[k, other, choice[k]] += weight
        k = 0
        while k < K:  # the next event, like the digits of a number
            choice[k] += 1
            while choice[k] < N and not possible[k, choice[k]]:
                choice[k] += 1
            if choice[k] < N:
                break
            choice[k] = -1
            k += 1
        if k == K:
            break
    if total > 0.0:
        p_alone /= total
        p_unheard /= total
        p_shared /= total
    else:
        p_unheard[:] = 1.0
    return p_alone, p_unheard, p_shared, total


@kernel
def _partner(choice: Ints, k: int) -> int:
    """Return the index of another target with target k's bearing in an association event; -1 if there is none.

    `choice` (K,) is the index of each target's bearing; -1: it is not heard. Target k must be heard.
    """
    for other in range(choice.shape[0]):
        if other != k and choice[other] == choice[k]:
            return other
    return -1


@kernel
def _event(choice: Ints, alone: Floats, unheard: Floats, shared: Floats, separate: Floats) -> float:
    """Return the weight of one association event of K targets and N bearings; 0 if three targets share a bearing.

    Densities are in units of the clutter density.

    Args:
        choice: (K,) index of each target's bearing; -1: it is not heard.
        alone: (K, N) relative density of bearing i and that target k is heard with it.
        unheard: (K,) probability that target k is not heard.
        shared: (K, K, N) relative density of bearing i and that both targets are heard with it.
        separate: (K, K) probability that two targets that are both heard are heard apart.
    """
    K = choice.shape[0]
    weight = 1.0
    for k in range(K):
        if choice[k] < 0:
            weight *= unheard[k]
            continue
        other, users = -1, 0
        for b in range(K):
            if b != k and choice[b] == choice[k]:
                other, users = b, users + 1
        if users > 1:
            return 0.0
        if users == 0:
            weight *= alone[k, choice[k]]
            for b in range(k):
                if choice[b] >= 0 and _partner(choice, b) < 0:
                    weight *= separate[k, b]
        elif other < k:
            weight *= shared[k, other, choice[k]]
        if weight == 0.0:
            return 0.0
    return weight


def reweigh(
    weights: Floats,
    heard: BearingFit,
    detection: float,
    alone: Floats,
    unheard: float,
    shared: Sequence[tuple[Floats, Floats]],
) -> Floats:
    """Return (J, L) normalised weights of one target's particles after the association of an array's N bearings.

    If no particle is left with a weight, they are those before.

    Args:
        weights: (J, L) weights before.
        heard: densities of the bearings at the target's particles.
        detection: probability that a target in range is heard.
        alone: (N,) probabilities that bearing i is of this target alone.
        unheard: probability that the target is not heard.
        shared: for each other target, (N,) probabilities that bearing i is of both, and (N, J, L) densities of it, from
            `merged_bearing_density`.
    """
    silent = 1.0 - detection * heard.within
    out = unheard * silent / max(float(np.vdot(weights, silent)), 1e-300)
    for each, chance in ((heard.each, alone), *((density, chance) for chance, density in shared)):
        for i in np.flatnonzero(chance > 0.0):
            mass = float(np.vdot(weights, each[i]))
            if mass > 0.0:
                out = out + (chance[i] / mass) * each[i]
    new = weights * out
    total = float(new.sum())
    return np.asarray(new / total) if total > 0.0 else weights
