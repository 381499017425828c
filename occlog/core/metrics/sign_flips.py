"""The exact test of paired differences: how often as much comes out when each pair is exchanged, or not, by chance.

Of two runs that do not differ each part (a recording, a stretch of time) could as well have come out the other way
round, so that the difference d_r of each part is as probable as -d_r.  Of all 2^N choices of signs the share of those
with a sum at least as large as the one that was observed is a p that keeps every level exactly, however the
differences are distributed (Fisher 1935, sec. 21; Pitman 1937).  No standard error is estimated: with the signs the
sum of squares stays, so that Student's t gives the same order.

Against a margin m it is d_r - m w_r that has either sign, with w_r the part's share.  A choice of signs that turns the
parts of a set S then has as large a sum exactly where m is at least the mean of S, sum(d_r) / sum(w_r): the means of
all subsets say all p and the confidence interval at once (the typical values of Hartigan 1969), and neither can
contradict the other.  Where there are too many subsets, some are drawn at random, and the observed one is counted with
them, so that p keeps its level, too (Phipson and Smyth 2010).
"""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats

ALL = 15
"""Most parts of which all subsets are taken."""
DRAWS = 2**ALL - 1
"""Subsets that are drawn at random of more parts."""
PER_DRAW = 512
"""Subsets of which the sums are made at a time."""
ROUNDING = 1e-9
"""Means that are this near to a margin, as a share of the largest of both, are at it."""


def subset_means(differences: Floats, weights: Floats, rng: np.random.Generator) -> Floats:
    """(D,) sorted means of subsets of parts, the empty one left out.

    Args:
        differences: (N,) what each part adds to a difference; N >= 1.
        weights: (N,) shares of the parts, > 0, with the sum 1.
        rng: draws subsets where there are more than `ALL` parts.
    """
    count = len(differences)
    if count <= ALL:
        sums = np.zeros((2, 1))
        for each in zip(differences, weights, strict=True):
            sums = np.concatenate([sums, sums + np.array(each)[:, None]], axis=1)
        return np.sort(sums[0, 1:] / sums[1, 1:])
    parts = np.column_stack([differences, weights])
    found = []
    for first in range(0, DRAWS, PER_DRAW):
        size = min(PER_DRAW, DRAWS - first), -(-count // 8)
        taken = np.unpackbits(rng.integers(0, 256, size, dtype=np.uint8), axis=1, count=count)
        taken[~taken.any(axis=1)] = 1  # none of N > `ALL` parts: once in 2^N draws
        found.append(taken @ parts)
    sums = np.concatenate(found)
    return np.sort(sums[:, 0] / sums[:, 1])


def chance_above(means: Floats, margin: float) -> float:
    """Probability of a difference at least as far above a margin, of parts whose differences lie about it evenly."""
    least = margin + ROUNDING * max(abs(margin), float(np.abs(means[[0, -1]]).max()))
    return float((np.searchsorted(means, least, side="right") + 1) / (len(means) + 1))


def chance_below(means: Floats, margin: float) -> float:
    """The same of a difference at least as far below."""
    return chance_above(-means[::-1], -margin)


def interval(means: Floats, level: float) -> tuple[float, float]:
    """The margins that the test rejects on neither side, at half of what the level leaves: (low, high).

    Unbounded where there are so few parts that no margin is rejected.
    """
    # Rejected are margins with fewer than k means at or below them
    k = int(np.floor(0.5 * (1.0 - level) * (len(means) + 1) + ROUNDING))
    return (float(means[k - 1]), float(means[-k])) if k > 0 else (-np.inf, np.inf)
