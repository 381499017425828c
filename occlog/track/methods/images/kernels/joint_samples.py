"""Filters with joint samples of all targets of a view: a Markov chain, and weights of whole samples.

The joint posterior of n targets is that of Khan, Balch, Dellaert, "An MCMC-based particle filter
for tracking multiple interacting targets" (ECCV 2004), the baseline of [Qu] Table 2:

    p(X | Z) ~ prod_i p(z | x_i) p(x_i | Z past) prod_{i<j} exp(-strength overlap(x_i, x_j))

The last factor, a Markov random field between neighbours, keeps two targets from the same position.
The chain changes one target at a time.  Its proposal is drawn from p(x_i | Z past), whatever
the state of the chain: the likelihoods of all proposals can be computed at once before it
runs, and the acceptance ratio needs only likelihoods and overlaps.
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.jit import kernel


@kernel
def overlap(one: Floats, two: Floats) -> float:
    """Return the overlap of two ellipses (5,), 0 (apart) to 1 (the smaller one is covered).

    It is the area common to two discs over that of the smaller disc. A disc has the centre of its ellipse, and as
    radius half the length of the ellipse's projection onto the line between the centres.
    """
    dx, dy = two[0] - one[0], two[1] - one[1]
    d, theta = math.hypot(dx, dy), math.atan2(dy, dx)
    r = math.hypot(one[2] * math.cos(theta - one[4]), one[3] * math.sin(theta - one[4]))
    s = math.hypot(two[2] * math.cos(theta - two[4]), two[3] * math.sin(theta - two[4]))
    small, large = min(r, s), max(r, s)
    if not d < r + s:
        return 0.0
    if d <= large - small:
        return 1.0
    # Where the chord through the meeting points crosses the line between the centres
    x = (d * d + small * small - large * large) / (2.0 * d)
    c, e = max(-1.0, min(1.0, x / small)), max(-1.0, min(1.0, (d - x) / large))
    half = small * math.sqrt(1.0 - c * c)
    area = small * small * math.acos(c) + large * large * math.acos(e) - d * half
    return min(max(area / (math.pi * small * small), 0.0), 1.0)


@kernel
def crowding(ellipse: Floats, pool: Floats, held: Ints, i: int) -> float:
    """Return the sum of the overlaps (0 to 1 each) of an ellipse (5,) with the ellipses of all targets but target `i`.

    Args:
        ellipse: (5,) position of target i, held or proposed.
        pool: (K, 5) ellipses of all initial positions and proposals.
        held: (n,) row of the pool at which each target is.
        i: number of the target, 0 to n - 1.
    """
    total = 0.0
    for j in range(held.shape[0]):
        if j != i:
            total += overlap(ellipse, pool[held[j]])
    return total


@kernel
def run_chain(
    pool: Floats, owner: Ints, log_likelihood: Floats, log_u: Floats, strength: float, burn: int, thin: int
) -> Ints:
    """Sample joint positions of n targets by Metropolis-Hastings, moving one target at a time (Khan et al. 2004).

    Proposals come from the targets' predictions, so that the acceptance ratio has only the likelihoods and the prior
    exp(-strength overlap) of each pair.

    Args:
        pool: (n + S, 5) ellipses: where targets 0 to n - 1 start, then what S moves propose.
        owner: (S,) target that each move changes, 0 to n - 1.
        log_likelihood: (n + S,) log likelihood of each ellipse of the pool for its target, finite.
        log_u: (S,) logarithms of draws from U(0, 1].
        strength: >= 0, strength of the prior against overlap.
        burn: moves before the first sample that is kept.
        thin: moves per sample that is kept, >= 1.

    Returns:
        ((S - burn) // thin, n) rows of the pool: the position of each target in each sample.
    """
    n = pool.shape[0] - owner.shape[0]
    held = np.arange(n)
    out = np.empty((max(owner.shape[0] - burn, 0) // thin, n), dtype=np.int64)
    for s in range(owner.shape[0]):
        i, new = owner[s], n + s
        # Acceptance ratio: likelihoods and prior; the proposal cancels
        gain = log_likelihood[new] - log_likelihood[held[i]]
        if strength > 0.0:
            gain -= strength * (crowding(pool[new], pool, held, i) - crowding(pool[held[i]], pool, held, i))
        if log_u[s] <= gain:
            held[i] = new
        kept = s + 1 - burn
        if kept > 0 and kept % thin == 0:
            out[kept // thin - 1] = held
    return out


@kernel
def crowding_of_samples(samples: Floats) -> Floats:
    """Return (N,) sums of the overlaps of all pairs of targets in each joint sample.

    `samples` (N, n, 5) has the ellipses of the n targets in N samples. An overlap is 0 (apart) to 1 (smaller one
    covered).
    """
    out = np.zeros(samples.shape[0])
    for k in range(samples.shape[0]):
        for i in range(samples.shape[1]):
            for j in range(i):
                out[k] += overlap(samples[k, i], samples[k, j])
    return out


def distinct_size(rows: Ints) -> Floats:
    """Return (n,) effective numbers of distinct samples of each target in a chain, 1 to N.

    The number is 1 / sum w^2, where equal samples count as one with their share w of the N samples.

    Args:
        rows: (N, n) position of each target in each sample, as a row of the pool (from `run_chain`).
    """
    out = np.empty(rows.shape[1])
    for i, column in enumerate(rows.T):
        counts = np.bincount(column).astype(np.float64)
        out[i] = counts.sum() ** 2 / np.dot(counts, counts)
    return out
