"""The most probable path through modes of a likelihood: a Viterbi algorithm of second order.

The likelihood of what is measured in a short time may have several modes, each a Gaussian of the position.  A path
passes through one mode of each time.  Where its velocity changes by white noise, the second difference

    e = x_3 - x_2 - r (x_2 - x_1),  r = (t_3 - t_2) / (t_2 - t_1)

of the true positions is Gaussian with variance q (t_3 - t_2)^2 (t_3 - t_1) / 3 per axis, to which the covariances of
the modes add; a path costs half the sum of squares of second differences by their covariances, and what each mode
costs.  States of the chain are pairs of modes that follow each other, so that the cheapest path, and the cheapest one
through every pair, are exact
(Viterbi 1967, Error bounds for convolutional codes, IEEE Trans. Inf. Theory 13(2); He 1988, Extended Viterbi algorithm
for second order hidden Markov process, ICPR).  Time is linear in the length, and cubic in the modes of one time.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.jit import kernel

MIN_DISTANCE_SIGMAS = 3.0
"""Modes of a time that are nearer, in standard deviations of their difference, belong to the same path."""


class ModeChain(NamedTuple):
    """N modes (possible positions) at W times, sorted by time, at least one per time.

    `first` (W + 1,) is the first mode of each time, `seconds` (W,) the times, `xy` (N, 2) and `covariance` (N, 2, 2)
    the positions, `cost` (N,) - log of each mode's probability, up to a constant of its time.
    """

    first: Ints  # (W + 1,) first mode of each time
    seconds: Floats  # (W,) ascending
    xy: Floats  # (N, 2)
    covariance: Floats  # (N, 2, 2)
    cost: Floats  # (N,) - log of the probability of each mode, up to a constant of its time


class PairCosts(NamedTuple):
    """Costs of the cheapest paths through each of P pairs of modes at successive times, sorted by time.

    `first` (W,) is the first pair of times t and t + 1, the last entry P; pair index = first + mode of t times number
    of modes of t + 1 + mode of t + 1. `before` (P,) is the least cost up to and including a pair, `after` (P,) of what
    follows, `back` and `ahead` (P,) the neighbouring pairs on these paths (-1: none).
    """

    first: Ints  # (W,) first pair of modes of times t and t + 1; the last entry is P
    before: Floats  # (P,) cost of the cheapest path up to a pair, pair included
    after: Floats  # (P,) cost of the cheapest continuation
    back: Ints  # (P,) pair before; -1: none
    ahead: Ints  # (P,) pair after; -1: none


@kernel
def half_square(e0: float, e1: float, s00: float, s01: float, s11: float) -> float:
    """Return half the squared Mahalanobis length of a vector (e0, e1) with the covariance [[s00, s01], [s01, s11]]."""
    det = max(s00 * s11 - s01 * s01, 1e-300)
    return 0.5 * (s11 * e0 * e0 - 2.0 * s01 * e0 * e1 + s00 * e1 * e1) / det


@kernel
def turn_cost(chain: ModeChain, i: int, j: int, k: int, a: float, b: float, q: float) -> float:
    """Return the cost of the second difference of three successive modes under white acceleration.

    Args:
        chain: the modes.
        i: index of the mode of the first time.
        j: index of the mode of the second.
        k: index of the mode of the third.
        a: time from the first to the second [s].
        b: time from the second to the third [s].
        q: variance per axis that the velocity gains in a second.
    """
    r = b / a
    e0 = chain.xy[k, 0] - chain.xy[j, 0] - r * (chain.xy[j, 0] - chain.xy[i, 0])
    e1 = chain.xy[k, 1] - chain.xy[j, 1] - r * (chain.xy[j, 1] - chain.xy[i, 1])
    C, w, v = chain.covariance, (1.0 + r) ** 2, r * r
    moved = q * b * b * (a + b) / 3.0
    return half_square(
        e0,
        e1,
        C[k, 0, 0] + w * C[j, 0, 0] + v * C[i, 0, 0] + moved,
        C[k, 0, 1] + w * C[j, 0, 1] + v * C[i, 0, 1],
        C[k, 1, 1] + w * C[j, 1, 1] + v * C[i, 1, 1] + moved,
    )


@kernel
def start_cost(chain: ModeChain, i: int, j: int, a: float, q: float, velocity: Floats, spread: Floats) -> float:
    """Return the cost of the difference of the first two modes under the prior of the velocity.

    Args:
        chain: the modes.
        i: index of the mode of the first time.
        j: index of the mode of the second.
        a: time between the two [s].
        q: variance per axis that the velocity gains in a second.
        velocity: (2,) prior mean of the velocity.
        spread: (2, 2) prior covariance of the velocity.
    """
    C, moved = chain.covariance, q * a**3 / 3.0
    return half_square(
        chain.xy[j, 0] - chain.xy[i, 0] - a * velocity[0],
        chain.xy[j, 1] - chain.xy[i, 1] - a * velocity[1],
        C[i, 0, 0] + C[j, 0, 0] + a * a * spread[0, 0] + moved,
        C[i, 0, 1] + C[j, 0, 1] + a * a * spread[0, 1],
        C[i, 1, 1] + C[j, 1, 1] + a * a * spread[1, 1] + moved,
    )


@kernel
def pair_costs(chain: ModeChain, q: float, velocity: Floats, spread: Floats) -> PairCosts:
    """Return the costs of the cheapest path through every pair of modes of successive times, by dynamic programming.

    Args:
        chain: modes of W >= 2 times.
        q: variance per axis that the velocity gains in a second.
        velocity: (2,) prior mean of the initial velocity.
        spread: (2, 2) prior covariance of the initial velocity.
    """
    W, m = chain.seconds.shape[0], chain.first
    first = np.zeros(W, dtype=np.int64)
    for t in range(W - 1):
        first[t + 1] = first[t] + (m[t + 1] - m[t]) * (m[t + 2] - m[t + 1])
    P = first[W - 1]
    before, after = np.full(P, math.inf), np.full(P, math.inf)
    back, ahead = np.full(P, -1, dtype=np.int64), np.full(P, -1, dtype=np.int64)
    for i in range(m[0], m[1]):
        for j in range(m[1], m[2]):
            step = start_cost(chain, i, j, chain.seconds[1] - chain.seconds[0], q, velocity, spread)
            before[(i - m[0]) * (m[2] - m[1]) + j - m[1]] = chain.cost[i] + chain.cost[j] + step
    # Forwards: the cheapest pair before each
    for t in range(1, W - 1):
        a, b = chain.seconds[t] - chain.seconds[t - 1], chain.seconds[t + 1] - chain.seconds[t]
        for j in range(m[t], m[t + 1]):
            for k in range(m[t + 1], m[t + 2]):
                p = first[t] + (j - m[t]) * (m[t + 2] - m[t + 1]) + k - m[t + 1]
                for i in range(m[t - 1], m[t]):
                    o = first[t - 1] + (i - m[t - 1]) * (m[t + 1] - m[t]) + j - m[t]
                    cost = before[o] + turn_cost(chain, i, j, k, a, b, q) + chain.cost[k]
                    if cost < before[p]:
                        before[p], back[p] = cost, o
    # Backwards: the cheapest pair after each
    after[first[W - 2] :] = 0.0
    for t in range(W - 2, 0, -1):
        a, b = chain.seconds[t] - chain.seconds[t - 1], chain.seconds[t + 1] - chain.seconds[t]
        for i in range(m[t - 1], m[t]):
            for j in range(m[t], m[t + 1]):
                o = first[t - 1] + (i - m[t - 1]) * (m[t + 1] - m[t]) + j - m[t]
                for k in range(m[t + 1], m[t + 2]):
                    p = first[t] + (j - m[t]) * (m[t + 2] - m[t + 1]) + k - m[t + 1]
                    cost = after[p] + turn_cost(chain, i, j, k, a, b, q) + chain.cost[k]
                    if cost < after[o]:
                        after[o], ahead[o] = cost, p
    return PairCosts(first, before, after, back, ahead)


def modes_of_path(chain: ModeChain, pairs: PairCosts, pair: int) -> Ints:
    """Return (W,) indices of the modes, one per time, of the cheapest path through the pair with index `pair`.

    `pairs` are the costs of all pairs of modes at successive times, from `pair_costs`.
    """
    path, one = [pair], pair
    while (one := int(pairs.back[one])) >= 0:
        path.append(one)
    path.reverse()
    one = pair
    while (one := int(pairs.ahead[one])) >= 0:
        path.append(one)
    own = np.array(path) - pairs.first[:-1]
    width = np.diff(chain.first)[1:]
    last = chain.first[-2] + own[-1] % width[-1]
    return np.append(chain.first[:-2] + own // width, last)


def distinct_paths(chain: ModeChain, pairs: PairCosts, most: int, gap: float) -> list[Ints]:
    """Return the modes (W,) of the cheapest path, then of cheapest paths through a mode distinct from all paths before.

    Args:
        chain: the modes.
        pairs: cheapest path through every pair of modes, from `pair_costs`.
        most: largest number of paths.
        gap: paths that cost more than the cheapest plus this are omitted.
    """
    through = pairs.before + pairs.after
    time = np.repeat(np.arange(len(pairs.first) - 1), np.diff(pairs.first))
    own, width = np.arange(len(through)) - pairs.first[time], np.diff(chain.first)[1:][time]
    modes = np.column_stack([chain.first[time] + own // width, chain.first[time + 1] + own % width])
    of_time = np.repeat(np.arange(len(chain.seconds)), np.diff(chain.first))
    apart, found = np.ones(len(chain.cost), dtype=np.bool_), list[Ints]()
    for pair in np.argsort(through, kind="stable").tolist():
        if len(found) == most or through[pair] > through.min() + gap:
            break
        if apart[modes[pair]].any():
            found.append(modes_of_path(chain, pairs, pair))
            own = found[-1][of_time]
            away, spread = chain.xy - chain.xy[own], chain.covariance + chain.covariance[own]
            apart &= np.einsum("ki,kij,kj->k", away, np.linalg.inv(spread), away) > MIN_DISTANCE_SIGMAS**2
    return found
